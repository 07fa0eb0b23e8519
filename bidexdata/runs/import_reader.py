"""Read foreign files in a worker process, whatever the executor.

A file may do what it likes to the memory of its reader, so no file is read in the caller's process,
nor by a worker of Ray, which has no bound of its own. Where tasks run in this process one child reads
for them; it stays for the next import, for its start costs seconds, and ends with this process.
"""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from typing import Any, TypeVar

from bidexdata.runs.executors import TaskFailure, run_tasks
from bidexdata.runs.stage import TaskExecution
from bidexdata.runs.workers import WorkerPool

T = TypeVar("T")
R = TypeVar("R")


def read_tasks(
    tasks: Sequence[T], work: Callable[[T], R], execution: TaskExecution
) -> Iterator[tuple[T, R | TaskFailure]]:
    """Apply `work` to every task in worker processes, as `run_tasks` does.

    Args:
        tasks: Picklable values.
        work: A module-level function, or a `functools.partial` of one; it bounds its own memory.
        execution: How many workers; one where the executor is `inline`.
    """
    if execution.executor == "inline":
        return in_child(tasks, work)
    return run_tasks(tasks, work, executor="processes", workers=execution.workers)


def read_apart(task: T, work: Callable[[T], R]) -> R | TaskFailure:
    """Do one task here if this process is a worker, else in a child."""
    if multiprocessing.parent_process() is not None:
        return work(task)
    ((_, result),) = in_child([task], work)
    return result


def in_child(tasks: Sequence[T], work: Callable[[T], R]) -> Iterator[tuple[T, R | TaskFailure]]:
    """Apply `work` to every task in the one child of this process; the results come in any order."""
    with _CHILD.lock:
        finished = False
        try:
            for outcome in _CHILD.pool().run([(work, task) for task in tasks]):
                task = tasks[outcome.number]
                if outcome.kind == "done":
                    yield task, outcome.value
                else:
                    how = (outcome.reason, outcome.kind, outcome.details, outcome.signal)
                    yield task, TaskFailure(task, *how)
            finished = True
        finally:
            if not finished:  # answers of tasks that nobody waits for are still to come
                _CHILD.close()


class _Child:
    """Owns the pool of one worker, started when it is first needed."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self._pool: WorkerPool | None = None
        self._stack = ExitStack()

    def pool(self) -> WorkerPool:
        if self._pool is None:
            self._pool = self._stack.enter_context(WorkerPool(_apply, 1))
        return self._pool

    def close(self) -> None:
        self._pool = None
        self._stack.close()


_CHILD = _Child()


def _apply(pair: tuple[Callable[[Any], Any], Any]) -> Any:
    work, task = pair
    return work(task)
