"""Rows of a run that benchmarks judge, opened once per worker process."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import cache
from multiprocessing import get_context
from typing import Any, NamedTuple

from bidexdata import Run
from bidexdata.hands import Hand
from bidexdata.objects.prepared import Solid
from bidexdata.record import GraspBatch, Status


class TaskRows(NamedTuple):
    """Rows of one task that have a grasp, with what is needed to judge them."""

    batch: GraspBatch
    solid: Solid
    hands: tuple[Hand, ...]


def task_rows(path: str, number: int) -> TaskRows:
    """All rows of task `number` with synth_status OK."""
    run = _opened(path)
    task = run.tasks[number]
    batch = run.task_batch(task)
    return TaskRows(
        batch.select(batch.synth_status == Status.OK), _solid(path, task.object_id), _hands(path)
    )


@contextmanager
def pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that start afresh, so that no state of this one is copied."""
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as executor:
        yield executor


def over_tasks(
    executor: ProcessPoolExecutor, run: Run, job: Callable[..., Any], *args: Any
) -> Sequence[Any]:
    """Results of `job(path, number, *args)` for every task, in the order of the run."""
    jobs = [executor.submit(job, str(run.path), i, *args) for i in range(len(run.tasks))]
    return [j.result() for j in jobs]


@cache
def _opened(path: str) -> Run:
    return Run.open(path)


@cache
def _hands(path: str) -> tuple[Hand, ...]:
    return tuple(_opened(path).hands())


@cache
def _solid(path: str, object_id: str) -> Solid:
    return _opened(path).load_solid(object_id)
