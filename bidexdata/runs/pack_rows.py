"""Rows of a run as a release takes them: those of one object, rounds joined, with their verdicts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from bidexdata.record import GraspBatch
from bidexdata.record.fields import columns_written_by
from bidexdata.runs.finished import Finished, Test
from bidexdata.runs.run import Run
from bidexdata.runs.run_rows import join_tasks
from bidexdata.runs.shards import read_mark, shard_path

if TYPE_CHECKING:
    import numpy as np

    from bidexdata.formats.rows import ReleaseRows


def rows_of_object(
    run: Run, finished: Finished, object_id: str, name: str, tests: Sequence[Test]
) -> ReleaseRows | None:
    """All finished rows of one object of a run, rounds joined, with their verdicts.

    A test that is not finished for all these rows is left out: half-tested scenes have no rate.
    """
    import numpy as np

    from bidexdata.formats.rows import ReleaseRows

    tasks = finished.tasks_of(run, object_id)
    if not tasks:
        return None
    batches = [run.task_batch(t) for t in tasks]
    verdicts: dict[Test, dict[str, np.ndarray]] = {}
    for protocol, test in tests:
        if {t.task_id for t in tasks} <= finished.verdicts.get((protocol, test), frozenset()):
            pairs = zip(tasks, batches, strict=True)
            parts = [run.task_verdicts(t, b, protocol, test) for t, b in pairs]
            verdicts[protocol, test] = {c: np.concatenate([p[c] for p in parts]) for c in parts[0]}
    if not {t.task_id for t in tasks} <= finished.armed:
        return ReleaseRows(name, join_tasks(batches), verdicts)
    solved = join_tasks([run.task_arms(t, b) for t, b in zip(tasks, batches, strict=True)])
    arms = {n: solved[n] for n in columns_written_by("arms")}
    rows = {n: c for n, c in solved.columns.items() if n not in arms}
    return ReleaseRows(name, GraspBatch(solved.header, rows), verdicts, arms)


def count_tested(run: Run, finished: Finished, protocol: str) -> tuple[int, int]:
    """Count the finished rows that every test begun of a protocol has a verdict on, and all."""
    tested = finished.tested([t for t in finished.tests if t[0] == protocol])
    folder = run.stage_folder("rows")
    rows = {i: read_mark(shard_path(folder, i)).rows for i in finished.rows}
    return sum(rows[i] for i in tested), sum(rows.values())
