"""Objects, hands and runs of a release as the material of another."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

from bidexdata.formats.clouds import CLOUDS
from bidexdata.formats.golden import complete_golden
from bidexdata.formats.object_pass import NO_CLOUD, ObjectPass, ObjectRow
from bidexdata.formats.object_table import object_row
from bidexdata.formats.release import Release
from bidexdata.formats.rows import RunInfo, TestKey
from bidexdata.formats.tables import OBJECT_FIELDS, plain_lacks
from bidexdata.objects.library import object_folder


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
            rig=row["rig"],
            library_fingerprint=row["library_fingerprint"],
            version=row["generator_version"],
            config=json.loads(row["config"]),
        )
        for row in release.runs.to_pylist()
    ]


def tests_of(releases: Sequence[Release]) -> list[TestKey]:
    """The tests that some release has verdicts of."""
    return sorted({key for release in releases for key in release.protocols})
