"""Objects of other projects whose convex pieces are kept: DexGraspNet and BODex trees."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from made_dexgraspbench import BOX_FACES, box, write_obj

from bidexdata.errors import BidexError, NotUsable, PathNotFound
from bidexdata.objects.closed import as_manifold, union
from bidexdata.objects.config import PrepareConfig
from bidexdata.objects.given import file_groups
from bidexdata.objects.library import Library
from bidexdata.objects.physics import mass_properties
from bidexdata.objects.prepare import prepare_object
from bidexdata.objects.prepared import PreparedObject, TriangleMesh
from bidexdata.objects.sources import resolve_sources
from bidexdata.runs.prepare import prepare_library
from bidexdata.runs.prepare_report import PrepareReport

FACES = np.array(BOX_FACES, np.int32) - 1
# Two boxes of 0.16 and 0.288 that overlap in 0.2 x 0.4 x 0.4.
TWO = [box((0.4, 0.0, 0.1), (0.5, 0.2, 0.2)), box((-0.3, 0.0, 0.1), (0.4, 0.3, 0.3))]
UNION = 0.16 + 0.288 - 0.032
ONE = [box((0.0, 0.0, 0.0), (0.6, 0.4, 0.5))]


def write_groups(path: Path, groups: list[np.ndarray]) -> None:
    """Boxes as `o` groups of one OBJ, as CoACD writes them."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = ["mtllib none.mtl"]
    for k, corners in enumerate(groups):
        lines += [f"o convex_{k}", *(f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in corners)]
        lines += [f"f {a + 8 * k} {b + 8 * k}/1 {c + 8 * k}//1" for a, b, c in BOX_FACES]
    path.write_text("\n".join(lines) + "\n")


def write_dexgraspnet(root: Path) -> Path:
    for name, groups in {
        "sem-Camera-7bff4fd4dc53de7496dece3f86cb5dd5": ONE,
        "core-mug-8570d9a8d24cb0acbebd3c0c0c70fb03": TWO,
        "mujoco-Schleich_Lion": [ONE[0] * 0.9],
    }.items():
        write_groups(root / name / "coacd" / "decomposed.obj", groups)
        write_obj(root / name / "coacd" / "coacd_convex_piece_0.obj", groups[0])
    (root / "core-lost" / "coacd").mkdir(parents=True)
    return root


def write_bodex(root: Path) -> Path:
    for name, groups in {"sem_ToyFigure_a3087c9105fe0878d1": TWO, "brick": ONE}.items():
        for k, corners in enumerate(groups):
            write_obj(root / name / "urdf" / "meshes" / f"convex_piece_{k:03d}.obj", corners)
        write_obj(root / name / "mesh" / "simplified.obj", groups[0])
        write_obj(root / name / "mesh" / "normalized.obj", groups[0])
    write_obj(root / "empty" / "mesh" / "simplified.obj", ONE[0])
    return root


TREES = {"dexgraspnet": write_dexgraspnet, "bodex": write_bodex}
TWO_BOXES = {"dexgraspnet": "core-mug", "bodex": "sem_Toy"}


def run(source: str, out: Path, config: PrepareConfig, **options) -> PrepareReport:
    return prepare_library([source], out, config, executor="inline", quiet=True, **options)


def in_file(obj: PreparedObject, points: np.ndarray) -> np.ndarray:
    known = obj.provenance
    return np.array(known["origin_in_file"]) + known["unit_in_file"] * points


def volume_of_union(pieces) -> float:
    return union([m for m in map(as_manifold, pieces) if m is not None]).volume()


def assert_convex(piece: TriangleMesh, tolerance: float) -> None:
    """Every vertex lies behind the plane of every face."""
    a, b, c = (piece.vertices[piece.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    height = np.einsum("fi,fvi->fv", normal, piece.vertices[None] - a[:, None])
    assert height.max() <= tolerance


@pytest.mark.parametrize("project", TREES)
def test_every_object_of_a_tree_is_one_row_of_the_index(tmp_path, small, project):
    tree = TREES[project](tmp_path / "tree")
    report = run(f"{project}:{tree}", tmp_path / "lib", small)
    assert [r["source_name"] for r in report.rows] == sorted(p.name for p in tree.iterdir())
    index = Library.open(tmp_path / "lib").index.to_pylist()
    assert [r["source_name"] for r in index] == [r["source_name"] for r in report.rows]
    bad = [r for r in index if r["status_label"] != "ok"]
    assert [r["source_name"] for r in bad] == ["core-lost" if "dex" in project[:3] else "empty"]
    assert all(r["reason"] for r in bad)
    good = [r for r in index if r["status_label"] == "ok"]
    assert {r["piece_method"] for r in good} == {"given"}
    assert {r["licence"] for r in good} == {"unknown"}
    again = run(f"{project}:{tree}", tmp_path / "lib", small)
    assert (again.resumed, again.fingerprint) == (len(good), report.fingerprint)


@pytest.mark.parametrize("project", TREES)
def test_pieces_are_kept_and_the_normalisation_undone_gives_the_file(tmp_path, small, project):
    tree = TREES[project](tmp_path / "tree")
    items = resolve_sources([f"{project}:{tree}"])
    item = next(i for i in items if i.source_name.startswith(TWO_BOXES[project]))
    obj = prepare_object(item, small)
    assert len(obj.pieces) == 2
    for piece, corners in zip(obj.pieces, TWO, strict=True):
        assert_convex(piece, 1e-6)
        found, wanted = in_file(obj, piece.vertices), np.array(corners)
        away = np.linalg.norm(found[:, None] - wanted[None], axis=2)
        assert away.min(axis=0).max() < 1e-6
        assert away.min(axis=1).max() < 1e-6
    assert obj.volume * obj.provenance["unit_in_file"] ** 3 == pytest.approx(UNION, rel=1e-5)
    assert volume_of_union(obj.pieces) == pytest.approx(obj.volume, rel=1e-5)
    # Not the sum over pieces, which counts the overlap twice: that is what an import makes.
    summed = sum(mass_properties(p).volume for p in obj.pieces)
    assert summed * obj.provenance["unit_in_file"] ** 3 == pytest.approx(0.448, rel=1e-5)
    farthest = np.linalg.norm(np.concatenate(TWO), axis=1).max()
    assert obj.provenance["source_radius"] == pytest.approx(farthest)
    words = {"dexgraspnet": "unit sphere", "bodex": "box diagonal 2"}
    assert obj.provenance["source_normalisation"] == words[project]


def test_a_name_tells_collection_and_category_and_an_index_more(tmp_path):
    tree = write_dexgraspnet(tmp_path / "tree")
    told = {
        i.source_name.split("-")[0]: (i.source, i.category)
        for i in resolve_sources([f"dexgraspnet:{tree}"])
        if i.source_name != "core-lost"
    }
    assert told == {
        "core": ("ShapeNetCore", "mug"),
        "mujoco": ("Google Scanned Objects", "unknown"),
        "sem": ("ShapeNetSem", "camera"),
    }
    (tmp_path / "INDEX.csv").write_text(
        "file,licence,author,category\nmujoco-Schleich_Lion,CC-BY-4.0,Google,lion\n"
    )
    lion = next(i for i in resolve_sources([f"dexgraspnet:{tree}"]) if "Lion" in i.source_name)
    known = (lion.source, lion.licence, lion.author, lion.category)
    assert known == ("Google Scanned Objects", "CC-BY-4.0", "Google", "lion")
    toy = resolve_sources([f"bodex:{write_bodex(tmp_path / 'bodex')}"])[-1]
    assert (toy.source, toy.category) == ("ShapeNetSem", "toyfigure")


def test_objects_are_found_at_any_depth_and_a_tree_may_be_one_object(tmp_path):
    tree = write_bodex(tmp_path / "assets" / "processed_data")
    deep = resolve_sources([f"bodex:{tmp_path / 'assets'}"])
    assert [i.source_name for i in deep] == [
        f"processed_data/{n}" for n in sorted(p.name for p in tree.iterdir())
    ]
    [brick] = resolve_sources([f"bodex:{tree / 'brick'}"])
    assert brick.source_name == "brick"
    assert len(resolve_sources([f"bodex:{tmp_path / 'assets'}", f"bodex:{tree}"])) == len(deep)


def test_the_same_file_without_its_pieces_has_another_identity(tmp_path, small):
    tree = write_dexgraspnet(tmp_path / "tree")
    kept = run(f"dexgraspnet:{tree}", tmp_path / "lib", small, limit=3, dry_run=True)
    plain = run(str(tree / "**" / "decomposed.obj"), tmp_path / "lib", small, dry_run=True)
    ids = [{r["object_id"] for r in report.rows if r.get("object_id")} for report in (kept, plain)]
    assert len(ids[0]) == 2
    assert not ids[0] & ids[1]


def test_a_tree_is_not_lost_where_its_files_are_named_as_meshes_too(tmp_path):
    root = write_dexgraspnet(tmp_path / "tree")
    both = resolve_sources([str(root), f"dexgraspnet:{root}", f"dexgraspnet:{root}"])
    trees = [item for item in both if item.pieces]
    assert len(trees) == 4
    assert len(both) == 4 + len(resolve_sources([str(root)]))
    assert trees == resolve_sources([f"dexgraspnet:{root}"])


def test_a_file_that_a_tree_lacks_is_named(tmp_path, small):
    root = write_dexgraspnet(tmp_path / "tree")
    rows = run(f"dexgraspnet:{root}", tmp_path / "lib", small).rows
    (lost,) = [r for r in rows if r["status_label"] == "no_file"]
    assert lost["reason"] == "there is no such file: coacd/decomposed.obj"


def test_a_group_that_is_not_convex_is_decomposed_anew(tmp_path, small):
    path = tmp_path / "tree" / "ell" / "coacd" / "decomposed.obj"
    write_groups(path, [box((1, 0, 0), (1.0, 0.2, 0.2)), box((0, 1, 0), (0.2, 1.2, 0.2))])
    path.write_text(path.read_text().replace("o convex_1\n", ""))
    [item] = resolve_sources([f"dexgraspnet:{tmp_path / 'tree'}"])
    obj = prepare_object(item, small)
    assert len(obj.pieces) >= 2
    assert obj.provenance["piece_method"].startswith("coacd")
    assert "1 of 1 given pieces are not convex: decomposed anew" in obj.provenance["warnings"]


def test_flat_pieces_are_left_out_and_named(tmp_path, small):
    write_groups(tmp_path / "a" / "coacd" / "decomposed.obj", [*ONE, ONE[0] * [1, 1, 0]])
    [item] = resolve_sources([f"dexgraspnet:{tmp_path}"])
    obj = prepare_object(item, small)
    assert len(obj.pieces) == 1
    assert obj.provenance["warnings"][0] == "1 of 2 given pieces are flat: left out"


def test_bad_files_of_pieces_are_rows_with_a_reason(tmp_path, small):
    texts = {"a_text": "no mesh", "b_index": "o a\nv 0 0 0\nf 1 2 3\no b\nf 1 1 1\n", "c_word": ""}
    for name, text in texts.items():
        path = tmp_path / "tree" / name / "coacd" / "decomposed.obj"
        write_groups(path, TWO)
        path.write_text(text or path.read_text().replace("f 9 ", "f 9x "))
    report = run(f"dexgraspnet:{tmp_path / 'tree'}", tmp_path / "lib", small)
    assert report.prepared == 0
    assert all(r["status_label"] in ("no_faces", "unreadable") for r in report.rows), report.rows


@pytest.mark.parametrize("project", TREES)
def test_places_that_cannot_be_used_are_one_sentence(tmp_path, project):
    with pytest.raises(PathNotFound, match="nowhere") as missing:
        resolve_sources([f"{project}:{tmp_path / 'nowhere'}"])
    (tmp_path / "x.obj").touch()
    with pytest.raises(NotUsable, match="no object is in it") as empty:
        resolve_sources([f"{project}:{tmp_path}"])
    with pytest.raises(BidexError, match=f"write {project}:PATH") as blank:
        resolve_sources([f"{project}:"])
    codes = [caught.value.exit_code for caught in (missing, empty, blank)]
    assert codes == [3, 3, 2]
    assert all("\n" not in str(caught.value) for caught in (missing, empty, blank))


@pytest.mark.slow
def test_pieces_of_real_trees_are_kept(shared, small):
    counts = {
        "core-mug-8570d9a8d24cb0acbebd3c0c0c70fb03": 27,
        "ddg-gd_banana_poisson_002": 4,
        "sem-Camera-7bff4fd4dc53de7496dece3f86cb5dd5": 5,
        "Curver_Storage_Bin_Black_Small": 16,
        "core_can_be67418a10003cc9eae3efbc9dbeea": 20,
        "sem_ToyFigure_a3087c9105fe0878d18a6b3b9816ca14": 2,
    }
    peers = shared / "peers"
    trees = [f"dexgraspnet:{peers / n / 'objects'}" for n in ("dexgraspnet", "bimangrasp")]
    items = resolve_sources([*trees, f"bodex:{peers / 'dexgraspbench' / 'objects'}"])
    assert {i.source_name for i in items} == counts.keys()
    for item in items:
        groups = [g for path in item.pieces for g in file_groups(path, small.load)]
        obj = prepare_object(item, small)
        assert len(obj.pieces) == len(groups) == counts[item.source_name]
        for piece in obj.pieces:
            assert_convex(piece, 1e-6)
        known = volume_of_union(groups)
        assert obj.volume * obj.provenance["unit_in_file"] ** 3 == pytest.approx(known, rel=1e-4)
