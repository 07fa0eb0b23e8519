"""Groups of tested grasps: success rate and mean of every metric, per object, size, hand, status.

Rows are the selected ones that one test was run on. What is kept of them is, for every group and
object in it, a count of rows and of successes and the moments of each metric: nothing per grasp,
about a kilobyte per object and size and per object and status. All sums are exact, so the order in
which batches come, and how they are cut, changes nothing.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from bidexdata.record import FIELDS, Header, Status
from bidexdata.record.batch import fill_value
from bidexdata.record.means import mean_interval
from bidexdata.record.moments import NOTHING, Moments, merged, moments_of
from bidexdata.record.rates import clustered_interval

BY = ("object", "size", "hand", "status")
"""What grasps can be grouped by."""
BOUNDED = ("size", "hand", "status")
"""Groupings of which there are few groups however large the set: these go into manifest and card."""
METRICS = (
    *("pd", "spd", "cdc", "contact_number", "contact_distance", "load_margin", "q1"),
    *("qp_certificate", "drift_pos", "drift_rot", "time"),
)
"""The verdict columns that measure something. None is negative."""


class Cell(NamedTuple):
    """What is kept of the rows of one object in one group."""

    rows: int = 0
    passed: int = 0
    moments: tuple[Moments, ...] = (NOTHING,) * len(METRICS)

    def joined(self, other: Cell) -> Cell:
        """Join the cells of disjoint rows."""
        pairs = zip(self.moments, other.moments, strict=True)
        moments = tuple(merged(pair) for pair in pairs)
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
        hand: str,
        passed: np.ndarray,
        verdict: Mapping[str, np.ndarray],
    ) -> None:
        """Count tested, selected rows.

        Args:
            object_id: Object of each row, (N,).
            size_mm: Size of each row, (N,).
            hand: The hands of these rows, from `hands_label`.
            passed: Rows that count as successes, (N,).
            verdict: Columns that `validate` writes, each (N,); missing metrics were not measured.
        """
        if not len(object_id):
            return
        keys = np.stack(
            [np.unique(object_id, return_inverse=True)[1], size_mm, verdict["verdict_status"]]
        )
        for key in np.unique(keys, axis=1).T:
            rows = np.flatnonzero((keys == key[:, None]).all(axis=0))
            moments = tuple(_measured(name, verdict, rows) for name in METRICS)
            cell = Cell(len(rows), int(np.count_nonzero(passed[rows])), moments)
            obj, status = str(object_id[rows[0]]), Status(int(key[2])).label
            for by, group in zip(BY, (obj, str(int(key[1])), hand, status), strict=True):
                known = self._cells[by][group]
                known[obj] = known[obj].joined(cell) if obj in known else cell

    def metrics(self) -> dict[str, Any]:
        """The mean of every metric over all rows, by name."""
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


def _measured(name: str, verdict: Mapping[str, np.ndarray], rows: np.ndarray) -> Moments:
    if name not in verdict:
        return NOTHING
    values, missing = verdict[name][rows], fill_value(FIELDS[name])
    return moments_of(values if np.isnan(missing) else values[values != missing])
