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
from bidexdata.formats.figures import size_text
from bidexdata.formats.metric_text import metric_head, metric_text
from bidexdata.objects.sources.item import UNKNOWN
from bidexdata.record.fields import HEADLINE, METRICS
from bidexdata.record.rates import Rate
from bidexdata.wording import counted, share

CARD = "DATASET_CARD.md"
README = "README.md"
# Hugging Face's identifiers are the lower-case SPDX ones for the licences it knows.
_HUB_LICENCES = (
    "apache-2.0", "mit", "bsd-3-clause", "cc0-1.0", "cc-by-3.0", "cc-by-4.0", "cc-by-sa-3.0",
    "cc-by-sa-4.0", "cc-by-nc-3.0", "cc-by-nc-4.0", "cc-by-nc-sa-4.0", "cc-by-nd-4.0",
)  # fmt: skip


def write_card(root: Path, head: Mapping[str, Any]) -> None:
    """Write `DATASET_CARD.md` and `README.md` (with Hub metadata) into a release folder.

    Args:
        root: Folder whose Parquet tables are complete.
        head: The manifest's head (see `writer.write_release`).
    """
    card = Template(files("bidexdata.formats").joinpath("dataset_card.md").read_text("utf-8"))
    text = card.substitute(_values(root, head))
    (root / CARD).write_text(text, encoding="utf-8")
    (root / README).write_text(_hub_metadata(root, head) + "\n" + text, encoding="utf-8")


def rate_text(rate: Mapping[str, Any]) -> str:
    """A rate of `Tally.figures` for a person, with its method."""
    if not rate["n"]:
        return "not available"
    value = Rate(**dict(rate))
    return f"{value}, {value.method}"


def _values(root: Path, head: Mapping[str, Any]) -> dict[str, Any]:
    figures, header = head["figures"], json.loads(head["header"])
    split = head["split"]
    return {
        "name": head["name"],
        "version": head["version"],
        "schema_version": head["schema_version"],
        "generator_version": head["generator"]["version"],
        "default_protocol": head["default_protocol"],
        "cloud_points": head["cloud_points"],
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
        "split_text": f"{100 * split['test_fraction']:.0f} % asked for test, seed {split['seed']}",
        "splits": _splits(root),
        "licences": _licences(root),
        "runs": _runs(root),
    }


def _rates(figures: Mapping[str, Any]) -> str:
    rows = []
    for test, rates in figures["tests"].items():
        for kind in ("unselected", "selected"):
            rows.append((f"{kind.capitalize()} SUC-{test.upper()}", rate_text(rates[kind])))
        rows.append((f"Object success, test `{test}`", rate_text(rates["object_success"])))
    rows.append(("Kept", _share(figures["kept"])))
    rows.append(("Rows stored", str(figures["n"])))
    rows.append(("Selected rows", str(figures["selected_rows"])))
    rows.append(("Audit rows", str(figures["audit_rows"])))
    return _markdown(("figure", "value"), rows)


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


def _splits(root: Path) -> str:
    objects = parquet.read_table(root / "objects.parquet", ["split"]).column("split").to_pylist()
    scenes = parquet.read_table(root / "scenes.parquet", ["split", "selected_rows", "audit_rows"])
    rows = []
    for split, count in sorted(Counter(objects).items(), reverse=True):
        mine = [r for r in scenes.to_pylist() if r["split"] == split]
        selected = sum(r["selected_rows"] for r in mine)
        audit = sum(r["audit_rows"] for r in mine)
        rows.append((split, count, len(mine), selected, audit))
    return _markdown(("split", "objects", "scenes", "selected rows", "audit rows"), rows)


def _licences(root: Path) -> str:
    rows = parquet.read_table(root / "objects.parquet", ["licence", "source", "author"]).to_pylist()
    counts = Counter((r["licence"], r["source"]) for r in rows)
    lines = []
    for (licence, source), count in sorted(counts.items()):
        authors = {r["author"] for r in rows if (r["licence"], r["source"]) == (licence, source)}
        lines.append((licence, source, count, len(authors - {UNKNOWN})))
    return _markdown(("licence", "source", "objects", "named authors"), lines)


def _runs(root: Path) -> str:
    rows = [
        (
            r["run"],
            r["preset"] or "-",
            r["setting"],
            "-" if r["grasps"] < 0 else r["grasps"],
            "-" if r["candidates"] < 0 else r["candidates"],
            r["seed"],
            r["generator_version"] or "-",
            r["fingerprint"],
        )
        for r in parquet.read_table(root / "runs.parquet").to_pylist()
    ]
    head = ("run", "preset", "setting", "N", "attempts", "seed", "bidexdata", "fingerprint")
    return _markdown(head, rows)


def _hub_metadata(root: Path, head: Mapping[str, Any]) -> str:
    import yaml

    licences = set(
        parquet.read_table(root / "objects.parquet", ["licence"]).column("licence").to_pylist()
    )
    rows = head["figures"]["selected_rows"]
    hands = ["bimanual"] if len(json.loads(head["header"])["hands"]) == 2 else []
    data: dict[str, Any] = {
        "pretty_name": f"{head['name']} {head['version']}",
        "license": _hub_licence(licences),
        "task_categories": ["robotics"],
        "tags": ["dexterous grasping", *hands, "grasp synthesis", "bidexdata"],
        "size_categories": [_size_category(rows)],
        "configs": _configs(root),
    }
    return "---\n" + yaml.safe_dump(data, sort_keys=False) + "---\n"


def _configs(root: Path) -> list[dict[str, Any]]:
    configs: list[dict[str, Any]] = []
    for name, folder in (("selected", "grasps"), ("audit", "grasps_audit")):
        found = []
        for split in ("train", "test"):
            parts = sorted((root / folder).glob(f"{split}-*.parquet"))
            # Hub readers refuse a split without rows.
            if any(sum(parquet.row_counts(part)) for part in parts):
                found.append({"split": split, "path": f"{folder}/{split}-*.parquet"})
        if found:
            configs.append({"config_name": name, "data_files": found})
    if configs:
        configs[0]["default"] = True
    for table in ("objects", "scenes", "runs"):
        configs.append({"config_name": table, "data_files": f"{table}.parquet"})
    return configs


def _hub_licence(licences: Iterable[str]) -> str:
    known = {licence.lower() for licence in licences}
    only = known.pop() if len(known) == 1 else ""
    return only if only in _HUB_LICENCES else "other"


def _size_category(rows: int) -> str:
    bounds = (
        (1_000, "n<1K"),
        (10_000, "1K<n<10K"),
        (100_000, "10K<n<100K"),
        (1_000_000, "100K<n<1M"),
    )
    return next(
        (text for bound, text in bounds if rows < bound),
        "1M<n<10M" if rows < 10_000_000 else "10M<n<100M",
    )


def _share(value: float | None) -> str:
    return share(value, missing="not available")


def _markdown(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(_cell(c) for c in row) + " |" for row in rows]
    return "\n".join(lines)


def _cell(value: Any) -> str:
    return str(value).replace("|", "\\|").replace("\n", " ")
