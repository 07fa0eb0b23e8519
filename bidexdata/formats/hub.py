"""The front matter of a release's README, which Hugging Face's hub and its loader read."""

from __future__ import annotations

import json
from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import Any

from bidexdata.formats import parquet
from bidexdata.formats.licences import hub_licence
from bidexdata.formats.splits import SPLITS
from bidexdata.formats.tables import CONFIGURATIONS, folder_of

PLAIN_TABLES = ("objects", "scenes", "runs")
_SIZES = (
    (1_000, "n<1K"),
    (10_000, "1K<n<10K"),
    (100_000, "10K<n<100K"),
    (1_000_000, "100K<n<1M"),
    (10_000_000, "1M<n<10M"),
)


def hub_metadata(root: Path, head: Mapping[str, Any]) -> str:
    """YAML between two lines of dashes: licence, tags, and one configuration per table.

    Every table has columns of its own, so each is a configuration; `selected` is the default.

    Args:
        root: Folder whose Parquet tables are complete.
        head: The manifest's head.
    """
    import yaml

    objects = parquet.read_table(root / "objects.parquet", ["licence"])
    hands = ["bimanual"] if len(json.loads(head["header"])["hands"]) == 2 else []
    data: dict[str, Any] = {
        "pretty_name": f"{head['name']} {head['version']}",
        "license": hub_licence(objects.column("licence").to_pylist()),
        "task_categories": ["robotics"],
        "tags": ["dexterous grasping", *hands, "grasp synthesis", "bidexdata"],
        "size_categories": [_size_category(head["figures"]["selected_rows"])],
        "configs": _configs(root, [f"{p}-{t}" for p, t in head["tests"]], head.get("rigs", [])),
    }
    return "---\n" + yaml.safe_dump(data, sort_keys=False) + "---\n"


def _configs(root: Path, tests: list[str], rigs: list[str]) -> list[dict[str, Any]]:
    tables = ["grasps", "contacts", *(f"arms/{r}" for r in rigs), *(f"verdicts/{t}" for t in tests)]
    configs: list[dict[str, Any]] = []
    for table, configuration in product(tables, CONFIGURATIONS):
        folder, found = folder_of(table, configuration), []
        name = configuration if table == "grasps" else folder.replace("/", "-")
        for split in SPLITS:
            parts = sorted((root / folder).glob(f"{split}-*.parquet"))
            # Hub readers refuse a split without rows.
            if any(sum(parquet.row_counts(part)) for part in parts):
                found.append({"split": split, "path": f"{folder}/{split}-*.parquet"})
        if found:
            configs.append({"config_name": name, "data_files": found})
    if configs:
        configs[0]["default"] = True
    for table in PLAIN_TABLES:
        configs.append({"config_name": table, "data_files": f"{table}.parquet"})
    return configs


def _size_category(rows: int) -> str:
    return next((text for bound, text in _SIZES if rows < bound), "10M<n<100M")
