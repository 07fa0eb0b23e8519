"""The scenes table says where every scene's rows lie."""

from __future__ import annotations

import numpy as np
import pytest
from made_release import OBJECTS, made_release, made_rows

from bidexdata.errors import UnknownName
from bidexdata.formats import parquet
from bidexdata.formats.release import Release
from bidexdata.formats.row_index import RowIndex


@pytest.fixture(scope="module")
def release(tmp_path_factory) -> Release:
    settings = {object_id: ("floating", "tabletop")[k % 2] for k, object_id in enumerate(OBJECTS)}
    return Release.open(
        made_release(
            tmp_path_factory.mktemp("index") / "release",
            rows_of=lambda object_id: [made_rows(object_id, setting=settings[object_id])],
        )
    )


@pytest.mark.parametrize("split", [None, "train", "test"])
@pytest.mark.parametrize("configuration", ["selected", "audit"])
def test_every_row_is_where_the_scenes_table_says(release, configuration, split):
    index = RowIndex(release, configuration, split)
    rows = release.index(configuration, split)
    assert len(index) == rows.num_rows
    ids = np.array(release.object_ids)
    assert ids[index.object_index].tolist() == rows.column("object_id").to_pylist()
    assert index.size_mm.tolist() == rows.column("size_mm").to_pylist()
    scenes = np.array(index.scene_ids)
    assert scenes[index.scene_index].tolist() == rows.column("scene_id").to_pylist()
    tabletop = [s == "tabletop" for s in rows.column("setting").to_pylist()]
    assert index.tabletop.tolist() == tabletop
    for scene in range(len(scenes)):
        low, high = index.scene_range(scene)
        assert set(index.scene_index[low:high]) <= {scene}


def test_objects_have_their_rows(release):
    index = RowIndex(release)
    for number, object_id in enumerate(release.object_ids):
        rows = np.flatnonzero(index.object_index == number)
        assert index.object_ranges(object_id) == [(rows[0], rows[-1] + 1)]
    with pytest.raises(UnknownName):
        index.object_ranges("nothing-00000000")


def test_pieces_are_the_row_groups_that_hold_the_rows(release, monkeypatch, tmp_path):
    monkeypatch.setattr(parquet, "ROW_GROUP", 5)
    monkeypatch.setattr(parquet, "ROWS_PER_FILE", 5)
    small = Release.open(made_release(tmp_path / "release"))
    index, whole = RowIndex(small, "audit"), small.index("audit", columns=["grasp_id"])
    files = small.table_files("grasps", "audit")
    for low, high in [(0, 1), (3, 9), (5, 5), (0, len(index)), (len(index) - 1, len(index))]:
        found = []
        for piece in index.pieces(low, high):
            tables = parquet.read_groups(files[piece.part], ["grasp_id"], piece.groups)
            ids = [i for table in tables for i in table.column("grasp_id").to_pylist()]
            found += ids[piece.skip : piece.skip + piece.high - piece.low]
        assert found == whole.column("grasp_id").to_pylist()[low:high]
