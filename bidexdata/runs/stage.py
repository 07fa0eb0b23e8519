"""What every stage of a run has in common: take the open tasks, work, count, report."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from bidexdata.runs.executors import TaskFailure, check_executor, run_tasks
from bidexdata.runs.logs import log_to
from bidexdata.runs.plan import Task, take_shard
from bidexdata.runs.progress import Progress


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskExecution:
    """Where and how a command runs; nothing here changes a result."""

    executor: str = "processes"
    workers: int = 0
    """0: one per core."""
    shard: tuple[int, int] | None = None
    """Part i of n of the plan, i from 0."""
    objects: frozenset[str] | None = None
    """Only tasks of these objects; None: of all."""
    quiet: bool = False

    def __post_init__(self) -> None:
        check_executor(self.executor, self.workers)  # before anything is written

    def part_of(self, tasks: Sequence[Task]) -> list[Task]:
        """The tasks of a plan that this command is to do."""
        wanted = [t for t in tasks if self.objects is None or t.object_id in self.objects]
        return take_shard(wanted, self.shard)


@dataclass(frozen=True, slots=True)
class TaskSummary:
    """What a worker says of a finished task; the rows themselves are in its shard."""

    rows: int
    """Rows stored."""
    good: int
    """Rows that succeeded."""
    by_status: dict[str, int]
    without_grasp: tuple[str, ...] = ()
    """Scenes of the task that it kept no grasp of."""
    by_size: dict[int, dict[str, int]] = field(default_factory=dict)
    """What `by_status` counts, for each `size_mm`; empty where the stage does not say."""
    cpu_seconds: float = 0.0
    """That the worker's process computed for the task; 0 where the stage does not say."""
    process: int = 0
    """Id of that process, likewise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StageReport:
    """What one call of a stage did; figures of the whole run are `info`'s."""

    tasks: int
    """Tasks in this machine's part of the plan."""
    before: int
    """Of these, done before the call."""
    failures: tuple[TaskFailure, ...] = ()
    rows: int = 0
    good: int = 0
    by_status: dict[str, int] = field(default_factory=dict)
    without_grasp: tuple[str, ...] = ()
    by_size: dict[int, dict[str, int]] = field(default_factory=dict)
    """`by_status` for each `size_mm`."""
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    """That the workers' processes computed for its tasks; 0 where the stage does not say."""

    @property
    def finished(self) -> int:
        """Tasks done by this call."""
        return self.tasks - self.before - len(self.failures)


def run_stage(
    tasks: Sequence[Task],
    done: set[str],
    work: Callable[[Task], TaskSummary],
    *,
    unit: str,
    logs: Path,
    execution: TaskExecution,
    on_task: Callable[[Task, TaskSummary], None] | None = None,
) -> StageReport:
    """Run the tasks that are not done yet.

    A failed task leaves no shard: the next call tries it again.

    Args:
        tasks: This machine's part of the plan.
        done: Ids of finished tasks.
        work: Writes the shard of one task.
        unit: What the progress counts.
        logs: Folder of the log files.
        execution: Where and how.
        on_task: Hears, in this process, of every task that a worker has done.
    """
    open_tasks = [t for t in tasks if t.task_id not in done]
    start = time.monotonic()
    failures: list[TaskFailure] = []
    rows = good = 0
    cpu = 0.0
    by_status: Counter[str] = Counter()
    by_size: dict[int, Counter[str]] = defaultdict(Counter)
    without: list[str] = []
    logger = log_to(logs)
    before = len(tasks) - len(open_tasks)
    with Progress(len(tasks), unit, quiet=execution.quiet, already=before) as progress:
        results = run_tasks(
            open_tasks, work, executor=execution.executor, workers=execution.workers
        )
        for task, result in results:
            if isinstance(result, TaskFailure):
                failures.append(result)
                place = f"task {task.task_id} ({task.object_id})"
                logger.error("%s: %s\n%s", place, result.reason, result.details)
                progress.write(f"{place} failed: {result.reason}")
            else:
                rows += result.rows
                good += result.good
                cpu += result.cpu_seconds
                by_status.update(result.by_status)
                for size, counts in result.by_size.items():
                    by_size[size].update(counts)
                without += result.without_grasp
                if on_task is not None:
                    on_task(task, result)
            progress.advance()
    return StageReport(
        tasks=len(tasks),
        before=before,
        failures=tuple(failures),
        rows=rows,
        good=good,
        by_status=dict(by_status),
        without_grasp=tuple(sorted(without)),
        by_size={size: dict(counts) for size, counts in sorted(by_size.items())},
        seconds=time.monotonic() - start,
        cpu_seconds=cpu,
    )
