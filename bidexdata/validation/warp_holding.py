"""Hold many grasps under their loads at once on MuJoCo Warp.

A world is one grasp under one load. Worlds that are decided make room for the next ones, so a
batch costs as much as its work, not as its slowest grasp.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.frames import matrix_from_quat
from bidexdata.record import Status
from bidexdata.record.fields import DIRECTIONS

from .stages import Grasp
from .verdict import UNSTABLE
from .warp_checks import ObjectPoses, Statuses, WorldChecks, advance, check_worlds, rests
from .warp_closing import Closed, WarpTest, poses_before
from .warp_worlds import FloatArray, IntArray, Worlds

FEW = 4
"""When no more than one in so many worlds is busy, the busy ones go on among themselves."""
SMALL = 32
"""Fewer worlds than this stay together: making new ones takes about a second."""
IDLE = -1
"""A world without a task."""


class Tasks(NamedTuple):
    """T loads to hold; those of one grasp lie together, in the order that decides."""

    grasp: IntArray
    """Row of the closed state, (T,)."""
    direction: IntArray
    """A place in `record.fields.DIRECTIONS`, -1 in test l, (T,)."""
    gravity: FloatArray
    """(T, 3) [m/s^2]."""
    wanted: ObjectPoses


class Held(NamedTuple):
    """How T loads ended; NOT_RUN where an earlier load had failed."""

    status: Statuses
    moved: FloatArray
    """Largest displacement at a check [m], (T,)."""
    turned: FloatArray
    """Largest rotation at a check [rad], (T,)."""
    time: FloatArray
    """Since the start of the load [s], (T,)."""


def loads_of(test: WarpTest, grasps: Sequence[Grasp], closed: Closed) -> Tasks:
    """The loads of all grasps that got so far: six along the object's axes, or one down."""
    pos, quat = poses_before(grasps)
    status = closed.found.status
    if test.lift is None:
        rows = np.flatnonzero(status == Status.OK)
        grasp = np.repeat(rows, len(DIRECTIONS))
        direction = np.tile(np.arange(len(DIRECTIONS)), len(rows))
        axes = np.swapaxes(matrix_from_quat(quat), 1, 2)
        sign = np.where(direction % 2 == 0, 1.0, -1.0)
        gravity = test.protocol.gravity * sign[:, None] * axes[grasp, direction // 2]
        return Tasks(grasp, direction, gravity, ObjectPoses(pos[grasp], quat[grasp]))
    rows = np.flatnonzero(~np.isin(status, UNSTABLE))
    up = np.array([0.0, 0.0, test.lift.height])
    down = np.tile([0.0, 0.0, -test.protocol.gravity], (len(rows), 1))
    return Tasks(rows, np.full(len(rows), -1), down, ObjectPoses(pos[rows] + up, quat[rows]))


def hold_all(test: WarpTest, closed: Closed, tasks: Tasks) -> Held:
    """Hold under every load. A grasp's loads after its first failing one are dropped."""
    total = len(tasks.grasp)
    held = Held(
        np.full(total, Status.NOT_RUN, np.int8), *(np.full(total, np.nan) for _ in range(3))
    )
    if total == 0:
        return held
    count = min(total, test.most_worlds)
    worlds = test.worlds(closed.state.rows(tasks.grasp[:1]), count)
    failed = np.full(len(closed.touched), len(DIRECTIONS))
    waiting = iter(range(total))
    task, checks = np.full(count, IDLE), np.zeros(count, int)
    while True:
        _fill(worlds, task, checks, waiting, closed, tasks, failed)
        busy = np.flatnonzero(task != IDLE)
        if len(busy) == 0:
            return held
        if SMALL < worlds.count >= FEW * len(busy):  # then nothing waits
            state = worlds.read(busy)
            worlds = test.worlds(state, len(busy))
            task, checks, busy = task[busy], checks[busy], np.arange(len(busy))
            worlds.write(busy, state)
        blown = advance(test.scene, test.protocol, worlds, test.protocol.steps_per_check)
        checks[busy] += 1
        qpos, qvel = worlds.motion(busy)
        wanted = ObjectPoses(*(a[task[busy]] for a in tasks.wanted))
        now = check_worlds(test.scene, test.protocol, qpos, qvel, wanted).unless(blown[busy])
        done = _decide(test, qvel, now, task[busy], checks[busy], held)
        bad = task[busy[done]]
        bad = bad[held.status[bad] != Status.OK]
        np.minimum.at(failed, tasks.grasp[bad], tasks.direction[bad])
        task[busy[done]] = IDLE


def _fill(
    worlds: Worlds,
    task: IntArray,
    checks: NDArray[np.int_],
    waiting: Iterator[int],
    closed: Closed,
    tasks: Tasks,
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
    test: WarpTest,
    qvel: FloatArray,
    now: WorldChecks,
    task: IntArray,
    checks: NDArray[np.int_],
    held: Held,
) -> NDArray[np.bool_]:
    """Judge the busy worlds, write what is decided into `held`, and say which are."""
    protocol = test.protocol
    held.moved[task] = np.fmax(held.moved[task], now.moved)
    held.turned[task] = np.fmax(held.turned[task], now.turned)
    last = round((test.lift.hold if test.lift else protocol.hold) / protocol.check_every)
    time = checks.astype(np.float64) * protocol.check_every
    done = (now.status != Status.OK) | (checks >= last)
    if not test.execution.plain:
        left = last * protocol.check_every - time
        done |= rests(test.scene, protocol, qvel, now, left)
    held.status[task[done]] = now.status[done]
    held.time[task[done]] = time[done]
    return done
