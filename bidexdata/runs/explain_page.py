"""The page and the table that `synth --explain` writes beside its pictures."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from bidexdata.record import Status
from bidexdata.synthesis.attempts import grasp_ids
from bidexdata.synthesis.trace import TERMS, Trace
from bidexdata.wording import counted

if TYPE_CHECKING:
    from bidexdata.runs.explain import ExplainReport
    from bidexdata.synthesis.explain import Explanation


def energies_csv(trace: Trace) -> str:
    """One line per step: its number, phase, the sum, and every term weighted and as it is.

    A term that a phase does not have is empty. Docs: docs/explain.md.
    """
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(["step", "phase", "phase_step", "sum", *(f"weighted_{t}" for t in TERMS), *TERMS])
    total, weighted = trace.total(), trace.energy * trace.weight
    for i, phase in enumerate(trace.phase):
        numbers = [total[i], *weighted[i], *trace.energy[i]]
        rows.writerow([i, phase, int(trace.step[i]), *(_number(v) for v in numbers)])
    return out.getvalue()


def headline(report: ExplainReport) -> list[str]:
    """What was made again, and whether it is what the run stores."""
    one, repeat = report.explanation, report.repeat
    kinds = [
        w
        for w, is_ in (("selected", one.found.selected), ("audit", one.found.audit))
        if is_[one.number]
    ]
    kept = f"stored ({', '.join(kinds)})" if report.stored else "not stored"
    number = report.attempt - one.number
    first = (
        f"grasp {report.grasp_id}: attempt {report.attempt} of {number} to "
        f"{number + report.attempts - 1} of {report.scene_id}, {kept}"
    )
    what = counted(repeat.rows, "stored row")
    if not repeat.differing:
        return [first, f"repeated: the scene's {what} came out bit for bit the same"]
    return [
        first,
        f"not repeated: {counted(len(repeat.differing), 'column')} of the scene's {what} differ "
        f"({', '.join(repeat.differing)}), for they were made otherwise "
        f"({'; '.join(repeat.elsewhere)}); what follows is of the grasp as it comes out here",
    ]


def explain_page(report: ExplainReport, run_fingerprint: str) -> str:
    """The whole explanation in Markdown."""
    one = report.explanation
    parts = [
        f"# Grasp {report.grasp_id}",
        *headline(report),
        "![stages](stages.png)",
        "## Stages",
        "\n".join(f"- **{s.stage}**{_mark(s.passed)}: {s.text}" for s in report.said),
    ]
    if report.verdicts:
        parts += ["## Verdicts of the run", "\n".join(f"- {v.text}" for v in report.verdicts)]
    if one.trace is not None:
        parts += ["![energies](energies.png)"]
    if one.poses:
        parts += ["## Distances", _distances(one)]
    if one.finished is not None:
        parts += ["## Contacts at the grasp", _contacts(one)]
    parts += ["## All attempts of the scene", _attempts(report, run_fingerprint)]
    parts += ["What the pictures and numbers mean: `docs/explain.md` of bidexdata."]
    return "\n\n".join(parts) + "\n"


def _mark(passed: bool | None) -> str:
    return {True: " (passed)", False: " (failed)", None: ""}[passed]


def _distances(one: Explanation) -> str:
    rows = []
    for m in one.poses:
        ranges = [f"{1e3 * g.min():.1f} to {1e3 * g.max():.1f}" for g in m.gaps]
        rows.append((m.name, *ranges, f"{1e3 * m.depth:.1f}"))
    head = (
        "stage",
        "left pads to surface [mm]",
        "right pads to surface [mm]",
        "deepest sphere [mm]",
    )
    return _table(head, rows)


def _contacts(one: Explanation) -> str:
    done, rows = one.finished, []
    assert done is not None
    for h, hand in enumerate(one.hands):
        for c, name in enumerate(hand.contact_names):
            force, normal = done.forces[h][c], done.normals_in[h][c]
            pressed = float(force @ normal)
            slide = float(np.linalg.norm(force - pressed * normal))
            place = " ".join(f"{1e3 * x:.0f}" for x in done.points[h][c])
            newton = f"{pressed * done.force_scale[h]:.2g}"
            gap = f"{1e3 * done.gaps[h][c]:.1f}"
            rows.append((hand.side, name, place, gap, f"{pressed:.2f}", f"{slide:.2f}", newton))
    head = (
        "hand",
        "contact",
        "point [mm]",
        "gap [mm]",
        "normal [cap]",
        "tangential [cap]",
        "normal [N]",
    )
    return _table(head, rows)


def _attempts(report: ExplainReport, run_fingerprint: str) -> str:
    one, found = report.explanation, report.explanation.found
    first = report.attempt - one.number
    ids = grasp_ids(run_fingerprint, report.scene_id, range(first, first + report.attempts))
    place = {int(i): k + 1 for k, i in enumerate(one.order)}
    rest = [i for i in range(report.attempts) if i not in place]
    placed = one.attempts.placed
    rows = []
    for i in [*place, *rest]:
        name = f"**{ids[i]}**" if i == one.number else ids[i]
        flags = [w for w, is_ in (("selected", found.selected), ("audit", found.audit)) if is_[i]]
        pair = "-" if placed is None else str(int(placed.pair_index[i]) + 1)
        figures = [1e3 * abs(found.depth[i]), found.residual[i], found.shifted[i], found.doubt[i]]
        numbers = [f"{v:.3g}" if np.isfinite(v) else "-" for v in figures]
        status = Status(int(found.status[i])).label
        rows.append((place.get(i, "-"), first + i, name, pair, status, *numbers, " ".join(flags)))
    head = (
        "rank",
        "attempt",
        "grasp_id",
        "pair",
        "status",
        "pre-grasp depth [mm]",
        "residual",
        "moved contacts' residual",
        "doubt",
        "rows",
    )
    return _table(head, rows)


def _table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *("| " + " | ".join(map(str, row)) + " |" for row in rows)])


def _number(value: float) -> str:
    return f"{value:.9g}" if np.isfinite(value) else ""
