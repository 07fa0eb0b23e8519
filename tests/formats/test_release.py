"""read(write(x)) = x, the same bytes twice, and what a writer must refuse."""

import filecmp
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_release import (
    OBJECTS,
    PAPER_F,
    PER_SCENE,
    SIZES,
    made_hand,
    made_object,
    made_release,
    made_rows,
)

from bidexdata.errors import Contradiction, NotUsable, PathNotFound, UnknownName
from bidexdata.formats.manifest import write_manifest
from bidexdata.formats.object_table import shape_hash
from bidexdata.formats.release import Release
from bidexdata.formats.rows import ReleaseRows, RunInfo
from bidexdata.formats.stored_parts import run_infos
from bidexdata.formats.tables import SORTED_BY
from bidexdata.record import Status
from bidexdata.record.batch import BadRecord

OBJECT = OBJECTS[0]


def tree_bytes(root: Path) -> dict[str, bytes]:
    return {p.relative_to(root).as_posix(): p.read_bytes() for p in root.rglob("*") if p.is_file()}


def same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    if a.dtype.kind == "U":
        return a.tolist() == b.tolist()
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


def test_two_packs_give_the_same_bytes_whatever_the_order(packed, tmp_path):
    def shuffled(object_id):
        rows = made_rows(object_id)
        order = np.random.default_rng(1).permutation(len(rows.batch))
        verdicts = {k: {c: v[order] for c, v in d.items()} for k, d in rows.verdicts.items()}
        return [ReleaseRows(rows.run, rows.batch.select(order), verdicts)]

    again = made_release(tmp_path / "again", OBJECTS[::-1], rows_of=shuffled)
    assert tree_bytes(again) == tree_bytes(packed)


def test_rows_are_sorted_and_flagged(packed):
    release = Release.open(packed)
    for configuration in ("selected", "audit"):
        for split in release.splits:
            batch = release.grasps(split=split, configuration=configuration)
            keys = list(zip(*(batch[c].tolist() for c in SORTED_BY), strict=True))
            assert keys == sorted(set(keys))
            assert batch[configuration].all()
            assert set(batch["object_id"]) == set(release.splits[split])


def test_grasps_are_found_by_object_size_and_configuration(packed):
    release = Release.open(packed)
    for object_id in OBJECTS:
        for mm in SIZES:
            batch = release.grasps(object_id, size_mm=mm)
            assert len(batch) == PER_SCENE
            assert set(batch["object_id"]) == {object_id}
            assert set(batch["size_mm"]) == {mm}
    assert len(release.grasps()) == PER_SCENE * len(OBJECTS) * len(SIZES)
    assert len(release.grasps(size_mm=123)) == 0
    assert len(release.grasps(OBJECT, configuration="audit")) == PER_SCENE * len(SIZES)


def test_what_is_not_there_is_named(packed, tmp_path):
    release = Release.open(packed)
    for call, said in [
        (lambda: release.grasps("bix-aaaaaaaa"), "did you mean 'box-aaaaaaaa'"),
        (lambda: release.grasps(split="val"), "train, test"),
        (lambda: release.grasps(configuration="all"), "selected, audit"),
        (lambda: release.load_solid("nothing"), "no object"),
        (lambda: release.cloud("cloud_hull"), "cloud_solid"),
        (lambda: release.index(columns=["joints"]), "no scalar column"),
    ]:
        with pytest.raises(UnknownName, match=said):
            call()
    with pytest.raises(PathNotFound, match="bidexdata pack"):
        Release.open(tmp_path)


def test_solids_and_clouds_come_back(packed):
    release = Release.open(packed)
    for i, object_id in enumerate(release.object_ids):
        made = made_object(object_id)
        solid = release.load_solid(object_id)
        assert shape_hash(solid) == shape_hash(made)
        assert solid.volume == made.volume
        assert solid.provenance["licence"] == made.provenance["licence"]
        cloud = release.cloud("cloud_solid", object_id)
        np.testing.assert_array_equal(cloud, release.cloud()[i])
        assert np.abs(cloud).max() <= np.abs(made.mesh.vertices).max() + 1e-6
    row = release.objects.to_pylist()[0]
    assert (row["licence"], row["category"], row["cloud_index"]) == ("CC0-1.0", "box", 0)


def test_null_means_not_tested(tmp_path):
    rows = {o: made_rows(o, tested=o == OBJECT) for o in OBJECTS}
    out = made_release(tmp_path / "r", rows_of=lambda o: [rows[o]])
    release = Release.open(out)
    index = release.index(columns=["object_id", "suc_f", "suc_l", "pd"]).to_pylist()
    for row in index:
        assert (row["suc_f"] is None) == (row["object_id"] != OBJECT)
        assert row["suc_l"] is None
        assert np.isnan(row["pd"]) == (row["object_id"] != OBJECT)
    untested = release.grasps(OBJECTS[1])
    assert (untested["verdict_status"] == Status.NOT_RUN).all()
    assert not untested["success"].any()
    # Rates count the tested object only.
    assert release.figures["tests"]["f"]["selected"]["n"] == PER_SCENE * len(SIZES)


def test_metrics_of_a_row_are_of_the_first_test_that_was_run_on_it(tmp_path):
    lift = ("paper-1", "l")

    def rows(object_id):
        made = made_rows(object_id)
        if object_id != OBJECT:  # lifted only
            made = replace(made, verdicts={lift: made.verdicts[PAPER_F]})
        return [made]

    release = Release.open(made_release(tmp_path / "r", rows_of=rows, tests=[PAPER_F, lift]))
    for object_id in OBJECTS:
        batch = release.grasps(object_id, test="f" if object_id == OBJECT else "l")
        rows = release.index(columns=["object_id", "pd", "contact_number"]).to_pylist()
        mine = [r for r in rows if r["object_id"] == object_id]
        np.testing.assert_array_equal([r["pd"] for r in mine], batch["pd"])
        assert np.isfinite(batch["pd"]).any()
        assert [r["contact_number"] for r in mine] == batch["contact_number"].tolist()


def test_runs_are_merged_and_kept_apart_in_the_table(tmp_path):
    runs = [
        RunInfo("a", "1" * 16, PER_SCENE, seed=3, rig="two_arms"),
        RunInfo("b", "2" * 16, None, preset="x"),
    ]
    out = made_release(
        tmp_path / "r",
        (OBJECT,),
        runs=runs,
        rows_of=lambda o: [made_rows(o, run="a", seed=1), made_rows(o, run="b", seed=2)],
    )
    release = Release.open(out)
    assert release.runs.to_pylist()[1]["grasps"] == -1
    assert run_infos(release) == runs
    assert release.runs.column("rig").to_pylist() == ["two_arms", ""]
    card = (tmp_path / "r" / "DATASET_CARD.md").read_text()
    assert "| a | - | floating | two_arms |" in card
    assert "| b | x | floating | - |" in card
    names = release.index(columns=["run"]).column("run").to_pylist()
    assert sorted(set(names)) == ["a", "b"]
    assert names.count("a") == names.count("b") == PER_SCENE * len(SIZES)
    scene = release.scenes.to_pylist()[0]
    assert scene["runs"] == 2
    assert scene["grasps_wanted"] == PER_SCENE
    assert json.loads(scene["attempts"])["ok"] == 6 * PER_SCENE
    # The imported run has no unselected rate: only run a counts.
    assert release.figures["tests"]["f"]["unselected"]["n"] == PER_SCENE * len(SIZES)


def test_the_same_grasp_twice_is_refused_by_name(tmp_path):
    rows = made_rows(OBJECT)
    other = replace(rows, run="copy")
    runs = [RunInfo(n, "f" * 16, 4) for n in ("run", "copy")]
    with pytest.raises(
        NotUsable, match=r"grasp [0-9a-f]{16} of box-aaaaaaaa is there twice \(in copy, run\)"
    ) as refused:
        made_release(tmp_path / "r", (OBJECT,), runs=runs, rows_of=lambda _: [rows, other])
    assert refused.value.exit_code == 3  # the command line names runs that do not go together


def test_rows_of_other_hands_objects_or_runs_are_refused(tmp_path):
    other_hand = replace(made_hand("left"), spec_hash="0" * 64)
    for n, (options, said, error) in enumerate(
        [
            (
                {"rows_of": lambda o: [made_rows(o, hands=(other_hand, made_hand("right")))]},
                "hands",
                NotUsable,
            ),
            ({"rows_of": lambda _: [made_rows(OBJECTS[1])]}, "were given as rows of", BadRecord),
            ({"rows_of": lambda o: [made_rows(o, run="stranger")]}, "'stranger'", NotUsable),
        ]
    ):
        with pytest.raises(error, match=said):
            made_release(tmp_path / str(n), (OBJECT,), **options)
        assert not (tmp_path / str(n)).exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"version": "1.0"}, "X.Y.Z"),
        ({"version": "01.0.0"}, "X.Y.Z"),
        ({"name": "a b"}, "letters"),
        ({"name": "../x"}, "letters"),
    ],
)
def test_impossible_names_are_refused(tmp_path, options, said):
    with pytest.raises(NotUsable, match=said):
        made_release(tmp_path / "r", (OBJECT,), **options)
    assert list(tmp_path.iterdir()) == []


def test_an_existing_folder_is_not_touched(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(NotUsable, match="exists already"):
        made_release(tmp_path)
    assert tree_bytes(tmp_path) == {"notes.txt": b"mine"}


def test_a_killed_pack_leaves_no_release_and_the_next_one_completes(packed, tmp_path):
    code = (
        "import os, signal, sys; from pathlib import Path; from made_release import *\n"
        "die = lambda object_id: os.kill(os.getpid(), signal.SIGKILL)\n"
        "made_release(Path(sys.argv[1]), on_object=die)\n"
    )
    out = tmp_path / "release"
    tests = Path(__file__).resolve().parents[1]
    env = {**os.environ, "PYTHONPATH": f"{tests}:{tests.parent}"}
    done = subprocess.run([sys.executable, "-c", code, str(out)], env=env, check=False)
    assert done.returncode == -signal.SIGKILL
    assert not out.exists()
    assert list(tmp_path.iterdir())  # it had begun
    made_release(out)
    assert [p.name for p in tmp_path.iterdir()] == ["release"]
    assert filecmp.cmp(out / "manifest.json", packed / "manifest.json", shallow=False)


def rewritten(root: Path, **changes) -> None:
    """Change the manifest and seal it again: a consistent release of another kind."""
    head = json.loads((root / "manifest.json").read_text())
    head.pop("files")
    header = json.loads(head["header"])
    header.update(changes)
    version = {"schema_version": header["schema_version"]}
    write_manifest(root, {**head, **version, "header": json.dumps(header)})


def test_a_newer_major_schema_is_refused_with_the_way_out(copied):
    rewritten(copied, schema_version="2.0")
    with pytest.raises(Contradiction, match=r"schema 2\.0.*pip install -U bidexdata"):
        Release.open(copied)


def test_a_newer_minor_schema_is_read(copied):
    rewritten(copied, schema_version="1.9", something_new=3)
    assert len(Release.open(copied).grasps()) == PER_SCENE * len(OBJECTS) * len(SIZES)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'{"format": "other", "files": {}}'])
def test_a_manifest_of_something_else_is_a_contradiction(copied, content):
    import hashlib

    (copied / "manifest.json").write_bytes(content)
    with pytest.raises(Contradiction, match="does not match"):
        Release.open(copied)
    line = f"{hashlib.sha256(content).hexdigest()}  manifest.json\n"
    (copied / "manifest.sha256").write_text(line)
    with pytest.raises(Contradiction, match="not a manifest"):
        Release.open(copied)


def test_the_manifest_says_how_many_rows_every_file_has(packed):
    from bidexdata.formats import parquet

    listed = Release.open(packed).manifest["files"]
    tables = {name: entry["rows"] for name, entry in listed.items() if "rows" in entry}
    on_disk = [p.relative_to(packed).as_posix() for p in packed.glob("*/**/*.parquet")]
    assert sorted(tables) == sorted(on_disk)
    for name, rows in tables.items():
        assert rows == sum(parquet.row_counts(packed / name))


def test_two_packs_to_one_place_leave_one_whole_release(packed, tmp_path):
    out, met = tmp_path / "release", threading.Barrier(2, timeout=60)
    first = OBJECTS[0]

    def pack(_: int) -> str:
        try:
            made_release(out, on_object=lambda object_id: met.wait() if object_id == first else 0)
        except NotUsable as err:
            return str(err)
        return ""

    with ThreadPoolExecutor(2) as pool:
        said = sorted(pool.map(pack, range(2)))
    assert said[0] == ""
    assert "exists already" in said[1]
    assert [p.name for p in tmp_path.iterdir()] == ["release"]
    assert tree_bytes(out) == tree_bytes(packed)


def test_a_failed_pack_leaves_nothing_and_ends_its_threads(tmp_path):
    def rows_of(object_id):
        raise NotUsable("no more rows")

    before = threading.active_count()
    with pytest.raises(NotUsable, match="no more rows"):
        made_release(tmp_path / "r", rows_of=rows_of)
    assert list(tmp_path.iterdir()) == []
    assert threading.active_count() == before


def test_an_error_of_a_writing_thread_ends_the_pack(tmp_path, monkeypatch):
    from bidexdata.formats.content_hash import ContentTally

    plain = ContentTally.add

    def full(self, name, table):
        if table.num_rows and "contacts" in name:
            raise OSError(28, "No space left on device")
        plain(self, name, table)

    monkeypatch.setattr(ContentTally, "add", full)
    with pytest.raises(OSError, match="No space left"):
        made_release(tmp_path / "r")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_pack_that_is_killed_at_any_moment_leaves_nothing_wrong(packed, tmp_path):
    """Twenty times, at random moments; then the next one completes."""
    from bidexdata.formats.verify import verify_release

    code = (
        "import sys; from pathlib import Path; from made_release import made_release\n"
        "import bidexdata.formats.verify, h5py, mujoco\n"
        "print('go', flush=True); made_release(Path(sys.argv[1]))\n"
    )
    tests = Path(__file__).resolve().parents[1]
    env = {**os.environ, "PYTHONPATH": f"{tests}:{tests.parent}"}
    out, rng = tmp_path / "release", np.random.default_rng(0)

    def start() -> subprocess.Popen:
        command = [sys.executable, "-c", code, str(out)]
        process = subprocess.Popen(command, env=env, stdout=subprocess.PIPE)
        process.stdout.readline()
        return process

    process, began = start(), time.monotonic()
    process.communicate()
    longest = time.monotonic() - began
    expected, left = tree_bytes(packed), 0
    for _ in range(20):
        shutil.rmtree(out, ignore_errors=True)
        process = start()
        time.sleep(rng.uniform(0, longest))
        process.kill()
        process.communicate()
        if out.exists():
            assert verify_release(out).ok
            assert tree_bytes(out) == expected
        left += any(p != out for p in tmp_path.iterdir())
    assert left > 0  # some were killed on the way
    shutil.rmtree(out, ignore_errors=True)
    made_release(out)
    assert [p.name for p in tmp_path.iterdir()] == ["release"]
    assert tree_bytes(out) == expected
