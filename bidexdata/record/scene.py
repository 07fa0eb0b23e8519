"""Scene: one object at one size in one pose and setting."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

from bidexdata.errors import UnknownChoice

Setting = Literal["floating", "tabletop"]


def setting_of(text: str) -> Setting:
    """Read a setting.

    Raises:
        UnknownChoice: There is none of this name.
    """
    for known in get_args(Setting):
        if text == known:
            return known
    raise UnknownChoice("--setting", text, get_args(Setting))


@dataclass(frozen=True, slots=True)
class Scene:
    """Where an object is while it is grasped.

    A floating object has the identity pose. On a table the surface is z = 0 and the object frame's
    origin lies at x = y = 0.
    """

    object_id: str
    size_mm: int
    """Bounding-box diagonal of the simulated solid in the object frame [mm]."""
    setting: Setting = "floating"
    rest_pose: int = -1
    """Number of the object's rest pose on a table; -1 when floating."""
    object_pos: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Origin of the object frame in the world [m]."""
    object_quat_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

    @property
    def size(self) -> float:
        """Bounding-box diagonal [m]."""
        return self.size_mm / 1000

    @property
    def scene_id(self) -> str:
        """`<object_id>/<size_mm>/float` or `<object_id>/<size_mm>/table<k>`."""
        tail = "float" if self.setting == "floating" else f"table{self.rest_pose}"
        return f"{self.object_id}/{self.size_mm}/{tail}"


class SceneParts(NamedTuple):
    """What a scene_id says."""

    object_id: str
    size_mm: int
    rest_pose: int
    """-1 when floating."""

    @property
    def setting(self) -> Setting:
        """Floating, or on a table."""
        return "floating" if self.rest_pose < 0 else "tabletop"


def scene_parts(scene_id: str) -> SceneParts:
    """Take a scene_id apart; the inverse of `Scene.scene_id`, but for the pose.

    >>> scene_parts("mug-0a1b2c3d/500/table1")
    SceneParts(object_id='mug-0a1b2c3d', size_mm=500, rest_pose=1)
    """
    object_id, size_mm, place = scene_id.rsplit("/", 2)
    pose = -1 if place == "float" else int(place.removeprefix("table"))
    return SceneParts(object_id, int(size_mm), pose)
