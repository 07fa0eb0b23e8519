"""Content hash of a run: sha256 over the decoded columns of its finished rows and verdicts.

As that of a release (`formats.content_hash`), over the tasks in the order of the plan: whichever
executor made the shards, and whichever machine of several, the hash is the same.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from bidexdata.formats.content_hash import ContentTally
from bidexdata.record import GraspBatch
from bidexdata.record.fields import columns_written_by
from bidexdata.runs.finished import Finished

if TYPE_CHECKING:
    import pyarrow as pa

    from bidexdata.runs.run import Run


def run_content_hash(run: Run) -> str:
    """Hash the rows, the counts of attempts and the verdicts of a run's finished tasks.

    Raises:
        ConfigConflict: Another configuration made a shard.
        Contradiction: A shard is damaged, or its ids are not those of the rows.
    """
    finished, tally = Finished.of(run), ContentTally()
    for task in run.tasks:
        if task.task_id not in finished.rows:
            continue
        batch = run.task_batch(task)
        tally.add("rows", batch.to_arrow())
        tally.add("counts", _counts(batch))
        if task.task_id in finished.armed:
            solved = run.task_arms(task, batch)
            columns = {n: solved[n] for n in ("grasp_id", *columns_written_by("arms"))}
            tally.add(f"arms/{run.rig}", GraspBatch(solved.header, columns).to_arrow())
        for (protocol, test), done in finished.verdicts.items():
            if task.task_id in done:
                columns = run.task_verdicts(task, batch, protocol, test)
                columns = {"grasp_id": batch["grasp_id"], **columns}
                judged = GraspBatch(batch.header, columns).to_arrow()
                tally.add(f"verdicts/{protocol}-{test}", judged)
    return tally.digest()


def _counts(batch: GraspBatch) -> pa.Table:
    import pyarrow as pa

    counts = sorted(batch.header.counts.items())
    return pa.table(
        {
            "scene_id": pa.array([scene for scene, _ in counts], pa.string()),
            "attempts": pa.array([json.dumps(dict(c), sort_keys=True) for _, c in counts]),
        },
        pa.schema([("scene_id", pa.string()), ("attempts", pa.string())]),
    )
