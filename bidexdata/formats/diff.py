"""What differs between two releases: columns, objects, rows by grasp_id, figures.

Rows are compared bit by bit and streamed object by object. Names and versions are shown, but are
no difference of content.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bidexdata.formats import parquet
from bidexdata.formats.columns import release_columns
from bidexdata.formats.release import Release
from bidexdata.formats.stored_rows import StoredRows

_ABOUT = ("name", "version", "schema_version", "default_protocol", "licences")


@dataclass(frozen=True, slots=True)
class Sides:
    """How many things are on one side only, on both, and on both but different."""

    only_a: int = 0
    only_b: int = 0
    both: int = 0
    changed: int = 0
    by_column: Mapping[str, int] = field(default_factory=dict)
    """How many of those changed differ in each column."""
    first: tuple[str, ...] = ()
    """A few ids of what is on one side only or changed."""

    @property
    def same(self) -> bool:
        """Nothing is on one side only, nothing changed."""
        return not (self.only_a or self.only_b or self.changed)


@dataclass(frozen=True, slots=True)
class ReleaseDiff:
    """Two releases compared."""

    about: Mapping[str, tuple[Any, Any]]
    """Name, version, schema, protocol, policy and split of both, equal or not."""
    columns: Mapping[str, tuple[list[str], list[str]]]
    """Per table, the columns that only the first and only the second has; tables that differ."""
    objects: Sides
    rows: Sides
    figures: Mapping[str, tuple[Any, Any]]
    """Figures that differ, by their path, such as `tests.f.selected.rate`."""

    @property
    def same(self) -> bool:
        """Whether the content is the same, whatever the releases are called."""
        return not self.columns and self.objects.same and self.rows.same and not self.figures

    def to_dict(self) -> dict[str, Any]:
        """Plain data for `--json`."""

        def pairs(found: Mapping[str, tuple[Any, Any]]) -> dict[str, Any]:
            return {key: {"a": a, "b": b} for key, (a, b) in found.items()}

        def sides(found: Sides) -> dict[str, Any]:
            names = ("only_a", "only_b", "both", "changed", "by_column", "first")
            return {name: getattr(found, name) for name in names}

        return {
            "same": self.same,
            "about": pairs(self.about),
            "columns": pairs(self.columns),
            "objects": sides(self.objects),
            "rows": sides(self.rows),
            "figures": pairs(self.figures),
        }


def diff_releases(a: Release, b: Release) -> ReleaseDiff:
    """Compare two releases.

    Raises:
        Contradiction: A file of one of them is damaged.
    """
    return ReleaseDiff(_about(a, b), _columns(a, b), _objects(a, b), _rows(a, b), _figures(a, b))


def _about(a: Release, b: Release) -> dict[str, tuple[Any, Any]]:
    found = {key: (a.manifest.get(key, ""), b.manifest.get(key, "")) for key in _ABOUT}
    found["split"] = (a.manifest["split"]["by"], b.manifest["split"]["by"])
    hands = [", ".join(f"{h.name} {h.side}" for h in r.hands) for r in (a, b)]
    return {**found, "hands": (hands[0], hands[1])}


def _columns(a: Release, b: Release) -> dict[str, tuple[list[str], list[str]]]:
    of = [_columns_of(release) for release in (a, b)]
    found = {}
    for table in sorted({*of[0], *of[1]}):
        mine, theirs = (columns.get(table, []) for columns in of)
        only = ([c for c in mine if c not in theirs], [c for c in theirs if c not in mine])
        if any(only):
            found[table] = only
    return found


def _columns_of(release: Release) -> dict[str, list[str]]:
    """Column names per table, those left out that came after the release's schema."""
    found = {
        table: [c.name for c in columns if not release.header.lacks(c.name)]
        for table, columns in release_columns(release.header, release.protocols).items()
    }
    for table in ("objects", "scenes", "runs"):
        found[table] = parquet.read_schema(release.path / f"{table}.parquet").names
    return found


def _objects(a: Release, b: Release) -> Sides:
    of = [{row["object_id"]: row for row in r.objects.to_pylist()} for r in (a, b)]
    both = [i for i in of[0] if i in of[1]]
    by_column: Counter[str] = Counter()
    changed = []
    for object_id in both:
        mine, theirs = of[0][object_id], of[1][object_id]
        keys = [k for k in mine if k != "cloud_index" and k in theirs and mine[k] != theirs[k]]
        by_column.update(keys)
        changed += [object_id] * bool(keys)
    only = [[i for i in of[k] if i not in of[1 - k]] for k in (0, 1)]
    first = tuple([*only[0], *only[1], *changed][:3])
    return Sides(len(only[0]), len(only[1]), len(both), len(changed), dict(by_column), first)


def _rows(a: Release, b: Release) -> Sides:
    sources = [StoredRows(release) for release in (a, b)]
    counts = Counter[str]()
    by_column: Counter[str] = Counter()
    first: list[str] = []
    for object_id in sorted({i for s in sources for i in s.object_ids}):
        mine, theirs = (_columns_by_id(s, object_id) for s in sources)
        ids = [m["grasp_id"] for m in (mine, theirs)]
        only = [np.setdiff1d(ids[k], ids[1 - k]) for k in (0, 1)]
        _, at, there = np.intersect1d(ids[0], ids[1], return_indices=True)
        differs = np.zeros(len(at), bool)
        for name in mine.keys() & theirs.keys():
            unequal = ~_equal(mine[name][at], theirs[name][there])
            by_column[name] += int(unequal.sum())
            differs |= unequal
        counts.update(a=len(only[0]), b=len(only[1]), both=len(at), changed=int(differs.sum()))
        if len(first) < 3:
            first += [*only[0].tolist(), *only[1].tolist(), *ids[0][at][differs].tolist()]
    columns = {name: n for name, n in sorted(by_column.items()) if n}
    a_only, b_only, both, changed = (counts[key] for key in ("a", "b", "both", "changed"))
    return Sides(a_only, b_only, both, changed, columns, tuple(first[:3]))


def _columns_by_id(source: StoredRows, object_id: str) -> dict[str, np.ndarray]:
    """All values of the rows of one object, verdicts beside them under `<protocol>-<test>/<name>`."""
    parts = list(source.rows_of(object_id)) if object_id in source else []
    found: dict[str, np.ndarray] = {"grasp_id": np.zeros(0, "<U16")}
    if not parts:
        return found
    for name in parts[0].batch.columns:
        found[name] = np.concatenate([p.batch[name] for p in parts])
    found["run"] = np.concatenate([np.full(len(p.batch), p.run) for p in parts])
    for key in source.release.protocols:
        label = "-".join(key)
        tested = [np.full(len(p.batch), key in p.verdicts) for p in parts]
        found[f"{label}/tested"] = np.concatenate(tested)
        judged = [p.verdicts[key] for p in parts if key in p.verdicts]
        for name in judged[0] if judged else ():
            whole = np.zeros(
                (len(found["grasp_id"]), *judged[0][name].shape[1:]), judged[0][name].dtype
            )
            whole[found[f"{label}/tested"]] = np.concatenate([v[name] for v in judged])
            found[f"{label}/{name}"] = whole
    return found


def _equal(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Rows that are the same bits, (N,)."""
    if a.shape[1:] != b.shape[1:]:
        return np.zeros(len(a), bool)
    if a.dtype.kind == "f":
        a, b = (np.ascontiguousarray(x).view(f"u{x.dtype.itemsize}") for x in (a, b))
    same = a == b
    return same.reshape(len(a), -1).all(axis=1) if len(a) else np.zeros(0, bool)


def _figures(a: Release, b: Release) -> dict[str, tuple[Any, Any]]:
    mine, theirs = dict(_leaves(a.figures)), dict(_leaves(b.figures))
    return {
        path: (mine.get(path), theirs.get(path))
        for path in sorted({*mine, *theirs})
        if mine.get(path) != theirs.get(path)
    }


def _leaves(figures: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(figures, Mapping):
        for key, value in figures.items():
            yield from _leaves(value, f"{path}.{key}" if path else str(key))
    else:
        yield path, figures
