"""What an item is: the options that `BiDexDataset`, `BiDexCases` and `BiDexStream` share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec

from bidexdata.errors import BadConfig, MissingExtra, UnknownName
from bidexdata.formats.clouds import CLOUDS
from bidexdata.formats.tables import ARM_COLUMNS
from bidexdata.loaders.normals import OF_CLOUD

DEFAULT_FIELDS = ("hand_pos", "hand_quat_wxyz", "joints", "size_mm", "size")
POSE_OF_OBJECT = ("object_pos", "object_quat_wxyz")
HAND_POSES = ("hand_pos", "hand_quat_wxyz")
ARM_ANGLES = ("arm_joints", "arm_path")
"""Columns that place hands in the world."""
AUGMENTATIONS = ("yaw", "mirror")
_WORDS: Mapping[str, tuple[str, ...]] = {
    "frame": ("object", "world"),
    "clouds": ("expand", "unique"),
    "quat_order": ("wxyz", "xyzw"),
    "rotation": ("quat", "6d", "matrix"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ItemOptions:
    """Fields, frames and forms of an item; the data sets' arguments say what each means."""

    fields: tuple[str, ...] = DEFAULT_FIELDS
    frame: str = "object"
    cloud: str | None = "cloud_solid"
    points: int = 1024
    normals: bool = False
    clouds: str = "expand"
    quat_order: str = "wxyz"
    rotation: str = "quat"
    augment: tuple[str, ...] = ()
    seed: int = 0
    """Of the augmentation."""

    def __post_init__(self) -> None:
        for name, words in _WORDS.items():
            if getattr(self, name) not in words:
                raise UnknownName(name, str(getattr(self, name)), words)
        for name in self.augment:
            if name not in AUGMENTATIONS:
                raise UnknownName("augmentation", str(name), AUGMENTATIONS)
        if self.cloud is not None and self.cloud not in CLOUDS:
            raise UnknownName("cloud", str(self.cloud), CLOUDS)
        if self.normals and self.cloud != OF_CLOUD:
            raise BadConfig(f"normals are those of {OF_CLOUD}, and cloud={self.cloud!r}")
        moved = [n for n in self.fields if n in ARM_COLUMNS]
        if moved and self.augment:
            raise BadConfig(
                f"augment moves hands and object, and arms cannot follow: leave out augment or {moved[0]}"
            )
        angles = [n for n in self.fields if n in ARM_ANGLES]
        beside = [n for n in self.fields if n in HAND_POSES]
        beside += [] if self.cloud is None else [self.cloud]
        if angles and beside and self.frame != "world":
            raise BadConfig(
                f"{angles[0]} moves arms that stand in the world, and {beside[0]} is asked for in the frame "
                f'of the object: add frame="world", or leave out {angles[0]}'
            )
        if self.points < 1:
            raise BadConfig(f"points={self.points}; a cloud has at least one")
        if self.rotation != "quat" and self.quat_order != "wxyz":
            raise BadConfig(
                f"quat_order={self.quat_order!r} orders quaternions, and rotation="
                f"{self.rotation!r} gives none; leave one out"
            )

    def helpers(self, *, on_table: bool) -> tuple[str, ...]:
        """Columns that are needed besides `fields` to make an item.

        Args:
            on_table: Whether some objects have another pose than the identity.
        """
        wanted: list[str] = ["size"] if self.cloud is not None else []
        in_object = self.frame == "object"
        if on_table and (self.augment or (self.cloud is not None and not in_object)):
            wanted += POSE_OF_OBJECT
        if on_table and in_object and set(HAND_POSES) & set(self.fields):
            wanted += [*POSE_OF_OBJECT, *HAND_POSES]
        if self.augment and set(HAND_POSES) & set(self.fields):
            wanted += HAND_POSES
        return tuple(n for n in dict.fromkeys(wanted) if n not in self.fields)


def names_of(option: str, given: Sequence[str]) -> tuple[str, ...]:
    """The names that an option lists.

    Raises:
        BadConfig: It is one text, which would be taken letter by letter.
    """
    if isinstance(given, str):
        raise BadConfig(f"{option} is a list of names: {option}=[{given!r}], not {given!r}")
    return tuple(given)


def require_torch() -> None:
    """Refuse to go on without torch.

    Raises:
        MissingExtra: torch is not installed.
    """
    if find_spec("torch") is None:
        raise MissingExtra("torch")
