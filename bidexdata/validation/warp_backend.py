"""Tests f and l of many grasps at once on MuJoCo Warp, for GPUs; another engine, other verdicts.

The phases, checks and limits are those of `stages`; `warp_closing` closes all hands at once,
`warp_holding` applies all loads. The engine computes in float32 with a looser solver, so its
verdicts are close to those of the C engine and not equal: docs/mujoco_warp.md. It is never chosen
silently.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bidexdata.errors import BadConfig, NotUsable
from bidexdata.record import Status
from bidexdata.record.fields import DIRECTIONS
from bidexdata.record.status import TestStage
from bidexdata.simulation.scene import SimScene

from .protocols import Protocol
from .stages import Execution, Grasp, Phase
from .verdict import UNSTABLE, Verdict, closing_failure, hold_cause, start_overlap
from .warp_closing import Closed, WarpTest, close_all
from .warp_holding import Held, Tasks, hold_all, loads_of
from .warp_worlds import CONTACTS, MOST_CONTACTS, ContactOverflow, IntArray

_log = logging.getLogger(__name__)

MOST_WORLDS = 8192
"""Worlds that step together; about 0.5 MB of device memory each."""


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
        execution: Early ends, on when omitted.
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
    setting = WarpTest(
        scene=scene,
        protocol=protocol,
        execution=execution or Execution(),
        lift=protocol.lift if test == "l" else None,
        device=device,
        most_worlds=most_worlds,
        contacts=CONTACTS,
    )
    found = _with_room(setting, [grasps[n] for n in rows])
    for n, verdict in zip(rows, found, strict=True):
        verdicts[n] = verdict
    return verdicts


def _with_room(test: WarpTest, grasps: Sequence[Grasp]) -> list[Verdict]:
    """Judge; as often as the buffers of contacts are too small again, with larger ones."""
    while True:
        try:
            return _judged(test, grasps)
        except ContactOverflow as err:
            if 2 * test.contacts > MOST_CONTACTS:
                raise
            _log.info("%d contacts a world overflow (%s); room is doubled", test.contacts, err.what)
            test = replace(test, contacts=2 * test.contacts)


def _judged(test: WarpTest, grasps: Sequence[Grasp]) -> list[Verdict]:
    closed = close_all(test, grasps)
    tasks = loads_of(test, grasps, closed)
    held = hold_all(test, closed, tasks)
    return [
        _verdict(test, closed, n, tasks, held, np.flatnonzero(tasks.grasp == n))
        for n in range(len(grasps))
    ]


def _verdict(
    test: WarpTest, closed: Closed, n: int, tasks: Tasks, held: Held, loads: IntArray
) -> Verdict:
    """The verdict on grasp `n`, whose loads are these."""
    status = Status(int(closed.found.status[n]))
    moved, turned = float(closed.found.moved[n]), float(closed.found.turned[n])
    if status in UNSTABLE:
        risen = test.lift is not None and bool(closed.raised[n])
        if test.lift is None or not risen:
            return closing_failure(test.protocol, status, np.nan, np.nan)
        time = test.lift.changes * test.lift.steps * test.protocol.scene.timestep
        return Verdict(status, TestStage.LIFT, time=time)
    if test.lift is None and status is not Status.OK:
        return closing_failure(test.protocol, status, moved, turned)
    if test.lift is not None:  # judged in the hold alone
        moved, turned = np.nan, np.nan
    for load in loads:
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
        return Verdict(cause, TestStage.HOLD, int(tasks.direction[load]), moved, turned, time)
    return Verdict(Status.OK, drift_pos=moved, drift_rot=turned)


def require_supported(protocol: Protocol) -> None:
    """Refuse what this back end does not do.

    Raises:
        NotUsable: The protocol wants one of these.
    """
    bench = {
        "load": protocol.load != "gravity",
        "directions": protocol.directions != DIRECTIONS,
        "load_after": protocol.load_after is not None,
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
