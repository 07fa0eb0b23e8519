"""Groups of tested grasps: success rate and mean of every metric per object, size, setting and so on.

Rows are the selected ones that one test was run on; per status, the audit rows too, for selection
leaves out most of what fails. What is kept of them is, for every group and
object in it, a count of rows and of successes and the moments of each metric: nothing per grasp,
about two kilobytes per object and size and per object and status. All sums are exact, so the order in
which batches come, and how they are cut, changes nothing.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple, get_args

import numpy as np

from bidexdata.record import FIELDS, Header, Status
from bidexdata.record.batch import fill_value
from bidexdata.record.fields import METRICS
from bidexdata.record.means import mean_interval
from bidexdata.record.moments import NOTHING, Moments, moments_of_runs
from bidexdata.record.rates import clustered_interval
from bidexdata.record.scene import Setting

BY = ("object", "size", "setting", "hand", "status")
"""What grasps can be grouped by."""
BOUNDED = ("size", "setting", "hand", "status")
"""Groupings of which there are few groups however large the set: these go into manifest and card."""


class Cell(NamedTuple):
    """What is kept of the rows of one object in one group."""

    rows: int = 0
    passed: int = 0
    moments: tuple[Moments, ...] = (NOTHING,) * len(METRICS)

    def joined(self, other: Cell) -> Cell:
        """Join the cells of disjoint rows."""
        pairs = zip(self.moments, other.moments, strict=True)
        moments = tuple(a.plus(b) for a, b in pairs)
        return Cell(self.rows + other.rows, self.passed + other.passed, moments)


class GroupTally:
    """Add rows in any order and number, then read `metrics()` and `groups(by)`."""

    def __init__(self) -> None:
        # by -> group -> object -> cell
        self._cells: dict[str, dict[str, dict[str, Cell]]] = {by: defaultdict(dict) for by in BY}

    def add(
        self,
        object_id: np.ndarray,
        size_mm: np.ndarray,
        setting: np.ndarray,
        hand: str,
        passed: np.ndarray,
        verdict: Mapping[str, np.ndarray],
        selected: np.ndarray,
    ) -> None:
        """Count rows that a test was asked for, each row once.

        Args:
            object_id: Object of each row, (N,).
            size_mm: Size of each row, (N,).
            setting: Setting of each row, (N,).
            hand: The hands of these rows, from `hands_label`.
            passed: Rows that count as successes, (N,).
            verdict: Columns that `validate` writes, each (N,); missing metrics were not measured.
            selected: Rows that count everywhere, (N,); the others count per status alone.
        """
        if not len(object_id):
            return
        objects, number = np.unique(object_id, return_inverse=True)
        on_table = setting == "tabletop"
        keys = np.stack([number, size_mm, on_table, verdict["verdict_status"], selected])
        order = np.lexsort(keys)
        keys, passed = keys[:, order], passed[order]
        # Rows of one object, size, setting and status, selected or not, now stand together.
        starts = [0, *(np.flatnonzero(np.diff(keys, axis=1).any(axis=0)) + 1).tolist()]
        moments = [_measured(name, verdict, order, starts) for name in METRICS]
        ends = [*starts[1:], len(order)]
        for i, (first, last) in enumerate(zip(starts, ends, strict=True)):
            wins = int(np.count_nonzero(passed[first:last]))
            cell = Cell(last - first, wins, tuple(runs[i] for runs in moments))
            obj, size, table, status, chosen = (int(key) for key in keys[:, first])
            name, where = str(objects[obj]), get_args(Setting)[table]
            groups = (name, str(size), where, hand, Status(status).label)
            for by, group in zip(BY, groups, strict=True):
                if status == Status.NOT_RUN if by == "status" else not chosen:
                    continue
                known = self._cells[by][group]
                known[name] = known[name].joined(cell) if name in known else cell

    def metrics(self) -> dict[str, Any]:
        """The mean of every metric over all selected rows, by name."""
        return _means(self._objects(self._cells["object"].values()))

    def groups(self, by: str) -> dict[str, Any]:
        """Figures of each group of one grouping: sizes in order, the rest by name.

        A group is `rows`, `objects`, `metrics` and, unless rows are grouped by what became of
        them, the rate `selected`.
        """
        cells = self._cells[by]
        names = sorted(cells, key=int) if by == "size" else sorted(cells)
        return {name: _group(self._objects([cells[name]]), rate=by != "status") for name in names}

    @staticmethod
    def _objects(groups: Iterable[Mapping[str, Cell]]) -> list[Cell]:
        """Cells by object id: the bootstrap must not see the order in which rows came."""
        found = {obj: cell for group in groups for obj, cell in group.items()}
        return [found[obj] for obj in sorted(found)]


def hands_label(header: Header) -> str:
    """Name the hands of a run: `shadow left, shadow right`."""
    return ", ".join(f"{hand.name} {hand.side}" for hand in header.hands)


def _group(cells: list[Cell], *, rate: bool) -> dict[str, Any]:
    selected = clustered_interval([c.passed for c in cells], [c.rows for c in cells])
    return {
        "rows": sum(c.rows for c in cells),
        "objects": len(cells),
        **({"selected": selected.to_dict()} if rate else {}),
        "metrics": _means(cells),
    }


def _means(cells: list[Cell]) -> dict[str, Any]:
    """Means of the metrics that some row has."""
    found = {}
    for i, name in enumerate(METRICS):
        mean = mean_interval((c.moments[i] for c in cells), least=0.0)
        if mean.n:
            found[name] = mean.to_dict()
    return found


def _measured(
    name: str, verdict: Mapping[str, np.ndarray], order: np.ndarray, starts: list[int]
) -> list[Moments]:
    """The moments of one metric for every run of rows, rows taken in `order`."""
    values, missing = verdict.get(name), fill_value(FIELDS[name])
    if values is None or not (known := np.isfinite(values) & (values != missing)).any():
        return [NOTHING] * len(starts)
    return moments_of_runs(np.where(known, values, np.nan)[order], starts)
