"""Finished: which tasks of a run were done at one moment, each folder listed once.

A run may grow while a command reads it, and a stage has up to ten thousand shards. All that one
command says of a run is drawn from one look, so its counts, rows and figures agree.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from bidexdata.runs.plan import Task
from bidexdata.runs.run import Run
from bidexdata.runs.shards import done_tasks

Test = tuple[str, str]
"""Protocol and test."""


@dataclass(frozen=True, slots=True)
class Finished:
    """Ids of the planned tasks whose shards are there."""

    rows: frozenset[str]
    verdicts: Mapping[Test, frozenset[str]]
    """Per test that has shards, sorted."""
    armed: frozenset[str] = frozenset()
    """With arm solutions, of the rig that is meant."""

    @classmethod
    def of(cls, run: Run) -> Finished:
        """Look at a run now."""
        planned = {t.task_id for t in run.tasks}
        # Verdicts first: whatever has one by now has its rows when these are listed.
        judged = {test: done_tasks(folder) for test, folder in run.verdict_folders().items()}
        armed = run.armed()
        rows = done_tasks(run.stage_folder("rows"))
        return cls(
            frozenset(rows & planned),
            {test: frozenset(ids & planned) for test, ids in judged.items() if ids},
            frozenset(armed),
        )

    @property
    def tests(self) -> tuple[Test, ...]:
        """The (protocol, test) pairs that have shards."""
        return tuple(self.verdicts)

    def tasks_of(self, run: Run, object_id: str) -> list[Task]:
        """The finished tasks of one object, in plan order."""
        return [t for t in run.tasks_of(object_id) if t.task_id in self.rows]

    def tested(self, tests: Sequence[Test]) -> frozenset[str]:
        """Tasks whose rows have a verdict of every one of some tests; none where there is no test."""
        found = [self.verdicts.get(test, frozenset[str]()) for test in tests]
        return self.rows.intersection(*found) if found else frozenset()
