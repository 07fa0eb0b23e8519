"""Groups of grasps as tables for a person: rows, success rate, and the mean of every metric."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bidexdata.cli.arm_figures import arm_status_lines, other_rigs
from bidexdata.cli.report import numbers, percent, table

_LEGEND = (
    "means over {rows} where measured, with 95 % intervals: a bootstrap over objects where "
    "there are ten or more, Student's t over objects or, within one object, over grasps otherwise; drift seen: the "
    "largest until the row's test ended, in full, early as the object rested, or by failing"
)
_ROWS = {"status": "all tested rows, selected and audit,"}
"""What a grouping counts, where that is not the selected rows."""
_HEADS = {"status": "verdict_status"}
"""What a grouping's column is called, where that is not the grouping's name."""
_ONE = ("object", "objects")  # the column that would hold nothing but ones


def group_lines(data: Mapping[str, Any]) -> list[str]:
    """The tables of every protocol and test, and under `status` the one of the arms before them.

    Args:
        data: From `runs.info.describe`: `by`, `groups` and, for a run, `protocols` and `arms`;
            `rig` says whose arms test a has.
    """
    by, lines = data["by"], []
    rig = data.get("rig", "")
    arms = data.get("arms") if by == "status" else None
    if arms:
        others = [name for name in data["rigs"] if name != rig]
        lines += [*other_rigs(rig, others), *arm_status_lines(rig, arms), ""]
    if not data["groups"]:
        return [*lines, "not validated yet"]
    for protocol, tests in data["groups"].items():
        for test, found in tests.items():
            if not found:
                lines.append(f"test {test} of {protocol}: no object is tested completely yet")
                continue
            whose = f", arms of {rig}" if rig and test == "a" else ""
            lines.append(f"test {test} of {protocol}{whose}, by {_HEADS.get(by, by)}")
            lines += _tables(by, found)
        untested = data.get("protocols", {}).get(protocol, {}).get("untested_objects", 0)
        if untested:
            lines.append(f"objects left out because not all their rows are tested: {untested}")
    return [*lines, legend(by)]


def legend(by: str) -> str:
    """What the tables of a grouping count, and what stands in them."""
    return _LEGEND.format(rows=_ROWS.get(by, "selected rows"))


def _tables(by: str, groups: Mapping[str, Any]) -> list[str]:
    """A table per block of metrics that was measured, an empty line behind each."""
    from bidexdata.formats.metric_text import BLOCKS, metric_head, metric_text

    lines, ordered = [], _ordered(by, groups)
    widest = max(len(name) for name, _ in ordered)
    for block in BLOCKS:
        used = [m for m in block if any(m in found["metrics"] for found in groups.values())]
        first = block is BLOCKS[0]
        if not (first or used):
            continue
        # What ended before anything of a block was measured would be a line of dashes.
        told = ordered if first else [p for p in ordered if set(used) & set(p[1]["metrics"])]
        columns = [[_HEADS.get(by, by), *(name.ljust(widest) for name, _ in told)]]
        if first:
            counts = [key for key in ("rows", "objects") if (by, key) != _ONE]
            columns += [numbers([k, *(str(found[k]) for _, found in told)]) for k in counts]
            if by != "status":
                columns.append(_means(["selected", *(percent(f["selected"]) for _, f in told)]))
        for m in used:
            cells = (metric_text(m, found["metrics"].get(m)) for _, found in told)
            columns.append(_means([metric_head(m), *cells]))
        lines += [*table([list(row) for row in zip(*columns, strict=True)]), ""]
    return lines


def _means(column: list[str]) -> list[str]:
    """Put the points of numbers under each other; what follows a number, its interval, moves along."""
    head, *cells = column
    width = max(len(cell.split(" ")[0]) for cell in cells)
    return [head, *(" " * (width - len(cell.split(" ")[0])) + cell for cell in cells)]


def _ordered(by: str, groups: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Groups under the names that a person reads.

    Of statuses those of the test come first, then those of arms, which the test did not simulate;
    among each the most frequent.
    """
    from bidexdata.formats.figures import size_text
    from bidexdata.record.status import ARM_STATUSES

    if by == "size":
        return [(size_text(size), found) for size, found in groups.items()]
    if by == "status":
        arms = {status.label for status in ARM_STATUSES}
        return sorted(groups.items(), key=lambda p: (p[0] in arms, -p[1]["rows"], p[0]))
    return list(groups.items())
