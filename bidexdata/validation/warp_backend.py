"""Tests f and l of many grasps at once on MuJoCo Warp, for GPUs; another engine, other verdicts.

The phases, checks and limits are those of `stages`; a world is one grasp under one load. Worlds
that are decided make room for the next ones, so a batch costs as much as its work, not as its
slowest grasp. The engine computes in float32 with a looser solver, so its verdicts are close to
those of the C engine and not equal: docs/mujoco_warp.md. It is never chosen silently.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.errors import BadConfig, NotUsable
from bidexdata.frames import matrix_from_quat
from bidexdata.record import Status
from bidexdata.record.fields import DIRECTIONS
from bidexdata.record.status import TestStage
from bidexdata.simulation.scene import SimScene
from bidexdata.simulation.state import set_pose

from .lift import LEFT_BEHIND
from .protocols import LiftRules, Protocol
from .stages import ControlPath, Execution, Grasp, Phase, closing_path
from .verdict import UNSTABLE, Verdict, closing_failure, hold_cause, start_overlap
from .warp_checks import Statuses, advance, check_worlds, instability, rests
from .warp_worlds import (
    CONTACTS,
    MOST_CONTACTS,
    ContactOverflow,
    FloatArray,
    IntArray,
    Worlds,
    WorldState,
)

_log = logging.getLogger(__name__)

MOST_WORLDS = 8192
"""Worlds that step together; about 0.5 MB of device memory each."""
FEW = 4
"""When no more than one in so many worlds is busy, the busy ones go on among themselves."""
SMALL = 32
"""Fewer worlds than this stay together: making new ones takes about a second."""
IDLE = -1
"""A world without a task."""


def warp_verdicts(
    scene: SimScene,
    protocol: Protocol,
    grasps: Sequence[Grasp],
    test: str = "f",
    *,
    device: str = "cuda:0",
    execution: Execution | None = None,
    most_worlds: int = MOST_WORLDS,
) -> list[Verdict]:
    """Judge grasps of one object at one size.

    On Warp's CPU device the same batch gives the same bits twice; another order or number of worlds
    changes the last digits of float32. On a GPU these vary from run to run.

    Args:
        scene: Its compiled model is simulated, its state serves the start check; with a table for
            test l.
        protocol: The settings. Noslip, cones, gains and contacts are taken from the model.
        grasps: In any number.
        test: f or l.
        device: Warp device.
        execution: Early ends, and what is measured besides; on when omitted.
        most_worlds: Bound of the worlds that step together; changes no verdict.

    Returns:
        As `force_closure` gives them, one per grasp.

    Raises:
        MissingExtra: MuJoCo Warp is not installed.
        NotUsable: No such device or test, or the engine lacks a feature of the scene.
        ContactOverflow: A world has more contacts than the largest buffers hold.
    """
    if test not in ("f", "l"):
        raise NotUsable(f"MuJoCo Warp runs the tests f and l, not {test!r}")
    if most_worlds < 1:
        raise BadConfig(f"most_worlds must be at least 1, not {most_worlds!r}")
    require_supported(protocol)
    refused = [start_overlap(scene, protocol, g) for g in grasps]
    rows = [n for n, verdict in enumerate(refused) if verdict is None]
    verdicts = [verdict or Verdict(Status.NOT_RUN) for verdict in refused]
    if not rows:
        return verdicts
    judge = _Judge(
        scene,
        protocol,
        execution or Execution(),
        protocol.lift if test == "l" else None,
        device,
        most_worlds,
    )
    kept = [grasps[n] for n in rows]
    contacts = CONTACTS
    while True:
        try:
            found = judge.verdicts(kept, contacts)
            break
        except ContactOverflow as err:
            if 2 * contacts > MOST_CONTACTS:
                raise
            _log.info("%d contacts a world overflow (%s); room is doubled", contacts, err.what)
            contacts *= 2
    for n, verdict in zip(rows, found, strict=True):
        verdicts[n] = verdict
    return verdicts


class _Closed(NamedTuple):
    """N grasps whose hands have closed, and in test l have gone up."""

    state: WorldState
    status: Statuses
    """OK, SLIP or TURNED when the hands had closed; UNSTABLE or BLOWN_UP if ever before the hold."""
    moved: FloatArray
    """Displacement when the hands had closed [m], (N,)."""
    turned: FloatArray
    """Rotation when the hands had closed [rad], (N,)."""
    touched: NDArray[np.bool_]
    """Whether a hand was in contact with the object when the hands had closed, (N,)."""
    raised: NDArray[np.bool_]
    """Whether the simulation was sane until the hands began to rise, (N,)."""
    lifted: NDArray[np.bool_]
    """Whether the object had left the table when the hands were up; True in test f, (N,)."""


class _Tasks(NamedTuple):
    """T loads to hold; those of one grasp lie together, in the order that decides."""

    grasp: IntArray
    """Row of the closed state, (T,)."""
    direction: IntArray
    """(T,)."""
    gravity: FloatArray
    """(T, 3) [m/s^2]."""
    pos: FloatArray
    """Where the object should be, (T, 3) [m]."""
    quat: FloatArray
    """(T, 4)."""


class _Held(NamedTuple):
    """How T loads ended; NOT_RUN where an earlier load had failed."""

    status: Statuses
    moved: FloatArray
    """Largest displacement at a check [m], (T,)."""
    turned: FloatArray
    """Largest rotation at a check [rad], (T,)."""
    time: FloatArray
    """Since the start of the load [s], (T,)."""


@dataclass(frozen=True, slots=True)
class _Judge:
    scene: SimScene
    protocol: Protocol
    execution: Execution
    lift: LiftRules | None
    """None in test f."""
    device: str
    most_worlds: int

    def verdicts(self, grasps: Sequence[Grasp], contacts: int) -> list[Verdict]:
        parts = [
            self._close(grasps[a : a + self.most_worlds], contacts)
            for a in range(0, len(grasps), self.most_worlds)
        ]
        state = WorldState(
            *(np.concatenate(f) for f in zip(*(p.state for p in parts), strict=True))
        )
        closed = _Closed(
            state, *(np.concatenate(f) for f in zip(*(p[1:] for p in parts), strict=True))
        )
        tasks = self._tasks(grasps, closed)
        held = self._hold(closed, tasks, contacts)
        return [
            self._verdict(closed, n, held, np.flatnonzero(tasks.grasp == n))
            for n in range(len(grasps))
        ]

    def _close(self, grasps: Sequence[Grasp], contacts: int) -> _Closed:
        """Close the hands round each object, and in test l lift them."""
        protocol, count = self.protocol, len(grasps)
        every = np.arange(count)
        start = self._start(grasps)
        worlds = Worlds(self.scene, self._calm(start), count, contacts, self.device)
        worlds.write(every, start)
        broken = np.full(count, Status.OK, np.int8)
        paths = [closing_path(self.scene, protocol, g) for g in grasps]
        self._follow(worlds, paths, protocol.segment_steps, broken)
        pos, quat = _wanted(grasps)
        status, moved, turned = check_worlds(self.scene, protocol, *worlds.motion(every), pos, quat)
        touched, raised = worlds.touching(), broken == Status.OK
        if self.lift is not None:
            ways = [_lift_path(p, self.lift) for p in paths]
            self._follow(worlds, ways, self.lift.steps, broken)
        bad = broken != Status.OK
        status[bad], moved[bad], turned[bad] = broken[bad], np.nan, np.nan
        lifted = np.ones(count, bool)
        if self.lift is not None:
            height = worlds.motion(every)[0][:, self.scene.object_qpos + 2]
            lifted = height - pos[:, 2] > LEFT_BEHIND * self.lift.height
        return _Closed(worlds.read(every), status, moved, turned, touched, raised, lifted)

    def _follow(
        self, worlds: Worlds, paths: Sequence[ControlPath], steps: int, broken: Statuses
    ) -> None:
        """Give each target in turn and step after it; mark and park what becomes unstable."""
        every = np.arange(len(paths))
        for number in range(len(paths[0].pos)):
            worlds.aim(*(np.stack([p[k][number] for p in paths]) for k in range(3)))
            worlds.park(np.flatnonzero(broken))
            blown = advance(self.scene, self.protocol, worlds, steps)[every]
            found = instability(self.scene, self.protocol, *worlds.motion(every))
            broken[:] = np.select([broken != Status.OK, blown != Status.OK], [broken, blown], found)

    def _tasks(self, grasps: Sequence[Grasp], closed: _Closed) -> _Tasks:
        """The loads of all grasps that got so far: six along the object's axes, or one down."""
        pos, quat = _wanted(grasps)
        if self.lift is None:
            rows = np.flatnonzero(closed.status == Status.OK)
            grasp = np.repeat(rows, len(DIRECTIONS))
            direction = np.tile(np.arange(len(DIRECTIONS)), len(rows))
            axes = np.swapaxes(matrix_from_quat(quat), 1, 2)
            sign = np.where(direction % 2 == 0, 1.0, -1.0)
            gravity = self.protocol.gravity * sign[:, None] * axes[grasp, direction // 2]
            return _Tasks(grasp, direction, gravity, pos[grasp], quat[grasp])
        rows = np.flatnonzero(~np.isin(closed.status, UNSTABLE))
        up = np.array([0.0, 0.0, self.lift.height])
        down = np.tile([0.0, 0.0, -self.protocol.gravity], (len(rows), 1))
        return _Tasks(rows, np.full(len(rows), -1), down, pos[rows] + up, quat[rows])

    def _hold(self, closed: _Closed, tasks: _Tasks, contacts: int) -> _Held:
        """Hold under every load. A grasp's loads after its first failing one are dropped."""
        total = len(tasks.grasp)
        held = _Held(
            np.full(total, Status.NOT_RUN, np.int8), *(np.full(total, np.nan) for _ in range(3))
        )
        if total == 0:
            return held
        first = closed.state.rows(tasks.grasp[:1])
        count = min(total, self.most_worlds)
        worlds = Worlds(self.scene, self._calm(first), count, contacts, self.device)
        failed = np.full(len(closed.status), len(DIRECTIONS))
        waiting = iter(range(total))
        task, checks = np.full(count, IDLE), np.zeros(count, int)
        while True:
            self._fill(worlds, task, checks, waiting, closed, tasks, failed)
            busy = np.flatnonzero(task != IDLE)
            if len(busy) == 0:
                return held
            if SMALL < worlds.count >= FEW * len(busy):  # then nothing waits
                state = worlds.read(busy)
                worlds = Worlds(self.scene, self._calm(state), len(busy), contacts, self.device)
                task, checks, busy = task[busy], checks[busy], np.arange(len(busy))
                worlds.write(busy, state)
            blown = advance(self.scene, self.protocol, worlds, self.protocol.steps_per_check)
            checks[busy] += 1
            qpos, qvel = worlds.motion(busy)
            done = self._decide(qpos, qvel, blown[busy], task[busy], checks[busy], tasks, held)
            bad = task[busy[done]]
            bad = bad[held.status[bad] != Status.OK]
            np.minimum.at(failed, tasks.grasp[bad], tasks.direction[bad])
            task[busy[done]] = IDLE

    @staticmethod
    def _fill(
        worlds: Worlds,
        task: IntArray,
        checks: NDArray[np.int_],
        waiting: Iterator[int],
        closed: _Closed,
        tasks: _Tasks,
        failed: IntArray,
    ) -> None:
        """Free the worlds of loads that no longer matter, then give waiting loads to free worlds."""
        running = np.flatnonzero(task != IDLE)
        dropped = tasks.direction[task[running]] > failed[tasks.grasp[task[running]]]
        task[running[dropped]] = IDLE
        free = np.flatnonzero(task == IDLE)
        taken = []
        while len(taken) < len(free):
            number = next(waiting, None)
            if number is None:
                break
            if tasks.direction[number] <= failed[tasks.grasp[number]]:
                taken.append(number)
        new = np.array(taken, np.intp)
        rows = free[: len(new)]
        state = closed.state.rows(tasks.grasp[new])
        worlds.write(rows, state._replace(gravity=tasks.gravity[new].astype(np.float32)))
        task[rows], checks[rows] = new, 0
        worlds.park(free[len(new) :])

    def _decide(
        self,
        qpos: FloatArray,
        qvel: FloatArray,
        blown: Statuses,
        task: IntArray,
        checks: NDArray[np.int_],
        tasks: _Tasks,
        held: _Held,
    ) -> NDArray[np.bool_]:
        """Judge the busy worlds, write what is decided into `held`, and say which are."""
        protocol = self.protocol
        status, moved, turned = check_worlds(
            self.scene, protocol, qpos, qvel, tasks.pos[task], tasks.quat[task]
        )
        held.moved[task] = np.fmax(held.moved[task], moved)
        held.turned[task] = np.fmax(held.turned[task], turned)
        last = round((self.lift.hold if self.lift else protocol.hold) / protocol.check_every)
        time = checks.astype(np.float64) * protocol.check_every
        done = (status != Status.OK) | (checks >= last)
        if not self.execution.plain:
            left = last * protocol.check_every - time
            done |= rests(self.scene, protocol, qvel, moved, turned, left)
        held.status[task[done]] = status[done]
        held.time[task[done]] = time[done]
        return done

    def _start(self, grasps: Sequence[Grasp]) -> WorldState:
        """The pre-grasps at rest; test l has its load on from here."""
        parts = []
        gravity = np.array([0.0, 0.0, -self.protocol.gravity if self.lift else 0.0])
        for g in grasps:
            at = (g.hand_pos[:, 0], g.hand_quat[:, 0], g.joints[:, 0])
            set_pose(self.scene, g.object_pos, g.object_quat, *at)
            d = self.scene.data
            row = (d.qpos, d.qvel, d.qacc_warmstart, d.ctrl, d.mocap_pos, d.mocap_quat, gravity)
            parts.append([np.array(a, np.float32) for a in row])
        return WorldState(*(np.stack(p) for p in zip(*parts, strict=True)))

    @staticmethod
    def _calm(state: WorldState) -> WorldState:
        """The first of these states without a load: where unused worlds wait."""
        first = state.rows(np.zeros(1, np.intp))
        return first._replace(gravity=np.zeros((1, 3), np.float32))

    def _verdict(self, closed: _Closed, n: int, held: _Held, loads: IntArray) -> Verdict:
        status = Status(int(closed.status[n]))
        moved, turned = float(closed.moved[n]), float(closed.turned[n])
        if status in UNSTABLE:
            risen = self.lift is not None and bool(closed.raised[n])
            if self.lift is None or not risen:
                return closing_failure(self.protocol, status, np.nan, np.nan)
            time = self.lift.changes * self.lift.steps * self.protocol.scene.timestep
            return Verdict(status, TestStage.LIFT, time=time)
        if self.lift is None and status is not Status.OK:
            return closing_failure(self.protocol, status, moved, turned)
        if self.lift is not None:  # judged in the hold alone
            moved, turned = np.nan, np.nan
        for direction, load in enumerate(loads):
            moved = float(np.fmax(moved, held.moved[load]))
            turned = float(np.fmax(turned, held.turned[load]))
            if held.status[load] == Status.OK:
                continue
            time = float(held.time[load])
            cause = hold_cause(
                Phase(Status(int(held.status[load])), moved, turned, time),
                touched=bool(closed.touched[n]),
                thrown=status is not Status.OK,
                lifted=bool(closed.lifted[n]),
            )
            number = direction if self.lift is None else -1
            return Verdict(cause, TestStage.HOLD, number, moved, turned, time)
        return Verdict(Status.OK, drift_pos=moved, drift_rot=turned)


def require_supported(protocol: Protocol) -> None:
    """Refuse what this back end does not do.

    Raises:
        NotUsable: The protocol wants one of these.
    """
    bench = {
        "load": protocol.load != "gravity",
        "directions": protocol.directions != DIRECTIONS,
        "check_closing": not protocol.check_closing,
        "reference": protocol.reference != "centre_of_mass",
        "lift.hold": protocol.lift_checks == 0,
        "scene.base": protocol.scene.base != "weld",
        "metrics.table_is_hand": protocol.metrics.table_is_hand,
    }
    wanted = [key for key, other in bench.items() if other]
    if wanted:
        raise NotUsable(
            f"the back end mujoco_warp runs protocols such as paper-1; {protocol.name!r} sets "
            f"{wanted[0]} otherwise: use --backend mujoco"
        )


def _wanted(grasps: Sequence[Grasp]) -> tuple[FloatArray, FloatArray]:
    """Poses of the objects before closing: (N, 3) [m], (N, 4)."""
    return np.stack([g.object_pos for g in grasps]), np.stack([g.object_quat for g in grasps])


def _lift_path(closing: ControlPath, lift: LiftRules) -> ControlPath:
    """Raise the last targets of the closing in equal steps; controls stay."""
    done = np.arange(1, lift.changes + 1) / lift.changes
    up = done[:, None, None] * np.array([0.0, 0.0, lift.height])
    still = [np.repeat(a[-1:], lift.changes, axis=0) for a in (closing.quat, closing.ctrl)]
    return ControlPath(closing.pos[-1] + up, *still)
