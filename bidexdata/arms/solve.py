"""solve_arms: motions of two arms that take the grasps of one scene, or what stands against them.

Candidates of each arm pass gates one after the other; pairs of those that nothing stopped are tried,
best first: apart from each other, a way from home, steps that are not too large, and clear by MuJoCo.
A grasp has the status of the try that came farthest. Nothing is drawn at random, and no grasp's
answer depends on the others. Frames: world.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from bidexdata.arms.approach import Around, approaches, least_alone, least_apart
from bidexdata.arms.arm_scene import ArmScene
from bidexdata.arms.arm_spheres import TOLERANCE
from bidexdata.arms.candidates import FREE, Candidates, Ways, find_candidates, ways
from bidexdata.arms.chain import chain_forward
from bidexdata.arms.clearance import HeldHands, Placed
from bidexdata.arms.config import ArmConfig
from bidexdata.arms.final_word import final_word
from bidexdata.arms.robot import Robot
from bidexdata.arms.smoothing import Smoother
from bidexdata.arms.solutions import ArmSolutions, Targets, no_solutions
from bidexdata.arms.timing import knot_times
from bidexdata.frames import matrix_from_quat, quat_angle, quat_from_matrix
from bidexdata.hands.kinematics import hand_points
from bidexdata.objects.prepared import SignedDistanceGrid
from bidexdata.record.status import Status

APART, APPROACHED, STEADY = FREE + 1, FREE + 2, FREE + 3
"""Gates of a pair of candidates, after those of each: arms apart, a way from home, no large step."""


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
    config = config or ArmConfig()
    every = no_solutions(robot, config, len(targets.hand_pos))
    rows = np.flatnonzero(_finite(robot, targets))
    if not len(rows):
        return every
    targets = targets.select(rows)
    way = (ways(robot, 0, field, targets, config), ways(robot, 1, field, targets, config))
    left, right = (
        find_candidates(arm, way[h], field, targets, config, device=device)
        for h, arm in enumerate(robot.arms)
    )
    made = no_solutions(robot, config, len(rows), Status.OK)
    made.arm_starts[:] = config.ik.starts + config.search.near_rest
    _refuse(made, (left, right), config)
    _try_pairs(made, robot, field, scene, targets, (left, right), config, device)
    _measure(made, robot, way, config)
    for whole, part in zip(every, made, strict=True):
        whole[rows] = part
    return every


def _finite(robot: Robot, targets: Targets) -> np.ndarray:
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
    _keep(made, sides, rows, best[rows], config)


def _keep(
    made: ArmSolutions,
    sides: tuple[Candidates, Candidates],
    rows: Int[np.ndarray, " R"],
    picks: Int[np.ndarray, "R 2"],
    config: ArmConfig,
) -> None:
    """Store the postures of candidates at the key frames; writes to `made`."""
    frames = np.cumsum([0, *config.path.knots[1:]])
    for h, side in enumerate(sides):
        q = side.q[rows, picks[:, h]][:, frames]
        made.arm_joints[rows[:, None], h, np.arange(1, 6), : q.shape[2]] = q
        made.manipulability[rows, h] = side.manipulability[rows, picks[:, h]]


def _pairs(sides: tuple[Candidates, Candidates], most: int) -> Int[np.ndarray, "N P 2"]:
    """Pairs of free candidates, best first; -1 behind the last."""
    cost = sides[0].cost[:, :, None] + sides[1].cost[:, None]
    flat = cost.reshape(len(cost), -1)
    order = np.argsort(flat, axis=1, kind="stable")[:, :most]
    pairs = np.stack(np.divmod(order, cost.shape[2]), axis=2)
    pairs[~np.isfinite(np.take_along_axis(flat, order, axis=1))] = -1
    return pairs


def _try_pairs(
    made: ArmSolutions,
    robot: Robot,
    field: SignedDistanceGrid | None,
    scene: ArmScene | None,
    targets: Targets,
    sides: tuple[Candidates, Candidates],
    config: ArmConfig,
    device: str,
) -> None:
    """Try pairs of candidates until each grasp has a motion or no more; writes to `made`."""
    pairs = _pairs(sides, config.search.pairs)
    gate = np.zeros(len(pairs), np.int64)
    done = made.arm_status != Status.OK
    for number in range(pairs.shape[1]):
        rows = np.flatnonzero(~done & (pairs[:, number, 0] >= 0))
        if not len(rows):
            return
        picks = pairs[rows, number]
        tried = _try(robot, field, scene, targets, rows,
                     tuple(side.q[rows, picks[:, h]] for h, side in enumerate(sides)),
                     config, device)  # fmt: skip
        farther = tried.gate > gate[rows]
        some = rows[farther]
        gate[some] = tried.gate[farther]
        made.arm_status[some] = tried.status[farther]
        made.arm_failed_side[some] = tried.side[farther]
        _keep(made, sides, some, picks[farther], config)
        good = tried.status == Status.OK
        done[rows[good]] = True
        _keep_paths(made, robot, rows[good], tried, good, config)


class _Tried:
    """What became of one pair of candidates of each of R grasps."""

    def __init__(self, count: int) -> None:
        self.gate = np.full(count, FREE)
        self.status = np.full(count, int(Status.COLLISION_ARMS))
        self.side = np.full(count, -1)
        self.least = np.full((count, 4), np.nan)
        self.paths: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def stop(self, some: np.ndarray, gate: int, status: np.ndarray | int) -> None:
        """Let some of them come to a gate and no farther."""
        self.gate[some], self.status[some] = gate, status


def _try(
    robot: Robot,
    field: SignedDistanceGrid | None,
    scene: ArmScene | None,
    targets: Targets,
    rows: np.ndarray,
    q: tuple[np.ndarray, ...],
    config: ArmConfig,
    device: str,
) -> _Tried:
    """Try one pair of candidates of each of some grasps, q (R, T, A) per side."""
    tried, margin = _Tried(len(rows)), config.clearance.margin
    apart = least_apart(robot, (q[0], q[1]), None, device=device)
    some = np.flatnonzero(apart.min(axis=1) >= margin)
    if not len(some):
        return tried
    around = _around(robot, field, targets, rows[some])
    goals = (q[0][some, 0], q[1][some, 0])
    ways_home = approaches(robot, goals, around, config, device=device)
    tried.stop(some, APART, ways_home.status)
    tried.side[some] = ways_home.side
    good = np.flatnonzero(ways_home.status == Status.OK)
    if not len(good):
        return tried
    some, around = some[good], _around(robot, field, targets, rows[some[good]])
    paths = [np.concatenate([ways_home.paths[h][good], q[h][some, 1:]], axis=1) for h in range(2)]
    gap = _smooth(robot, paths, around, config, device)
    turns = np.max([_largest_step(path) for path in paths], axis=0)
    tried.stop(some, APPROACHED, Status.JUMP)
    for k in np.flatnonzero(turns <= config.path.largest_step):
        n = some[k]
        path = _padded(robot, [p[k] for p in paths])
        status, least = Status.OK, np.full(4, np.nan)
        if scene is not None:
            asked = np.ones(path.shape[1], bool)
            asked[: gap.shape[1]] = gap[k] < config.clearance.reach + TOLERANCE
            status, least = final_word(scene, targets, int(rows[n]), path, asked, config)
        tried.gate[n], tried.status[n], tried.least[n] = STEADY, status, least
        tried.paths[int(n)] = (paths[0][k], paths[1][k])
    return tried


def _around(
    robot: Robot, field: SignedDistanceGrid | None, targets: Targets, rows: np.ndarray
) -> Around:
    """The object and the open hands of some grasps."""
    hands = tuple(
        HeldHands(
            hand_points(hand, targets.joints[rows, h, 0, : len(hand.joint_names)]).sphere,
            hand.sphere_radius,
        )
        for h, hand in enumerate(robot.hands)
    )
    placed = None
    if field is not None:
        count = len(rows)
        rot = matrix_from_quat(targets.object_quat_wxyz)
        placed = Placed(
            *(field, np.full(count, targets.size)),
            np.tile(targets.object_pos, (count, 1)),
            np.tile(rot, (count, 1, 1)),
        )
    return Around(placed, (hands[0], hands[1]))


def _smooth(
    robot: Robot, paths: list[np.ndarray], around: Around, config: ArmConfig, device: str
) -> Float[np.ndarray, "R K"]:
    """Smooth the ways from home where that leaves them clear; writes to `paths` (R, W, A).

    Returns:
        Clearance by spheres at the knots of the approach [m].
    """
    count = config.path.knots[0] + 1
    pinned = np.ones(paths[0].shape[1], bool)
    pinned[1 : count - 1] = False
    smooth = [np.empty_like(path) for path in paths]
    for h, arm in enumerate(robot.arms):
        smoother = _smoother(len(pinned), arm.chain.joints)
        for k, path in enumerate(paths[h]):
            found = smoother.smooth(
                path, pinned, arm.chain.lower, arm.chain.upper, 0.999 * config.path.largest_step
            )
            smooth[h][k] = found.path
    gap = _gaps(robot, [path[:, :count] for path in smooth], around, device)
    rough = np.flatnonzero(gap.min(axis=1, initial=np.inf) < config.clearance.margin)
    if len(rough):
        for h in range(2):
            smooth[h][rough] = paths[h][rough]
        gap = _gaps(robot, [path[:, :count] for path in smooth], around, device)
    for h in range(2):
        paths[h][:] = smooth[h]
    return gap


def _gaps(
    robot: Robot, paths: list[np.ndarray], around: Around, device: str
) -> Float[np.ndarray, "R K"]:
    """Clearance of both arms with their hands at every knot, by spheres [m]."""
    alone = [
        least_alone(arm, paths[h], around.placed, around.hands[h], device=device)[0]
        for h, arm in enumerate(robot.arms)
    ]
    apart = least_apart(robot, (paths[0], paths[1]), around.hands, device=device)
    return np.minimum(apart, np.minimum(*alone))


@lru_cache(maxsize=8)
def _smoother(knots: int, joints: int) -> Smoother:
    return Smoother(knots, joints)


def _largest_step(path: Float[np.ndarray, "R W A"]) -> Float[np.ndarray, " R"]:
    """Largest turn of a joint from knot to knot, as the record stores them [rad]."""
    stored = path.astype(np.float32).astype(np.float64)
    return np.abs(np.diff(stored, axis=1)).max(axis=(1, 2))


def _padded(robot: Robot, paths: list[np.ndarray]) -> Float[np.ndarray, "2 W A"]:
    both = np.full((2, len(paths[0]), robot.joints), np.nan)
    for h, path in enumerate(paths):
        both[h, :, : path.shape[1]] = path.astype(np.float32)
    return both


def _keep_paths(
    made: ArmSolutions,
    robot: Robot,
    rows: np.ndarray,
    tried: _Tried,
    good: np.ndarray,
    config: ArmConfig,
) -> None:
    """Store motions, their times and clearances; writes to `made`."""
    path_config = config.path
    clear = (made.clear_table, made.clear_object, made.clear_arms, made.clear_self)
    for n, k in zip(rows, np.flatnonzero(good), strict=True):
        paths = tried.paths[int(k)]
        both = _padded(robot, list(paths))
        made.arm_path[n] = both
        made.arm_joints[n, :, 0] = both[:, 0]
        made.arm_step[n] = max(float(_largest_step(path[None])[0]) for path in paths)
        made.arm_time[n] = knot_times(
            *(paths, [arm.chain.velocity for arm in robot.arms]),
            *(path_config.knots, path_config.seconds, path_config.speed),
        )
        for column, least in zip(clear, tried.least[k], strict=True):
            column[n] = least


def _measure(made: ArmSolutions, robot: Robot, way: tuple[Ways, Ways], config: ArmConfig) -> None:
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
