"""`report.html` of a library: every input with a picture, what was done to it, and how long it took.

The page needs no network: its pictures are those in the objects' folders, and the times are read
from a file of their own, so that everything but `.times` is the same for the same inputs.
"""

from __future__ import annotations

import contextlib
import csv
import json
import os
import socket
from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

from bidexdata.kinds import REPORT
from bidexdata.objects.library import LEFT_OUT, object_folder
from bidexdata.record.status import Status
from bidexdata.runs.shards import write_text
from bidexdata.runs.thumbnails import HEIGHT, THUMBNAIL, WIDTH
from bidexdata.wording import counted

TIMES = ".times"
"""Folder of the seconds that every input took: one file per process that wrote some, with lines of
object_id and `Taken`, and all of them as the page reads them."""
TIMES_SCRIPT = "times.js"

_STYLE = """
body { font: 14px/1.45 system-ui, sans-serif; margin: 2em; color: #222 }
table { border-collapse: collapse } th, td { padding: .3em .7em; text-align: left; vertical-align: top }
th { position: sticky; top: 0; background: #fff; border-bottom: 2px solid #888 }
tr.input td { border-bottom: 1px solid #ddd }
.failed { background: #fdeaea } .left { background: #f2f2f2 } .warned { background: #fff8e1 }
small { color: #666 } img { background: #fff; border: 1px solid #ddd }
.sums td, .sums th { position: static; border: 0 } input { padding: .3em; width: 24em }
"""
_SCRIPT = """
const known = [];
for (const cell of document.querySelectorAll("td[data-of]")) {
  const taken = (window.seconds || {})[cell.dataset.of];
  if (taken === undefined) continue;
  cell.textContent = taken[0].toFixed(1);
  known.push([...taken, cell.dataset.name]);
}
const most = (k, count) => known.sort((a, b) => b[k] - a[k]).slice(0, count)
  .map(one => one[3] + " " + one[k].toFixed(1) + " s").join(", ");
const work = known.reduce((sum, one) => sum + one[0], 0).toFixed(0);
document.getElementById("times").textContent = known.length ? work + " s of work; slowest: " +
  most(0, 10) + ". Most CPU time in the worker: " + most(1, 3) + "; in the decomposition: " +
  most(2, 3) + "." : "";
document.getElementById("find").addEventListener("input", event => {
  const wanted = event.target.value.toLowerCase();
  for (const row of document.querySelectorAll("tr.input"))
    row.hidden = !row.textContent.toLowerCase().includes(wanted);
});
"""
_HEADS = ("mesh and pieces", "input", "repair", "pieces", "shape", "rest", "s", "notes")


class Taken(NamedTuple):
    """How long an input took [s]."""

    seconds: float
    """Wall-clock time."""
    cpu: float
    """CPU time of the worker, which `limits.cpu_seconds` bounds."""
    search_cpu: float
    """CPU time of all searches of the decomposition; `convex.cpu_seconds` bounds the first."""


def append_time(library: Path, object_id: str, taken: Taken) -> None:
    """Note how long an input took."""
    folder = library / TIMES
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{socket.gethostname()}-{os.getpid()}.csv"
    with path.open("a", newline="", encoding="utf-8") as file:
        csv.writer(file).writerow([object_id, *(f"{seconds:.3f}" for seconds in taken)])


def read_times(library: Path) -> dict[str, Taken]:
    """What every input took that has been worked on, by object_id; the last time counts."""
    found: dict[str, Taken] = {}
    for path in sorted((library / TIMES).glob("*.csv"), key=lambda p: p.stat().st_mtime):
        with path.open(newline="", encoding="utf-8") as file:
            for row in csv.reader(file):
                # A killed process may have left half a line.
                with contextlib.suppress(ValueError):
                    object_id, seconds, cpu, search = row
                    found[object_id] = Taken(float(seconds), float(cpu), float(search))
    return found


def write_report(library: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write the page for the rows of the index, and the times that it shows."""
    (library / TIMES).mkdir(parents=True, exist_ok=True)
    times = json.dumps(read_times(library), indent=0, sort_keys=True)
    write_text(library / TIMES / TIMES_SCRIPT, f"window.seconds = {times};\n")
    write_text(library / REPORT, report_html(rows))


def report_html(rows: Sequence[Mapping[str, Any]]) -> str:
    """The page as text: figures, the slowest inputs, one table row per input."""
    body = [
        "<h1>Object library</h1>",
        _sums(rows),
        '<p id="times"></p>',
        '<p><input id="find" placeholder="show only rows with these letters"></p>',
        "<table><thead><tr>" + "".join(f"<th>{head}</th>" for head in _HEADS) + "</tr></thead>",
        "<tbody>",
        *map(_row, rows),
        "</tbody></table>",
        f'<script src="{TIMES}/{TIMES_SCRIPT}"></script>',
        f"<script>{_SCRIPT}</script>",
    ]
    head = f'<meta charset="utf-8"><title>Object library</title><style>{_STYLE}</style>'
    text = "\n".join(body)
    return f"<!doctype html><html><head>{head}</head><body>\n{text}\n</body></html>\n"


def _sums(rows: Sequence[Mapping[str, Any]]) -> str:
    good = [r for r in rows if r["status"] == Status.OK]
    warned = sum(bool(r.get("warnings")) for r in good)
    lines = [
        f"<p>{len(good)} of {counted(len(rows), 'input')} prepared, {warned} of them with warnings</p>"
    ]
    for title, key in (
        ("status", "status_label"),
        ("repair", "repair"),
        ("pieces", "piece_method"),
    ):
        found = Counter(str(r[key]) for r in rows if r.get(key))
        cells = "".join(f"<td>{escape(k)}: {n}</td>" for k, n in sorted(found.items()))
        lines.append(f'<table class="sums"><tr><th>{title}</th>{cells}</tr></table>')
    return "\n".join(lines)


def _row(row: Mapping[str, Any]) -> str:
    status = Status(row["status"])
    kind = "left" if status in LEFT_OUT else "failed" if status != Status.OK else ""
    if status == Status.OK and row.get("warnings"):
        kind = "warned"
    made = row.get("content_sha256")
    picture = ""
    if made:
        source = escape((object_folder(row["object_id"]) / THUMBNAIL).as_posix())
        picture = (
            f'<img loading="lazy" width="{2 * WIDTH}" height="{HEIGHT}" src="{source}" alt="">'
        )
    about = [
        f"<small>{escape(str(row[k]))}</small>" for k in ("object_id", "licence") if row.get(k)
    ]
    notes = [] if status == Status.OK else [f"<b>{status.label}</b> {escape(row['reason'])}"]
    notes += [escape(text) for text in row.get("warnings") or ()]
    if row.get("near_duplicate_of"):
        notes.append(f"like {escape(row['near_duplicate_of'])}")
    identity = f'data-of="{row.get("object_id")}" data-name="{escape(str(row["source_name"]))}"'
    cells = [
        picture,
        "<br>".join([escape(str(row["source_name"])), *about]),
        *([_repair(row), _pieces(row), _shape(row), str(row["rest_poses"])] if made else [""] * 4),
    ]
    inner = "".join(f"<td>{text}</td>" for text in cells)
    inner += f"<td {identity}></td><td>{'<br>'.join(notes)}</td>"
    return f'<tr class="input {kind}">{inner}</tr>'


def _repair(row: Mapping[str, Any]) -> str:
    steps = ", ".join(row.get("repair_steps") or ())
    away = row.get("hausdorff")
    text = [f"{escape(str(row.get('repair')))}", f"<small>{escape(steps)}</small>"]
    return "<br>".join([*text, *([] if away is None else [f"{100 * away:.2f} % from the file"])])


def _pieces(row: Mapping[str, Any]) -> str:
    text = [f"{row.get('pieces')}", f"<small>{escape(str(row.get('piece_method')))}</small>"]
    ratio, away = row.get("volume_ratio"), row.get("solid_hausdorff")
    text += [] if ratio is None else [f"volume x {ratio:.2f}"]
    text += [] if away is None else [f"{100 * away:.2f} % from the mesh"]
    return "<br>".join(text)


def _shape(row: Mapping[str, Any]) -> str:
    if row.get("aspect") is None:
        return ""
    return (
        f"aspect {row['aspect']:.1f}<br>walls {100 * row['thickness']:.1f} %<br>"
        f"{counted(row['components'], 'body', 'bodies')}, genus {row['genus']}"
    )
