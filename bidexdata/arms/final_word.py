"""MuJoCo's word on the motion of two arms: its depths wherever something may be near.

Between two places of a motion nothing comes nearer than half of what is missing there to the way from
one to the other; where that does not rule out an overlap, the middle is looked at too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from bidexdata.arms.arm_scene import ArmScene, set_arms
from bidexdata.arms.arm_spheres import TOLERANCE
from bidexdata.arms.config import ArmConfig
from bidexdata.arms.contacts import arm_distances, nearest_side
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


class FinalWord(NamedTuple):
    """Of one motion."""

    status: Status
    """OK, or what is too deep first."""
    least: Float[np.ndarray, " 4"]
    """Least signed distances to table, object, the other arm and itself, at most the reach [m]."""
    side: int = -1
    """Whose arm or hand it is that is too deep; -1: nobody's, or of both."""
    hand: bool = False
    """It is an open hand between stand-off and pre-grasp, which goes there with any posture of its arm."""


class _Posed(NamedTuple):
    """A motion of one grasp: what stands where at a place among the knots."""

    scene: ArmScene
    path: Float[np.ndarray, "2 W A"]
    joints: Float[np.ndarray, "2 3 J"]
    """Of the hands at their stages [rad]."""
    config: ArmConfig

    def distances(self, at: Float[np.ndarray, " M"], *, touch: bool) -> Float[np.ndarray, "M 4"]:
        """Least distances at some places [m]."""
        approach, reach, close, squeeze, lift = self.config.path.knots
        pregrasp = approach + reach
        k = np.minimum(at.astype(int), self.path.shape[1] - 2)
        t = (at - k)[:, None, None]
        arms = (1 - t) * self.path[:, k].swapaxes(0, 1) + t * self.path[:, k + 1].swapaxes(0, 1)
        knots = np.cumsum([0, *self.config.path.knots])
        fingers = fingers_at(self.joints, np.interp(at, knots, np.arange(len(knots))), "grasp")
        rise = np.maximum(at - pregrasp - close - squeeze, 0) / lift * self.config.path.lift
        found = arm_distances(
            *(self.scene, arms, fingers),
            rise=rise,
            reach=self.config.clearance.reach,
            hands_touch=touch,
        )
        return np.stack(found, axis=1)


def final_word(
    scene: ArmScene,
    grasps: Grasps,
    row: int,
    path: Float[np.ndarray, "2 W A"],
    looks: Looks,
    config: ArmConfig,
) -> FinalWord:
    """Ask MuJoCo about one motion.

    Fingers are those of the pre-grasp up to its knot, then on the way to the grasp, and stay there:
    in the squeeze they press on, and are stopped. Up to the pre-grasp hands count as arms do; what the
    pre-grasp itself overlaps is the grasp's own, and the step to it may. The object rises with the hands.

    Args:
        scene: The object at its size; its state is overwritten.
        grasps: The grasps.
        row: Which of them.
        path: Angles of both arms at every knot [rad].
        looks: Where spheres have looked at it.
        config: How deep things may be.
    """
    approach, reach, *_rest = config.path.knots
    pregrasp, joints = approach + reach, grasps.joints[row]
    set_arms(scene, grasps.object_pos[row], grasps.object_quat_wxyz[row], path[:, 0], joints[:, 0])
    posed = _Posed(scene, path, joints, config)
    asked = looks.open(config.clearance.asked)
    asked[np.isin(looks.at, np.cumsum(config.path.knots))] = True
    least = np.full(4, config.clearance.reach)
    # The grasp is looked at first: most motions that collide do so there.
    for touch in (True, False):
        part = looks.at >= pregrasp if touch else looks.at <= pregrasp
        met = _search(posed, looks.select(part), asked[part], least, touch=touch)
        if met is not None:
            at, place = met
            posed.distances(np.array([at]), touch=touch)
            side, hand = nearest_side(scene, place, hands_touch=touch)
            return FinalWord(_STATUS[place], least, side, hand and approach <= at and not touch)
    return FinalWord(Status.OK, least)


def _search(
    posed: _Posed,
    looks: Looks,
    asked: Bool[np.ndarray, " M"],
    least: Float[np.ndarray, " 4"],
    *,
    touch: bool,
) -> tuple[float, int] | None:
    """Look for a place where something is too deep; `least` becomes what was found least.

    Returns:
        The place, and what is too deep there, as a place in `ArmDepths`; None where nothing is.
    """
    rule, last = posed.config.clearance, looks.at[-1]
    depth = np.full(4, min(_DEEPER - rule.depth, 0.0))
    at, long, both = looks.at, looks.way.max(axis=1), looks.way.sum(axis=1)
    way = np.stack([long, long, both, long], axis=1)
    # What spheres say: links stand out of them by that much at most.
    apart, alone = looks.apart - TOLERANCE, looks.alone - TOLERANCE
    known = np.stack([alone, alone, apart, alone], axis=1)
    dist, own = known.copy(), depth
    new = np.flatnonzero(asked)
    while True:
        found = posed.distances(at[new], touch=touch)
        dist[new] = np.where(found < rule.reach, found, np.maximum(found, known[new]))
        np.minimum(least, found.min(axis=0, initial=rule.reach), out=least)
        if not touch and own is depth:  # the first time; the last place is the pre-grasp
            own = np.minimum(found[-1], depth)
        free = (at[new] > last - 1)[:, None] & (not touch)
        over = found - np.where(free, own, depth)
        if (over < 0).any():
            first = int(np.flatnonzero((over < 0).any(axis=1))[0])
            return float(at[new[first]]), int(over[first].argmin())
        low = 0.5 * (dist[:-1] + dist[1:] - _NEARER * way[:-1])
        middle = 0.5 * (at[:-1] + at[1:])
        allowed = np.where((middle > last - 1)[:, None] & (not touch), own, depth)
        k = np.flatnonzero((low < allowed).any(axis=1) & (way[:-1, 0] > rule.finest))
        if not len(k):
            return None
        way[k] *= 0.5
        new = k + 1 + np.arange(len(k))
        at, way = np.insert(at, k + 1, middle[k]), np.insert(way, k + 1, way[k], axis=0)
        dist, known = (np.insert(values, k + 1, 0.0, axis=0) for values in (dist, known))
