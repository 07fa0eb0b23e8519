"""One function that runs tasks: in this process, in worker processes, or on a Ray cluster.

A task must be idempotent and say all that its worker needs. Whatever becomes of one task, an
exception or the death of its worker, the others go on; the caller learns of it as a
`TaskFailure`. Results come in completion order, so nothing may depend on it.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

from bidexdata.errors import BadValue, MissingExtra, UnknownName
from bidexdata.runs.boundary import Raised, call_task, describe
from bidexdata.runs.workers import THREAD_VARIABLES, Outcome, WorkerPool, usable_cores

T = TypeVar("T")
R = TypeVar("R")
EXECUTORS = ("processes", "inline", "ray")


@dataclass(frozen=True, slots=True)
class TaskFailure:
    """A task that gave no result."""

    task: Any
    reason: str
    """One line: the exception, or how the worker died."""
    kind: Literal["exception", "died", "timeout"] = "exception"
    details: str = ""
    """The traceback, where there is one."""
    signal: str = ""
    """Name of the signal that the worker died of, where it is known."""


def run_tasks(
    tasks: Sequence[T],
    work: Callable[[T], R],
    *,
    executor: str = "processes",
    workers: int = 0,
    timeout: float | None = None,
) -> Iterator[tuple[T, R | TaskFailure]]:
    """Apply `work` to every task and yield (task, result) in completion order.

    Closing the iterator, an exception in the consumer, or Ctrl-C ends all workers.

    Args:
        tasks: Picklable values (any for `inline`).
        work: A module-level function, or a `functools.partial` of one.
        executor: `processes` spawns single-threaded workers, `inline` runs here, one by one,
            `ray` uses a Ray cluster (the extra `ray`).
        workers: Number of workers; 0 means one per usable core.
        timeout: Wall seconds after which a task's worker is ended and the task fails; only
            `processes` can keep it, the others ignore it.

    Raises:
        UnknownName: No executor is called so.
        BadValue: A negative number of workers.
        NotUsable: Workers cannot start at all.
    """
    check_executor(executor, workers)
    if executor == "inline":
        return _run_inline(tasks, work)
    count = min(workers or usable_cores(), max(len(tasks), 1))
    if executor == "ray":
        return _run_ray(tasks, work, count if workers else 0)
    return _run_processes(tasks, work, count, timeout)


def check_executor(executor: str, workers: int) -> None:
    """Refuse an executor that does not exist, or a negative number of workers.

    Raises:
        UnknownName: No executor is called so.
        BadValue: The number is negative.
    """
    if executor not in EXECUTORS:
        raise UnknownName("executor", executor, EXECUTORS)
    if workers < 0:
        raise BadValue(f"--workers {workers}: give 0 (one per core) or a positive number")


def _run_inline(tasks: Sequence[T], work: Callable[[T], R]) -> Iterator[tuple[T, R | TaskFailure]]:
    for task in tasks:
        result = call_task(work, task)
        if isinstance(result, Raised):
            yield task, TaskFailure(task, result.reason, details=result.details)
        else:
            yield task, result


def _run_processes(
    tasks: Sequence[T], work: Callable[[T], R], workers: int, timeout: float | None
) -> Iterator[tuple[T, R | TaskFailure]]:
    if not tasks:
        return
    with WorkerPool(work, workers, timeout) as pool:
        for outcome in pool.run(tasks):
            task = tasks[outcome.number]
            if outcome.kind == "done":
                yield task, outcome.value
            else:
                yield task, _failure(task, outcome)


def _failure(task: Any, outcome: Outcome) -> TaskFailure:
    assert outcome.kind != "done"
    return TaskFailure(task, outcome.reason, outcome.kind, outcome.details, outcome.signal)


def _run_ray(
    tasks: Sequence[T], work: Callable[[T], R], workers: int
) -> Iterator[tuple[T, R | TaskFailure]]:
    ray, started = _start_ray(workers)
    try:
        # A deterministic failure fails again: no retries.
        remote = ray.remote(num_cpus=1, max_retries=0)(_apply)
        shared = ray.put(work)
        queue = iter(tasks)
        window = 2 * max(workers or int(ray.cluster_resources().get("CPU", 1)), 1)
        pending: dict[Any, T] = {}
        while True:
            while len(pending) < window and (task := next(queue, _END)) is not _END:
                pending[remote.remote(shared, task)] = task  # type: ignore[assignment]
            if not pending:
                return
            (ready,), _ = ray.wait(list(pending), num_returns=1)
            task = pending.pop(ready)
            yield task, _ray_result(ray, ready, task)
    finally:
        if started:
            ray.shutdown()


def _apply(work: Callable[[T], R], task: T) -> R:
    # Ray makes tasks of functions only, and `work` may be a partial of one.
    return work(task)


def _start_ray(workers: int) -> tuple[Any, bool]:
    # Ray collects usage statistics unless told not to; read when it is imported.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
    except ImportError as err:
        raise MissingExtra("ray", "ray") from err
    if ray.is_initialized():
        return ray, False
    # Inside a cluster (`ray start`, a Slurm script) RAY_ADDRESS names it; otherwise a local one.
    local = not os.environ.get("RAY_ADDRESS")
    env: dict[str, str] = dict.fromkeys(THREAD_VARIABLES, "1")
    if local:  # as spawned workers do: what is importable here is importable there
        env["PYTHONPATH"] = os.pathsep.join(p for p in sys.path if p)
    ray.init(
        num_cpus=(workers or usable_cores()) if local else None,
        include_dashboard=False,
        log_to_driver=False,
        logging_level=logging.ERROR,
        runtime_env={"env_vars": env},
    )
    return ray, True


def _ray_result(ray: Any, ready: Any, task: Any) -> Any:
    try:
        return ray.get(ready)
    except ray.exceptions.RayTaskError as err:
        reason = describe(err.cause) if err.cause is not None else str(err).splitlines()[-1]
        return TaskFailure(task, reason, details=str(err))
    except ray.exceptions.RayError as err:
        return TaskFailure(task, f"the worker died ({type(err).__name__})", "died", str(err))


_END: Any = object()
