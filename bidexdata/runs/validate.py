"""The validate stage: rows of a run are tested, verdicts go to shards of their own."""

from __future__ import annotations

import dataclasses
import json
import logging
import os
import time
from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from bidexdata.config import from_plain, to_plain
from bidexdata.errors import ConfigConflict, NotUsable
from bidexdata.extras import require
from bidexdata.record import Status
from bidexdata.record.fields import ON_TABLE, WITH_ARMS
from bidexdata.record.settings import differing_settings, fuller_settings
from bidexdata.runs.logs import log_to
from bidexdata.runs.plan import Task
from bidexdata.runs.run import Run, open_unchanged, verdict_fingerprint
from bidexdata.runs.run_folder import PROTOCOL_FILE
from bidexdata.runs.run_rows import verdict_batch
from bidexdata.runs.shards import (
    check_mark,
    done_tasks,
    read_mark,
    shard_path,
    sweep,
    write_shard,
    write_text,
)
from bidexdata.runs.stage import StageReport, TaskExecution, TaskSummary, run_stage

if TYPE_CHECKING:
    from bidexdata.validation import stages
    from bidexdata.validation.backends import Backend
    from bidexdata.validation.protocols import Protocol

Extra = Literal["load_margin", "analytic", "plain"]
"""What costs extra and is done when asked for: further columns, and plain simulation."""


def validate_run(
    run: Run,
    protocol: Protocol,
    tests: Sequence[str] = (),
    *,
    execution: TaskExecution | None = None,
    extras: Sequence[Extra] = (),
    backend: Backend = "mujoco",
    device: str = "cpu",
) -> dict[str, StageReport]:
    """Test every finished task of a run that is not tested yet; with arms those that have motions.

    The verdicts are stored under the protocol that `on_backend` gives: `paper-1` on `mujoco_warp`
    is `paper-1-warp`. Unless `execution` says how many, one worker drives the device.

    Args:
        run: The run; its unfinished tasks are left out.
        protocol: Settings of the tests.
        tests: Names of tests; what the rows allow when empty.
        execution: Where and how.
        extras: What else to do; tasks that were tested without are tested again, with what they
            had.
        backend: The engine that judges, `mujoco` or `mujoco_warp`.
        device: Warp device of `mujoco_warp`.

    Returns:
        A report per test.

    Raises:
        NotUsable: A test that the protocol or the setting does not allow, nothing to test,
            something that the back end does not do here, or other settings than those of the
            known protocol of that name.
        MissingExtra: A package that simulates is not installed.
        ConfigConflict: The run has verdicts of another protocol under this name, or its library has
            changed.
    """
    from bidexdata.validation.backends import check_backend, on_backend
    from bidexdata.validation.protocols import require_own_name

    require("mujoco", "scipy")
    require_own_name(protocol)
    execution = execution or TaskExecution()
    check_backend(protocol, backend, device, _how(extras))
    protocol = on_backend(protocol, backend, device)
    if protocol.engine is not None:
        execution = _for_one_device(execution)
    names = allowed_tests(run, protocol, tests)
    have = run.done()
    if not have:
        raise NotUsable(f"{run.path} has no finished task yet; run `bidexdata synth` first")
    run.check_source()
    _store_protocol(run, protocol)
    mine = execution.part_of(run.tasks)
    ready = {test: have & run.armed() if test in WITH_ARMS else have for test in names}
    return {
        test: _run_test(
            run,
            protocol,
            test,
            [t for t in mine if t.task_id in ready[test]],
            execution,
            tuple(extras),
            device,
        )
        for test in names
    }


def _how(extras: Sequence[Extra]) -> stages.Execution:
    from bidexdata.validation import stages

    return stages.Execution(
        plain="plain" in extras,
        load_margin="load_margin" in extras,
        analytic="analytic" in extras,
    )


def _for_one_device(execution: TaskExecution) -> TaskExecution:
    """Let one worker drive the device, unless the caller says how many.

    Raises:
        NotUsable: A Ray cluster, whose workers are on other machines.
    """
    if execution.executor == "ray":
        raise NotUsable(
            "the back end mujoco_warp is driven by a process beside its device: use "
            "--executor processes or inline"
        )
    return execution if execution.workers else dataclasses.replace(execution, workers=1)


def allowed_tests(run: Run, protocol: Protocol, asked: Sequence[str]) -> tuple[str, ...]:
    """Tests to run: those asked for, or all that the protocol defines and the rows allow.

    Raises:
        NotUsable: The protocol does not define one that is asked for, the rows do not allow it, it
            needs motions of arms that the run does not have, or they allow none.
    """
    from bidexdata.validation.protocols import require_test

    here = [t for t in protocol.tests if t not in ON_TABLE or run.spec.setting == "tabletop"]
    if not here:
        raise NotUsable(
            f"protocol {protocol.name!r} has no test for {run.spec.setting} rows, which are all "
            f"that {run.path} has; it has: {', '.join(protocol.tests)}"
        )
    armed = bool(set(here) & set(WITH_ARMS)) and bool(run.armed())
    if not asked:
        possible = tuple(t for t in here if armed or t not in WITH_ARMS)
        if not possible:
            raise NotUsable(_needs_arms(run, here[0]))
        return possible
    for test in asked:
        require_test(protocol, test)
        if test not in here:
            raise NotUsable(f"test {test!r} cannot be run on {run.spec.setting} rows of {run.path}")
        if test in WITH_ARMS and not armed:
            raise NotUsable(_needs_arms(run, test))
    return tuple(dict.fromkeys(asked))


def _needs_arms(run: Run, test: str) -> str:
    return (
        f"test {test!r} needs the motions of arms, and {run.path} has none; `bidexdata arms "
        f"{run.path}` makes them"
    )


def _store_protocol(run: Run, protocol: Protocol) -> None:
    """Write the settings beside the verdicts, or check that they are the same.

    What is there from before there were arms gets the rules of the arms added.

    Raises:
        ConfigConflict: The run has verdicts of other settings under this name.
    """
    path = run.path / "validate" / protocol.name / PROTOCOL_FILE
    settings = to_plain(protocol)
    if path.is_file():
        known = to_plain(run.protocol(protocol.name))
        differing = differing_settings(known, settings)
        if differing:
            raise ConfigConflict(path.parent, differing)
        if fuller_settings(known, settings) is known:
            return
    write_text(path, json.dumps(settings, indent=1, sort_keys=True) + "\n")


def _run_test(
    run: Run,
    protocol: Protocol,
    test: str,
    tasks: Sequence[Task],
    execution: TaskExecution,
    extras: tuple[Extra, ...],
    device: str,
) -> StageReport:
    folder = run.stage_folder("validate", protocol.name, test)
    mark = verdict_fingerprint(run, protocol, test)
    sweep([folder])
    done = done_tasks(folder)
    for task in tasks:
        if task.task_id in done:
            has = _extras_of(shard_path(folder, task.task_id), mark)
            if not has >= set(extras):
                done.remove(task.task_id)
    return run_stage(
        tasks,
        done,
        partial(
            _validate_task,
            str(run.path),
            run.fingerprint,
            run.rig if test in WITH_ARMS else None,
            to_plain(protocol),
            test,
            extras,
            device,
        ),
        unit="task",
        logs=run.path / "logs",
        execution=execution,
    )


def _extras_of(path: Path, mark: str) -> set[Extra]:
    """What a shard was made with.

    Raises:
        ConfigConflict: Another run, or other settings, made it.
    """
    try:
        check_mark(path, mark)
    except ConfigConflict as err:
        changed = f"the run, or settings of protocol {path.parents[2].name!r}, that the shard is of"
        raise ConfigConflict(path, [changed]) from err
    return set(read_mark(path).notes.get("extras", ()))


def _validate_task(
    run_path: str,
    run_fingerprint: str,
    rig: str | None,
    protocol_data: dict,
    test: str,
    extras: tuple[Extra, ...],
    device: str,
    task: Task,
) -> TaskSummary:
    from bidexdata.validation.protocols import Protocol
    from bidexdata.validation.validate import validate_grasps

    run = open_unchanged(run_path, run_fingerprint, rig)
    log_to(run.path / "logs")
    start, cpu = time.monotonic(), time.process_time()
    protocol = from_plain(Protocol, protocol_data)
    path = shard_path(run.stage_folder("validate", protocol.name, test), task.task_id)
    mark = verdict_fingerprint(run, protocol, test)
    # What was measured once is not lost: a task is done again with what its own shard has.
    had = _extras_of(path, mark) if path.is_file() else set()
    extras = tuple(sorted({*extras, *had}))
    how = _how(extras)
    batch = run.task_batch(task)
    armed = test in WITH_ARMS
    columns = validate_grasps(
        run.task_arms(task, batch) if armed else batch,
        run.load_solid(task.object_id),
        run.hands(),
        protocol,
        test,
        robot=run.robot() if armed else None,
        execution=how,
        backend=protocol.backend,
        device=device,
    )
    verdicts = verdict_batch(batch.header, batch["grasp_id"], columns)
    notes = {"extras": list(extras), "execution": to_plain(how)}
    if protocol.backend != "mujoco":  # its rule is another
        from bidexdata.validation.warp_checks import REST

        notes["execution"]["rest"] = notes["execution"]["lift_rest"] = to_plain(REST)
    write_shard(path, verdicts.to_arrow(), mark, device=device, notes=notes)
    labels = [Status(int(s)).label for s in columns["verdict_status"]]
    seconds = time.monotonic() - start
    logging.getLogger(__name__).info(
        "task %s test %s: %d rows in %.1f s", task.task_id, test, len(batch), seconds
    )
    return TaskSummary(
        len(batch),
        int(np.sum(columns["success"])),
        dict(Counter(labels)),
        cpu_seconds=time.process_time() - cpu,
        process=os.getpid(),
    )
