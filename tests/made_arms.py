"""Arms for made releases: two chains of three and of two hinges, and motions that lead the made hands.

The chains are of different lengths, so columns are padded; the left one ends with a wrist joint. Hands
are where the angles bring them, so that every law of `verify --full` holds.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bidexdata.arms.config import ArmConfig, PathConfig
from bidexdata.config import to_plain
from bidexdata.formats.rig_files import ReleaseRig, hand_poses
from bidexdata.frames import quat_canonical, quat_from_matrix
from bidexdata.record import GraspBatch, Header, Status
from bidexdata.record.batch import ArmHeader, empty_columns
from bidexdata.record.fields import KEY_FRAMES, PHASES, columns_written_by

KNOTS = (4, 2, 2, 1, 3)
SECONDS = (1.0, 0.5, 0.4, 0.4, 1.0)
PATH = PathConfig(knots=KNOTS, seconds=SECONDS, lift=0.001, standoff=0.01, largest_step=1.0)
"""Chains of so few joints cannot lift a hand as it is turned: they stay, a millimetre short."""
RIG = "made"
_QUARTER = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])


def chain(side: str) -> dict[str, Any]:
    """The serial chain of one side, as `rig.json` has it."""
    left = side == "left"
    count, y = (3, 0.4) if left else (2, -0.4)
    turned = [np.eye(3), _QUARTER, np.eye(3)][:count]
    return {
        "joint_names": [f"j{k}" for k in range(count - left)] + ["lh_W"] * left,
        "before_pos": [[-0.6, y, 0.5], [0.1, 0, 0.3], [0.0, 0.05, 0.25]][:count],
        "before_rot": [turn.tolist() for turn in turned],
        "axis": [[0.0, 0, 1], [0, 1.0, 0], [0.6, 0, 0.8]][:count],
        "lower": [-1.5] * count,
        "upper": [1.5] * count,
        "velocity": [4.0] * count,
        "end_pos": [0.02, 0.0, 0.1],
        "end_rot": _QUARTER.T.tolist(),
        "wrist": int(left),
    }


def made_rig() -> ReleaseRig:
    """What a release says of the arms."""
    chains = {side: chain(side) for side in ("left", "right")}
    arms = tuple(
        ArmHeader(RIG, "a" * 64, side, tuple(c["joint_names"]), c["wrist"], KNOTS)
        for side, c in chains.items()
    )
    config = to_plain(ArmConfig(path=PATH))
    spec = {"name": RIG, "description": "two made chains"}
    document = {"name": RIG, "digest": "a" * 64, "spec": spec, "config": config, "chains": chains}
    document["models"] = {s: {"licence": "Apache-2.0", "sha256": "b" * 64} for s in chains}
    return ReleaseRig(arms, document, "made by hand\n")


def made_motions(header: Header, ok: np.ndarray, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Columns of arms: of the rows with a grasp every fourth has none, the first of them has one."""
    rig = made_rig()
    header = Header(header.hands, arms=rig.arms)
    c = empty_columns(header, columns_written_by("arms"), len(ok))
    c["arm_status"][:], c["arm_failed_side"][:] = Status.NO_GRASP, -1
    rows = np.flatnonzero(ok)
    missed = rows[3::4]
    c["arm_status"][rows] = Status.OK
    c["arm_status"][missed], c["arm_failed_side"][missed] = Status.IK_GRASP, 0
    rows = np.setdiff1d(rows, missed)
    ends = np.cumsum([0, *KNOTS])
    for h, arm in enumerate(rig.arms):
        own = len(arm.joint_names)
        keys = rng.uniform(-0.5, 0.5, (len(rows), len(KEY_FRAMES), own)).astype(np.float32)
        keys[:, KEY_FRAMES.index("standoff")] = keys[:, KEY_FRAMES.index("pregrasp")]
        keys[:, KEY_FRAMES.index("lift")] = keys[:, KEY_FRAMES.index("squeeze")]
        c["arm_joints"][rows, h, :, :own] = keys
        for n, row in enumerate(rows):
            for j in range(own):
                line = np.interp(np.arange(ends[-1] + 1), ends, keys[n, :, j])
                c["arm_path"][row, h, :, j] = line
        c["arm_path"][rows[:, None], h, ends, :own] = keys
    per_knot = np.repeat(np.array(SECONDS) / KNOTS, KNOTS)
    c["arm_time"][rows] = np.concatenate([[0], np.cumsum(per_knot)])
    steps = np.abs(np.diff(c["arm_path"][rows], axis=2))
    c["arm_step"][rows] = np.nanmax(steps, axis=(1, 2, 3)) if len(rows) else []
    c["arm_starts"][ok] = 16
    for name in ("clear_table", "clear_object", "clear_arms", "clear_self"):
        c[name][rows] = rng.uniform(0, 0.02, len(rows))
    c["manipulability"][rows] = rng.random((len(rows), 2))
    c["ik_error_pos"][rows, :, 1:] = c["ik_error_rot"][rows, :, 1:] = 0
    c["ik_error_pos"][rows, :, KEY_FRAMES.index("lift")] = PATH.lift
    assert len(PHASES) == len(KNOTS)
    return c


def led_poses(motions: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows with a motion, and where it brings the hands: (n,), (n, H, S, 3), (n, H, S, 4)."""
    rig, rows = made_rig(), np.flatnonzero(motions["arm_status"] == Status.OK)
    pos, quat = np.zeros((len(rows), 2, 3, 3)), np.zeros((len(rows), 2, 3, 4))
    for h, arm in enumerate(rig.arms):
        for s in range(3):
            q = motions["arm_joints"][rows, h, KEY_FRAMES.index("pregrasp") + s]
            at = q[:, : len(arm.joint_names)].astype(np.float64)
            pos[:, h, s], rot = hand_poses(rig.document["chains"][arm.side], at)
            quat[:, h, s] = quat_canonical(quat_from_matrix(rot))
    return rows, pos, quat


def with_motions(batch: GraspBatch, motions: dict[str, np.ndarray]) -> GraspBatch:
    """The rows, with arms in their header."""
    header = Header(
        batch.header.hands,
        batch.header.fingerprints,
        batch.header.version,
        batch.header.counts,
        arms=made_rig().arms,
    )
    return GraspBatch(header, {**batch.columns, **motions})
