"""What a folder of exported motions says of the rig: `rig.json`, and where bases and hands are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bidexdata.runs.arm_folder import RIG_FILE, arms_folder

if TYPE_CHECKING:
    from bidexdata.record.batch import HandHeader
    from bidexdata.runs.browse import Browsable


def rig_file(source: Browsable) -> Path:
    """The `rig.json` of the arms that are meant, of a run or a release."""
    from bidexdata.formats.rig_files import RIGS

    if source.kind == "run":
        return arms_folder(source.path, source.rig) / RIG_FILE
    return source.path / RIGS / source.rig / RIG_FILE


def rig_lines(spec: Mapping[str, Any], hands: Sequence[HandHeader]) -> Iterator[str]:
    """Say where the bases of the arms stand, and how the hands are mounted.

    Args:
        spec: Plain data of the rig's spec.
        hands: Left and right.
    """
    yield "`rig.json` is the rig in full, under `spec`, with keys as docs/own_rig.md has them. Where the origins of the"
    yield "arms' models stand in `world` (position [m], quaternion wxyz), and how the hands are mounted:"
    yield ""
    for hand in hands:
        arm = spec.get("right_arm" if hand.side == "right" else "arm") or spec.get("arm", {})
        place = spec.get(hand.side, {})
        yield f"- {hand.side} base, {arm.get('source', 'a model')}: {_pose(place)}"
        mounts = spec.get("mounts", {})
        mount = mounts.get(hand.name, mounts.get("*", {}))
        what = mount.get("top")
        part = (
            "its palm frame"
            if what is None
            else f"the body `{what}` of its model (its own pose there is replaced)"
        )
        yield f"- {hand.side} hand {hand.name}: {part} in the frame of the arm's `{arm.get('flange', 'flange')}`: {_pose(mount)}"


def _pose(plain: Mapping[str, Any]) -> str:
    pos = plain.get("pos", (0, 0, 0))
    quat = plain.get("quat_wxyz", (1, 0, 0, 0))
    return f"({', '.join(f'{v:g}' for v in pos)}), ({', '.join(f'{v:.8g}' for v in quat)})"
