"""The laws of what is derived from all rows at once: content hash and statistics."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

from bidexdata.errors import Contradiction
from bidexdata.formats.content_hash import content_hash
from bidexdata.formats.row_groups import aligned
from bidexdata.formats.statistics import CONFIGURATION, STATISTICS, StatisticsTally
from bidexdata.wording import counted

if TYPE_CHECKING:
    from bidexdata.formats.release import Release

RELATIVE = 1e-6
"""Means may differ by this fraction: another processor rounds sums otherwise."""


def content(release: Release) -> str:
    """Hash the decoded columns of all tables again."""
    stated = release.manifest.get("content_hash")
    if stated is None:
        return f"schema {release.header.schema_version} states no content hash"
    found = content_hash(release)
    if found != stated:
        raise Contradiction(f"the tables have content hash {found}, the manifest says {stated}")
    return f"{found[:16]}..., of all columns decoded"


def statistics(release: Release) -> str:
    """Compute the statistics of every split again."""
    path = release.path / STATISTICS
    if not path.is_file():
        return f"schema {release.header.schema_version} has none"
    try:
        stated = json.loads(path.read_text(encoding="utf-8"))["splits"]
    except (OSError, ValueError, KeyError, TypeError) as err:
        raise Contradiction(f"{path}: damaged statistics ({err!r})") from err
    tables = {"grasps": None, "contacts": None}
    for split in release.split_names:
        tally = StatisticsTally()
        for parts in aligned(release, tables, CONFIGURATION, split):
            for part in parts:
                tally.add(part)
        found = tally.columns()
        for name in sorted({*found, *stated.get(split, {})}):
            if not _same(stated.get(split, {}).get(name), found.get(name)):
                raise Contradiction(f"{STATISTICS}: {name} of {split} is not that of the rows")
    return f"{counted(len(release.split_names), 'split')} computed again"


def _same(stated: Any, found: Any) -> bool:
    if not isinstance(stated, dict) or not isinstance(found, dict) or set(stated) != set(found):
        return False
    scale = [1.0 if s is None else s for s in found["std"]]
    return all(
        len(stated[key]) == len(found[key])
        and all(_near(a, b, s) for a, b, s in zip(stated[key], found[key], scale, strict=True))
        for key in found
    )


def _near(stated: Any, found: Any, scale: float) -> bool:
    if stated is None or found is None:
        return stated is found
    return math.isclose(stated, found, rel_tol=RELATIVE, abs_tol=RELATIVE * scale + 1e-30)
