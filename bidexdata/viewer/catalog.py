"""What all open pages share: objects, rows and hands, read once and kept for a while.

Pages run in threads; reading is serialised by one lock.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Literal, TypeVar

import numpy as np

from bidexdata.pictures.posing import has_pose
from bidexdata.record import GraspBatch
from bidexdata.runs.browse import Browsable, rows_by_test, verdicts_of
from bidexdata.viewer.nodes import body_meshes

if TYPE_CHECKING:
    from bidexdata.hands.model import Hand
    from bidexdata.objects.prepared import Solid

T = TypeVar("T")

Outcome = Literal["all", "passed", "failed", "not tested"]
Kept = Literal["all", "selected", "audit"]
OUTCOMES: tuple[Outcome, ...] = ("all", "passed", "failed", "not tested")
KEPT: tuple[Kept, ...] = ("all", "selected", "audit")

_CACHED_OBJECTS = 8


class Catalog:
    """Reads a library, a run or a release for any number of pages."""

    def __init__(self, source: Browsable):
        self.source = source
        self._lock = threading.RLock()
        self._solids: OrderedDict[str, Solid] = OrderedDict()
        self._batches: OrderedDict[str, dict[str, GraspBatch]] = OrderedDict()

    @cached_property
    def object_ids(self) -> tuple[str, ...]:
        """Objects, sorted."""
        return self.source.object_ids

    @cached_property
    def hands(self) -> tuple[Hand, ...]:
        """In the order of the H axis; none for a library."""
        with self._lock:
            return self.source.hands()

    def preload(self) -> None:
        """Load the hands and the first object before the first page asks for them."""
        for hand in self.hands:
            body_meshes(hand)
        self.solid(self.object_ids[0])

    def solid(self, object_id: str) -> Solid:
        """Read an object, or take it from the cache."""
        return self._cached(self._solids, object_id, self.source.load_solid)

    def grasps(self, object_id: str) -> dict[str, GraspBatch]:
        """Read all rows of an object per test, or take them from the cache; see `rows_by_test`."""
        return self._cached(self._batches, object_id, lambda name: rows_by_test(self.source, name))

    def _cached(self, cache: OrderedDict[str, T], key: str, read: Callable[[str], T]) -> T:
        with self._lock:
            if key not in cache:
                cache[key] = read(key)
                while len(cache) > _CACHED_OBJECTS:
                    cache.popitem(last=False)
            cache.move_to_end(key)
            return cache[key]


def matching_rows(
    batch: GraspBatch | None,
    *,
    size_mm: int | None = None,
    outcome: Outcome = "all",
    kept: Kept = "all",
) -> list[int]:
    """Rows with a pose that pass the filters, ordered by size, then as stored.

    Args:
        batch: Rows of one object; none gives no rows.
        size_mm: One size; all when None.
        outcome: What the test of these verdicts said.
        kept: `selected` or `audit` rows.
    """
    if batch is None:
        return []
    mask = np.array([has_pose(batch, row) for row in range(len(batch))], bool)
    if size_mm is not None:
        mask &= batch["size_mm"] == size_mm
    if outcome != "all":
        mask &= verdicts_of(batch) == {"passed": 1, "failed": 0, "not tested": -1}[outcome]
    if kept != "all" and kept in batch:
        mask &= batch[kept]
    rows = np.flatnonzero(mask)
    return [int(r) for r in rows[np.argsort(batch["size_mm"][rows], kind="stable")]]
