"""Look into a run, also one that is still being made."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bidexdata.kinds import Kind
from bidexdata.record import GraspBatch
from bidexdata.record.batch import empty_columns
from bidexdata.record.fields import columns_written_by
from bidexdata.runs.browse_library import library_categories
from bidexdata.runs.chosen import chosen_protocol, tests_of_protocol

if TYPE_CHECKING:
    from bidexdata.arms.robot import Robot
    from bidexdata.hands.model import Hand
    from bidexdata.objects.prepared import Solid
    from bidexdata.runs.release_rows import ReleaseRowsIndex
    from bidexdata.runs.run import Run


class RunSource:
    """Rows of a run, also of one that is still being made; verdicts where they are there."""

    kind: Kind = "run"

    def __init__(self, path: Path, protocol: str | None = None, rig: str | Path | None = None):
        from bidexdata.runs.run import Run

        self.path = path
        self.run: Run = Run.open(path, rig=rig)
        tests = self.run.verdict_tests()
        self.protocol = chosen_protocol(path, tests, protocol)
        self.tests = tests_of_protocol(self.protocol, tests)
        self.test = next(iter(self.tests), "")

    @property
    def object_ids(self) -> tuple[str, ...]:
        """Objects of the plan, sorted."""
        return self.run.object_ids

    def categories(self) -> tuple[str, ...]:
        """As the run's library has them; a run that tests a release anew names none."""
        if self.run.spec.of_release:
            return ("",) * len(self.object_ids)
        return library_categories(self.run.library, self.object_ids)

    def load_solid(self, object_id: str) -> Solid:
        """Read one object of the run's library."""
        return self.run.load_solid(object_id)

    def index(self) -> ReleaseRowsIndex | None:
        """None: rows lie in shards, which are read object by object."""
        return None

    def grasps(self, object_id: str, test: str = "") -> GraspBatch | None:
        """Rows of the tasks that are done by now; those not yet validated say so in every row."""
        from bidexdata.runs.run_rows import join_tasks

        found, test = [], test or self.test
        for task in self.run.tasks_of(object_id):
            if not self.run.is_done(task):
                continue
            batch = self.run.task_batch(task)
            if test and self.run.is_done(task, self.protocol, test):
                verdicts = self.run.task_verdicts(task, batch, self.protocol, test)
            elif test:
                verdicts = _no_verdicts(batch)
            else:
                verdicts = {}
            found.append(batch.with_columns(**verdicts))
        return join_tasks(found) if found else None

    def hands(self) -> tuple[Hand, ...]:
        """Load the run's hands as far as they are drawn."""
        return self.run.hands(drawn=True)

    @property
    def rig(self) -> str:
        """The run's."""
        return self.run.rig

    def arms(self, object_id: str) -> GraspBatch | None:
        """Rows of the tasks whose arms are solved by now."""
        from bidexdata.runs.run_rows import join_tasks

        tasks = [t for t in self.run.tasks_of(object_id) if self.run.is_armed(t)]
        found = [self.run.task_arms(t, self.run.task_batch(t)) for t in tasks]
        return join_tasks(found) if found else None

    def robot(self) -> Robot | None:
        """The run's."""
        return self.run.robot() if self.run.rig else None


def _no_verdicts(batch: GraspBatch) -> dict[str, np.ndarray]:
    missing = [n for n in columns_written_by("validate") if n not in batch]
    return empty_columns(batch.header, missing, len(batch))
