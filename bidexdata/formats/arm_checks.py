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
STAGE_OF = {"pregrasp": 0, "grasp": 1, "squeeze": 2}
"""Key frames at which the hands are where a stage of the grasp has them."""


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
            _check_motions(ok, rig.document["chains"])
    return f"{counted(motions, 'motion')} of {counted(rows, 'row')} inside their limits"


def arm_poses(release: Release) -> str:
    """Place the hands from the stored angles, and compare them with the stored grasps."""
    if not release.rig:
        return "none"
    document = read_rig_files(release.path, release.header.arms).document
    names = [name for name in STAGE_OF if name != "squeeze" or _palm_moves(document)]
    accept_pos, accept_rot = _accepted(document)
    count, largest = 0, 0.0
    for group in _groups(release):
        ok = group.select(group.arms["arm_status"] == Status.OK)
        for h, arm in enumerate(release.header.arms):
            for name in names if ok.ids else ():
                q = ok.arms["arm_joints"][:, h, KEY_FRAMES.index(name), : len(arm.joint_names)]
                pos, rot = hand_poses(document["chains"][arm.side], q.astype(np.float64))
                stage = STAGE_OF[name]
                off = np.linalg.norm(pos - ok.grasps["hand_pos"][:, h, stage], axis=-1)
                wanted = matrix_from_quat(ok.grasps["hand_quat_wxyz"][:, h, stage].astype(float))
                trace = np.einsum("nij,nij->n", rot, wanted)
                angle = np.arccos(np.clip((trace - 1) / 2, -1, 1))
                where = f"the {arm.side} hand is not at its {name}"
                ok.refuse((off > accept_pos) | (angle > accept_rot), where)
                largest = max(largest, float(off.max()))
        count += len(ok.ids)
    return f"hands of {counted(count, 'motion')} at most {1e3 * largest:.2f} mm from their grasps"


def _accepted(document: Mapping[str, Any]) -> tuple[float, float]:
    """How far a hand may be from where the grasp has it: distance [m] and angle [rad]."""
    stated = document["config"].get("ik", {})
    pos, rot = (min(stated.get(k, ACCEPT[k]), LARGEST[k]) for k in ("accept_pos", "accept_rot"))
    return SLACK * pos, SLACK * rot


def _palm_moves(document: Mapping[str, Any]) -> bool:
    return document["config"].get("path", {}).get("squeeze_palm", "moves") == "moves"


def _check_motions(ok: _Solved, chains: Mapping[str, Any]) -> None:
    path = ok.arms["arm_path"]
    time = ok.arms["arm_time"]
    ok.refuse(~np.isfinite(time).all(axis=1), "its arm_time is not finite")
    ok.refuse(
        (time[:, 0] != 0) | (np.diff(time) <= 0).any(axis=1), "its arm_time does not rise from 0"
    )
    steps = np.nanmax(np.abs(np.diff(path, axis=2)), axis=(1, 2, 3), initial=0.0)
    ok.refuse(np.abs(steps - ok.arms["arm_step"]) > ANGLE, "its arm_step is not that of its path")
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
