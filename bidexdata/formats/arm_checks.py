"""Laws of the arm solutions of a release: statuses, paths inside limits, hands where grasps are.

Each function returns what it counted, or raises `Contradiction` with what is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bidexdata.errors import Contradiction
from bidexdata.formats.rig_files import hand_poses, read_rig_files
from bidexdata.formats.row_groups import aligned
from bidexdata.formats.tables import arms_tables
from bidexdata.frames import matrix_from_quat
from bidexdata.record import GraspBatch, Status
from bidexdata.record.batch import fill_value
from bidexdata.record.fields import FIELDS, KEY_FRAMES
from bidexdata.record.status import ARM_STATUSES
from bidexdata.wording import counted

if TYPE_CHECKING:
    from bidexdata.formats.release import Release

NONE_ASKED = fill_value(FIELDS["arm_status"])
"""`arm_status` of a row that the stage `arms` has not seen."""
ANGLE = 1e-4
"""By how much float32 may take an angle beyond its limit, or a step from what is stated [rad]."""
ACCEPT = {"accept_pos": 1e-3, "accept_rot": math.radians(0.5)}
"""How far a hand may be from where the grasp has it [m] [rad], where the rig does not say."""
LARGEST = {"accept_pos": 0.01, "accept_rot": 0.1}
"""What a rig may say of it at most: the solver takes no more."""
SLACK = 1.1
"""Factor beyond what the solver accepted, for what float32 and other engines add."""
PATH = {"lift": 0.10, "standoff": 0.12, "largest_step": 0.2, "squeeze_palm": "moves"}
"""What a rig says of motions; these where it does not [m] [m] [rad]."""
SAME = {"ik_error_pos": 1e-5, "ik_error_rot": 1e-4}
"""By how much stored errors may differ from what is counted here: float32 at a metre [m] [rad]."""
_STANDOFF = KEY_FRAMES.index("standoff")


class _Solved(NamedTuple):
    ids: list[str]
    grasps: GraspBatch
    arms: GraspBatch

    def refuse(self, bad: Any, text: str) -> None:
        if np.any(bad):
            first = self.ids[int(np.flatnonzero(bad)[0])]
            raise Contradiction(f"grasp {first}: {text} ({int(np.sum(bad))} such rows)")

    def select(self, mask: np.ndarray) -> _Solved:
        ids = [i for i, keep in zip(self.ids, mask, strict=True) if keep]
        return _Solved(ids, self.grasps.select(mask), self.arms.select(mask))


def arm_rows(release: Release) -> str:
    """Check statuses, and of every motion its angles, times, steps and limits."""
    if not release.rig:
        return "none"
    rig = read_rig_files(release.path, release.header.arms)
    rows = motions = 0
    for group in _groups(release):
        status = group.arms["arm_status"]
        known = np.isin(status, [NONE_ASKED, Status.OK, *ARM_STATUSES])
        group.refuse(~known, "its arm_status is none of the statuses of arms")
        lost = (group.grasps["synth_status"] != Status.OK) & (status != NONE_ASKED)
        group.refuse(lost & (status != Status.NO_GRASP), "has no grasp, and arms that reach for it")
        rows += int((status != NONE_ASKED).sum())
        ok = group.select(status == Status.OK)
        motions += len(ok.ids)
        if ok.ids:
            _check_motions(ok, rig.document)
    return f"{counted(motions, 'motion')} of {counted(rows, 'row')} inside their limits"


def arm_poses(release: Release) -> str:
    """Place the hands from the stored angles, and compare them with the stored grasps and errors."""
    if not release.rig:
        return "none"
    document = read_rig_files(release.path, release.header.arms).document
    count, largest = 0, 0.0
    for group in _groups(release):
        ok = group.select(group.arms["arm_status"] == Status.OK)
        for h in range(len(release.header.arms)) if ok.ids else ():
            largest = max(largest, _check_hand(ok, h, document))
        count += len(ok.ids)
    return f"hands of {counted(count, 'motion')} at most {1e3 * largest:.2f} mm from their grasps"


def _check_hand(ok: _Solved, h: int, document: Mapping[str, Any]) -> float:
    """Check where one arm has its hand at the key frames; the largest distance from there [m]."""
    arm = ok.arms.header.arms[h]
    accept_pos, accept_rot = _accepted(document)
    q = ok.arms["arm_joints"][:, h, :, : len(arm.joint_names)].astype(np.float64)
    placed = [hand_poses(document["chains"][arm.side], q[:, k]) for k in range(len(KEY_FRAMES))]
    wanted, largest = _wanted(ok.grasps, h, _path(document)), 0.0
    for name, (pos, rot) in wanted.items():
        k = KEY_FRAMES.index(name)
        off = np.linalg.norm(placed[k][0] - pos, axis=-1)
        angle = _turn(placed[k][1], rot)
        where = f"the {arm.side} hand is not at its {name}"
        ok.refuse((off > accept_pos) | (angle > accept_rot), where)
        largest = max(largest, float(off.max()))
        for column, counted_here in (("ik_error_pos", off), ("ik_error_rot", angle)):
            near = np.abs(ok.arms[column][:, h, k] - counted_here) <= SAME[column]  # False for NaN
            ok.refuse(~near, f"its {column} is not what the {arm.side} hand is off at its {name}")
    pos, rot = placed[_STANDOFF]
    before, turned = wanted["pregrasp"]
    far = _beyond(pos - before, _path(document)["standoff"] + accept_pos)
    far |= _turn(rot, turned) > accept_rot
    ok.refuse(far, f"the {arm.side} hand is not at a stand-off of its pre-grasp")
    within = ok.arms["ik_error_pos"][:, h, _STANDOFF] <= accept_pos
    within &= ok.arms["ik_error_rot"][:, h, _STANDOFF] <= accept_rot
    ok.refuse(~within, f"the {arm.side} hand misses its stand-off by more than was accepted")
    return largest


def _wanted(
    grasps: GraspBatch, h: int, path: Mapping[str, Any]
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Where a hand is to be at the key frames that a grasp decides: (N, 3) and (N, 3, 3)."""
    pos = grasps["hand_pos"][:, h].astype(np.float64)
    quat = grasps["hand_quat_wxyz"][:, h].astype(np.float64)
    rot = matrix_from_quat(quat / np.linalg.norm(quat, axis=-1, keepdims=True))
    pregrasp, grasp, squeeze = ((pos[:, s], rot[:, s]) for s in range(3))
    if path["squeeze_palm"] == "fixed":
        squeeze = grasp
    lift = squeeze[0] + path["lift"] * np.array([0.0, 0.0, 1.0]), squeeze[1]
    return {"pregrasp": pregrasp, "grasp": grasp, "squeeze": squeeze, "lift": lift}


def _beyond(away: np.ndarray, distance: float) -> np.ndarray:
    """Which ways (N, 3) [m] go farther than a distance; up they may, out of the table."""
    below = np.concatenate([away[:, :2], np.minimum(away[:, 2:], 0.0)], axis=1)
    return np.linalg.norm(below, axis=1) > distance


def _turn(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Angle between rotations, (N,) [rad]."""
    trace = np.einsum("nij,nij->n", first, second)
    return np.arccos(np.clip((trace - 1) / 2, -1, 1))


def _path(document: Mapping[str, Any]) -> Mapping[str, Any]:
    return {**PATH, **document["config"].get("path", {})}


def _accepted(document: Mapping[str, Any]) -> tuple[float, float]:
    """How far a hand may be from where the grasp has it: distance [m] and angle [rad]."""
    stated = document["config"].get("ik", {})
    pos, rot = (min(stated.get(k, ACCEPT[k]), LARGEST[k]) for k in ("accept_pos", "accept_rot"))
    return SLACK * pos, SLACK * rot


def _check_motions(ok: _Solved, document: Mapping[str, Any]) -> None:
    chains, most = document["chains"], _path(document)["largest_step"]
    path = ok.arms["arm_path"]
    time = ok.arms["arm_time"]
    ok.refuse(~np.isfinite(time).all(axis=1), "its arm_time is not finite")
    ok.refuse(
        (time[:, 0] != 0) | (np.diff(time) <= 0).any(axis=1), "its arm_time does not rise from 0"
    )
    steps = np.nanmax(np.abs(np.diff(path, axis=2)), axis=(1, 2, 3), initial=0.0)
    ok.refuse(np.abs(steps - ok.arms["arm_step"]) > ANGLE, "its arm_step is not that of its path")
    ok.refuse(steps > most + ANGLE, f"a joint turns by more than {most:g} rad from knot to knot")
    ends = np.cumsum([0, *ok.arms.header.arms[0].knots])
    keys = ok.arms["arm_joints"]
    same = (path[:, :, ends] == keys) | (np.isnan(path[:, :, ends]) & np.isnan(keys))
    ok.refuse(
        ~same.all(axis=(1, 2, 3)), "its arm_joints are not those of its path at the key frames"
    )
    for h, arm in enumerate(ok.arms.header.arms):
        own = len(arm.joint_names)
        chain = chains[arm.side]
        low, high = np.array(chain["lower"]) - ANGLE, np.array(chain["upper"]) + ANGLE
        for angles in (path[:, h], ok.arms["arm_joints"][:, h]):
            inside = (angles[..., :own] >= low) & (angles[..., :own] <= high)  # False for NaN
            ok.refuse(
                ~inside.all(axis=(1, 2)), f"angles of the {arm.side} arm are beyond its limits"
            )
            ok.refuse(~np.isnan(angles[..., own:]).all(axis=(1, 2)), "padded angles are not NaN")


def _groups(release: Release) -> Iterator[_Solved]:
    grasps = ["grasp_id", "synth_status", "hand_pos", "hand_quat_wxyz"]
    (table,) = arms_tables(release.header)
    for configuration in release.configurations:
        for split in release.split_names:
            for first, second in aligned(
                release, {"grasps": grasps, table: None}, configuration, split
            ):
                if first.num_rows:
                    ids = first.column("grasp_id").to_pylist()
                    yield _Solved(ids, GraspBatch.from_arrow(first), GraspBatch.from_arrow(second))
