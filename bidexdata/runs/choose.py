"""Which grasps of a run or a release a picture shows: spread over objects and sizes, by outcome or status.

The choice follows from the seed, the ids and what is asked for alone.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from itertools import zip_longest
from typing import Literal, NamedTuple

import numpy as np

from bidexdata.errors import UnknownName
from bidexdata.record import GraspBatch, Status
from bidexdata.record.fields import WITH_ARMS
from bidexdata.runs.arm_pictures import rows_with_arms
from bidexdata.runs.browse import Browsable, rows_by_test, verdicts_of

Only = Literal["success", "failure"]


class Shown(NamedTuple):
    """One grasp chosen for a sheet."""

    object_id: str
    batch: GraspBatch
    row: int


def chosen_of_each(
    source: Browsable,
    count: int,
    only: Only | None,
    statuses: Sequence[Status],
    seed: int,
    *,
    moving: bool,
) -> list[Shown]:
    """Choose grasps; as many of each status that some grasp came to, at least one."""
    if not statuses:
        return choose_grasps(source, count, only=only, seed=seed, moving=moving)

    def of_each(some: Sequence[Status]) -> dict[Status, list[Shown]]:
        each = max(1, count // len(some))
        return {s: choose_grasps(source, each, only=only, seed=seed, status=s) for s in some}

    found = of_each(statuses)
    some = [s for s in found if found[s]]
    if some and len(some) < len(found):  # the others take the places of those without one
        found = of_each(some)
    return [shown for chosen in found.values() for shown in chosen]


def choose_grasps(
    source: Browsable,
    count: int,
    *,
    only: Only | None = None,
    seed: int = 0,
    status: Status | None = None,
    moving: bool = False,
) -> list[Shown]:
    """Choose grasps with poses, spread over objects, then over sizes.

    Objects are taken in an order that the seed decides, until `count` of them have something to
    show; then each gives one grasp in turn, its sizes alternating. The result is sorted by object,
    size and grasp.

    Args:
        source: A run or a release.
        count: How many at most.
        only: Those that passed, or that failed; see `judging_test`.
        seed: Chooses others.
        status: Those whose attempt, arms or any test came to this.
        moving: Those whose arms have a motion.
    """
    queues: list[list[Shown]] = []
    for object_id in shuffled(source.object_ids, seed):
        if len(queues) == count:
            break
        batch = source.grasps(object_id)
        rows = [] if batch is None else _matching(source, batch, only, status, moving=moving)
        if batch is not None and rows:
            order = _alternating(batch, rows, seed, len(queues))
            queues.append([Shown(object_id, batch, row) for row in order])
    # First of each object, then second of each ...
    turns = zip_longest(*queues)
    chosen = [shown for turn in turns for shown in turn if shown is not None][:count]
    return sorted(
        chosen,
        key=lambda s: (
            s.object_id,
            int(s.batch["size_mm"][s.row]),
            str(s.batch["grasp_id"][s.row]),
        ),
    )


def statuses_called(labels: Sequence[str]) -> tuple[Status, ...]:
    """The failures of attempts, arms and tests that are called so.

    Raises:
        UnknownName: There is none.
    """
    known = {s.label: s for s in Status if s >= Status.NO_REGION_PAIR}
    for label in labels:
        if label not in known:
            raise UnknownName("status", label, known)
    return tuple(known[label] for label in labels)


def judging_test(source: Browsable, *, moving: bool = False) -> str:
    """The test that `only` goes by: the first; of motions that with arms, where it was run."""
    return next((t for t in WITH_ARMS if moving and t in source.tests), source.test)


def _matching(
    source: Browsable, batch: GraspBatch, only: Only | None, status: Status | None, *, moving: bool
) -> list[int]:
    """Rows of one object that are wanted, with its first test's verdicts."""
    from bidexdata.pictures.posing import has_pose

    keep = np.ones(len(batch), bool)
    object_id = str(batch["object_id"][0]) if len(batch) else ""
    if only is not None:
        test = judging_test(source, moving=moving)
        judged = batch if test == source.test else rows_by_test(source, object_id, batch)[test]
        keep = verdicts_of(judged) == (1 if only == "success" else 0)
    if only != "failure" and status is None and "selected" in batch:
        keep &= batch["selected"]
    if status is not None or moving:
        keep &= _of_arms(source, batch, object_id, status, moving=moving)
    return [int(r) for r in np.flatnonzero(keep) if has_pose(batch, int(r))]


def _of_arms(
    source: Browsable, batch: GraspBatch, object_id: str, status: Status | None, *, moving: bool
) -> np.ndarray:
    """Which rows came to a status; without one, which have a motion, (N,) bool."""
    armed = rows_with_arms(source, object_id, batch) if source.rig else None
    found = np.zeros(len(batch), bool)
    if armed is not None:
        found |= armed["arm_status"] == (Status.OK if status is None else status)
    if status is not None:
        for rows in rows_by_test(source, object_id, batch).values():
            for name in ("synth_status", "verdict_status"):
                found |= rows[name] == status if name in rows else False
    return found


def _alternating(batch: GraspBatch, rows: Sequence[int], seed: int, turn: int) -> list[int]:
    # Sizes alternate, and each object starts with another size.
    by_size: dict[int, list[int]] = {}
    names = {str(batch["grasp_id"][r]): r for r in rows}
    for name in shuffled(tuple(names), seed):
        by_size.setdefault(int(batch["size_mm"][names[name]]), []).append(names[name])
    sizes = sorted(by_size)
    sizes = sizes[turn % len(sizes) :] + sizes[: turn % len(sizes)]
    order: list[int] = []
    while any(by_size.values()):
        order += [by_size[s].pop(0) for s in sizes if by_size[s]]
    return order


def shuffled(names: Sequence[str], seed: int) -> list[str]:
    """Names in an order that the seed decides, by hash: one more does not change that of the others."""
    return sorted(names, key=lambda n: (hashlib.sha256(f"{seed}/{n}".encode()).digest(), n))
