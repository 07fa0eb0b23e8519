"""Judge the grasps of one object: from record rows to the columns that `validate` writes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from bidexdata.arms.arm_scene import build_arm_scene
from bidexdata.arms.chain import chain_forward
from bidexdata.arms.robot import Robot
from bidexdata.engine_log import engine_warnings_logged
from bidexdata.errors import NotUsable
from bidexdata.hands.model import Hand
from bidexdata.objects.prepared import Solid
from bidexdata.record import GraspBatch, Status
from bidexdata.record.batch import empty_columns, in_metres
from bidexdata.record.fields import OF_TEST, ON_TABLE, WITH_ARMS, columns_written_by
from bidexdata.simulation.scene import SceneNotBuilt, SimScene, build_scene

from .analytic import analytic_metrics
from .arm_lift import ArmTest, lift_with_arms, servo_settings
from .backends import Backend, check_backend
from .force_closure import force_closure
from .lift import lift
from .metrics import grasp_metrics, measure
from .protocols import Protocol, require_test
from .stages import Execution as Execution
from .stages import Grasp, Motion
from .verdict import Verdict
from .warp_backend import warp_verdicts

TESTS: dict[str, Callable[..., Verdict]] = {"f": force_closure, "l": lift, "a": lift_with_arms}
"""How each test is run that `record.fields.JUDGED` names, on what `scene_of_rows` or
`arm_test_of_rows` gives."""

FARTHEST = 1000.0
"""Poses beyond this are refused [m]: float32 then resolves less than 0.1 mm."""
LARGEST_JOINT = 100.0
"""Joint angles beyond this are refused [rad]."""
QUAT_TOLERANCE = 1e-3
"""A stored quaternion's length may differ from 1 by this much (float32 gives 1e-7)."""
LIFT_TOLERANCE = 0.002
"""Arms lift as high as the protocol says, to this [m]."""


def validate_grasps(
    batch: GraspBatch,
    solid: Solid,
    hands: Sequence[Hand],
    protocol: Protocol,
    test: str = "f",
    *,
    robot: Robot | None = None,
    execution: Execution | None = None,
    backend: Backend = "mujoco",
    device: str = "cpu",
) -> dict[str, np.ndarray]:
    """Test and measure grasps of one object; any sizes and scenes, in any order.

    One scene is compiled per size and reused; every grasp starts from a full reset, so the order
    of the rows changes nothing. The grasps of a size are one batch for `mujoco_warp`, whose
    verdicts are not those of `protocol` but of `backends.on_backend(protocol, ...)`; metrics are
    measured on MuJoCo's C engine under either.

    Args:
        batch: Rows whose object is `solid`.
        solid: The object at unit diagonal.
        hands: The hands in the order of the header's.
        protocol: The settings.
        test: Which of the protocol's tests.
        robot: The arms that made the batch's columns of arms; needed for test a. A row that they
            do not reach fails it, with the status of its arms.
        execution: Early ends and whose noslip pass, both on when omitted, and what is measured
            besides: then nothing.
        backend: The engine that judges: `mujoco`, or `mujoco_warp` for GPUs.
        device: Warp device of `mujoco_warp`, such as `cuda:0`; its `cpu` is for trying it out.

    Returns:
        The columns written by "validate", one value per row of `batch` in its order. Rows
        without a grasp get status NOT_RUN.

    Raises:
        NotUsable: The protocol lacks the test, object, hands or arms are not those of the batch,
            or the back end cannot judge by the protocol here.
        MissingExtra: MuJoCo Warp is asked for and not installed.
        ContactOverflow: MuJoCo Warp has no room for the contacts of a grasp.
    """
    require_test(protocol, test)
    _require_same(batch, solid, hands)
    if test in WITH_ARMS:
        _require_arms(batch, robot, protocol)
    execution = execution or Execution()
    check_backend(protocol, backend, device, execution)
    columns = empty_columns(batch.header, columns_written_by("validate"), len(batch))
    statuses = statuses_before(batch, hands)
    columns["verdict_status"][:] = statuses
    runnable = statuses == Status.OK
    for size in np.unique(batch.size[runnable]):
        rows = np.flatnonzero(runnable & (batch.size == size))
        try:
            at_size = batch.select(batch.size == size)
            if test in WITH_ARMS:
                assert robot is not None
                scenes = arm_test_of_rows(at_size, solid, robot, protocol)
                scene = scenes.floating
            else:
                scenes = scene = scene_of_rows(at_size, solid, hands, protocol, test)
        except SceneNotBuilt:
            columns["verdict_status"][rows] = Status.NO_SCENE
            continue
        grasps = [grasp_of(batch, int(row)) for row in rows]
        with engine_warnings_logged():
            for row, grasp in zip(rows, grasps, strict=True):
                _write_metrics(columns, int(row), scene, protocol, grasp, execution)
            if backend == "mujoco":
                verdicts = [TESTS[test](scenes, protocol, g, execution) for g in grasps]
            else:
                verdicts = warp_verdicts(
                    scene, protocol, grasps, test, device=device, execution=execution
                )
        for row, verdict in zip(rows, verdicts, strict=True):
            _write_verdict(columns, int(row), verdict)
    return columns


def scene_of_rows(
    batch: GraspBatch, solid: Solid, hands: Sequence[Hand], protocol: Protocol, test: str
) -> SimScene:
    """Compile the scene of rows of one size, hands on welds.

    Raises:
        SceneNotBuilt: MuJoCo refuses the scene.
    """
    size = in_metres(batch.size[0])
    return build_scene(hands, solid, size, protocol.scene, table=test in ON_TABLE)


def arm_test_of_rows(batch: GraspBatch, solid: Solid, robot: Robot, protocol: Protocol) -> ArmTest:
    """Compile the scenes of test a of rows of one size.

    Raises:
        SceneNotBuilt: MuJoCo refuses a scene.
    """
    assert protocol.arm is not None
    floating = scene_of_rows(batch, solid, robot.hands, protocol, "a")
    size, servos = in_metres(batch.size[0]), servo_settings(protocol.arm)
    return ArmTest(floating, build_arm_scene(robot, solid, size, protocol.scene, servos))


def grasp_of(batch: GraspBatch, row: int) -> Grasp:
    """Read one row in float64, quaternions made exactly unit; with a motion if arms are joined.

    Rows of a release name its arms in their header also where their columns are left out.
    """
    return Grasp(
        batch.object_pos[row].astype(np.float64),
        _unit(batch.object_quat_wxyz[row]),
        batch.hand_pos[row].astype(np.float64),
        _unit(batch.hand_quat_wxyz[row]),
        batch.joints[row].astype(np.float64),
        _motion_of(batch, row) if "arm_status" in batch else None,
    )


def _motion_of(batch: GraspBatch, row: int) -> Motion:
    return Motion(
        Status(int(batch["arm_status"][row])),
        batch["arm_path"][row].astype(np.float64),
        batch["arm_time"][row].astype(np.float64),
        batch.header.arms[0].knots,
    )


def _unit(quat: NDArray[np.float32]) -> NDArray[np.float64]:
    quat64 = quat.astype(np.float64)
    return quat64 / np.linalg.norm(quat64, axis=-1, keepdims=True)


def _write_metrics(
    columns: dict[str, np.ndarray],
    row: int,
    scene: SimScene,
    protocol: Protocol,
    grasp: Grasp,
    execution: Execution,
) -> None:
    distances = measure(scene, protocol.metrics, grasp)
    values = grasp_metrics(distances, protocol.metrics, scene.hands)._asdict()
    if execution.analytic:
        friction = (protocol.scene.friction_slide, protocol.scene.friction_spin)
        values |= analytic_metrics(scene.hands, distances.contacts, friction)._asdict()
    for name, value in values.items():
        columns[name][row] = value


def _write_verdict(columns: dict[str, np.ndarray], row: int, verdict: Verdict) -> None:
    columns["success"][row] = verdict.status is Status.OK
    columns["verdict_status"][row] = verdict.status
    for name in ("failed_stage", "direction", *OF_TEST):
        columns[name][row] = getattr(verdict, name)


def statuses_before(batch: GraspBatch, hands: Sequence[Hand]) -> NDArray[np.int8]:
    """Status of every row before any test, (N,).

    NOT_RUN for rows without a grasp, BAD_POSE for rows that no simulator should see, else OK.
    """
    statuses = np.full(len(batch), Status.OK, dtype=np.int8)
    good = _is_position(batch.object_pos) & _is_rotation(batch.object_quat_wxyz)
    good &= _is_position(batch.hand_pos).all(axis=(1, 2))
    good &= _is_rotation(batch.hand_quat_wxyz).all(axis=(1, 2))
    for i, hand in enumerate(hands):
        own = batch.joints[:, i, :, : len(hand.joint_names)]
        good &= (np.abs(own) < LARGEST_JOINT).all(axis=(1, 2))  # False for NaN
    statuses[~good] = Status.BAD_POSE
    statuses[~np.isfinite(batch.size)] = Status.NO_SCENE
    if "synth_status" in batch:
        statuses[batch.synth_status != Status.OK] = Status.NOT_RUN
    return statuses


def _is_position(pos: np.ndarray) -> NDArray[np.bool_]:
    return np.all(np.abs(pos) < FARTHEST, axis=-1)  # False for NaN


def _is_rotation(quat: np.ndarray) -> NDArray[np.bool_]:
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.linalg.norm(quat.astype(np.float64), axis=-1)
        return np.less(np.abs(length - 1), QUAT_TOLERANCE)


def _require_same(batch: GraspBatch, solid: Solid, hands: Sequence[Hand]) -> None:
    others = sorted(set(batch.object_id.tolist()) - {solid.object_id})
    if others:
        raise NotUsable(f"the grasps are of object {others[0]!r}, not of {solid.object_id!r}")
    names = [h.joint_names for h in batch.header.hands]
    if names != [tuple(h.joint_names) for h in hands]:
        raise NotUsable(
            f"the grasps were made with hands {[h.name for h in batch.header.hands]} whose joints "
            f"differ from those of {[h.name for h in hands]}"
        )


def _require_arms(batch: GraspBatch, robot: Robot | None, protocol: Protocol) -> None:
    """Refuse rows without arms, or with the motions of others or of another height."""
    arms = batch.header.arms
    if robot is None or not arms or "arm_status" not in batch:
        raise NotUsable(
            "a test with arms needs the arms' motions and their robot: `bidexdata arms` makes them"
        )
    if [arm.rig_hash for arm in arms] != [robot.digest] * 2:
        raise NotUsable(
            f"the arms' motions were made with another rig than {robot.rig.spec.name!r}, or with "
            "other hands"
        )
    ok = np.flatnonzero(batch["arm_status"] == Status.OK)
    if len(ok):
        chain, path = robot.arms[0].chain, batch["arm_path"][ok[0], 0]
        ends = path[[-1 - arms[0].knots[-1], -1], : chain.joints].astype(np.float64)
        below, above = chain_forward(chain, ends)[0]
        risen, height = float(above[2] - below[2]), protocol.lift.height
        if abs(risen - height) > LIFT_TOLERANCE:
            raise NotUsable(
                f"the arms lift by {risen:.3f} m and protocol {protocol.name!r} by {height:g} m: "
                f"make the motions with --set path.lift={height:g}"
            )
