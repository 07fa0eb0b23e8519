"""solve_arms: motions of two arms that take the grasps of one scene, or what stands against them.

Candidates of each arm pass gates one after the other; pairs of those that nothing stopped are tried,
best first: apart from each other, a way from home, steps that are not too large, and clear by MuJoCo.
A grasp has the status of the try that came farthest. Nothing is drawn at random, and no grasp's
answer depends on the others. Frames: world.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Int

from bidexdata.arms.arm_scene import ArmScene, SizedArmScenes
from bidexdata.arms.candidates import (
    FREE,
    Candidates,
    Ways,
    find_candidates,
    object_along,
    ways,
)
from bidexdata.arms.chain import chain_forward
from bidexdata.arms.config import ArmConfig
from bidexdata.arms.pairing import Pairing, keep_key_frames
from bidexdata.arms.robot import Robot
from bidexdata.arms.solutions import (
    ArmSolutions,
    Grasps,
    Targets,
    join_targets,
    no_solutions,
)
from bidexdata.arms.surroundings import HeldHands, Placed, Surroundings
from bidexdata.frames import matrix_from_quat, quat_angle, quat_from_matrix
from bidexdata.hands.kinematics import hand_points
from bidexdata.objects.prepared import SignedDistanceGrid
from bidexdata.record.status import Status


def solve_arms(
    robot: Robot,
    field: SignedDistanceGrid | None,
    scene: ArmScene | None,
    targets: Targets,
    config: ArmConfig | None = None,
    *,
    device: str = "cpu",
) -> ArmSolutions:
    """Find the motions of the arms for N grasps of one scene.

    Args:
        robot: The robot.
        field: Signed distances of the object; none where it does not count.
        scene: The object at its size, for MuJoCo's word; none for the search alone, which leaves
            the clearances NaN. Its state is overwritten.
        targets: The grasps; rows that are not finite have none.
        config: How.
        device: A Warp device.
    """
    give = None if scene is None else (lambda _size: scene)
    return _solve(robot, field, give, join_targets([targets]), config or ArmConfig(), device)


def solve_scenes(
    robot: Robot,
    field: SignedDistanceGrid | None,
    scenes: SizedArmScenes | None,
    targets: Sequence[Targets],
    config: ArmConfig | None = None,
    *,
    device: str = "cpu",
) -> list[ArmSolutions]:
    """`solve_arms` for several scenes of one object, which takes less time than one by one.

    Args:
        robot: The robot.
        field: As for `solve_arms`.
        scenes: The object at any size, for MuJoCo's word.
        targets: The grasps of each scene.
        config: How.
        device: A Warp device.
    """
    if not targets:
        return []
    give = None if scenes is None else scenes.at
    found = _solve(robot, field, give, join_targets(targets), config or ArmConfig(), device)
    ends = np.cumsum([len(one.hand_pos) for one in targets])
    return [
        found.select(slice(end - len(one.hand_pos), end))
        for one, end in zip(targets, ends, strict=True)
    ]


def _solve(
    robot: Robot,
    field: SignedDistanceGrid | None,
    scene_at: Callable[[float], ArmScene] | None,
    grasps: Grasps,
    config: ArmConfig,
    device: str,
) -> ArmSolutions:
    every = no_solutions(robot, config, len(grasps.hand_pos))
    rows = np.flatnonzero(_finite(robot, grasps))
    if not len(rows):
        return every
    grasps = grasps.select(rows)
    refused = np.zeros((len(rows), 2), np.int64)
    made, blocked = _attempt(robot, field, scene_at, grasps, refused, config, device)
    again = np.flatnonzero(blocked >= 0)
    others = config.search.standoffs - 1
    if len(again) and others:
        # The next stand-offs together: the work for a few grasps is that for one.
        more = np.repeat(again, others)
        refused = refused[more]
        refused[np.arange(len(more)), blocked[more]] = np.tile(np.arange(1, others + 1), len(again))
        one, _ = _attempt(robot, field, scene_at, grasps.select(more), refused, config, device)
        good = one.ok.reshape(len(again), others)
        some = np.flatnonzero(good.any(axis=1))
        taken = some * others + good[some].argmax(axis=1)
        # What came less far than MuJoCo's word does not take its place.
        for whole, part in zip(made, one, strict=True):
            whole[again[some]] = part[taken]
    for whole, part in zip(every, made, strict=True):
        whole[rows] = part
    return every


def _attempt(
    robot: Robot,
    field: SignedDistanceGrid | None,
    scene_at: Callable[[float], ArmScene] | None,
    grasps: Grasps,
    refused: Int[np.ndarray, "N 2"],
    config: ArmConfig,
    device: str,
) -> tuple[ArmSolutions, Int[np.ndarray, " N"]]:
    """Solve grasps by one stand-off of each hand; say too whose open hand was blocked behind it."""
    around = surroundings(robot, field, grasps, device=device)
    along = object_along(field, grasps, config, device=device)
    way = tuple(ways(robot, h, around, grasps, config, refused[:, h]) for h in range(2))
    left, right = (
        find_candidates(arm, way[h], along, config, device=device)
        for h, arm in enumerate(robot.arms)
    )
    made = no_solutions(robot, config, len(grasps.size), Status.OK)
    for h, side in enumerate((left, right)):
        more = config.search.near_rest * (side.gate > 0).any(axis=1)
        made.arm_starts[:, h] = config.ik.starts + more
    _refuse(made, (left, right), config)
    pairing = Pairing(robot, scene_at, grasps, (left, right), around, config)
    pairing.solve(made)
    _measure(made, robot, way, config)
    return made, pairing.blocked


def surroundings(
    robot: Robot,
    field: SignedDistanceGrid | None,
    grasps: Grasps,
    *,
    device: str = "cpu",
) -> Surroundings:
    """The object and the open hands of each grasp."""
    left, right = (
        HeldHands(
            hand_points(hand, grasps.joints[:, h, 0, : len(hand.joint_names)]).sphere,
            hand.sphere_radius,
        )
        for h, hand in enumerate(robot.hands)
    )
    placed = None
    if field is not None:
        rot = matrix_from_quat(grasps.object_quat_wxyz)
        placed = Placed(field, grasps.size, grasps.object_pos, rot)
    return Surroundings(placed, (left, right), rows=len(grasps.size), device=device)


def _finite(robot: Robot, targets: Grasps) -> np.ndarray:
    """Which rows have poses and fingers, (N,) bool."""
    pose = np.asarray(np.isfinite(targets.hand_pos).all(axis=(1, 2, 3)))
    pose &= np.isfinite(targets.hand_quat_wxyz).all(axis=(1, 2, 3))
    for h, hand in enumerate(robot.hands):
        pose &= np.isfinite(targets.joints[:, h, :, : len(hand.joint_names)]).all(axis=(1, 2))
    return pose


def _refuse(made: ArmSolutions, sides: tuple[Candidates, Candidates], config: ArmConfig) -> None:
    """Name what stopped the grasps that an arm has no free candidate for; writes to `made`."""
    best, gate, status = (
        np.stack(x, axis=1) for x in zip(*(s.outcome() for s in sides), strict=True)
    )
    failed = gate < FREE
    worse = (gate[:, 1] < gate[:, 0]).astype(np.int64)
    rows = np.flatnonzero(failed.any(axis=1))
    made.arm_status[rows] = status[rows, worse[rows]]
    made.arm_failed_side[rows] = np.where(failed.all(axis=1), -1, worse)[rows]
    keep_key_frames(made, sides, rows, best[rows], config)


def _measure(made: ArmSolutions, robot: Robot, way: Sequence[Ways], config: ArmConfig) -> None:
    """Compare the hands at the stored angles with where the grasps have them; writes to `made`."""
    frames = np.cumsum([0, *config.path.knots[1:]])
    for h, arm in enumerate(robot.arms):
        q = made.arm_joints[:, h, 1:, : arm.chain.joints].astype(np.float32)
        pos, rot = chain_forward(arm.chain, np.nan_to_num(q))
        known = np.isfinite(q).all(axis=2)
        off = np.linalg.norm(pos - way[h].poses.pos[:, frames], axis=2)
        turn = quat_angle(quat_from_matrix(rot), way[h].poses.quat_wxyz[:, frames])
        made.ik_error_pos[:, h, 1:] = np.where(known, off, np.nan)
        made.ik_error_rot[:, h, 1:] = np.where(known, turn, np.nan)
