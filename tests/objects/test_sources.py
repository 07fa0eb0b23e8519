"""What a SOURCE argument names."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from bidexdata.errors import NotUsable, PathNotFound, UnknownName
from bidexdata.objects.identity import object_id_of
from bidexdata.objects.prepare import prepare_object
from bidexdata.objects.sources import SourceItem, resolve_sources
from bidexdata.objects.sources.shapes import shape_bytes, shape_families, shape_mesh


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A folder of empty files: sources are listed without being read."""
    for name in (
        "b.obj",
        "a.STL",
        "deep/er/c.glb",
        "deep/d.PLY",
        "note.txt",
        ".hidden.obj",
        "Z.off",
    ):
        path = tmp_path / "meshes" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    return tmp_path / "meshes"


def names(*sources: str | Path) -> list[str]:
    return [item.source_name for item in resolve_sources([str(s) for s in sources])]


def test_a_folder_is_searched_to_the_bottom_in_byte_order(tree):
    assert names(tree) == ["Z.off", "a.STL", "b.obj", "deep/d.PLY", "deep/er/c.glb"]


def test_a_glob_takes_what_matches_in_byte_order(tree):
    assert names(f"{tree}/*.obj") == ["b.obj"]
    # The names are those that the folder gives: where it lies is no part of them.
    assert names(f"{tree}/**/*.*") == names(tree)
    assert names(f"{tree}/deep/*/*.glb") == ["er/c.glb"]


def test_a_file_named_twice_comes_once(tree):
    assert names(tree / "b.obj", tree, tree / "b.obj") == [
        *("b.obj", "Z.off", "a.STL", "deep/d.PLY", "deep/er/c.glb")
    ]


def test_a_text_list_names_files_relative_to_itself(tree):
    listed = tree / "list.txt"
    listed.write_text("# a comment\nb.obj\n\ndeep/d.PLY # another\nmissing.obj\n")
    items = resolve_sources([str(listed)])
    assert [i.source_name for i in items] == ["b.obj", "deep/d.PLY", "missing.obj"]
    assert items[0].path == tree / "b.obj"


def test_a_table_brings_licences_and_categories(tree):
    listed = tree / "list.csv"
    listed.write_text("File,License,category,author,other\nb.obj,MIT,toy,Ada,x\na.STL,,,,\n")
    b, a = resolve_sources([str(listed)])
    assert (b.licence, b.category, b.author, b.source) == ("MIT", "toy", "Ada", "unknown")
    assert (a.licence, a.category) == ("unknown", "unknown")


@pytest.mark.parametrize("place", [".", ".."])
def test_an_index_in_or_beside_a_folder_describes_its_files(tree, place):
    (tree / place / "INDEX.csv").write_text("file,licence\nb.obj,CC0-1.0\ndeep/d.PLY,MIT\n")
    licences = {i.source_name: i.licence for i in resolve_sources([str(tree)])}
    assert licences["b.obj"] == "CC0-1.0"
    assert licences["deep/d.PLY"] == "MIT"
    assert licences["a.STL"] == "unknown"
    assert resolve_sources([str(tree / "b.obj")])[0].licence == "CC0-1.0"


@pytest.mark.parametrize(
    "spoilt",
    [
        b"name,licence\nb.obj,MIT\n",
        b"\xff\xfe",
        b"file,licence\nb.obj," + b"x" * 140_000,
        b"file,licence\nb.obj,MIT\n" + b"#" * 1000,
        "link",
        "loop",
    ],
)
def test_an_index_that_cannot_be_used_is_one_warning(tree, spoilt, caplog, monkeypatch):
    monkeypatch.setattr(
        "bidexdata.objects.sources.lists._MOST", 200_000 if len(spoilt) > 9999 else 500
    )
    path = tree / "INDEX.csv"
    if isinstance(spoilt, bytes):
        path.write_bytes(spoilt)
    else:
        (tree.parent / "secret").write_text("file,licence\nb.obj,secret\n")
        path.symlink_to(tree.parent / "secret" if spoilt == "link" else path)
    for source in (tree, f"{tree}/*.obj"):
        caplog.clear()
        assert {i.licence for i in resolve_sources([str(source)])} == {"unknown"}
        (warning,) = caplog.records
        assert "INDEX.csv: not used" in warning.getMessage()


def test_a_list_beside_many_folders_is_read_once(tree, monkeypatch):
    read = []

    def counted(folder):
        read.append(folder)
        return {}

    for k in range(5):
        (tree / f"{k}").mkdir()
        (tree / f"{k}" / "a.obj").touch()
    (tree / "INDEX.csv").touch()
    monkeypatch.setattr("bidexdata.objects.sources.files.side_list", counted)
    assert len(names(f"{tree}/[0-9]/*.obj")) == 5
    assert read == [tree]


def test_what_does_not_exist_is_named(tree):
    for source in (tree / "no.obj", f"{tree}/*.dae", tree / "nowhere"):
        with pytest.raises(PathNotFound, match=re.escape(str(source))):
            names(source)
    (tree / "empty").mkdir()
    with pytest.raises(PathNotFound, match="mesh files"):
        names(tree / "empty")


def test_bad_lists_are_named(tree):
    for text in ("name\nb.obj\n", ""):
        (tree / "bad.csv").write_text(text)
        with pytest.raises(NotUsable, match="file"):
            names(tree / "bad.csv")
    (tree / "bad.csv").write_text(f"file\n{'x' * 140_000}\n")
    with pytest.raises(NotUsable, match="not a table"):
        names(tree / "bad.csv")
    (tree / "bad.txt").write_bytes("b.obj".encode("utf-16"))
    with pytest.raises(NotUsable, match="UTF-8"):
        names(tree / "bad.txt")


def test_unknown_prefixes_and_families_list_the_known():
    with pytest.raises(UnknownName, match="shapes"):
        names("shape:box")
    with pytest.raises(UnknownName, match="bottle"):
        names("shapes:botle")
    with pytest.raises(NotUsable, match="COUNT"):
        names("shapes:box/0")


def test_shapes_are_one_per_family_or_the_first_of_one():
    assert names("shapes") == [f"shapes:{family}/0" for family in shape_families()]
    assert names("shapes:box/3,cone") == [
        *("shapes:box/0", "shapes:box/1", "shapes:box/2", "shapes:cone/0")
    ]


def test_numbered_shapes_differ_and_are_the_same_every_time():
    recipes = [shape_bytes(f"box/{k}") for k in range(6)]
    assert len(set(recipes)) == 6
    # The stored text: print(shape_bytes("box/3")) on Linux, numpy 2.4; a library made elsewhere or
    # later must give the shape the same identity.
    stored = b'{"family":"box","lengths":{"height":0.1532,"length":0.2226,"width":0.161}}'
    assert recipes[3] == stored
    assert shape_mesh("mug/2").vertices.tobytes() == shape_mesh("mug/2").vertices.tobytes()


@pytest.mark.parametrize(
    ("name", "slug"),
    [
        ("Tea Pot (1).OBJ", "tea-pot-1"),
        ("ねこ.stl", "object"),
        ("002_master_chef_can/google_16k/nontextured.ply", "002_master_chef_can"),
        ("duck/model.obj", "duck"),
        ("x" * 200 + ".stl", "x" * 48),
        ("a/b/c.glb", "c"),
        ("model.obj", "model"),
        ("../model.obj", "model"),
        ("/meshes/model.obj", "model"),
    ],
)
def test_object_ids_are_slugs_of_telling_names_and_a_hash_wherever_the_file_lies(name, slug):
    for place in ("/data", "/home/someone/private"):
        item = SourceItem(source_name=name, path=Path(place) / name)
        made = object_id_of(item, "277089d9" + 56 * "0")
        assert re.fullmatch(r"[a-z0-9_-]{1,48}-[0-9a-f]{8}", made)
        assert made == f"{slug}-277089d9"


def test_prepare_object_names_a_missing_file(tmp_path):
    with pytest.raises(PathNotFound):
        prepare_object(tmp_path / "no.obj")
    with pytest.raises(UnknownName):
        prepare_object("shapes:banana")


def test_absolute_paths_of_a_list_do_not_name_the_folders_of_the_machine(tmp_path):
    from bidexdata.objects.sources.lists import list_items

    here, other = tmp_path / "here", tmp_path / "home" / "me"
    here.mkdir()
    files = [f"{other}/a/x.obj", f"{other}/b/x.obj", f"{here}/c/y.obj", "z.obj"]
    (here / "list.txt").write_text("\n".join(files))
    items = list_items(here / "list.txt")
    assert [item.source_name for item in items] == ["a/x.obj", "b/x.obj", "c/y.obj", "z.obj"]
    assert [str(item.path) for item in items[:3]] == files[:3]
    (here / "one.txt").write_text(files[0])
    assert [item.source_name for item in list_items(here / "one.txt")] == ["x.obj"]
