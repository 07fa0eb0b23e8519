"""Objects of Objaverse from a download cache that the test makes; no network is touched.

With the package `objaverse` installed its own functions read the cache, otherwise stand-ins of the
same names and results do.
"""

from __future__ import annotations

import gzip
import json
import socket
import sys
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from urllib.error import HTTPError, URLError

import pytest

from bidexdata.errors import BadValue, MissingExtra, NotUsable, PathNotFound, UnknownName
from bidexdata.objects.library import Library
from bidexdata.objects.prepare import prepare_object
from bidexdata.objects.sources import fetched, resolve_sources
from bidexdata.runs.prepare import prepare_library

UIDS = [f"{k:x}" * 32 for k in (7, 2, 11, 5, 13, 3)]
LVIS = {"mug": UIDS[:2], "Christmas_tree": UIDS[1:5]}
ANNOTATIONS = {
    UIDS[0]: {
        "license": "by",
        "viewerUrl": f"https://sketchfab.com/3d-models/{UIDS[0]}",
        "user": {"username": "ada", "displayName": "Ada L."},
        "categories": [{"name": "food-drink"}],
    },
    UIDS[1]: {"license": "by-nc-sa", "user": {"username": "bob"}, "categories": []},
    UIDS[2]: {"license": "cc0", "user": {}, "categories": [{"name": "nature-plants"}]},
    UIDS[3]: {"license": None},
}


def write_gz(path: Path, content) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(gzip.compress(json.dumps(content).encode()))


def write_glb(path: Path, number: int) -> None:
    import trimesh

    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(
        trimesh.Scene(trimesh.creation.box((1, 1 + number, 2))).export(file_type="glb")
    )


def path_of(uid: str) -> str:
    return f"glbs/000-00{int(uid[0], 16) % 2}/{uid}.glb"


def stand_in() -> ModuleType:
    """The four functions of the package, for a cache that holds everything asked of it."""
    package = ModuleType("objaverse")

    def read(name: str):
        try:
            return json.loads(gzip.decompress((Path(package._VERSIONED_PATH) / name).read_bytes()))
        except FileNotFoundError as err:
            raise URLError("no network in tests") from err

    def load_objects(uids):
        known = read("object-paths.json.gz")
        found = {u: f"{package._VERSIONED_PATH}/{known[u]}" for u in uids if u in known}
        if not all(Path(p).is_file() for p in found.values()):
            raise URLError("no network in tests")
        return found

    def load_annotations(uids):
        folders = {Path(read("object-paths.json.gz")[u]).parent.name for u in uids}
        return {
            u: a
            for folder in folders
            for u, a in read(f"metadata/{folder}.json.gz").items()
            if u in uids
        }

    package.load_uids = lambda: list(read("object-paths.json.gz"))
    package.load_lvis_annotations = lambda: read("lvis-annotations.json.gz")
    package.load_objects, package.load_annotations = load_objects, load_annotations
    return package


@pytest.fixture
def package(monkeypatch) -> ModuleType:
    try:
        import objaverse
    except ImportError:
        objaverse = stand_in()
        monkeypatch.setitem(sys.modules, "objaverse", objaverse)
    return objaverse


@pytest.fixture
def cache(tmp_path: Path, package, monkeypatch) -> Path:
    """A whole cache, and a machine without network."""
    folder = tmp_path / "hf-objaverse-v1"
    write_gz(folder / "object-paths.json.gz", {uid: path_of(uid) for uid in UIDS})
    write_gz(folder / "lvis-annotations.json.gz", LVIS)
    for part in ("000-000", "000-001"):
        own = {u: a for u, a in ANNOTATIONS.items() if part in path_of(u)}
        write_gz(folder / "metadata" / f"{part}.json.gz", own)
    for k, uid in enumerate(UIDS):
        write_glb(folder / path_of(uid), k)
    monkeypatch.setattr(package, "_VERSIONED_PATH", str(folder), raising=False)

    def refuse(*_args, **_options):
        raise OSError("no network in tests")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(socket, "getaddrinfo", refuse)
    return folder


def uids(*sources: str) -> list[str]:
    return [item.uid for item in resolve_sources(sources)]


def test_a_list_keeps_its_order_and_names_each_object_once(cache, tmp_path):
    listed = tmp_path / "uids.txt"
    listed.write_text(f"# mine\n{UIDS[3]}\nglbs/000-000/{UIDS[0]}.glb # a mug\n{UIDS[3]}\n")
    assert uids(f"objaverse:uids={listed}") == [UIDS[3], UIDS[0]]
    assert uids(f"objaverse:uids={listed}", "objaverse:lvis=mug") == [UIDS[3], UIDS[0], UIDS[1]]


def test_a_category_comes_in_byte_order(cache):
    assert uids("objaverse:lvis=mug") == sorted(LVIS["mug"])
    assert uids("objaverse:lvis=Christmas_tree") == sorted(LVIS["Christmas_tree"])


def test_the_seed_alone_decides_a_random_choice(cache):
    choices = {seed: uids(f"objaverse:random=3,seed={seed}") for seed in range(20)}
    assert all(len(set(c)) == 3 and c == sorted(c) for c in choices.values())
    assert len({tuple(c) for c in choices.values()}) > 5
    assert choices[0] == uids("objaverse:random=3")
    # The order in which the collection names its objects changes nothing.
    write_gz(cache / "object-paths.json.gz", {uid: path_of(uid) for uid in reversed(UIDS)})
    assert choices == {seed: uids(f"objaverse:random=3,seed={seed}") for seed in choices}
    for seed in range(5):
        grown = [set(uids(f"objaverse:random={n},seed={seed}")) for n in range(1, 9)]
        assert all(a <= b for a, b in pairwise(grown))
        assert grown[-1] == set(UIDS)
    some = uids("objaverse:lvis=Christmas_tree,random=2,seed=4")
    assert len(some) == 2
    assert set(some) <= set(LVIS["Christmas_tree"])


def test_licence_and_author_of_each_object_reach_the_index(cache, tmp_path, small, capsys):
    listed = tmp_path / "uids.txt"
    listed.write_text("\n".join([*UIDS[:5], "f" * 32]))
    out = tmp_path / "lib"
    options = {"executor": "inline", "quiet": True}
    report = prepare_library([f"objaverse:uids={listed}"], out, small, **options)
    rows = Library.open(out).index.to_pylist()
    assert [r["source_name"] for r in rows] == [f"objaverse:{u}" for u in [*UIDS[:5], "f" * 32]]
    assert [r["licence"] for r in rows] == [
        *("CC-BY-4.0", "CC-BY-NC-SA-4.0", "CC0-1.0", "unknown", "unknown", "unknown")
    ]
    assert [r["author"] for r in rows[:4]] == ["Ada L.", "bob", "unknown", "unknown"]
    assert [r["category"] for r in rows[:3]] == ["food-drink", "unknown", "nature-plants"]
    assert rows[0]["source"] == f"https://sketchfab.com/3d-models/{UIDS[0]}"
    assert rows[1]["source"] == "Objaverse 1.0"
    assert all(r["object_id"].startswith(r["source_name"][10:]) for r in rows[:5])
    assert report.by_status == {"ok": 5, "unreadable": 1}
    assert "no such object" in rows[5]["reason"]
    assert capsys.readouterr().out == ""
    again = prepare_library([f"objaverse:uids={listed}"], out, small, **options)
    assert (again.resumed, again.fingerprint) == (5, report.fingerprint)


def test_the_category_asked_for_is_the_objects_category(cache):
    items = fetched(resolve_sources(["objaverse:lvis=mug"]))
    assert {i.category for i in items} == {"mug"}
    assert all(i.path and i.path.is_file() for i in items)


def test_real_files_in_the_cache_are_prepared(cache, tmp_path, small, shared):
    for uid, name in zip(LVIS["mug"], ("duck", "kaykit_bottle"), strict=True):
        (cache / path_of(uid)).write_bytes((shared / f"objects/train/{name}.glb").read_bytes())
    options = {"executor": "inline", "quiet": True}
    report = prepare_library(["objaverse:lvis=mug"], tmp_path / "lib", small, **options)
    assert (report.prepared, report.hulls) == (2, 0)
    assert {r["licence"] for r in report.rows} == {"CC-BY-4.0", "CC-BY-NC-SA-4.0"}


def test_an_item_without_its_file_says_what_to_call(cache, tmp_path, small):
    listed = tmp_path / "uids.txt"
    listed.write_text(UIDS[0])
    (item,) = resolve_sources([f"objaverse:uids={listed}"])
    with pytest.raises(NotUsable, match="fetched"):
        prepare_object(item, small)
    assert prepare_object(*fetched([item]), small).volume > 0


def test_only_what_the_limit_leaves_is_fetched(cache, tmp_path, small):
    for uid in UIDS:
        if uid != sorted(UIDS)[0]:
            (cache / path_of(uid)).unlink()
    options = {"executor": "inline", "quiet": True, "dry_run": True}
    report = prepare_library(["objaverse:random=6"], tmp_path / "l", small, limit=1, **options)
    assert [r["source_name"] for r in report.rows] == [f"objaverse:{sorted(UIDS)[0]}"]
    with pytest.raises(NotUsable, match="no network in tests") as caught:
        prepare_library(["objaverse:random=6"], tmp_path / "l", small, **options)
    assert caught.value.exit_code == 3


@pytest.mark.parametrize("name", ["object-paths.json.gz", "lvis-annotations.json.gz"])
def test_an_index_that_is_not_there_is_one_sentence(cache, name):
    (cache / name).unlink()
    source = "objaverse:lvis=mug" if "lvis" in name else "objaverse:random=2"
    with pytest.raises(NotUsable, match="cannot be read from the download cache") as caught:
        resolve_sources([source])
    assert "\n" not in str(caught.value)


def test_a_damaged_index_is_one_sentence(cache):
    path = cache / "object-paths.json.gz"
    data = bytearray(path.read_bytes())
    data[10] ^= 0xFF  # the first byte after the header of gzip
    path.write_bytes(data)
    with pytest.raises(NotUsable, match="cannot be read from the download cache"):
        resolve_sources(["objaverse:random=2"])


def test_a_file_that_the_server_refuses_costs_that_object_alone(cache, package, monkeypatch):
    whole = package.load_objects

    def load_objects(wanted):
        if UIDS[0] in wanted:
            raise HTTPError("https://example.org", 404, "Not Found", {}, None)  # type: ignore
        return whole(wanted)

    monkeypatch.setattr(package, "load_objects", load_objects)
    items = {i.uid: i for i in fetched(resolve_sources(["objaverse:lvis=mug"]))}
    assert items[UIDS[0]].problem == "it cannot be downloaded: HTTP 404 Not Found"
    assert items[UIDS[1]].path is not None


def test_names_that_do_not_exist_are_named(cache, tmp_path):
    with pytest.raises(UnknownName, match="did you mean 'mug'") as caught:
        resolve_sources(["objaverse:lvis=mugs"])
    assert caught.value.exit_code == 3
    with pytest.raises(PathNotFound, match=r"no\.txt"):
        resolve_sources([f"objaverse:uids={tmp_path / 'no.txt'}"])
    (tmp_path / "empty.txt").write_text("# nothing\n")
    with pytest.raises(NotUsable, match="names no Objaverse uid"):
        resolve_sources([f"objaverse:uids={tmp_path / 'empty.txt'}"])


@pytest.mark.parametrize(
    "request_",
    [
        *("", "mug", "lvis=", "random=0", "random=many", "random=3,seed=-1", "seed=3"),
        *("uids=a.txt,random=3", "lvis=mug,lvis=bowl", "colour=red"),
    ],
)
def test_malformed_requests_show_the_form(request_):
    with pytest.raises(BadValue, match="random") as caught:
        resolve_sources([f"objaverse:{request_}"])
    assert caught.value.exit_code == 2


def test_without_the_package_its_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "objaverse", None)
    with pytest.raises(MissingExtra, match=r"pip install 'bidexdata\[objaverse\]'") as caught:
        resolve_sources(["objaverse:lvis=mug"])
    assert caught.value.exit_code == 3
