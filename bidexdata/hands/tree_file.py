"""A hand from the `tree.json` of a release: all that kinematics needs, without the hand's meshes."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from bidexdata.errors import BadConfig, Contradiction, PathNotFound
from bidexdata.hands.model import Hand

if TYPE_CHECKING:
    import mujoco

_INTEGERS = ("body_parent", "body_joint", "contact_body", "sphere_body", "self_pairs")
_NAMES = (
    "body_names",
    "joint_names",
    "actuator_names",
    "contact_names",
    "contact_finger",
    "contact_part",
)
_TEXT = ("name", "side", "spec_hash", "licence")
_NOT_THERE = ("make_spec", "make_mounted", "prefix", "licence_text")
_WIDTHS = {
    **dict.fromkeys(("body_pos", "joint_axis", "contact_pos", "contact_normal", "sphere_pos"), 3),
    **{"body_quat_wxyz": 4, "self_pairs": 2},
}
"""Length of the last axis, which an empty list does not tell."""


def hand_of_release(root: Path, side: str) -> Hand:
    """Read the hand of one side from a release folder.

    Raises:
        PathNotFound: The folder holds no hand of this side.
        Contradiction: The file does not describe a hand.
    """
    found = sorted(root.glob(f"hands/*/{side}/tree.json"))
    if not found:
        raise PathNotFound(root / "hands", f"the tree.json of a {side} hand")
    return read_hand(found[0])


def read_hand(path: Path) -> Hand:
    """Read a hand from its `tree.json`; it cannot be simulated, for its meshes are not there.

    Raises:
        Contradiction: The file does not describe a hand.
    """
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
        return hand_of_tree(tree, _NoModel(path))
    except (OSError, ValueError, KeyError, TypeError) as err:
        raise Contradiction(f"{path}: not the tree of a hand ({err!r})") from err


def hand_of_tree(tree: Mapping[str, Any], make_spec: Callable[[], mujoco.MjSpec]) -> Hand:
    """Build a hand from what `tree.json` holds and a function that gives its model.

    Raises:
        KeyError: A field is missing.
        ValueError: One has another shape or kind.
        TypeError: The same.
    """
    values = {
        f.name: _value(f.name, tree[f.name])
        for f in dataclasses.fields(Hand)
        if f.name not in _NOT_THERE
    }
    prefix = tree["prefix"] if "prefix" in tree else _prefix(values)
    return Hand(**values, make_spec=make_spec, prefix=prefix)


@dataclasses.dataclass(frozen=True)
class _NoModel:
    path: Path

    def __call__(self) -> NoReturn:
        raise BadConfig(
            f"{self.path} describes a hand without its meshes; load_hand(NAME, SIDE) has the model"
        )


def _value(name: str, value: Any) -> Any:
    if name in _TEXT:
        return str(value)
    if name in _NAMES:
        return tuple(str(v) for v in value)
    if name == "fingers":
        return {str(k): tuple(v) for k, v in value.items()}
    array = np.asarray(value, np.int32 if name in _INTEGERS else np.float64)
    return array.reshape(-1, _WIDTHS[name]) if name in _WIDTHS else array


def _prefix(values: dict[str, Any]) -> str:
    """What all names of bodies and joints begin with, up to an underscore: of trees before schema 1.3."""
    names = (*values["body_names"], *values["joint_names"])
    head = names[0][: names[0].find("_") + 1]
    return head if all(n.startswith(head) for n in names) else ""
