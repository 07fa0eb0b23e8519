"""solve_arms: motions of two arms that take the grasps of one scene, or what stands against them.

Candidates of each arm pass gates one after the other; pairs of those that nothing stopped are tried,
best first: apart from each other, a way from home, steps that are not too large, and clear by MuJoCo.
A grasp has the status of the try that came farthest. Nothing is drawn at random, and no grasp's
answer depends on the others. Frames: world.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

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
from bidexdata.arms.clearance import HeldHands, Placed, Surroundings, apart_at, clear_at
from bidexdata.arms.config import ArmConfig, just_above
from bidexdata.arms.final_word import final_word
from bidexdata.arms.robot import Robot
from bidexdata.arms.smoothing import Smoother
from bidexdata.arms.solutions import (
    ArmSolutions,
    Grasps,
    Targets,
    join_targets,
    no_solutions,
)
from bidexdata.arms.timing import knot_times
from bidexdata.arms.ways_home import OTHERS, OVER, PLANNED, STRAIGHT, WaysHome, waiting
from bidexdata.frames import matrix_from_quat, quat_angle, quat_from_matrix
from bidexdata.hands.kinematics import hand_points
from bidexdata.objects.prepared import SignedDistanceGrid
from bidexdata.record.status import Status

APART, STEADY, SPOKEN = FREE + 1, FREE + 2, FREE + 3
"""Gates at which a pair of candidates that have ways from home ends: the arms meet, a step is too large,
MuJoCo has spoken."""


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
    around = surroundings(robot, field, grasps, device=device)
    along = object_along(field, grasps, config, device=device)
    way = (ways(robot, 0, around, grasps, config), ways(robot, 1, around, grasps, config))
    left, right = (
        find_candidates(arm, way[h], along, config, device=device)
        for h, arm in enumerate(robot.arms)
    )
    made = no_solutions(robot, config, len(rows), Status.OK)
    made.arm_starts[:] = config.ik.starts + config.search.near_rest
    _refuse(made, (left, right), config)
    _Pairing(robot, scene_at, grasps, (left, right), around, config).solve(made)
    _measure(made, robot, way, config)
    for whole, part in zip(every, made, strict=True):
        whole[rows] = part
    return every


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


class _Pairing:
    """Pairs of candidates of both arms, tried until each grasp has a motion or no more."""

    def __init__(
        self,
        robot: Robot,
        scene_at: Callable[[float], ArmScene] | None,
        grasps: Grasps,
        sides: tuple[Candidates, Candidates],
        around: Surroundings,
        config: ArmConfig,
    ) -> None:
        self._robot, self._scene_at, self._grasps = robot, scene_at, grasps
        self._sides, self._around, self._config = sides, around, config
        both = np.asarray(sides[0].free.any(axis=1) & sides[1].free.any(axis=1))
        self._home = tuple(
            WaysHome(robot, h, side.q[:, :, 0], side.free & both[:, None], around, config)
            for h, side in enumerate(sides)
        )
        self._open = sides[0].free[:, :, None] & sides[1].free[:, None]
        self._cost = sides[0].cost[:, :, None] + sides[1].cost[:, None]
        self._gate = np.full(len(both), FREE)
        self._tries = np.zeros(len(both), np.int64)
        self._todo = both

    def solve(self, made: ArmSolutions) -> None:
        """Try harder and harder; writes to `made`."""
        for effort in (STRAIGHT, OTHERS, OVER, PLANNED):
            rows = np.flatnonzero(self._todo)
            if not len(rows):
                return
            lacking = [~np.any(home.ok[rows], axis=1) for home in self._home]
            stuck = ~(lacking[0] | lacking[1])
            for home, lacks in zip(self._home, lacking, strict=True):
                home.find(effort, rows[lacks | stuck])
            while len(rows := self._next_rows()):
                self._try(made, rows)
        for h in (1, 0):
            without = self._todo & ~self._home[h].ok.any(axis=1)
            made.arm_status[without] = self._home[h].status[without]
            made.arm_failed_side[without] = h
        none = self._todo & ~(self._home[0].ok.any(axis=1) | self._home[1].ok.any(axis=1))
        made.arm_failed_side[none] = -1
        rows = np.flatnonzero(self._todo & (self._gate == FREE))
        _keep(made, self._sides, rows, np.zeros((len(rows), 2), np.int64), self._config)

    def _next_rows(self) -> np.ndarray:
        """Grasps that still have a pair with two ways from home."""
        ready = self._open & self._home[0].ok[:, :, None] & self._home[1].ok[:, None]
        return np.flatnonzero(
            self._todo & np.any(ready, axis=(1, 2)) & (self._tries < self._config.search.pairs)
        )

    def _best(self, rows: np.ndarray) -> np.ndarray:
        """The best open pair of each of some grasps, (R, 2); it is open no more."""
        ready = self._open[rows] & self._home[0].ok[rows][:, :, None]
        ready &= self._home[1].ok[rows][:, None]
        cost = np.where(ready, self._cost[rows], np.inf).reshape(len(rows), -1)
        picks = np.stack(np.divmod(cost.argmin(axis=1), self._open.shape[2]), axis=1)
        self._open[rows, picks[:, 0], picks[:, 1]] = False
        self._tries[rows] += 1
        return picks

    def _try(self, made: ArmSolutions, rows: np.ndarray) -> None:
        """Try the next pair of each of some grasps."""
        picks, config = self._best(rows), self._config
        way = [home.path[rows, picks[:, h]] for h, home in enumerate(self._home)]
        on = [side.q[rows, picks[:, h], 1:] for h, side in enumerate(self._sides)]
        apart = np.asarray(self._apart(rows, way) >= config.clearance.margin)
        for k in np.flatnonzero(~apart):
            apart[k] = self._wait(int(rows[k]), picks[k], way, int(k))
        apart &= self._apart(rows, on, with_hands=False) >= config.clearance.margin
        self._stop(made, rows, picks, ~apart, APART, Status.COLLISION_ARMS)
        rows, picks = rows[apart], picks[apart]
        if not len(rows):
            return
        paths = [np.concatenate([way[h][apart], on[h][apart]], axis=1) for h in range(2)]
        gap = self._smooth(rows, paths)
        turns = np.max([_largest_step(path) for path in paths], axis=0)
        steady = turns <= config.path.largest_step
        self._stop(made, rows, picks, ~steady, STEADY, Status.JUMP)
        scene, size = None, np.nan
        for k in np.flatnonzero(steady):
            n, both = int(rows[k]), _padded(self._robot, [path[k] for path in paths])
            status, least = Status.OK, np.full(4, np.nan)
            if self._scene_at is not None:
                if scene is None or self._grasps.size[n] != size:
                    size = self._grasps.size[n]
                    scene = self._scene_at(float(size))
                asked = gap[k] < config.clearance.asked
                asked[_key_knots(config)] = True
                status, least = final_word(scene, self._grasps, n, both, asked, config)
                if status != Status.OK:
                    self._tries[n] += config.search.pairs // config.search.words
            one = np.arange(len(rows)) == k
            self._stop(made, rows, picks, one, SPOKEN, status)
            if status == Status.OK:
                _keep_path(made, self._robot, n, [path[k] for path in paths], least, config)
                self._todo[n] = False

    def _stop(
        self,
        made: ArmSolutions,
        rows: np.ndarray,
        picks: np.ndarray,
        some: np.ndarray,
        gate: int,
        status: Status,
    ) -> None:
        """Let some tries end; those that came farther than any before are kept in `made`."""
        farther = some & ((gate > self._gate[rows]) | (status == Status.OK))
        self._gate[rows[farther]] = gate
        made.arm_status[rows[farther]] = status
        _keep(made, self._sides, rows[farther], picks[farther], self._config)

    def _apart(
        self, rows: np.ndarray, paths: list[np.ndarray], *, with_hands: bool = True
    ) -> np.ndarray:
        """Least clearance between the arms on paths that they go together, (R,) [m]."""
        most = just_above(self._config.clearance.margin)
        gaps = self._gaps_apart(rows, paths, most, with_hands=with_hands)
        return gaps.min(axis=1, initial=np.inf)

    def _gaps_apart(
        self, rows: np.ndarray, paths: list[np.ndarray], most: float, *, with_hands: bool
    ) -> np.ndarray:
        of = np.repeat(rows, paths[0].shape[1])
        left, right = (path.reshape(-1, path.shape[2]) for path in paths)
        gaps = apart_at(
            *(self._robot.arms, left, right, (of, of), self._around),
            with_hands=with_hands,
            most=most,
        )
        return gaps.reshape(paths[0].shape[:2])

    def _wait(self, row: int, pick: np.ndarray, way: list[np.ndarray], k: int) -> bool:
        """Let one arm wait for the other where they meet on the way; writes to `way`."""
        left, right = (home.corners[row, int(c)] for home, c in zip(self._home, pick, strict=True))
        for first in range(2):
            split = waiting((left, right), first, self._config)
            if split is None:
                continue
            gap = self._apart(np.array([row]), [part[None] for part in split])
            if gap[0] >= self._config.clearance.margin:
                way[0][k], way[1][k] = split
                return True
        return False

    def _smooth(self, rows: np.ndarray, paths: list[np.ndarray]) -> Float[np.ndarray, "R K"]:
        """Smooth the ways from home where that leaves them clear; writes to `paths`.

        Returns:
            Clearance by spheres at all knots [m]; behind the approach without hands.
        """
        count = self._config.path.knots[0] + 1
        pinned = np.ones(paths[0].shape[1], bool)
        pinned[1 : count - 1] = False
        smooth = []
        for arm, path in zip(self._robot.arms, paths, strict=True):
            smoother = _smoother(len(pinned), arm.chain.joints)
            most = 0.999 * self._config.path.largest_step
            smooth.append(
                smoother.smooth(path, pinned, arm.chain.lower, arm.chain.upper, most).path
            )
        gap = self._gaps(rows, [path[:, :count] for path in smooth])
        rough = gap.min(axis=1) < self._config.clearance.margin
        for path, better in zip(paths, smooth, strict=True):
            path[~rough] = better[~rough]
        if rough.any():
            gap[rough] = self._gaps(rows[rough], [path[rough, :count] for path in paths])
        on = self._gaps(rows, [path[:, count:] for path in paths], with_hands=False)
        return np.concatenate([gap, on], axis=1)

    def _gaps(
        self, rows: np.ndarray, paths: list[np.ndarray], *, with_hands: bool = True
    ) -> Float[np.ndarray, "R K"]:
        """Clearance of both arms at every knot, by spheres, as far as it matters [m]."""
        rule = self._config.clearance
        most = just_above(max(rule.asked, rule.margin))
        gap = self._gaps_apart(rows, paths, most, with_hands=with_hands)
        of = np.repeat(rows, gap.shape[1])
        for h, (arm, path) in enumerate(zip(self._robot.arms, paths, strict=True)):
            flat = path.reshape(-1, path.shape[2])
            alone = clear_at(arm, flat, of, self._around, h, with_hand=with_hands, most=most)
            gap = np.minimum(gap, alone.min(axis=0).reshape(gap.shape))
        return gap


def _key_knots(config: ArmConfig) -> np.ndarray:
    """Knots about which MuJoCo is always asked: key frames, and the last before the pre-grasp."""
    ends = np.cumsum(config.path.knots)
    return np.append(ends, ends[1] - 1)


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


def _keep_path(
    made: ArmSolutions,
    robot: Robot,
    row: int,
    paths: list[np.ndarray],
    least: np.ndarray,
    config: ArmConfig,
) -> None:
    """Store a motion, its times and clearances; writes to `made`."""
    both, rule = _padded(robot, paths), config.path
    made.arm_path[row] = both
    made.arm_joints[row, :, 0] = both[:, 0]
    made.arm_step[row] = max(float(_largest_step(path[None])[0]) for path in paths)
    made.arm_time[row] = knot_times(
        *(paths, [arm.chain.velocity for arm in robot.arms]),
        *(rule.knots, rule.seconds, rule.speed),
    )
    for column, value in zip(
        (made.clear_table, made.clear_object, made.clear_arms, made.clear_self), least, strict=True
    ):
        column[row] = value


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
