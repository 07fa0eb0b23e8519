"""The card and the README of a release, filled with figures computed from its rows."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

from bidexdata.formats import parquet
from bidexdata.formats.card_words import (
    arms_text,
    derived_text,
    holds_shapes,
    policy_text,
    split_text,
    success_text,
    tests_of,
)
from bidexdata.formats.columns import release_columns
from bidexdata.formats.figures import size_text
from bidexdata.formats.hub import hub_metadata
from bidexdata.formats.metric_text import metric_head, metric_text
from bidexdata.formats.reach import ARM_RATES
from bidexdata.formats.rig_files import read_rig_files
from bidexdata.objects.sources.item import UNKNOWN
from bidexdata.record import Header
from bidexdata.record.fields import HEADLINE, METRICS
from bidexdata.record.rates import Rate
from bidexdata.wording import counted, share

CARD = "DATASET_CARD.md"
_SHAPES = """Point clouds (`clouds/`,
{cloud_points} points per object) and meshes are at unit bounding-box diagonal; multiply by
the row's `size`. A file of `clouds/` is one plain float32 array (objects, points, 3): read it with
`numpy.load(path, mmap_mode="r")`; its rows are `cloud_index` of `objects.parquet`."""
_NO_SHAPES = """Meshes and point clouds are not in this
release, for their licences do not allow that or nobody stated them: `objects.parquet` has of every
object its source, the sha256 of the source file and of the prepared geometry, and the recipe."""
README = "README.md"


def write_card(root: Path, head: Mapping[str, Any]) -> None:
    """Write `DATASET_CARD.md` and `README.md` (with Hub metadata) into a release folder.

    Args:
        root: Folder whose Parquet tables are complete.
        head: The manifest's head (see `writer.write_release`); nothing else is read, so that the
            pages can be written again and compared.
    """
    card = Template(files("bidexdata.formats").joinpath("dataset_card.md").read_text("utf-8"))
    text = card.substitute(_values(root, head))
    (root / CARD).write_text(text, encoding="utf-8")
    (root / README).write_text(hub_metadata(root, head) + "\n" + text, encoding="utf-8")


def rate_text(rate: Mapping[str, Any]) -> str:
    """A rate of `Tally.figures` for a person, with its method."""
    if not rate["n"]:
        return "not available"
    value = Rate(**dict(rate))
    return f"{value}, {value.method}"


def _values(root: Path, head: Mapping[str, Any]) -> dict[str, Any]:
    figures, header = head["figures"], json.loads(head["header"])
    tests = tests_of(head)
    return {
        "name": head["name"],
        "version": head["version"],
        "schema_version": head["schema_version"],
        "generator_version": head["generator"]["version"],
        "success_text": success_text(head),
        "load_where": f', where="suc_{tests[0]}"' if tests else "",
        "arm_axes": ", A arm joints, K key frames, W knots" if head.get("rigs") else "",
        "rig_named": "".join(f" Arms: {rig}." for rig in head.get("rigs", ())),
        "arms": _arms(root, head),
        "objects": counted(figures["objects"], "object"),
        "scenes": counted(figures["scenes"], "scene"),
        "selected_rows": counted(figures["selected_rows"], "selected dexterous grasp"),
        "hands": ", ".join(f"{h['name']} {h['side']}" for h in header["hands"]),
        "sides": ", ".join(h["side"] for h in header["hands"]),
        "rates": _rates(figures),
        "metrics": _metrics(figures),
        "diversity": _share(figures["d"]),
        "diversity_scale_free": _share(figures["d_scale_free"]),
        "diversity_audit": _share(figures["d_audit"]),
        "metrics_by_verdict": _metrics_by_verdict(figures),
        "by_size": _by_size(figures),
        "by_status": _counts(figures["by_status"], "status", "attempts"),
        "by_verdict": _counts(figures["by_verdict"], "verdict", "rows"),
        "pictures": "".join(f"![{t}]({p})\n\n{t}\n\n" for p, t in head.get("pictures", ())),
        "derived": derived_text(head.get("derived")),
        "split_text": split_text(head["split"]),
        "splits": _splits(root, head),
        "licences": _licences(root),
        "policy_text": policy_text(head.get("licences", "")),
        "shapes_text": (_SHAPES if holds_shapes(head) else _NO_SHAPES).format(
            cloud_points=head["cloud_points"]
        ),
        "columns": _columns(head),
        "runs": _runs(root),
    }


def _rates(figures: Mapping[str, Any]) -> str:
    rows = []
    for test, rates in figures["tests"].items():
        for kind in ("unselected", "selected"):
            rows.append((f"{kind.capitalize()} SUC-{test.upper()}", rate_text(rates[kind])))
        rows.append((f"Object success, test `{test}`", rate_text(rates["object_success"])))
        for name in (n for n in ARM_RATES if n in rates):
            words = name.replace("_", " ")
            for kind in ("unselected", "selected"):
                label = f"{kind.capitalize()} {words}, test `{test}`"
                rows.append((label, rate_text(rates[name][kind])))
        rows += _rates_apart(figures["by_setting"], test)
    rows.append(("Kept", _share(figures["kept"])))
    rows.append(("Rows stored", str(figures["n"])))
    rows.append(("Selected rows", str(figures["selected_rows"])))
    rows.append(("Audit rows", str(figures["audit_rows"])))
    return _markdown(("figure", "value"), rows)


def _rates_apart(by_setting: Mapping[str, Any], test: str) -> list[tuple[str, str]]:
    """Rates of each setting, where there are several."""
    return [
        (f"{kind.capitalize()} SUC-{test.upper()}, {setting}", rate_text(found[f"{kind}_{test}"]))
        for setting, found in by_setting.items()
        for kind in ("unselected", "selected")
        if len(by_setting) > 1 and found[f"selected_{test}"]["n"]
    ]


def _by_size(figures: Mapping[str, Any]) -> str:
    tests = list(figures["tests"])
    head = ["size"]
    head += [f"{kind} SUC-{t.upper()}" for t in tests for kind in ("unselected", "selected")]
    head += ["kept", *(metric_head(m) for m in HEADLINE)]
    rows = []
    for size, row in figures["by_size"].items():
        rates = [
            rate_text(row[f"{kind}_{t}"]) for t in tests for kind in ("unselected", "selected")
        ]
        means = _measured_test(figures)["groups"]["size"].get(size, {}).get("metrics", {})
        metrics = [metric_text(m, means.get(m)) for m in HEADLINE]
        rows.append([size_text(size), *rates, _share(row["kept"]), *metrics])
    return _markdown(head, rows)


def _metrics(figures: Mapping[str, Any]) -> str:
    rows = [
        (metric_head(name), metric_text(name, mean), mean["n"], mean["objects"], mean["method"])
        for name, mean in _measured_test(figures)["metrics"].items()
    ]
    head = ("metric", "mean", "rows", "objects", "interval")
    return _markdown(head, rows) if rows else "Nothing was measured."


def _metrics_by_verdict(figures: Mapping[str, Any]) -> str:
    groups = _measured_test(figures)["groups"]["status"]
    used = [m for m in METRICS if any(m in found["metrics"] for found in groups.values())]
    rows = [
        (
            f"`{status}`",
            found["rows"],
            *(metric_text(m, found["metrics"].get(m)) for m in used),
        )
        for status, found in groups.items()
    ]
    head = ("verdict", "rows", *(metric_head(m) for m in used))
    return _markdown(head, rows) if rows else "Nothing was measured."


def _measured_test(figures: Mapping[str, Any]) -> Mapping[str, Any]:
    """The first test with measured rows; the metrics at the grasp do not depend on the test."""
    tests = list(figures["tests"].values())
    return next((test for test in tests if test["metrics"]), tests[0])


def _counts(counts: Mapping[str, int], label: str, unit: str) -> str:
    total = sum(counts.values())
    rows = [(f"`{k}`", v, _share(v / total if total else None)) for k, v in counts.items()]
    return _markdown((label, unit, "share"), rows) if rows else "None recorded."


def _splits(root: Path, head: Mapping[str, Any]) -> str:
    names = ["split", "selected_rows", "audit_rows"]
    scenes = parquet.read_table(root / "scenes.parquet", names).to_pylist()
    rows = []
    for split, objects in head["splits"]:
        mine = [r for r in scenes if r["split"] == split]
        selected = sum(r["selected_rows"] for r in mine)
        audit = sum(r["audit_rows"] for r in mine)
        if objects:
            rows.append((split, objects, len(mine), selected, audit))
    return _markdown(("split", "objects", "scenes", "selected rows", "audit rows"), rows)


def _licences(root: Path) -> str:
    rows = parquet.read_table(root / "objects.parquet", ["licence", "source", "author"]).to_pylist()
    counts = Counter((r["licence"], r["source"]) for r in rows)
    lines = []
    for (licence, source), count in sorted(counts.items()):
        authors = {r["author"] for r in rows if (r["licence"], r["source"]) == (licence, source)}
        lines.append((licence, source, count, len(authors - {UNKNOWN})))
    return _markdown(("licence", "source", "objects", "named authors"), lines)


def _columns(head: Mapping[str, Any]) -> str:
    """A table of the columns of every table, folded."""
    parts = []
    tests = [(p, t) for p, t in head["tests"]]
    for table, columns in release_columns(Header.from_json(head["header"]), tests).items():
        rows = [(f"`{c.name}`", c.dtype, c.shape, c.unit, c.frame, c.description) for c in columns]
        text = _markdown(("column", "type", "shape", "unit", "frame", "meaning"), rows)
        parts.append(f"<details><summary>{table}</summary>\n\n{text}\n\n</details>\n")
    return "\n".join(parts)


def _arms(root: Path, head: Mapping[str, Any]) -> str:
    """Which rigs the motions are for, and the licences of their arms; empty without arms."""
    header = Header.from_json(head["header"])
    return "".join(
        arms_text(read_rig_files(root, header.arms).document) for _ in head.get("rigs", ())
    )


def _runs(root: Path) -> str:
    rows = [
        (
            r["run"],
            r["preset"] or "-",
            r["setting"],
            r["rig"] or "-",
            "-" if r["grasps"] < 0 else r["grasps"],
            "-" if r["candidates"] < 0 else r["candidates"],
            r["seed"],
            r["generator_version"] or "-",
            r["fingerprint"],
        )
        for r in parquet.read_table(root / "runs.parquet").to_pylist()
    ]
    head = ("run", "preset", "setting", "rig", "N", "attempts", "seed", "bidexdata", "fingerprint")
    return _markdown(head, rows)


def _share(value: float | None) -> str:
    return share(value, missing="not available")


def _markdown(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(_cell(c) for c in row) + " |" for row in rows]
    return "\n".join(lines)


def _cell(value: Any) -> str:
    return str(value).replace("|", "\\|").replace("\n", " ")
