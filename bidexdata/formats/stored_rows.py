"""All rows of a release, object by object and run by run: as the writer was given them.

A release holds a row that is selected and an audit row twice, in two tables; here it comes once.
What is held in memory is one object's rows and a row group of each table. Whoever counts, compares
or rewrites a release reads it here.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from bidexdata.formats.release import Release
from bidexdata.formats.row_groups import aligned
from bidexdata.formats.row_stream import RowStream, TableRows, joined
from bidexdata.formats.rows import ReleaseRows, TestKey
from bidexdata.formats.scene_runs import SceneRuns
from bidexdata.record import Header

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
        contacts: bool = True,
    ):
        """Open the row tables.

        Args:
            release: Where.
            scenes: Which scenes are wanted, by their row of the scenes table.
            choose: Which rows of those are wanted; then scenes without such a row are left out.
            run_names: New name of every run, where they change.
            contacts: Read the contacts and the arms too.
        """
        self.release, self._choose = release, choose
        self._names = run_names or {}
        self._scenes: dict[str, list[dict[str, Any]]] = {}
        for scene in release.scenes.to_pylist():
            if scenes(scene):
                self._scenes.setdefault(scene["object_id"], []).append(scene)
        places = itertools.product(release.configurations, release.split_names)
        self._streams = [RowStream(release, *place, contacts=contacts) for place in places]
        runs = release.runs.select(["run", "grasps"]).to_pylist()
        self.wanted = {r["run"]: None if r["grasps"] < 0 else r["grasps"] for r in runs}
        """Grasps per scene that every run wanted; None where it did not say."""
        self._scene_runs = SceneRuns(self.wanted)
        self._presumed: set[tuple[str, TestKey]] = set()
        self._partly: set[tuple[str, TestKey]] = set()

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

    @property
    def unsure(self) -> bool:
        """Whether the tables leave open which run made some attempts, or if they were tested.

        Of the objects that were asked for so far. Rates `unselected` hang on it.
        """
        return self._scene_runs.ambiguous or bool(self._presumed & self._partly)

    def rows_of(self, object_id: str) -> Iterator[ReleaseRows]:
        """Rows of one object, run by run, with the attempts of its scenes.

        Raises:
            Contradiction: A file is damaged, the row tables have not the same rows, or no runs fit
                what the scenes table says.
        """
        scenes = {s["scene_id"]: s for s in self._scenes.get(object_id, ())}
        rows = joined([part for stream in self._streams for part in stream.take(object_id)])
        found = rows.text("scene_id")
        keep = np.isin(found, list(scenes))
        if self._choose is not None and keep.any():
            keep &= self._choose(object_id, rows.grasps)
        if not keep.all():
            rows, found = rows.select(keep), found[keep]
        if self._choose is not None:
            scenes = {name: scenes[name] for name in np.unique(found).tolist()}
        runs = rows.text("run")
        counts = self._counts(scenes, found, runs)
        for run in sorted(counts):
            mine = runs == run
            yield from self._of_run(rows if mine.all() else rows.select(mine), run, counts[run])

    def _of_run(
        self, rows: TableRows, run: str, counts: Mapping[str, Mapping[str, int]]
    ) -> Iterator[ReleaseRows]:
        """Rows of one run; apart where a test was run on some of them only."""
        tests = self.release.protocols
        tested = np.stack([rows.tested(i) for i in range(len(tests))] or [np.zeros(rows.n, bool)])
        patterns = np.unique(tested, axis=1).T if rows.n else [self._presumed_tests(run)]
        self._partly.update((run, key) for i, key in enumerate(tests) if not tested[i].all())
        name = self._names.get(run, run)
        for k, pattern in enumerate(patterns):
            part = rows
            if len(patterns) > 1:
                part = rows.select((tested == np.asarray(pattern)[:, None]).all(axis=0))
            header = Header(
                self.release.hands,
                counts=counts if k == 0 else {},
                arms=self.release.header.arms,
            )
            verdicts = {key: part.verdicts(i) for i, key in enumerate(tests) if pattern[i]}
            yield ReleaseRows(name, part.batch(header), verdicts, part.solved())

    def _counts(
        self, scenes: Mapping[str, Mapping[str, Any]], of_row: np.ndarray, run: np.ndarray
    ) -> dict[str, dict[str, dict[str, int]]]:
        """Attempts per run and scene. They are stored as sums over the runs: the first has them."""
        known: dict[str, set[str]] = {name: set() for name in scenes}
        for name, worked in set(zip(of_row.tolist(), run.tolist(), strict=True)):
            known[name].add(worked)
        found: dict[str, dict[str, dict[str, int]]] = {}
        for name, scene in scenes.items():
            attempts = json.loads(scene["attempts"])
            runs = known[name] if self._choose else self._scene_runs.of(scene, known[name])
            for worked in sorted(runs):
                found.setdefault(worked, {})[name] = attempts
                attempts = {}
        return found

    def _presumed_tests(self, run: str) -> list[bool]:
        """Tests of an object without rows: a run whose rows were tested would have tested those."""
        self._presumed.update((run, key) for key in self.release.protocols)
        return [run in runs for runs in self._runs_with_verdicts]

    @cached_property
    def _runs_with_verdicts(self) -> list[set[str]]:
        """Per test, the runs that it was run on some row of."""
        import pyarrow.compute as pc

        compute: Any = pc
        found: list[set[str]] = []
        places = [*itertools.product(self.release.configurations, self.release.split_names)]
        for key in self.release.protocols:
            tables = {
                "grasps": ["grasp_id", "run"],
                "verdicts/" + "-".join(key): ["grasp_id", "success"],
            }
            runs: set[str] = set()
            for place in places:
                for grasps, judged in aligned(self.release, tables, *place):
                    tested = grasps.column("run").filter(judged.column("success").is_valid())
                    runs.update(compute.unique(tested).to_pylist())
            found.append(runs)
        return found
