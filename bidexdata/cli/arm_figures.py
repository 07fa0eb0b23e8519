"""What the arms of a run came to, as lines for a person."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bidexdata.cli.report import counts_text, numbers, percent, table
from bidexdata.wording import counted

_WITHOUT = ("ok", "no_grasp")


def arm_table(kinds: Mapping[str, Mapping[str, Mapping[str, int]]]) -> list[str]:
    """The share of the grasps with a motion and the reasons of the others, a line per size.

    Args:
        kinds: Rows per label of their status, per `size_mm` as text, per name of a kind of rows.
    """
    from bidexdata.formats.figures import size_text

    sizes = sorted({size for found in kinds.values() for size in found}, key=int)
    head = ["size"]
    for kind in kinds:
        head += [f"have a motion ({kind})", "reasons of the others"]
    rows = [head]
    for size in sizes:
        row = [size_text(size)]
        for found in kinds.values():
            row += _cells(found.get(size, {}))
        rows.append(row)
    return table(rows)


def arm_lines(rig: str, others: Sequence[str], arms: Mapping[str, Any]) -> list[str]:
    """What the arms that are meant came to, and which others there are.

    Args:
        rig: Whose arms.
        others: Rigs whose solutions lie beside them.
        arms: From `runs.info.arms_of`.
    """
    lines = other_rigs(rig, others)
    if not arms:
        return lines
    shown = {kind: arms[kind] for kind in ("selected", "audit") if arms[kind]["by_status"]}
    said = [f"{kind} {_cells(found['by_status'])[0]}" for kind, found in shown.items()]
    none = arms["all"]["by_status"].get("no_grasp", 0)
    lost = f"; no grasp to take: {counted(none, 'stored attempt')}" if none else ""
    lines.append(f"arms of {rig}: grasps with a motion: {'; '.join(said)}{lost}")
    return lines + arm_table({kind: found["by_size"] for kind, found in shown.items()})


def other_rigs(rig: str, others: Sequence[str]) -> list[str]:
    """Whose arms are shown, where a run has solutions of others too."""
    if not others:
        return []
    return [f"arms shown: {rig} (--rig shows others: {', '.join(others)})"]


def arm_status_lines(rig: str, arms: Mapping[str, Any]) -> list[str]:
    """A table of what stands against a motion: rows per `arm_status`, the most frequent first.

    Args:
        rig: Whose arms.
        arms: From `runs.info.arms_of`; `all` is each row once, and a row may be both of the others.
    """
    from bidexdata.record.status import Status

    every = arms["all"]["by_status"]
    labels = sorted(every, key=lambda label: (label != "ok", -every[label], label))
    columns = [["arm_status", *labels]]
    for head, kind in (("rows", "all"), ("selected", "selected"), ("audit", "audit")):
        found = arms[kind]["by_status"]
        columns.append(numbers([head, *(str(found.get(label, 0)) for label in labels)]))
    sentences = {status.label: status.sentence for status in Status}
    said = ["nothing" if label == "ok" else sentences[label] for label in labels]
    columns.append(["what stands against a motion", *said])
    rows = [list(row) for row in zip(*columns, strict=True)]
    return [f"arms of {rig}, by arm_status", *table(rows)]


def _cells(by_status: Mapping[str, int]) -> list[str]:
    """The share with a motion of the rows with a grasp, and what the others came to."""
    from bidexdata.record.rates import rate_interval

    asked = sum(by_status.values()) - by_status.get("no_grasp", 0)
    reasons = {label: n for label, n in by_status.items() if label not in _WITHOUT}
    rate = percent(rate_interval(by_status.get("ok", 0), asked).to_dict())
    return [rate, counts_text(reasons)]
