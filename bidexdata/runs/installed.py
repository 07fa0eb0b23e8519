"""Hands and rigs of this installation that the headers of a release name, refused where others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bidexdata.errors import NotUsable
from bidexdata.record import HandHeader
from bidexdata.record.batch import ArmHeader

if TYPE_CHECKING:
    from bidexdata.arms.robot import Robot
    from bidexdata.hands.model import Hand, Side


def hand_here(
    header: HandHeader, path: Path, load: Callable[[str, Side], Hand] | None = None
) -> Hand:
    """Load the hand of this installation that a header names.

    Args:
        header: Of the release at `path`.
        path: For messages.
        load: How; `hands.load_hand` when omitted.

    Raises:
        NotUsable: There is none, or its joints are others.
    """
    from bidexdata.hands import load_hand

    side = "left" if header.side == "left" else "right"
    hand = (load or load_hand)(header.name, side)
    if hand.joint_names != header.joint_names or hand.root_body != header.root_body:
        raise NotUsable(
            f"{path}: its {header.side} hand {header.name!r} has other joints or another root body "
            "than the hand of that name here; use the version of bidexdata that made it"
        )
    return hand


def robot_here(header: ArmHeader, hands: Sequence[Hand], path: Path) -> Robot:
    """Mount hands on the rig of this installation that a header names.

    Args:
        header: Of the first arm of the release at `path`.
        hands: The release's, in the order of the H axis.
        path: For messages.

    Raises:
        NotUsable: There is none, or it has changed.
    """
    from bidexdata.arms.registry import load_rig
    from bidexdata.arms.robot import mount_robot

    robot = mount_robot(load_rig(header.rig), tuple(hands))
    if robot.digest != header.rig_hash:
        raise NotUsable(
            f"{path}: its rig {header.rig!r} is another than that of this name here; use the "
            "version of bidexdata that made it"
        )
    return robot
