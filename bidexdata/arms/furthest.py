"""Where the arms came to on the way to a grasp that they cannot take, and what stopped them there.

The record keeps the key frames of the candidate that came farthest. What is between them, the straight way
from home, and the posture nearest to a pose that no arm reaches are found again here: a picture of the
failure, not its proof. World frame.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bidexdata.arms.arm_scene import FIXTURE, ArmScene, set_arms
from bidexdata.arms.candidates import Ways, ways
from bidexdata.arms.config import ArmConfig
from bidexdata.arms.contacts import ARMS, ITSELF, OBJECT, REACH, TABLE, arm_distances, pair_kinds
from bidexdata.arms.fingers import fingers_at
from bidexdata.arms.inverse_kinematics import solve_first
from bidexdata.arms.motion import Moment
from bidexdata.arms.robot import Robot
from bidexdata.arms.solutions import Grasps
from bidexdata.arms.solve import surroundings
from bidexdata.objects.prepared import SignedDistanceGrid
from bidexdata.pictures.posing import HandPoses
from bidexdata.record.fields import KEY_FRAMES, SIDES
from bidexdata.record.status import Status
from bidexdata.simulation.scene import NOBODY

MISSES = {Status.IK_PREGRASP: (2, 1), Status.IK_GRASP: (3, 4), Status.IK_LIFT: (5,)}
"""Key frames that an arm may have missed, by status, the first to look at first."""
COLLISIONS = {
    Status.COLLISION_TABLE: TABLE,
    Status.COLLISION_OBJECT: OBJECT,
    Status.COLLISION_ARMS: ARMS,
    Status.COLLISION_SELF: ITSELF,
}
"""Places in `ArmDepths`."""
SHOWN = (*MISSES, *COLLISIONS, Status.JUMP)
"""Statuses that have a posture to show."""
_HOME, _STANDOFF, _PREGRASP, _GRASP = range(4)
_FRAMES = tuple(
    {"standoff": "stand-off", "pregrasp": "pre-grasp"}.get(name, name) for name in KEY_FRAMES
)
"""Key frames in words for a person."""
_BETWEEN = 5
"""Postures that are looked at from one key frame to the next [-]."""
_ON_THE_WAY = 40
"""The same from home to the stand-off [-]."""
_BEYOND = 1e-4
"""Contacts whose distance is no larger than the least by this count as the same [m]."""


class Found(NamedTuple):
    """What the record says of one row."""

    status: Status
    frames: Float[np.ndarray, "2 K A"]
    """`arm_joints` [rad]."""
    failed_side: int


class Furthest(NamedTuple):
    """A posture of a robot that says what stopped it."""

    moment: Moment
    words: str
    touching: frozenset[str] = frozenset()
    """Bodies and fixtures that collide there, by their names in scenes."""
    wanted: tuple[HandPoses, tuple[int, ...]] | None = None
    """Poses of the hands that were to be reached, and the sides that miss them."""
    after: Moment | None = None
    """Where the arms would have to be at once to go on."""


def furthest_posture(
    robot: Robot,
    scene: ArmScene | None,
    field: SignedDistanceGrid | None,
    grasps: Grasps,
    found: Found,
    config: ArmConfig,
) -> Furthest:
    """Find the posture of one row whose status is one of `SHOWN`.

    Args:
        robot: The robot.
        scene: The object at its size; its state is overwritten. None: nothing is said to touch.
        field: Signed distances of the object.
        grasps: The row alone.
        found: What the record says of it.
        config: How the motion was searched.
    """
    around = surroundings(robot, field, grasps)
    way = [ways(robot, h, around, grasps, config) for h in range(2)]
    if found.status in MISSES:
        return _missed(robot, grasps, found, way, config)
    if found.status in COLLISIONS and scene is not None:
        return _collision(robot, scene, grasps, found, config)
    return _jump(robot, grasps, found, way, config)


def _figure(value: float) -> str:
    """Two digits below ten: misses begin at 1 mm, and none of them is to read as nothing."""
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"


def _missed(
    robot: Robot, grasps: Grasps, found: Found, way: list[Ways], config: ArmConfig
) -> Furthest:
    sides = _failed(found)
    frame, nearest = 0, {}
    for frame in MISSES[found.status]:
        nearest = {h: _nearest(robot, h, way[h], frame, config) for h in sides}
        if not all(near.ok[0] for near in nearest.values()):
            break
    arms = np.array(
        [
            _padded(robot, nearest[h].q[0])
            if h in nearest
            else _known(robot, found, h, frame, way[h], config)
            for h in range(2)
        ]
    )
    missing = tuple(h for h, near in nearest.items() if not near.ok[0])
    told = [
        f"the {SIDES[h]} hand stays {_figure(1e3 * nearest[h].error_pos[0])} mm and "
        f"{_figure(np.degrees(nearest[h].error_rot[0]))}° short of the {_FRAMES[frame]}"
        for h in missing
    ]
    at = _waypoint(frame, config)
    wanted = HandPoses(
        np.array([way[h].poses.pos[0, at] for h in range(2)]),
        np.array([way[h].poses.quat_wxyz[0, at] for h in range(2)]),
        _fingers(grasps, np.array([frame]))[0],
    )
    words = "; ".join(told) or f"between the {_FRAMES[frame]} and the key frame before"
    return Furthest(_moment(grasps, arms, frame, config), words, wanted=(wanted, missing))


def _jump(
    robot: Robot, grasps: Grasps, found: Found, way: list[Ways], config: ArmConfig
) -> Furthest:
    """The posture before the largest turn from one key frame to the next, and the one after it."""
    best = (-1.0, 0, _GRASP, _GRASP)
    for h in _failed(found):
        for before, after in ((3, 4), (4, 5), (3, 2), (2, 1)):
            first = found.frames[h, before]
            then = _known(robot, found, h, after, way[h], config)
            turn = float(np.nanmax(np.abs(then - first), initial=-1.0))
            best = max(best, (turn, h, before, after))
    turn, h, before, after = best
    arms = np.array([_known(robot, found, s, before, way[s], config) for s in range(2)])
    other = arms.copy()
    other[h] = _known(robot, found, h, after, way[h], config)
    words = (
        f"the {SIDES[h]} arm turns a joint by {turn:.2f} rad between {_FRAMES[before]} "
        f"and {_FRAMES[after]}"
    )
    moment = _moment(grasps, arms, before, config)
    return Furthest(moment, words, after=moment._replace(arms=other))


def _collision(
    robot: Robot, scene: ArmScene, grasps: Grasps, found: Found, config: ArmConfig
) -> Furthest:
    """The posture where what collides is deepest, on the way from home and from frame to frame."""
    place = COLLISIONS[found.status]
    shown, number = _along(robot, found)
    asked = shown.copy()
    if place != ARMS and found.failed_side >= 0:  # the other arm is not what is looked for
        other = 1 - found.failed_side
        asked[:, other] = _padded(robot, robot.arms[other].chain.rest)
    joints, rise = _fingers(grasps, number), _rise(number, config)
    set_arms(scene, grasps.object_pos[0], grasps.object_quat_wxyz[0], asked[0], joints[0])
    least = np.full(len(number), np.inf)
    touch = np.asarray(number >= _PREGRASP)
    for may in (True, False):
        some = np.flatnonzero(touch == may)
        found_here = arm_distances(
            scene, asked[some], joints[some], rise=rise[some], hands_touch=may
        )
        least[some] = found_here[place]
    worst = _worst(least, number, config.clearance.depth)
    one = slice(worst, worst + 1)
    may = bool(touch[worst])
    arm_distances(scene, asked[one], joints[one], rise=rise[one], hands_touch=may)
    touching, pair = _touching(scene, place, hands_touch=may)
    depth = 1e3 * float(least[worst])
    deep = f"{-depth:.0f} mm deep" if depth < 0 else f"at {depth:.0f} mm, their spheres overlap"
    words = f"{pair}: {deep}, {_when(float(number[worst]))}" if pair else _when(number[worst])
    moment = Moment(shown[worst], joints[worst], grasps.object_pos[0] + [0, 0, rise[worst]])
    return Furthest(moment, words, touching)


def _worst(least: np.ndarray, number: np.ndarray, depth: float) -> int:
    """Which posture to show: the deepest from the stand-off on, else on the way there, else the nearest."""
    for some in (number >= _STANDOFF, number < _STANDOFF):
        inside = np.where(some, least, np.inf)
        if inside.min() < -depth:
            return int(inside.argmin())
    return int(least.argmin())


def _along(robot: Robot, found: Found) -> tuple[Float[np.ndarray, "T 2 A"], np.ndarray]:
    """Postures from home over the key frames that are known, and their places among those.

    Arms that have no posture at a key frame stand as at the one known nearest to the grasp.
    """
    frames = np.array(found.frames, np.float64)
    rests = np.array([_padded(robot, arm.chain.rest) for arm in robot.arms])
    frames[:, _HOME] = rests
    for h, arm in enumerate(robot.arms):
        known = np.asarray(np.isfinite(frames[h, :, : arm.chain.joints]).all(axis=1))
        for k in np.flatnonzero(~known):
            near = _GRASP if known[_GRASP] else _HOME
            frames[h, k] = frames[h, near]
    steps = [_ON_THE_WAY if k == _HOME else _BETWEEN for k in range(len(KEY_FRAMES) - 1)]
    number = np.concatenate([[0.0], *(k + np.arange(1, n + 1) / n for k, n in enumerate(steps))])
    both_off = np.isfinite(found.frames[:, _STANDOFF]).any(axis=1)
    if not both_off.any():  # nobody came to a stand-off: what is known is the grasp
        number = number[number >= _PREGRASP]
    k = np.minimum(number.astype(int), len(KEY_FRAMES) - 2)
    t = (number - k)[:, None, None]
    return (1 - t) * frames[:, k].swapaxes(0, 1) + t * frames[:, k + 1].swapaxes(0, 1), number


def _touching(scene: ArmScene, place: int, *, hands_touch: bool) -> tuple[frozenset[str], str]:
    """Bodies of the contacts of one kind in the scene's state, and the nearest pair in words."""
    model, contact = scene.scene.model, scene.scene.data.contact
    kinds, owner = pair_kinds(scene, hands_touch=hands_touch), scene.scene.geom_owner
    geoms = np.array(contact.geom).reshape(-1, 2)
    dist = np.array(contact.dist)
    pairs = owner[geoms] + kinds.shift
    counts = kinds.kind[pairs[:, 0], pairs[:, 1]] == place
    counts &= (dist < -kinds.may[pairs[:, 0], pairs[:, 1]]) & (dist < REACH)
    if not counts.any():
        return frozenset(), ""
    deep = counts & (dist <= max(float(dist[counts].min()) + _BEYOND, 0.0))

    def body(geom: int) -> str:
        if owner[geom] == FIXTURE:
            return str(model.geom(geom).name)
        return str(model.body(int(model.geom_bodyid[geom])).name)

    def called(geom: int) -> str:
        if owner[geom] == NOBODY:
            return "the table"
        if owner[geom] == scene.scene.object_owner:
            return "the object"
        if owner[geom] == FIXTURE:
            return "the stand"
        prefix, _, name = body(geom).partition("/")
        return f"{SIDES[int(prefix[-1])]} {name}"

    robots = [
        int(g) for g in geoms[deep].ravel() if owner[g] not in (NOBODY, scene.scene.object_owner)
    ]
    first, second = (int(g) for g in geoms[np.flatnonzero(counts)[dist[counts].argmin()]])
    return frozenset(body(g) for g in robots), f"{called(first)} and {called(second)}"


def _nearest(robot: Robot, h: int, way: Ways, frame: int, config: ArmConfig):
    at = _waypoint(frame, config)
    return solve_first(
        *(robot.arms[h].chain, way.poses.pos[:, at], way.poses.rot[:, at]), config.ik
    )


def _known(
    robot: Robot, found: Found, h: int, frame: int, way: Ways, config: ArmConfig
) -> Float[np.ndarray, " A"]:
    """The stored posture of an arm at a key frame; where there is none the nearest to it."""
    stored = np.asarray(found.frames[h, frame], np.float64)
    if np.isfinite(stored[: robot.arms[h].chain.joints]).all():
        return stored
    return _padded(robot, _nearest(robot, h, way, frame, config).q[0])


def _failed(found: Found) -> tuple[int, ...]:
    return (0, 1) if found.failed_side < 0 else (found.failed_side,)


def _waypoint(frame: int, config: ArmConfig) -> int:
    """Number of a key frame among the waypoints, which begin at the stand-off."""
    return sum(config.path.knots[1:frame])


def _padded(robot: Robot, q: np.ndarray) -> Float[np.ndarray, " A"]:
    whole = np.full(robot.joints, np.nan)
    whole[: len(q)] = q
    return whole


def _fingers(grasps: Grasps, number: np.ndarray) -> Float[np.ndarray, "T 2 J"]:
    """Fingers at places among the key frames: they do not close beyond the grasp [rad]."""
    return fingers_at(grasps.joints[0], number.astype(np.float64), "grasp")


def _rise(number: np.ndarray, config: ArmConfig) -> Float[np.ndarray, " T"]:
    return np.clip(number - (len(KEY_FRAMES) - 2), 0.0, 1.0) * config.path.lift


def _moment(grasps: Grasps, arms: np.ndarray, frame: int, config: ArmConfig) -> Moment:
    at = np.array([float(frame)])
    up = np.array([0.0, 0.0, _rise(at, config)[0]])
    return Moment(arms, _fingers(grasps, at)[0], grasps.object_pos[0] + up)


def _when(number: float) -> str:
    k = round(number)
    if abs(number - k) < 1e-6:
        return f"at the {_FRAMES[k]}"
    first = int(number)
    if first == _HOME:
        return "on the straight way from home"
    return f"between {_FRAMES[first]} and {_FRAMES[first + 1]}"
