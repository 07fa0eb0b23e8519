"""Laws of the library's files: what was written is read, always the same bytes, damage is found."""

from __future__ import annotations

import dataclasses
import io
import os
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pyarrow import parquet

from bidexdata.errors import Contradiction, NotUsable, PathNotFound, UnknownName
from bidexdata.objects.config import PrepareConfig
from bidexdata.objects.library import (
    COLUMNS,
    Library,
    content_sha256,
    object_folder,
    warnings_of,
    write_index,
)
from bidexdata.objects.prepare import prepare_object
from bidexdata.objects.prepared import PreparedObject, Solid, TriangleMesh
from bidexdata.objects.storage import (
    OBJECT_FILES,
    object_files,
    read_object,
    read_solid,
    write_files,
    write_object,
    write_solid,
)
from bidexdata.record.status import Status


def assert_same(a, b, where=""):
    """Equal in type, dtype and every bit."""
    if isinstance(a, np.ndarray):
        assert a.dtype == b.dtype, where
        assert np.array_equal(a, b), where
    elif isinstance(a, tuple):
        assert len(a) == len(b), where
        for k, (x, y) in enumerate(zip(a, b, strict=True)):
            assert_same(x, y, f"{where}[{k}]")
    elif dataclasses.is_dataclass(a):
        for field in dataclasses.fields(a):
            assert_same(getattr(a, field.name), getattr(b, field.name), field.name)
    else:
        assert a == b, where


def as_stored(mesh: TriangleMesh) -> TriangleMesh:
    return TriangleMesh(mesh.vertices.astype(np.float32).astype(float), mesh.faces)


def test_what_was_written_is_read_to_the_bit(tmp_path, prepared):
    for name, obj in prepared.items():
        write_object(tmp_path / name, obj)
        assert_same(read_object(tmp_path / name), obj)


def test_a_release_keeps_the_solid_without_the_geometry(tmp_path, prepared):
    obj = prepared["bracket"]
    write_solid(tmp_path / "solid", obj)
    assert not (tmp_path / "solid" / "geometry.npz").exists()
    solid = read_solid(tmp_path / "solid")
    assert type(solid) is Solid
    for field in dataclasses.fields(Solid):
        assert_same(getattr(solid, field.name), getattr(obj, field.name), field.name)
    with pytest.raises(Contradiction):
        read_object(tmp_path / "solid")


def test_the_same_source_and_configuration_give_the_same_bytes(prepared, small):
    for name in ("box", "mug"):
        again = prepare_object(f"shapes:{name}", small)
        assert object_files(again) == object_files(prepared[name])


def test_any_reader_of_gltf_shows_the_mesh_upright(prepared):
    obj = prepared["mug"]
    scene = trimesh.load(io.BytesIO(object_files(obj)["mesh.glb"]), file_type="glb")
    size = np.ptp(obj.mesh.vertices, axis=0)
    np.testing.assert_allclose(scene.extents, size[[0, 2, 1]], atol=1e-6)


@pytest.mark.parametrize("name", OBJECT_FILES)
def test_one_flipped_byte_is_found_in_every_file(library: Path, name):
    lib = Library.open(library)
    path = lib.folder(lib.object_ids[0]) / name
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(Contradiction) as caught:
        lib.load(lib.object_ids[0])
    assert caught.value.exit_code == 4
    path.unlink()
    with pytest.raises(Contradiction):
        lib.load_solid(lib.object_ids[0])


@pytest.mark.parametrize("name", ["pieces.npz", "geometry.npz", "mesh.glb", "object.json"])
def test_a_cut_off_file_is_a_contradiction_not_a_crash(tmp_path, prepared, name):
    write_object(tmp_path / "box", prepared["box"])
    path = tmp_path / "box" / name
    for keep in (0, 10, len(path.read_bytes()) // 2):
        path.write_bytes(path.read_bytes()[:keep])
        with pytest.raises(Contradiction):
            read_object(tmp_path / "box")


def test_a_damaged_index_is_a_contradiction(library: Path):
    path = library / "index.parquet"
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(Contradiction):
        Library.open(library)


def rewrite_index(library: Path, version: str, without: tuple[str, ...] = ()) -> None:
    """Write an index anew, as another version of the package might have."""
    path = library / "index.parquet"
    table = parquet.read_table(path)
    metadata = {**table.schema.metadata, b"schema_version": version.encode()}
    if "colour" not in table.column_names:
        table = table.append_column("colour", [["red"] * table.num_rows])
    table = table.drop_columns(list(without)).replace_schema_metadata(metadata)
    parquet.write_table(table, path)


@pytest.mark.parametrize(
    ("version", "said"), [("2.0", "upgrade bidexdata"), ("0.9", "again"), ("", "version none")]
)
def test_an_index_of_another_major_version_is_not_read(library: Path, version, said):
    rewrite_index(library, version)
    with pytest.raises(Contradiction, match=said):
        Library.open(library)


def test_an_index_of_another_minor_version_is_read_with_nulls(library: Path):
    ids = Library.open(library).object_ids
    rewrite_index(library, "1.9", ("genus", "warnings"))
    lib = Library.open(library)
    assert lib.object_ids == ids
    assert lib.index.column_names == [*(name for name, _, _ in COLUMNS), "colour"]
    assert lib.index.column("genus").to_pylist() == [None] * 3
    assert warnings_of(lib.index.to_pylist()) == []
    assert lib.load(ids[0]).volume > 0
    rewrite_index(library, "1.9", ("content_sha256",))
    with pytest.raises(Contradiction, match="no column 'content_sha256'"):
        Library.open(library)


def test_what_is_no_library_says_so(tmp_path):
    with pytest.raises(PathNotFound):
        Library.open(tmp_path / "nowhere")
    with pytest.raises(NotUsable, match="no library"):
        Library.open(tmp_path)
    (tmp_path / "objects").mkdir()
    with pytest.raises(NotUsable, match="unfinished"):
        Library.open(tmp_path)


def test_an_unknown_object_names_those_that_exist(library: Path):
    lib = Library.open(library)
    with pytest.raises(UnknownName) as caught:
        lib.load("box")
    assert lib.object_ids[0] in str(caught.value)


def test_fingerprint_depends_on_contents_alone(library: Path, tmp_path, prepared):
    one = Library.open(library)
    assert one.fingerprint == Library.open(library).fingerprint
    fewer = tmp_path / "fewer"
    fill(fewer, [prepared["box"]])
    assert Library.open(fewer).fingerprint != one.fingerprint


def test_the_index_holds_failures_too_and_is_the_same_bytes_twice(library: Path):
    lib = Library.open(library)
    assert lib.index.num_rows == 3
    assert lib.index.column("status").to_pylist() == [0, Status.NO_FACES, 0]
    assert lib.index.column_names == [name for name, _, _ in COLUMNS]
    before = (library / "index.parquet").read_bytes()
    write_index(library, lib.index.to_pylist(), PrepareConfig())
    assert (library / "index.parquet").read_bytes() == before


@pytest.fixture
def library(tmp_path: Path, prepared: dict[str, PreparedObject]) -> Path:
    """A library of two objects and one failure."""
    fill(tmp_path / "library", [prepared["box"], prepared["bracket"]], failure=True)
    return tmp_path / "library"


def fill(library: Path, objects: list[PreparedObject], failure: bool = False) -> None:
    rows = []
    for obj in objects:
        folder = library / object_folder(obj.object_id)
        write_object(folder, obj)
        row = {"source_name": obj.object_id, "object_id": obj.object_id, "status": 0}
        rows.append({**row, "content_sha256": content_sha256(folder)})
    if failure:
        rows.insert(1, {"source_name": "points.obj", "status": int(Status.NO_FACES)})
    write_index(library, rows, PrepareConfig())


def test_of_two_writers_of_one_folder_the_first_stays_and_nothing_else(tmp_path, monkeypatch):
    folder, real = tmp_path / "objects" / "box", os.replace

    def overtaken(source, target):
        folder.mkdir()
        (folder / "a").write_bytes(b"first")
        real(source, target)

    monkeypatch.setattr(os, "replace", overtaken)
    write_files(folder, {"a": b"second"})
    assert (folder / "a").read_bytes() == b"first"
    assert [p.name for p in folder.parent.iterdir()] == ["box"]


def test_a_solid_far_from_its_mesh_is_warned_of_in_millimetres():
    row = {"source_name": "barrow.obj", "status": Status.OK, "warnings": ["one"]}
    near = warnings_of([{**row, "solid_hausdorff": 0.039}])
    far = warnings_of([{**row, "solid_hausdorff": 0.06}])
    assert [w["warning"] for w in near] == ["one"]
    assert "6.0 % of the diagonal" in far[1]["warning"]
    assert "30 mm at 0.5 m" in far[1]["warning"]
