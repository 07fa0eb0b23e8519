"""Groups of grasps as tables for a person: rows, success rate, and the mean of every metric."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bidexdata.cli.report import percent, table

_LEGEND = (
    "means over {rows} where measured, with 95 % intervals: a bootstrap over objects where "
    "there are ten or more, Student's t over objects or, within one object, over grasps otherwise; drift seen: the "
    "largest until the row's test ended, in full, early as the object rested, or by failing"
)
_ROWS = {"status": "all tested rows, selected and audit,"}
"""What a grouping counts, where that is not the selected rows."""
_ONE = ("object", "objects")  # the column that would hold nothing but ones


def group_lines(data: Mapping[str, Any]) -> list[str]:
    """The tables of every protocol and test.

    Args:
        data: From `runs.info.describe`: `by`, `groups` and, for a run, `protocols`.
    """
    by, lines = data["by"], []
    for protocol, tests in data["groups"].items():
        for test, found in tests.items():
            if not found:
                lines.append(f"test {test} of {protocol}: no object is tested completely yet")
                continue
            lines.append(f"test {test} of {protocol}, by {by}")
            lines += _tables(by, found)
        untested = data.get("protocols", {}).get(protocol, {}).get("untested_objects", 0)
        if untested:
            lines.append(f"objects left out because not all their rows are tested: {untested}")
    return [*lines, legend(by)] if lines else ["not validated yet"]


def legend(by: str) -> str:
    """What the tables of a grouping count, and what stands in them."""
    return _LEGEND.format(rows=_ROWS.get(by, "selected rows"))


def _tables(by: str, groups: Mapping[str, Any]) -> list[str]:
    from bidexdata.formats.metric_text import BLOCKS, metric_head, metric_text

    lines = []
    for block in BLOCKS:
        used = [m for m in block if any(m in found["metrics"] for found in groups.values())]
        first = block is BLOCKS[0]
        if not (first or used):
            continue
        counts = [key for key in ("rows", "objects") if first and (by, key) != _ONE]
        rated = ["selected"] if first and by != "status" else []
        rows = [[by, *counts, *rated, *(metric_head(m) for m in used)]]
        for name, found in _ordered(by, groups):
            row = [name, *(str(found[key]) for key in counts)]
            row += [percent(found[key]) for key in rated]
            rows.append(row + [metric_text(m, found["metrics"].get(m)) for m in used])
        lines += table(rows)
    return lines


def _ordered(by: str, groups: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Groups under the names that a person reads; statuses with the most frequent first."""
    from bidexdata.formats.figures import size_text

    if by == "size":
        return [(size_text(size), found) for size, found in groups.items()]
    if by == "status":
        return sorted(groups.items(), key=lambda pair: (-pair[1]["rows"], pair[0]))
    return list(groups.items())
