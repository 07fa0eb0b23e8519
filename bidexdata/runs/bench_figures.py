"""Figures of the rows and regions of the tables, counted from the shards; plain data for JSON.

The definitions are those of `formats.figures`. There the metrics are means over selected rows; here
they are given for the unselected ones too, which are what the paper's figures are of.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bidexdata.record import GraspBatch
from bidexdata.record.fields import HEADLINE
from bidexdata.record.means import mean_interval
from bidexdata.record.moments import moments_of
from bidexdata.record.rates import clustered_interval
from bidexdata.runs.bench_regions import CONTACTS, FRICTION, KINDS, PAIRS, read_regions
from bidexdata.runs.bench_rows import Row
from bidexdata.runs.bench_speed import speed_of
from bidexdata.runs.chosen import DEFAULT_PROTOCOL
from bidexdata.runs.finished import Finished
from bidexdata.runs.info import made_with_of
from bidexdata.runs.pack_rows import rows_of_object
from bidexdata.runs.run import Run

if TYPE_CHECKING:
    from bidexdata.objects.library import Library


def row_figures(row: Row, run: Run, object_ids: Sequence[str], rig: str = "") -> dict[str, Any]:
    """What the run of a row comes to on some objects; it may hold more.

    Args:
        row: Which.
        run: Opened for the rig, where it has motions of its arms.
        object_ids: The objects.
        rig: Whose arms its grasps are tested with, where it is on a table; empty for none.
    """
    from bidexdata.formats.figures import Tally

    finished, untested, names = Finished.of(run), 0, row.tests(rig)
    stored, audited = Tally(names), Tally(names)
    for object_id in object_ids:
        tests = [(DEFAULT_PROTOCOL, t) for t in names]
        rows = rows_of_object(run, finished, object_id, "", tests)
        if rows is None:
            continue
        untested += len(rows.verdicts) < len(tests)
        verdicts = {test: columns for (_, test), columns in rows.verdicts.items()}
        stored.add(rows.batch, verdicts, grasps=run.spec.grasps)
        audit = rows.batch["audit"]
        audited.add(
            as_selected(rows.batch.select(audit)),
            {t: {name: c[audit] for name, c in v.items()} for t, v in verdicts.items()},
            grasps=run.spec.grasps,
        )
    figures, of_audit = stored.figures(), audited.figures()
    speed = speed_of(run, object_ids)
    return {
        "fingerprint": run.fingerprint,
        "made_with": made_with_of(run, finished),
        "objects": figures["objects"],
        "scenes": figures["scenes"],
        "objects_without_scene": sum(i in run.spec.without_scene for i in object_ids),
        "objects_untested": untested,
        "attempts": sum(figures["by_status"].values()),
        "by_status": figures["by_status"],
        "kept": figures["kept"],
        "unselected": {
            "rows": figures["audit_rows"],
            **_rates(figures, "unselected"),
            **_measured(of_audit, names[0]),
        },
        "selected": {
            "rows": figures["selected_rows"],
            **_rates(figures, "selected"),
            **_measured(figures, names[0]),
        },
        "s": speed.per_second,
        "s_attempts": speed.attempts,
        "s_cpu_seconds": round(speed.cpu_seconds, 4),
        "sgs": {t: _product(speed.per_second, _rate(figures, t)) for t in names},
    }


def as_selected(batch: GraspBatch) -> GraspBatch:
    """The same rows, all of them marked as selected."""
    marked = {**batch.columns, "selected": np.ones(len(batch), bool)}
    return dataclasses.replace(batch, columns=marked)


def region_figures(
    library: Library, object_ids: Sequence[str], sizes_mm: Sequence[int], seed: int, folder: Path
) -> dict[str, Any]:
    """Mean Q1 of every kind of regions, and how many pairs resist some wrench in every direction."""
    found = [read_regions(library, i, sizes_mm, seed, folder) for i in sorted(object_ids)]
    measured = [one for one in found if one is not None]
    kinds = {}
    for kind in KINDS:
        values = [one[kind.name] for one in measured]
        positive = [sum(q > 0 for q in qs) for qs in values]
        kinds[kind.name] = {
            "says": kind.says,
            "preset": kind.preset,
            "changes": dict(kind.changes),
            "pairs": sum(len(qs) for qs in values),
            "q1": mean_interval([moments_of(qs) for qs in values], least=0.0).to_dict(),
            "positive": clustered_interval(positive, [len(qs) for qs in values]).to_dict(),
        }
    return {
        "objects": len(measured),
        "scenes": len(measured) * len(sizes_mm),
        "pairs_per_scene": PAIRS,
        "contacts_per_region": CONTACTS,
        "friction": FRICTION,
        "kinds": kinds,
    }


def _rates(figures: Mapping[str, Any], kind: str) -> dict[str, Any]:
    from bidexdata.formats.reach import ARM_RATES

    rates = {f"suc_{test}": found[kind] for test, found in figures["tests"].items()}
    for found in figures["tests"].values():
        rates |= {name: found[name][kind] for name in ARM_RATES if name in found}
    return rates


def _rate(figures: Mapping[str, Any], test: str) -> float | None:
    return figures["tests"][test]["unselected"]["rate"]


def _measured(figures: Mapping[str, Any], test: str) -> dict[str, Any]:
    """Means of PD, SPD and CDC, which do not depend on the test, and D."""
    metrics = figures["tests"][test]["metrics"]
    return {**{name: metrics.get(name) for name in HEADLINE}, "d": figures["d"]}


def _product(speed: float | None, rate: float | None) -> float | None:
    return None if speed is None or rate is None else speed * rate
