"""Laws of an import: a bad file is counted and no more, the same files give the same bytes."""

from __future__ import annotations

import csv
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_dexgraspbench import NOMINAL, OBJECTS, PER_SCENE, SCALES, made_dexgraspbench, save

from bidexdata.errors import ConfigConflict, Contradiction, NotUsable, PathNotFound, UnknownName
from bidexdata.formats.release import Release
from bidexdata.formats.verify import verify_release
from bidexdata.objects.library import Library
from bidexdata.objects.library_page import NOT_IMPORTED
from bidexdata.runs import import_objects, import_reader, import_scan
from bidexdata.runs.browse import open_browsable
from bidexdata.runs.import_ import ImportRequest, import_run
from bidexdata.runs.import_scan import read_files
from bidexdata.runs.info import describe
from bidexdata.runs.pack import pack_runs
from bidexdata.runs.render import render
from bidexdata.runs.resimulate import resimulate
from bidexdata.runs.retest import start_retest
from bidexdata.runs.run import Run
from bidexdata.runs.stage import TaskExecution

HERE = TaskExecution(executor="inline", quiet=True)
N = len(OBJECTS) * len(SCALES) * PER_SCENE


def request(path: Path, **changes) -> ImportRequest:
    return replace(ImportRequest(format="dexgraspbench", path=path, hand="capsule"), **changes)


@pytest.fixture(scope="module", autouse=True)
def coarse():
    """Objects are made with few points and cells: these tests are about what surrounds them."""
    from bidexdata.objects.config import PrepareConfig, RestConfig, SdfConfig, SurfaceConfig

    small = PrepareConfig(
        surface=SurfaceConfig(points=100), sdf=SdfConfig(cells=12), rest=RestConfig(drops=24)
    )
    patch = pytest.MonkeyPatch()
    patch.setattr(import_objects, "PrepareConfig", lambda: small)
    yield
    patch.undo()


@pytest.fixture(scope="module")
def bench(tmp_path_factory) -> Path:
    root = made_dexgraspbench(tmp_path_factory.mktemp("bench"))
    rows = "".join(f"{name},CC BY-NC 4.0\n" for name in OBJECTS)
    (root / "objects" / "INDEX.csv").write_text(f"file,licence\n{rows}")
    return root


@pytest.fixture(scope="module")
def imported(bench, tmp_path_factory) -> Path:
    """An imported run; read only."""
    out = tmp_path_factory.mktemp("import") / "run"
    import_run(request(bench), out, execution=HERE)
    return out


@pytest.fixture
def copied(bench, tmp_path) -> Path:
    return Path(shutil.copytree(bench, tmp_path / "bench"))


def contents(root: Path) -> dict[str, bytes]:
    files = (p for p in root.rglob("*") if p.is_file() and "logs" not in p.parts)
    return {p.relative_to(root).as_posix(): p.read_bytes() for p in files}


def test_a_run_with_its_own_library_comes_out(bench, imported):
    run = Run.open(imported)
    assert run.spec.kind == "import"
    assert len(run.tasks) == len(OBJECTS)
    batches = list(run.batches())
    assert sum(map(len, batches)) == N
    assert len(set(np.concatenate([b["grasp_id"] for b in batches]).tolist())) == N
    refs = [r for b in batches for r in b["source_ref"].tolist()]
    assert sorted(refs) == sorted(f"{p.relative_to(bench)}" for p in bench.rglob("*.npy"))
    library = Library.open(imported / "library")
    assert set(library.object_ids) == set(run.object_ids)
    assert library.path.resolve() == run.library.path.resolve()
    for task, batch in zip(run.tasks, batches, strict=True):
        obj = library.load(task.object_id)
        unit = obj.provenance["unit_in_file"]
        assert obj.nominal_volume == pytest.approx(NOMINAL / unit**3)
        expected = np.repeat(np.float32(np.array(SCALES) * unit), PER_SCENE)
        np.testing.assert_array_equal(np.sort(batch["size"]), expected)
        assert set(batch["scene_id"].tolist()) == set(task.scene_ids)
        assert set(batch["size_mm"].tolist()) <= set(run.spec.sizes_mm)


def test_an_imported_library_lacks_what_its_page_says(imported):
    rows = Library.open(imported / "library").index.to_pylist()
    for row in rows:
        assert {name for name, value in row.items() if value is None} == set(NOT_IMPORTED)
    names = {p.name for p in (imported / "library").rglob("*")}
    assert not names & {"report.html", ".times", "thumbnail.png"}
    for object_id in Library.open(imported / "library").object_ids:
        known = Library.open(imported / "library").load_solid(object_id).provenance
        assert not set(known) & set(NOT_IMPORTED)


def test_the_same_files_give_the_same_bytes_wherever_they_lie(bench, imported, tmp_path):
    moved = shutil.copytree(bench, tmp_path / "elsewhere")
    import_run(request(moved), tmp_path / "again", execution=HERE)
    assert contents(tmp_path / "again") == contents(imported)


def test_worker_processes_give_the_same_bytes(bench, tmp_path, monkeypatch):
    from bidexdata.objects.config import PrepareConfig

    # Workers are fresh processes, which know nothing of the coarse configuration.
    monkeypatch.setattr(import_objects, "PrepareConfig", PrepareConfig)
    import_run(request(bench, limit=1), tmp_path / "here", execution=HERE)
    workers = TaskExecution(workers=1, quiet=True)
    import_run(request(bench, limit=1), tmp_path / "there", execution=workers)
    assert contents(tmp_path / "there") == contents(tmp_path / "here")


def test_the_same_command_does_nothing_twice_and_finishes_what_was_stopped(copied, tmp_path):
    out = tmp_path / "run"
    first = import_run(request(copied), out, execution=HERE)
    before = contents(out)
    again = import_run(request(copied), out, execution=HERE)
    assert (again.stage.before, again.stage.finished) == (2, 0)
    assert again.fingerprint == first.fingerprint
    # Stopped in the last pass: a shard is missing. Stopped before: no run.json, half a library.
    shard = next((out / "import").rglob("*.arrow"))
    shard.unlink()
    assert import_run(request(copied), out, execution=HERE).stage.finished == 1
    assert contents(out) == before
    (out / "run.json").unlink()
    (out / "library" / "index.parquet").unlink()
    shutil.rmtree(next((out / "library" / "objects").glob("*/*")))
    import_run(request(copied), out, execution=HERE)
    assert contents(out) == before


@pytest.mark.parametrize("change", ["hand", "setting", "limit", "file", "object"])
def test_another_import_into_the_same_run_is_refused(copied, tmp_path, change):
    out = tmp_path / "run"
    import_run(request(copied), out, execution=HERE)
    asked = request(copied)
    if change == "hand":
        (tmp_path / "capsule_links.yaml").write_text(_spec_text("capsule_links"))
        spec = tmp_path / "other.yaml"
        spec.write_text(_spec_text("capsule").replace("radius: 0.0078", "radius: 0.0079"))
        asked = replace(asked, hand=str(spec))
    elif change == "setting":
        asked = replace(asked, setting="tabletop")
    elif change == "limit":
        asked = replace(asked, limit=N - 1)
    elif change == "file":
        name = next(copied.rglob("*.npy"))
        content = np.load(name, allow_pickle=True).item()
        save(name, content | {"grasp_qpos": content["squeeze_qpos"]})
    else:
        piece = next(copied.rglob("convex_piece_000.obj"))
        piece.write_text(piece.read_text() + "# another\n")
    before = contents(out)
    with pytest.raises(ConfigConflict) as caught:
        import_run(asked, out, execution=HERE)
    assert caught.value.exit_code == 5
    assert contents(out) == before


def _spec_text(name: str) -> str:
    from bidexdata.hands import registry

    return (Path(registry.__file__).parent / "specs" / f"{name}.yaml").read_text()


class Payload:
    def __init__(self, mark: Path):
        self.mark = mark

    def __reduce__(self):
        return os.system, (f"touch {self.mark}",)


def test_every_kind_of_bad_file_is_counted_with_its_reason(copied, tmp_path):
    folder = copied / "graspdata" / "zz"
    content = np.load(next(copied.rglob("*.npy")), allow_pickle=True).item()
    mark = tmp_path / "ran"
    save(folder / "attack.npy", {**content, "extra": Payload(mark)})
    save(folder / "noobject.npy", {**content, "obj_path": "assets/nothing"})
    save(folder / "nan.npy", {**content, "grasp_qpos": np.full(29, np.nan)})
    (folder / "empty.npy").write_bytes(b"")
    os.mkfifo(folder / "pipe.npy")
    whole = next(copied.rglob("0.npy")).read_bytes()
    (folder / "cut.npy").write_bytes(whole[: len(whole) // 2])
    rng = np.random.default_rng(0)
    (folder / "noise.npy").write_bytes(rng.bytes(1000))
    several = {k: np.stack([v, v]) if k.endswith("qpos") else v for k, v in content.items()}
    several["squeeze_qpos"][1, 3:7] = 0
    save(folder / "half.npy", several)
    report = import_run(request(copied), tmp_path / "run", execution=HERE)
    assert not mark.exists()
    reasons = {Path(f.file).stem: f.reason for f in report.files if f.reason}
    assert "system, which no data needs" in reasons["attack"]
    assert "'assets/nothing' has no urdf/meshes" in reasons["noobject"]
    assert "grasp_qpos is not finite" in reasons["nan"]
    assert "no .npy file" in reasons["empty"]
    assert reasons["pipe"] == "it is no plain file"
    assert reasons["cut"].startswith("its pickle")
    assert "no .npy file" in reasons["noise"]
    assert "grasp 1: the quaternion of its squeeze_qpos" in reasons["half"]
    assert len(report.failed) == 7
    assert report.rows == N + 1
    assert report.left_out == 2  # one of half.npy, and that of noobject.npy
    run = Run.open(tmp_path / "run")
    assert sum(len(b) for b in run.batches()) == N + 1
    assert [f._replace(places=()) for f in report.files] == read_files(tmp_path / "run")
    told = describe(tmp_path / "run")["files"]
    assert (told["read"], told["failed"], told["left_out"]) == (N + 1, 7, 2)
    assert {Path(f["file"]).stem for f in told["failures"]} == set(reasons)


def test_a_bad_object_fails_its_files_and_no_other(copied, tmp_path):
    piece = next((copied / "objects" / "brick").rglob("convex_piece_000.obj"))
    piece.write_text("no mesh")
    report = import_run(request(copied), tmp_path / "run", execution=HERE)
    assert len(report.failed) == N // 2
    assert all("its object failed" in f.reason for f in report.failed)
    index = {
        r["source_name"]: r for r in Library.open(tmp_path / "run" / "library").index.to_pylist()
    }
    assert index["brick"]["status_label"] == "no_faces"
    assert index["Two_Boxes"]["status_label"] == "ok"
    assert len(Run.open(tmp_path / "run").tasks) == 1


def failing_once(name: str):
    """`_make_object` of a moment in which one object cannot be made, for a passing reason."""
    make = import_objects._make_object

    def work(form_name, library, source):
        if source.name == name:
            raise OSError("no space left")
        return make(form_name, library, source)

    return work


def test_an_object_that_failed_for_a_moment_does_not_break_the_run(bench, tmp_path, monkeypatch):
    out = tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr(import_objects, "_make_object", failing_once("brick"))
        first = import_run(request(bench), out, execution=HERE)
    assert len(first.failed) == N // 2
    assert all("traceback is in the logs: OSError" in f.reason for f in first.failed)
    assert any("in work" in p.read_text() for p in (out / "logs").iterdir())
    before = contents(out)
    again = import_run(request(bench), out, execution=HERE)
    assert (again.stage.before, again.stage.finished) == (1, 0)
    assert again.files == tuple(f for f in first.files)
    assert contents(out) == before
    assert len(Run.open(out).library.object_ids) == 1
    # Without its index the run still knows its objects.
    (out / "library" / "index.parquet").unlink()
    import_run(request(bench), out, execution=HERE)
    rows = {r["source_name"]: r for r in Run.open(out).library.index.to_pylist()}
    assert rows["Two_Boxes"]["status_label"] == "ok"
    assert "the run began without it" in rows["brick"]["reason"]
    other = import_run(request(bench), tmp_path / "other", execution=HERE)
    assert not other.failed


def test_a_lost_object_is_made_again_or_the_run_stays_as_it_is(bench, tmp_path, monkeypatch):
    out = tmp_path / "run"
    import_run(request(bench), out, execution=HERE)
    before = contents(out)
    folder = next((out / "library" / "objects").glob("*/brick*"))
    shutil.rmtree(folder)
    rest = contents(out)
    with monkeypatch.context() as patch:
        patch.setattr(import_objects, "_make_object", failing_once("brick"))
        with pytest.raises(NotUsable, match="the object brick of the run is damaged or gone"):
            import_run(request(bench), out, execution=HERE)
    assert contents(out) == rest
    import_run(request(bench), out, execution=HERE)
    assert contents(out) == before
    # Another configuration, of a later version say, makes another object: not for this run.
    shutil.rmtree(folder)
    made = import_objects.PrepareConfig()
    finer = replace(made, surface=replace(made.surface, points=101))
    monkeypatch.setattr(import_objects, "PrepareConfig", lambda: finer)
    with pytest.raises(Contradiction, match="not what they were"):
        import_run(request(bench), out, execution=HERE)


def test_a_later_version_leaves_the_objects_of_a_run_alone(bench, tmp_path, monkeypatch):
    out = tmp_path / "run"
    import_run(request(bench), out, execution=HERE)
    before, made = contents(out), import_objects.PrepareConfig()
    finer = replace(made, surface=replace(made.surface, points=101))
    monkeypatch.setattr(import_objects, "PrepareConfig", lambda: finer)
    import_run(request(bench), out, execution=HERE)
    assert contents(out) == before


def test_object_files_from_elsewhere_or_without_end_are_not_read(copied, tmp_path):
    secret = tmp_path / "secret.obj"
    piece = next((copied / "objects" / "brick").rglob("convex_piece_000.obj"))
    piece.rename(secret)
    piece.symlink_to(secret)
    with open(next((copied / "objects" / "Two_Boxes").rglob("*_000.obj")), "r+b") as stream:
        stream.truncate(2**33)  # a hole: nothing is written
    report = import_run(request(copied), tmp_path / "run", execution=HERE)
    reasons = {f.reason for f in report.failed}
    assert len(report.failed) == N
    assert any("is a link to outside of" in r and "--objects" in r for r in reasons)
    assert any("has 8589934592 bytes" in r for r in reasons)
    # A folder that the caller names may be anywhere.
    piece.unlink()
    secret.rename(piece)
    (copied / "objects").rename(tmp_path / "objects")
    (copied / "objects").symlink_to(tmp_path / "objects")
    through = import_run(request(copied), tmp_path / "run", execution=HERE)
    assert len(through.failed) == N
    named = request(copied, objects=tmp_path / "objects")
    assert len(import_run(named, tmp_path / "run", execution=HERE).failed) == N // 2


def test_nothing_usable_leaves_no_run(copied, tmp_path):
    for file in copied.rglob("*.npy"):
        file.write_bytes(b"x")
    report = import_run(request(copied), tmp_path / "run", execution=HERE)
    assert (report.rows, report.fingerprint, len(report.failed)) == (0, "", N)
    assert not (tmp_path / "run").exists()


VICTIM = "graspdata/Two_Boxes/scale0.1_pose000/1.npy"
_scan_chunk = import_scan._scan_chunk


def dying_chunk(form_name, root, names):
    """`_scan_chunk` in the child, for a file that ends its process."""
    if VICTIM in names:
        os._exit(7)
    return _scan_chunk(form_name, root, names)


def test_a_file_that_ends_its_reader_costs_no_other(copied, tmp_path, monkeypatch):
    # A chunk whose worker died is read again file by file.
    assert (copied / VICTIM).is_file()
    monkeypatch.setattr(import_scan, "_scan_chunk", dying_chunk)
    report = import_run(request(copied), tmp_path / "run", execution=HERE)
    assert [f.file for f in report.failed] == [VICTIM]
    assert report.failed[0].reason == "reading it failed: the worker died (exit code 7)"


def test_no_file_is_read_in_the_caller_s_process(bench, tmp_path, monkeypatch):
    def refused(*_):
        raise AssertionError("read here")

    monkeypatch.setattr(import_scan, "read_file", refused)
    assert import_run(request(bench), tmp_path / "run", execution=HERE).rows == N


def limit_in_reader(names):
    """What the operating system allows the process in which files are read."""
    import resource

    import_scan._scan_chunk("dexgraspbench", "", names)
    return os.getpid(), resource.getrlimit(resource.RLIMIT_AS)[0]


def test_the_reader_has_a_bound_on_memory():
    process, bound = import_reader.read_apart((), limit_in_reader)
    assert process != os.getpid()
    assert bound == import_scan.MEMORY_GIB * 2**30


def test_a_reading_that_was_given_up_leaves_no_answer_for_the_next():
    first = import_reader.in_child([1, 2, 3], abs)
    next(first)
    first.close()
    assert sorted(import_reader.in_child([-4, -5], abs)) == [(-5, 5), (-4, 4)]


def test_what_is_too_large_is_not_read(copied, tmp_path, monkeypatch):
    victim = next(copied.rglob("*.npy"))
    with open(victim, "r+b") as stream:
        stream.truncate(2**33)  # a hole: nothing is written
    report = import_run(request(copied), tmp_path / "run", execution=HERE)
    assert [f.file for f in report.failed] == [victim.relative_to(copied).as_posix()]
    assert "more than the 67108864 that are read" in report.failed[0].reason


def test_the_first_files_in_byte_order_are_taken(bench, tmp_path):
    report = import_run(request(bench, limit=3), tmp_path / "run", execution=HERE)
    names = sorted(p.relative_to(bench).as_posix() for p in bench.rglob("*.npy"))
    assert [f.file for f in report.files] == names[:3]


def test_what_does_not_fit_is_one_sentence(bench, tmp_path):
    for asked, error, said in (
        (request(tmp_path / "no"), PathNotFound, "no such file or folder"),
        (request(bench, objects=tmp_path / "no"), PathNotFound, "folder of the objects"),
        (request(bench / "objects"), NotUsable, "holds no file that the format"),
        (request(bench, format="graspnet"), UnknownName, "import format"),
        (request(bench, hand="capsule,capsule"), NotUsable, "holds one hand"),
        (
            request(bench, format="dexgraspnet", setting="tabletop"),
            NotUsable,
            "dexgraspnet says nothing of the object's pose in the world; use floating",
        ),
    ):
        with pytest.raises(error, match=said):
            import_run(asked, tmp_path / "run", execution=HERE)
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "main.tex").touch()
    with pytest.raises(NotUsable, match="is no run"):
        import_run(request(bench), tmp_path / "thesis", execution=HERE)


def test_an_imported_run_can_be_looked_into_packed_checked_and_tested_again(imported, tmp_path):
    source = open_browsable(imported)
    assert len(source.hands()) == 1
    told = describe(imported)
    assert told["grasps"] is None
    assert told["figures"]["kept"] is None
    assert told["figures"]["by_status"] == {}
    report = pack_runs([imported], tmp_path / "release", name="peer", version="1.0.0", quiet=True)
    checked = verify_release(tmp_path / "release", full=True)
    assert checked.ok, [c for c in checked.checks if not c.ok]
    release = Release.open(report.path)
    rows = release.grasps()
    assert len(rows) == N
    assert rows["hand_pos"].shape[1] == 1
    assert np.isnan(rows["energy_qp"]).all()
    for object_id in release.object_ids:
        mine = rows.select(rows["object_id"] == object_id)
        own = source.grasps(object_id)
        order = np.argsort(own["grasp_id"][np.argsort(own["size_mm"], kind="stable")])
        assert set(mine["source_ref"].tolist()) == set(own["source_ref"].tolist())
        assert len(order) == len(mine)
        assert (
            release.load_solid(object_id).nominal_volume
            == source.load_solid(object_id).nominal_volume
        )
    assert set(release.objects.column("licence").to_pylist()) == {"CC-BY-NC-4.0"}
    again = start_retest(tmp_path / "release", tmp_path / "again")
    assert sum(len(b) for b in again.batches()) == N


def test_a_policy_that_the_licences_do_not_meet_leaves_names_or_nothing(imported, tmp_path):
    names = {"name": "peer", "version": "1.0.0", "quiet": True}
    said = r"--licences permissive: 2 objects .* CC BY-NC 4\.0\); --licences ids-only packs"
    with pytest.raises(NotUsable, match=said):
        pack_runs([imported], tmp_path / "r", licences="permissive", **names)
    report = pack_runs([imported], tmp_path / "ids", licences="ids-only", **names)
    checked = verify_release(report.path, full=True, resimulate=resimulate)
    assert checked.ok, [c for c in checked.checks if not c.ok]
    release = Release.open(report.path)
    assert len(release.grasps()) == N
    assert not (report.path / "objects").exists()
    assert not (report.path / "clouds").exists()
    for needs_shapes in (
        lambda: release.load_solid(release.object_ids[0]),
        release.cloud,
        lambda: start_retest(report.path, tmp_path / "again"),
        lambda: render(report.path, tmp_path / "sheet.png", quiet=True),
    ):
        with pytest.raises(NotUsable, match=r"ids has no meshes and no clouds .*ids-only"):
            needs_shapes()


def test_the_benchmark_s_own_grasps_keep_their_depths_and_verdicts(shared, menagerie, tmp_path):
    """Four of its grasps, imported and judged by its protocol as this package states it."""
    from bidexdata.validation import load_protocol, validate_grasps

    root = shared / "peers" / "dexgraspbench"
    with open(root / "peer_results.csv", newline="") as stream:
        results = {row["file"]: row for row in csv.DictReader(stream)}
    asked = request(root, hand="shadow", limit=80)
    import_run(asked, tmp_path / "run", execution=HERE)
    run = Run.open(tmp_path / "run")
    batch = next(run.batches()).select(slice(None, None, 20))
    assert [r in results for r in batch["source_ref"].tolist()] == [True] * 4
    solid = run.load_solid(str(batch["object_id"][0]))
    judged = validate_grasps(batch, solid, run.hands(), load_protocol("dexgraspbench-1"))
    for k, ref in enumerate(batch["source_ref"].tolist()):
        row = results[ref]
        scale = float(row["scale"]) * solid.provenance["unit_in_file"]
        assert batch["size"][k] == np.float32(scale)
        assert judged["pd"][k] == pytest.approx(float(row["mj400_ho_pene_m"]), abs=1e-5)
        assert judged["spd"][k] == pytest.approx(float(row["mj400_self_pene_m"]), abs=1e-5)
        assert judged["success"][k] == bool(int(row["mj400_succ_flag"]))
