"""How fast a run was made: what each task took, noted as tasks finish.

Shards say nothing of time, for they are the same bytes wherever they are made. So a file beside them
does, a line per task; a task whose line a kill lost, and a worker's first task, which loads kernels
or compiles them, count in no speed.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

from bidexdata.runs.plan import Task
from bidexdata.runs.run import Run
from bidexdata.runs.stage import TaskSummary

TIMES = "times.jsonl"
"""In the run's folder."""


class Speed(NamedTuple):
    """Attempts made in so much time of cores."""

    attempts: int
    cpu_seconds: float

    @property
    def per_second(self) -> float | None:
        """Attempts per second of one core; None where nothing was timed."""
        return self.attempts / self.cpu_seconds if self.cpu_seconds else None


def noted_in(run: Path) -> Callable[[Task, TaskSummary], None]:
    """What is to hear of a run's finished tasks, and writes what they took."""

    def note(task: Task, summary: TaskSummary) -> None:
        line = {
            "task_id": task.task_id,
            "attempts": sum(summary.by_status.values()),
            "cpu_seconds": round(summary.cpu_seconds, 4),
            "process": summary.process,
        }
        with (run / TIMES).open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")

    return note


def speed_of(run: Run, object_ids: Iterable[str]) -> Speed:
    """Sum up what the tasks of some objects took; first tasks count where there are no others."""
    lines = _lines(run.path / TIMES)
    firsts: dict[int, str] = {}
    for line in lines:
        firsts.setdefault(line["process"], line["task_id"])
    ids = set(object_ids)
    wanted = {t.task_id for t in run.tasks if t.object_id in ids}
    mine = {line["task_id"]: line for line in lines if line["task_id"] in wanted}
    warm = {i: line for i, line in mine.items() if i not in firsts.values()} or mine
    return Speed(
        sum(line["attempts"] for line in warm.values()),
        sum(line["cpu_seconds"] for line in warm.values()),
    )


def _lines(path: Path) -> list[dict[str, Any]]:
    found = []
    if path.is_file():
        for text in path.read_text(encoding="utf-8").splitlines():
            with contextlib.suppress(ValueError):  # half a line, of a killed command
                found.append(json.loads(text))
    return found
