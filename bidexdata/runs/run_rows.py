"""Rows of a run joined: tasks behind each other, and a later stage's columns beside the first's."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from bidexdata.errors import Contradiction
from bidexdata.record import FIELDS, GraspBatch, Header
from bidexdata.record.fields import columns_written_by
from bidexdata.runs.shards import read_shard


def join_tasks(batches: list[GraspBatch]) -> GraspBatch:
    """Join tasks of one run; attempts of a scene in several rounds are added up."""
    joined = GraspBatch.concat(batches)
    counts: dict[str, Counter[str]] = {}
    for batch in batches:
        for scene, found in batch.header.counts.items():
            counts.setdefault(scene, Counter()).update(found)
    header = dataclasses.replace(
        joined.header, counts={scene: dict(found) for scene, found in counts.items()}
    )
    return dataclasses.replace(joined, header=header)


def columns_beside(
    path: Path, mark: str, batch: GraspBatch, stage: str
) -> tuple[dict[str, np.ndarray], Header]:
    """Read what a later stage wrote, row by row for `batch`, and the header of its shard.

    Args:
        path: The later stage's shard.
        mark: What it must carry.
        batch: The rows of the first stage.
        stage: The later stage, as the field table calls it.

    Raises:
        PathNotFound: The stage has not done the task.
        ConfigConflict: The shard carries another mark.
        Contradiction: It is damaged, or its ids are not those of the rows.
    """
    joined = GraspBatch.from_arrow(read_shard(path, mark))
    if not np.array_equal(joined["grasp_id"], batch["grasp_id"]):
        raise Contradiction(f"{path}: its grasp ids are not those of the rows; delete it")
    names = [n for n in joined.columns if FIELDS[n].written_by == stage]
    return {n: joined[n] for n in names}, joined.header


def verdict_batch(
    header: Header, grasp_id: np.ndarray, columns: Mapping[str, np.ndarray]
) -> GraspBatch:
    """What a validate shard holds: `grasp_id` and the verdict columns in table order."""
    ordered = {n: columns[n] for n in columns_written_by("validate") if n in columns}
    lean = dataclasses.replace(header, counts={})
    return GraspBatch(lean, {"grasp_id": grasp_id, **ordered})
