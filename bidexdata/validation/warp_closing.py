"""Close the hands of many grasps at once, and in test l lift them, on MuJoCo Warp."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.record import Status
from bidexdata.simulation.scene import SimScene
from bidexdata.simulation.state import set_pose

from .lift import LEFT_BEHIND
from .protocols import LiftRules, Protocol
from .stages import ControlPath, Execution, Grasp, closing_path
from .warp_checks import (
    ObjectPoses,
    Statuses,
    WorldChecks,
    advance,
    check_worlds,
    instability,
)
from .warp_worlds import Worlds, WorldState


@dataclass(frozen=True, slots=True, kw_only=True)
class WarpTest:
    """A test on worlds of one scene."""

    scene: SimScene
    protocol: Protocol
    execution: Execution
    lift: LiftRules | None
    """None in test f."""
    device: str
    most_worlds: int
    contacts: int
    """Contacts that a world has room for."""

    def worlds(self, state: WorldState, count: int) -> Worlds:
        """Make worlds; unused ones wait in the first of these states, without a load."""
        first = state.rows(np.zeros(1, np.intp))
        calm = first._replace(gravity=np.zeros((1, 3), np.float32))
        return Worlds(self.scene, calm, count, self.contacts, self.device)


class Closed(NamedTuple):
    """N grasps whose hands have closed, and in test l have gone up."""

    state: WorldState
    found: WorldChecks
    """When the hands had closed; UNSTABLE or BLOWN_UP if ever before the hold."""
    touched: NDArray[np.bool_]
    """Whether a hand was in contact with the object when the hands had closed, (N,)."""
    raised: NDArray[np.bool_]
    """Whether the simulation was sane until the hands began to rise, (N,)."""
    lifted: NDArray[np.bool_]
    """Whether the object had left the table when the hands were up; True in test f, (N,)."""


def close_all(test: WarpTest, grasps: Sequence[Grasp]) -> Closed:
    """Close the hands of all grasps, as many at once as there may be worlds."""
    most = test.most_worlds
    parts = [_close(test, grasps[a : a + most]) for a in range(0, len(grasps), most)]
    state, found, *flags = zip(*parts, strict=True)
    return Closed(
        WorldState(*map(np.concatenate, zip(*state, strict=True))),
        WorldChecks(*map(np.concatenate, zip(*found, strict=True))),
        *map(np.concatenate, flags),
    )


def poses_before(grasps: Sequence[Grasp]) -> ObjectPoses:
    """Poses of the objects before closing."""
    return ObjectPoses(
        np.stack([g.object_pos for g in grasps]), np.stack([g.object_quat for g in grasps])
    )


def _close(test: WarpTest, grasps: Sequence[Grasp]) -> Closed:
    protocol, every = test.protocol, np.arange(len(grasps))
    start = _start(test, grasps)
    worlds = test.worlds(start, len(grasps))
    worlds.write(every, start)
    broken = np.full(len(grasps), Status.OK, np.int8)
    paths = [closing_path(test.scene, protocol, g) for g in grasps]
    broken = _follow(test, worlds, paths, protocol.segment_steps, broken)
    wanted = poses_before(grasps)
    found = check_worlds(test.scene, protocol, *worlds.motion(every), wanted)
    touched, raised = worlds.touching(), broken == Status.OK
    lifted = np.ones(len(grasps), bool)
    if test.lift is not None:
        ways = [_lift_path(p, test.lift) for p in paths]
        broken = _follow(test, worlds, ways, test.lift.steps, broken)
        height = worlds.motion(every)[0][:, test.scene.object_qpos + 2]
        lifted = height - wanted.pos[:, 2] > LEFT_BEHIND * test.lift.height
    return Closed(worlds.read(every), found.unless(broken), touched, raised, lifted)


def _follow(
    test: WarpTest, worlds: Worlds, paths: Sequence[ControlPath], steps: int, broken: Statuses
) -> Statuses:
    """Give each target in turn and step after it; park what breaks, and say what has broken."""
    every = np.arange(len(paths))
    for number in range(len(paths[0].pos)):
        worlds.aim(*(np.stack([p[k][number] for p in paths]) for k in range(3)))
        worlds.park(np.flatnonzero(broken))
        blown = advance(test.scene, test.protocol, worlds, steps)[every]
        found = instability(test.scene, test.protocol, *worlds.motion(every))
        broken = np.select([broken != Status.OK, blown != Status.OK], [broken, blown], found)
    return broken


def _start(test: WarpTest, grasps: Sequence[Grasp]) -> WorldState:
    """The pre-grasps at rest; test l has its load on from here."""
    parts = []
    gravity = np.array([0.0, 0.0, -test.protocol.gravity if test.lift else 0.0])
    for g in grasps:
        at = (g.hand_pos[:, 0], g.hand_quat[:, 0], g.joints[:, 0])
        set_pose(test.scene, g.object_pos, g.object_quat, *at)
        d = test.scene.data
        row = (d.qpos, d.qvel, d.qacc_warmstart, d.ctrl, d.mocap_pos, d.mocap_quat, gravity)
        parts.append([np.array(a, np.float32) for a in row])
    return WorldState(*(np.stack(p) for p in zip(*parts, strict=True)))


def _lift_path(closing: ControlPath, lift: LiftRules) -> ControlPath:
    """Raise the last targets of the closing in equal steps; controls stay."""
    done = np.arange(1, lift.changes + 1) / lift.changes
    up = done[:, None, None] * np.array([0.0, 0.0, lift.height])
    still = [np.repeat(a[-1:], lift.changes, axis=0) for a in (closing.quat, closing.ctrl)]
    return ControlPath(closing.pos[-1] + up, *still)
