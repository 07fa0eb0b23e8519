"""MuJoCo's word on motions of two arms: its depths wherever something may be near.

Between two places of a motion nothing comes nearer than half of what is missing there to the way from
one to the other; where that does not rule out an overlap, the middle is looked at too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from bidexdata.arms.arm_scene import ArmScene
from bidexdata.arms.arm_spheres import TOLERANCE
from bidexdata.arms.config import ArmConfig
from bidexdata.arms.contacts import distances_at, nearest_side, qpos_of
from bidexdata.arms.fingers import fingers_at
from bidexdata.arms.looks import Looks
from bidexdata.arms.solutions import Grasps
from bidexdata.record.status import Status

_NEARER = 0.6
"""How much nearer a thing comes, of the way from one place to the next, where the middle of them need
not be looked at: hands and links go past what they are near to, seldom straight at it [-]."""
_DEEPER = 2.5e-4
"""By how much an overlap between two places may be deeper than at those [m]."""
_STATUS = (
    Status.COLLISION_TABLE,
    Status.COLLISION_OBJECT,
    Status.COLLISION_ARMS,
    Status.COLLISION_SELF,
)
"""What the fields of `ArmDepths` are called where they are too deep."""


class FinalWords(NamedTuple):
    """Of R motions."""

    status: Int[np.ndarray, " R"]
    """OK, or what is too deep first."""
    least: Float[np.ndarray, "R 4"]
    """Least signed distances to table, object, the other arm and itself, at most the reach [m]."""
    side: Int[np.ndarray, " R"]
    """Whose arm or hand it is that is too deep; -1: nobody's, or of both."""
    hand: Bool[np.ndarray, " R"]
    """It is an open hand between stand-off and pre-grasp, which goes there with any posture of its arm."""

    @classmethod
    def none(cls, count: int) -> FinalWords:
        """Nothing is known, and nothing too deep."""
        status, least = np.full(count, int(Status.OK)), np.full((count, 4), np.nan)
        return cls(status, least, np.full(count, -1), np.zeros(count, bool))


class _Posed(NamedTuple):
    """Motions of grasps of one object: what stands where at a place among the knots."""

    scene_at: Callable[[float], ArmScene]
    grasps: Grasps
    path: Float[np.ndarray, "R 2 W A"]
    config: ArmConfig

    def distances(
        self, of: Int[np.ndarray, " M"], at: Float[np.ndarray, " M"], reach: float, *, touch: bool
    ) -> Float[np.ndarray, "M 4"]:
        """Least distances at some places of some motions, at most the reach [m]."""
        rule, sizes = self.config.path, self.grasps.size[of]
        scene = self.scene_at(float(sizes[0]))
        k = np.minimum(at.astype(int), self.path.shape[2] - 2)
        t = (at - k)[:, None, None]
        arms = (1 - t) * self.path[of, :, k] + t * self.path[of, :, k + 1]
        knots = np.cumsum([0, *rule.knots])
        places = np.interp(at, knots, np.arange(len(knots)))
        qpos = qpos_of(scene, arms, fingers_at(self.grasps.joints[of], places, "grasp"))
        first = scene.scene.object_qpos
        qpos[:, first : first + 3] = self.grasps.object_pos[of]
        qpos[:, first + 3 : first + 7] = self.grasps.object_quat_wxyz[of]
        qpos[:, first + 2] += np.maximum(at - knots[-2], 0) / rule.knots[-1] * rule.lift
        other = np.flatnonzero(np.diff(sizes)) + 1
        resized = dict(zip(other.tolist(), sizes[other].tolist(), strict=True))

        def before(number: int) -> None:
            if number in resized:
                self.scene_at(resized[number])

        return distances_at(scene, qpos, reach=reach, hands_touch=touch, before=before)


def final_words(
    scene_at: Callable[[float], ArmScene],
    grasps: Grasps,
    path: Float[np.ndarray, "R 2 W A"],
    looks: Looks,
    config: ArmConfig,
) -> FinalWords:
    """Ask MuJoCo about motions.

    Fingers are those of the pre-grasp up to its knot, then on the way to the grasp, and stay there:
    in the squeeze they press on, and are stopped. Up to the pre-grasp hands count as arms do; what the
    pre-grasp itself overlaps is the grasp's own, and the step to it may. The object rises with the hands.

    Args:
        scene_at: Gives the object at a size [m], always the same scene; its state is overwritten.
        grasps: The grasp of each motion.
        path: Angles of both arms at every knot [rad].
        looks: Where spheres have looked at them.
        config: How deep things may be.
    """
    pregrasp = sum(config.path.knots[:2])
    posed = _Posed(scene_at, grasps, path, config)
    asked = looks.open(config.clearance.asked)
    asked[np.isin(looks.at, np.cumsum(config.path.knots))] = True
    words = FinalWords.none(len(path))
    words.least[:] = config.clearance.reach
    # The grasp is looked at first: most motions that collide do so there.
    for touch in (True, False):
        part = looks.at >= pregrasp if touch else looks.at <= pregrasp
        part &= words.status[looks.of] == Status.OK
        if part.any():
            _search(posed, looks.select(part), asked[part], words, touch=touch)
    return words


def _search(
    posed: _Posed,
    looks: Looks,
    asked: Bool[np.ndarray, " M"],
    words: FinalWords,
    *,
    touch: bool,
) -> None:
    """Look for the first place of each motion where something is too deep; writes to `words`."""
    rule, pregrasp = posed.config.clearance, sum(posed.config.path.knots[:2])
    of, at, long, both = looks.of, looks.at, looks.way.max(axis=1), looks.way.sum(axis=1)
    way = np.stack([long, long, both, long], axis=1)
    # What spheres say: links stand out of them by that much at most.
    apart, alone = looks.apart - TOLERANCE, looks.alone - TOLERANCE
    known = np.stack([alone, alone, apart, alone], axis=1)
    dist, new = known.copy(), np.flatnonzero(asked)
    may = np.full((len(words.status), 4), min(_DEEPER - rule.depth, 0.0))
    own = may.copy()

    def allowed(of: np.ndarray, at: np.ndarray) -> np.ndarray:
        free = (at > pregrasp - 1)[:, None] & (not touch)
        return np.where(free, own[of], may[of])

    reach = rule.reach
    while len(new):
        found = posed.distances(of[new], at[new], reach, touch=touch)
        dist[new] = np.where(found < reach, found, np.maximum(reach, known[new]))
        np.minimum.at(words.least, of[new], np.where(found < reach, found, rule.reach))
        ends = at[new] == pregrasp
        own[of[new[ends]]] = np.minimum(found[ends], may[of[new[ends]]])
        over = found - allowed(of[new], at[new])
        deep = np.flatnonzero((over < 0).any(axis=1))
        which, first = np.unique(of[new[deep]], return_index=True)
        for motion, k in zip(which.tolist(), deep[first].tolist(), strict=True):
            _refuse(posed, words, motion, float(at[new[k]]), int(over[k].argmin()), touch=touch)
        low = 0.5 * (dist[:-1] + dist[1:] - _NEARER * way[:-1])
        middle = 0.5 * (at[:-1] + at[1:])
        near = (low < allowed(of[:-1], middle)).any(axis=1) & (way[:-1, 0] > rule.finest)
        k = np.flatnonzero(near & (of[:-1] == of[1:]) & (words.status[of[:-1]] == Status.OK))
        way[k] *= 0.5
        # What is farther cannot come that near on the half of the way that is left.
        reach = min(rule.reach, _NEARER * float(way[k].max(initial=0.0)))
        new = k + 1 + np.arange(len(k))
        of, at = np.insert(of, k + 1, of[k]), np.insert(at, k + 1, middle[k])
        way, dist, known = (
            np.insert(values, k + 1, fill, axis=0)
            for values, fill in ((way, way[k]), (dist, 0.0), (known, 0.0))
        )


def _refuse(
    posed: _Posed, words: FinalWords, motion: int, at: float, place: int, *, touch: bool
) -> None:
    """Say what is too deep at a place of one motion, and whose it is; writes to `words`."""
    reach = posed.config.clearance.reach
    posed.distances(np.array([motion]), np.array([at]), reach, touch=touch)
    scene = posed.scene_at(float(posed.grasps.size[motion]))
    words.status[motion] = _STATUS[place]
    words.side[motion], hand = nearest_side(scene, place, hands_touch=touch)
    words.hand[motion] = hand and posed.config.path.knots[0] <= at and not touch
