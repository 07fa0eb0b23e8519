"""A release as the material of another: its rows object by object, its objects, hands and runs.

Rows are streamed: what is held in memory is one object's rows and a row group of each table.
"""

from __future__ import annotations

import itertools
import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bidexdata.formats.clouds import CLOUDS
from bidexdata.formats.golden import complete_golden
from bidexdata.formats.object_pass import NO_CLOUD, ObjectPass, ObjectRow
from bidexdata.formats.object_table import object_row
from bidexdata.formats.release import Release
from bidexdata.formats.rows import ReleaseRows, RunInfo, TestKey
from bidexdata.formats.tables import (
    CONTACT_COLUMNS,
    GRASP_COLUMNS,
    OBJECT_FIELDS,
    VERDICT_COLUMNS,
    plain_lacks,
)
from bidexdata.objects.library import object_folder
from bidexdata.record import GraspBatch, Header

if TYPE_CHECKING:
    import pyarrow as pa

Choose = Callable[[str, "pa.Table"], np.ndarray]
"""Chooses rows of one object by their scalar columns: a mask, (N,)."""


class StoredRows:
    """The rows of a release; objects must be asked for in ascending order, each once."""

    def __init__(
        self,
        release: Release,
        *,
        scenes: Callable[[Mapping[str, Any]], bool] = lambda _: True,
        choose: Choose | None = None,
        run_names: Mapping[str, str] | None = None,
    ):
        """Open the row tables.

        Args:
            release: Where.
            scenes: Which scenes are wanted, by their row of the scenes table.
            choose: Which rows of those are wanted; then scenes without such a row are left out.
            run_names: New name of every run, where they change.
        """
        self.release, self._choose = release, choose
        self._names = run_names or {}
        self._scenes: dict[str, list[dict[str, Any]]] = {}
        for scene in release.scenes.to_pylist():
            if scenes(scene):
                self._scenes.setdefault(scene["object_id"], []).append(scene)
        self._streams = [
            _Stream(release, configuration, split)
            for configuration in release.configurations
            for split in release.split_names
        ]
        self._wanted = {r.name: r.grasps for r in run_infos(release)}

    def __contains__(self, object_id: str) -> bool:
        """Whether an object has a wanted scene."""
        return object_id in self._scenes

    @property
    def object_ids(self) -> tuple[str, ...]:
        """Objects with a wanted scene, ascending."""
        return tuple(sorted(self._scenes))

    @property
    def scenes(self) -> Iterator[Mapping[str, Any]]:
        """Wanted rows of the scenes table."""
        return itertools.chain.from_iterable(self._scenes.values())

    def rows_of(self, object_id: str) -> Iterator[ReleaseRows]:
        """Rows of one object, run by run, with the attempts of its scenes."""
        scenes = {s["scene_id"]: s for s in self._scenes.get(object_id, ())}
        parts = [rows for stream in self._streams for rows in stream.take(object_id)]
        whole = _Rows.joined(parts)
        keep = np.isin(whole.text("scene_id"), list(scenes))
        if self._choose is not None and keep.any():
            keep &= self._choose(object_id, whole.tables[0])
        rows = whole.select(keep)
        found = rows.text("scene_id")
        if self._choose is not None:
            scenes = {name: scenes[name] for name in np.unique(found).tolist()}
        counts = self._counts(scenes, found, rows.text("run"))
        for run in sorted(counts):
            yield from self._of_run(rows, run, counts[run])

    def _of_run(
        self, rows: _Rows, run: str, counts: Mapping[str, Mapping[str, int]]
    ) -> Iterator[ReleaseRows]:
        """Rows of one run; apart where a test was run on some of them only."""
        mine = rows.select(rows.text("run") == run)
        tests = self.release.protocols
        tested = np.stack([mine.tested(i) for i in range(len(tests))] or [np.zeros(mine.n, bool)])
        # A run whose rows were all tested would have tested those of an object without any.
        patterns = np.unique(tested, axis=1).T if mine.n else [self._tested_runs(run)]
        name = self._names.get(run, run)
        for k, pattern in enumerate(patterns):
            same = (tested == np.asarray(pattern)[:, None]).all(axis=0)
            part = mine.select(same) if mine.n else mine
            header = Header(self.release.hands, counts=counts if k == 0 else {})
            verdicts = {key: part.verdicts(i) for i, key in enumerate(tests) if pattern[i]}
            yield ReleaseRows(name, part.batch(header), verdicts)

    def _counts(
        self, scenes: Mapping[str, Mapping[str, Any]], of_row: np.ndarray, run: np.ndarray
    ) -> dict[str, dict[str, dict[str, int]]]:
        """Attempts per run and scene. They are stored as sums over the runs: the first has them."""
        pairs = set(zip(of_row.tolist(), run.tolist(), strict=True))
        found: dict[str, dict[str, dict[str, int]]] = {}
        for name, scene in scenes.items():
            attempts = json.loads(scene["attempts"])
            for worked in sorted(self._runs_of(scene, {r for s, r in pairs if s == name})):
                found.setdefault(worked, {})[name] = attempts
                attempts = {}
        return found

    def _runs_of(self, scene: Mapping[str, Any], known: set[str]) -> set[str]:
        """The runs that worked on a scene: those of its rows, and others that fit what it says."""
        missing = 0 if self._choose is not None else scene["runs"] - len(known)
        if missing <= 0:
            return known
        wanted = scene["grasps_wanted"] - sum(self._wanted[run] or 0 for run in known)
        others = sorted(set(self._wanted) - known)
        ways = itertools.islice(itertools.combinations(others, missing), 1000)
        sums = ((w, sum(self._wanted[run] or 0 for run in w)) for w in ways)
        return known.union(next((w for w, total in sums if total == wanted), others[:missing]))

    def _tested_runs(self, run: str) -> list[bool]:
        return [run in runs for runs in self._runs_with_verdicts]

    @cached_property
    def _runs_with_verdicts(self) -> list[set[str]]:
        """Per test, the runs that it was run on some row of."""
        found: list[set[str]] = [set() for _ in self.release.protocols]
        for configuration in self.release.configurations:
            names = self.release.index(configuration, columns=["run"]).column("run")
            for i, (protocol, test) in enumerate(self.release.protocols):
                judged = self.release.row_groups(
                    f"verdicts/{protocol}-{test}", configuration, columns=["success"]
                )
                at = 0
                for group in judged:
                    mine = names.slice(at, group.num_rows)
                    tested = mine.filter(group.column("success").is_valid())
                    found[i].update(tested.unique().to_pylist())
                    at += group.num_rows
        return found


class StoredParts:
    """Objects and hands of some releases; the first that has an object gives it."""

    def __init__(self, releases: Sequence[Release]):
        self._releases = tuple(releases)
        self.hands = releases[0].hands
        # Clouds are in farthest-point order: the first points of one are a good cloud too.
        self.cloud_points = min(r.manifest["cloud_points"] for r in releases)

    def rows(self, ids: Sequence[str]) -> dict[str, ObjectRow]:
        """Rows of the objects table by object, without their places in a release."""
        names = [f.name for f in OBJECT_FIELDS if f.name not in ("cloud_index", "split")]
        found: dict[str, ObjectRow] = {}
        for release in reversed(self._releases):
            wanted = set(ids)
            for row in release.objects.to_pylist():
                if row["object_id"] in wanted:
                    found[row["object_id"]] = {name: row[name] for name in names}
        return found

    def each_object(self, one: ObjectPass, ids: Sequence[str]) -> Iterator[tuple[str, ObjectRow]]:
        """Copy folders and clouds, unless shapes are left out; give the objects' rows."""
        rows = self.rows(ids)
        places = [self._places(release) for release in self._releases]
        for number, object_id in enumerate(ids):
            k = next(k for k, place in enumerate(places) if object_id in place)
            release, at = self._releases[k], places[k][object_id]
            row = _completed(release, rows[object_id])
            if not one.shapes:
                yield object_id, {**row, "cloud_index": NO_CLOUD}
                continue
            folder = object_folder(object_id)
            shutil.copytree(release.path / folder, one.root / folder)
            for kind in CLOUDS:
                one.fill(number, kind, release.cloud(kind)[at, : self.cloud_points])
            yield object_id, row

    def write_hands(self, root: Path) -> None:
        """Copy the files of the hands; an older schema lacks golden poses, which are added."""
        shutil.copytree(self._releases[0].path / "hands", root / "hands")
        for name in sorted({h.name for h in self.hands}):
            complete_golden(root / "hands" / name, [h.side for h in self.hands if h.name == name])

    @staticmethod
    def _places(release: Release) -> dict[str, int]:
        indices = release.objects.column("cloud_index").to_pylist()
        return dict(zip(release.object_ids, indices, strict=True))


def _completed(release: Release, row: ObjectRow) -> ObjectRow:
    """Fill in what an older schema did not state of an object, where its files say it."""
    late = [f.name for f in OBJECT_FIELDS if plain_lacks(release.header, f.name)]
    if not late or not release.has_shapes:
        return row
    told = object_row(release.load_solid(row["object_id"]), row["shape_sha256"])
    return {**row, **{name: told[name] for name in late}}


def run_infos(release: Release) -> list[RunInfo]:
    """The runs of a release."""
    return [
        RunInfo(
            name=row["run"],
            fingerprint=row["fingerprint"],
            grasps=None if row["grasps"] < 0 else row["grasps"],
            candidates=None if row["candidates"] < 0 else row["candidates"],
            seed=row["seed"],
            preset=row["preset"],
            setting=row["setting"],
            library_fingerprint=row["library_fingerprint"],
            version=row["generator_version"],
            config=json.loads(row["config"]),
        )
        for row in release.runs.to_pylist()
    ]


class _Rows:
    """Rows of the tables grasps, contacts and verdicts side by side."""

    def __init__(self, tables: Sequence[pa.Table]):
        self.tables = tuple(tables)
        self.n = tables[0].num_rows

    @classmethod
    def joined(cls, parts: Sequence[_Rows]) -> _Rows:
        """One after the other."""
        import pyarrow as pa

        columns = zip(*(part.tables for part in parts), strict=True)
        return cls([pa.concat_tables(tables).combine_chunks() for tables in columns])

    def text(self, name: str) -> np.ndarray:
        """A text column of the grasps table."""
        return np.array(self.tables[0].column(name).to_pylist(), np.str_)

    def tested(self, test: int) -> np.ndarray:
        """Rows that a test was run on, by its place among the verdict tables."""
        return self.tables[2 + test].column("success").is_valid().to_numpy()

    def select(self, mask: np.ndarray) -> _Rows:
        """Keep rows."""
        import pyarrow as pa

        return _Rows([table.filter(pa.array(mask)) for table in self.tables])

    def batch(self, header: Header) -> GraspBatch:
        """Columns of grasps and contacts as stored; an older schema lacks some."""
        grasps, contacts = (GraspBatch.from_arrow(table) for table in self.tables[:2])
        columns = {n: grasps[n] for n in GRASP_COLUMNS if n in grasps}
        columns |= {n: contacts[n] for n in CONTACT_COLUMNS if n in contacts}
        return GraspBatch(header, columns)

    def verdicts(self, test: int) -> dict[str, np.ndarray]:
        """Columns of one verdict table, all rows of which were tested."""
        found = GraspBatch.from_arrow(self.tables[2 + test])
        return {n: found[n] for n in VERDICT_COLUMNS if n in found}


class _Stream:
    """The rows of one configuration and split, object after object.

    State: the row groups to come, and the rows of the last one that were not taken yet.
    """

    def __init__(self, release: Release, configuration: str, split: str):
        tables = ["grasps", "contacts", *("verdicts/" + "-".join(k) for k in release.protocols)]
        groups = [release.row_groups(table, configuration, split) for table in tables]
        self._groups = zip(*groups, strict=True)
        # A row that is selected and an audit row is in both configurations; it comes once.
        self._others = configuration != "selected"
        self._wait_for(_Rows(next(self._groups)))

    def take(self, object_id: str) -> list[_Rows]:
        """The rows of an object, which may be none; at least one part."""
        parts: list[_Rows] = []
        while True:
            # Objects that are not asked for are passed over.
            low = int(np.searchsorted(self._owners, object_id))
            high = int(np.searchsorted(self._owners, object_id, "right"))
            parts.append(self._part(low, high))
            left = high < len(self._owners)
            following = None if left else next(self._groups, None)
            if following is None:
                self._waiting = _Rows([t.slice(high) for t in self._waiting.tables])
                self._owners = self._owners[high:]
                return parts
            self._wait_for(_Rows(following))

    def _wait_for(self, rows: _Rows) -> None:
        self._waiting, self._owners = rows, rows.text("object_id")

    def _part(self, low: int, high: int) -> _Rows:
        part = _Rows([t.slice(low, high - low) for t in self._waiting.tables])
        if not self._others:
            return part
        return part.select(~part.tables[0].column("selected").to_numpy(zero_copy_only=False))


def tests_of(releases: Sequence[Release]) -> list[TestKey]:
    """The tests that some release has verdicts of."""
    return sorted({key for release in releases for key in release.protocols})
