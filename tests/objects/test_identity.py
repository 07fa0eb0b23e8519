"""Laws of identity: what an object is made of decides it, each file is read in blocks, no name is fatal."""

from __future__ import annotations

import hashlib
import os
import shutil
from pathlib import Path

import pytest
from mesh_files import write_gltf, write_obj, write_stl

from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.identity import Identity, source_identity
from bidexdata.objects.library import Library
from bidexdata.objects.prepared import TriangleMesh
from bidexdata.objects.readers import inside
from bidexdata.objects.sources import SourceItem, resolve_sources
from bidexdata.record.status import Status
from bidexdata.runs.prepare import prepare_library
from bidexdata.runs.prepare_report import PrepareReport

MOST = 10**6


def identity(path: Path, most: int = MOST) -> Identity:
    return source_identity(SourceItem(source_name=path.name, path=path), most)


def status_of(path: Path) -> Status:
    with pytest.raises(PrepareFailure) as caught:
        identity(path)
    return caught.value.status


def prepared(source: Path, out: Path, config, **options) -> PrepareReport:
    options = {"executor": "inline", "quiet": True, **options}
    return prepare_library([str(source)], out, config, **options)


@pytest.mark.parametrize("block", [1, 7, 1 << 20])
def test_a_file_is_its_bytes_whatever_the_blocks(tmp_path, box, monkeypatch, block):
    monkeypatch.setattr(inside, "_BLOCK", block)
    path = write_stl(tmp_path / "a.stl", box)
    data = path.read_bytes()
    assert identity(path) == (hashlib.sha256(data).hexdigest(), len(data))
    assert inside.regular_bytes(path, len(data)) == data
    # The name of a glTF file's buffer lies across blocks.
    same, other = (write_gltf(tmp_path / f"{n}.gltf", box, f"{n}%20of.bin") for n in "ab")
    (tmp_path / "a of.bin").write_bytes(b"1")
    before = identity(same)
    (tmp_path / "a of.bin").write_bytes(b"2")
    assert identity(same) != before
    assert identity(other) != before


def test_a_file_that_grows_while_it_is_read_is_refused(tmp_path, box):
    path = write_stl(tmp_path / "a.stl", box)
    size = path.stat().st_size
    for other in (size - 1, size + 1):
        with pytest.raises(PrepareFailure, match="changed while"):
            b"".join(inside.regular_blocks(path, other))


def test_the_buffers_of_a_gltf_file_are_part_of_its_identity(tmp_path, box, small):
    folder, twice = tmp_path / "meshes", TriangleMesh(box.vertices * [2, 1, 1], box.faces)
    for name, mesh in (("a", box), ("b", twice), ("c", box)):
        (folder / name).mkdir(parents=True)
        write_gltf(folder / name / "model.gltf", mesh, "model.bin")
    out = tmp_path / "lib"
    first = prepared(folder, out, small)
    assert [r["status_label"] for r in first.rows] == ["ok", "ok", "duplicate"]
    assert prepared(folder, out, small).made == 0
    shutil.copy(folder / "b" / "model.bin", folder / "a" / "model.bin")
    again = prepared(folder, out, small)
    assert [r["status_label"] for r in again.rows] == ["ok", "duplicate", "ok"]
    assert Library.open(out).object_ids == (
        first.rows[1]["object_id"].replace("b-", "a-"),
        first.rows[0]["object_id"].replace("a-", "c-"),
    )


def test_a_gltf_file_that_holds_its_numbers_is_its_own_bytes(tmp_path, box):
    path = write_gltf(tmp_path / "a.gltf", box)
    assert identity(path).sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_buffers_outside_the_folder_are_not_read_and_large_ones_are_refused(tmp_path, box):
    folder = tmp_path / "meshes"
    folder.mkdir()
    path = write_gltf(folder / "a.gltf", box, "../secret.bin")
    before = identity(path)
    (tmp_path / "secret.bin").write_bytes(b"other")
    assert identity(path) == before
    path = write_gltf(folder / "b.gltf", box, "b.bin")
    sizes = [p.stat().st_size for p in (path, folder / "b.bin")]
    assert identity(path, sum(sizes)).size > sum(sizes)
    with pytest.raises(PrepareFailure, match="2 files have more bytes together") as caught:
        identity(path, sum(sizes) - 1)
    assert caught.value.status == Status.TOO_COMPLEX


def test_the_pieces_of_an_object_have_one_bound_together(tmp_path, box):
    meshes = tmp_path / "brick" / "urdf" / "meshes"
    meshes.mkdir(parents=True)
    size = sum(write_obj(meshes / f"{k}.obj", box).stat().st_size for k in range(3))
    (item,) = resolve_sources([f"bodex:{tmp_path}"])
    source_identity(item, size)
    with pytest.raises(PrepareFailure, match=r"3 files .* load\.max_bytes") as caught:
        source_identity(item, size - 1)
    assert caught.value.status == Status.TOO_COMPLEX


def test_a_link_that_leads_to_itself_is_one_refused_input(tmp_path, box, small):
    folder = tmp_path / "meshes"
    folder.mkdir()
    (folder / "a.obj").symlink_to("a.obj")
    (folder / "b.obj").symlink_to("nowhere.obj")
    write_stl(folder / "c.stl", box)
    (tmp_path / "INDEX.csv").write_text("file,licence\nmeshes/a.obj,MIT\n")
    for number, source in enumerate((folder, folder / "*.*")):
        report = prepared(source, tmp_path / f"lib{number}", small)
        assert [r["status_label"] for r in report.rows] == ["unreadable", "no_file", "ok"]
        assert "links" in report.rows[0]["reason"]
        assert number or report.rows[0]["licence"] == "MIT"


def test_lines_that_are_no_file_names_are_rows(tmp_path, box, small):
    write_stl(tmp_path / "a.stl", box)
    listed = tmp_path / "list.txt"
    listed.write_text(f"{'x' * 300}.obj\na\0b.obj\na.stl/b.obj\na.stl\n")
    report = prepared(listed, tmp_path / "lib", small)
    labels = [r["status_label"] for r in report.rows]
    assert labels == ["unreadable", "no_file", "no_file", "ok"]
    assert "File name too long" in report.rows[0]["reason"]


def test_a_file_that_may_not_be_looked_at_is_refused(tmp_path, monkeypatch):
    def denied(path, *args, **kwargs):
        raise PermissionError(13, "Permission denied", str(path))

    (tmp_path / "a.obj").touch()
    monkeypatch.setattr(os, "stat", denied)
    assert status_of(tmp_path / "a.obj") == Status.UNREADABLE


def test_a_name_that_is_no_utf8_is_stored_and_shown(tmp_path, box, small):
    folder = tmp_path / "meshes"
    folder.mkdir()
    write_stl(Path(os.fsdecode(os.fsencode(folder) + b"/caf\xe9.stl")), box)
    Path(os.fsdecode(os.fsencode(folder) + b"/caf\xe9.obj")).symlink_to("/dev/null")
    out = tmp_path / "lib"
    report = prepared(folder, out, small)
    names = [row["source_name"] for row in Library.open(out).index.to_pylist()]
    assert names == ["caf\\xe9.obj", "caf\\xe9.stl"]
    assert [r["status_label"] for r in report.rows] == ["unreadable", "ok"]
    assert "caf\\xe9.obj is a link" in report.rows[0]["reason"]
    (made,) = Library.open(out).object_ids
    assert Library.open(out).load(made).provenance["source_name"] == "caf\\xe9.stl"
    assert "caf\\xe9.stl" in (out / "report.html").read_text("utf-8")
    assert prepared(folder, out, small).made == 0


def test_pieces_whose_names_are_no_utf8_have_an_identity(tmp_path, box):
    meshes = tmp_path / "brick" / "urdf" / "meshes"
    meshes.mkdir(parents=True)
    write_obj(Path(os.fsdecode(os.fsencode(meshes) + b"/\xe9.obj")), box)
    (item,) = resolve_sources([f"bodex:{tmp_path}"])
    assert len(source_identity(item, MOST).sha256) == 64
