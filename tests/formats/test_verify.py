"""Every damage is found: by a hash where bytes changed, by a law where a sealed release lies."""

import inspect
import json
import os
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from made_release import (
    OBJECTS,
    PAPER_F,
    PER_SCENE,
    SIZES,
    as_schema_1_0,
    made_release,
    made_rows,
)
from sealing import failed, put, reseal, rewrite, swap_rows

from bidexdata.errors import Contradiction, NotUsable, PathNotFound
from bidexdata.formats import parquet, verify
from bidexdata.formats.contact_checks import contacts
from bidexdata.formats.hdf5 import rebuild_training_form
from bidexdata.formats.release import Release
from bidexdata.formats.rows import ReleaseRows
from bidexdata.formats.verify import Judged, verify_release
from bidexdata.record import Status


def test_a_good_release_keeps_every_law(packed):
    report = verify_release(packed, full=True)
    assert report.ok, failed(report)
    report.raise_if_bad()
    names = [c.name for c in report.checks]
    assert names[0] == "files"
    assert "contacts" in names
    assert report.to_dict()["ok"] is True
    assert [c.name for c in verify_release(packed).checks] == names[: names.index("content hash")]


def test_a_release_of_schema_1_0_has_no_size_and_keeps_every_law(copied):
    as_schema_1_0(copied)
    report = verify_release(copied, full=True)
    assert report.ok, failed(report)
    rows = Release.open(copied).grasps()
    np.testing.assert_array_equal(rows.columns["size"], (rows.size_mm / 1000).astype(np.float32))


def test_a_release_of_this_schema_must_have_its_size(copied):
    path = copied / "grasps" / "train-00000.parquet"
    parquet.write_table(path, parquet.read_table(path).drop_columns(["size"]))
    reseal(copied)
    assert "column size is missing" in failed(verify_release(copied))["tables"]


def test_a_flipped_bit_is_found_in_every_file(copied):
    rng = np.random.default_rng(0)
    for path in sorted(p for p in copied.rglob("*") if p.is_file()):
        data = path.read_bytes()
        for at in rng.integers(0, len(data), 2):
            flipped = bytearray(data)
            flipped[at] ^= 1 << rng.integers(8)
            path.write_bytes(flipped)
            report = verify_release(copied)
            assert not report.ok, (path, at)
            with pytest.raises(Contradiction) as caught:
                report.raise_if_bad()
            assert caught.value.exit_code == 4
        path.write_bytes(data)
    assert verify_release(copied).ok


def test_every_byte_of_the_manifest_hash_counts(copied):
    line = copied / "manifest.sha256"
    data = line.read_bytes()
    for at in range(len(data)):
        flipped = bytearray(data)
        flipped[at] ^= 1
        line.write_bytes(flipped)
        assert failed(verify_release(copied))["manifest"]


@pytest.mark.parametrize(
    ("harm", "said"),
    [
        (lambda r: (r / "notes.txt").write_text("x"), "notes.txt is not in the manifest"),
        (lambda r: (r / "objects" / "new").mkdir(), "objects/new/ is not in the manifest"),
        (lambda r: (r / "grasps.h5").unlink(), "grasps.h5 is missing"),
        (lambda r: os.symlink("runs.parquet", r / "x"), "x is not in the manifest"),
        (lambda r: os.truncate(r / "scenes.parquet", 100), "scenes.parquet has 100 bytes"),
        (lambda r: _swap_for_link(r / "runs.parquet"), "runs.parquet is not a plain file"),
    ],
)
def test_missing_extra_and_replaced_files_are_named(copied, harm, said):
    harm(copied)
    assert said in failed(verify_release(copied))["files"]


def _swap_for_link(path: Path) -> None:
    kept = path.parent.parent / "elsewhere"
    shutil.move(path, kept)
    path.symlink_to(kept)


def test_nothing_there_is_a_path_error(tmp_path):
    with pytest.raises(PathNotFound):
        verify_release(tmp_path / "nothing")


@pytest.mark.parametrize(
    ("table", "change", "law", "said"),
    [
        ("grasps", put("hand_quat_wxyz", 0, 0.5, 0), "rows", "hand_quat_wxyz is not unit"),
        ("grasps", put("hand_pos", 1, np.nan, 3), "rows", "hand_pos is not finite"),
        ("grasps", put("object_pos", 1, np.nan, 0), "rows", "object_pos is not finite"),
        ("grasps", put("joints", 0, np.nan, 0), "rows", "joints are not finite"),
        ("grasps", put("joints", 0, 0.0, 17), "rows", "past the hand's own"),
        ("grasps", put("size_mm", 0, -5), "rows", "not positive"),
        ("grasps", put("size", 0, 0.3006), "rows", "size does not round to size_mm"),
        ("grasps", put("size", 0, np.nan), "rows", "size does not round to size_mm"),
        ("grasps", put("selected", 2, False), "rows", "is not selected"),
        ("grasps", put("object_id", 0, "stranger-dddddddd"), "rows", "its object_id is stranger"),
        ("grasps", put("joints", 0, 3.0, 3), "joint limits", "outside the limits"),
        ("grasps", put("joints", 0, 0.9, 3), "contacts", "contact points are not where"),
        ("contacts", put("contact_point", 0, 0.3, 0), "contacts", "contact points are not where"),
        ("contacts", put("contact_index", 0, 9, 0), "rows", "names no contact point"),
        ("contacts", put("grasp_id", 0, "0" * 16), "rows", "rows are not those of"),
        (
            "verdicts/paper-1-f",
            put("grasp_id", 0, "0" * 16),
            "verdict tables",
            "rows are not those of",
        ),
        ("grasps", put("setting", 3, "tabletop"), "rows", "its setting is tabletop"),
        ("grasps", put("scene_id", 3, "box-aaaaaaaa/500/float"), "rows", "out of order"),
        ("grasps", put("pd", 0, 0.5), "verdict tables", "pd is not that of its verdict table"),
        ("grasps", lambda c: c.update(audit=[True] * len(c["audit"])), "rows", "row of both"),
    ],
)
def test_a_sealed_lie_breaks_its_law(copied, table, change, law, said):
    rewrite(copied, table, change)
    found = failed(verify_release(copied, full=True))
    assert said in found[law], found


@pytest.mark.parametrize("bad", ["nothexadecimal!!", "0123", "0" * 17, "00000000000000AF", ""])
def test_an_id_that_is_none_is_found(copied, bad):
    for table in ("grasps", "contacts", "verdicts/paper-1-f"):
        rewrite(copied, table, put("grasp_id", 5, bad))
    assert "16 hexadecimal digits" in failed(verify_release(copied))["rows"]


def test_rows_out_of_order_are_found(copied):
    for table in ("grasps", "contacts", "verdicts/paper-1-f"):
        rewrite(copied, table, swap_rows)
    assert "out of order" in failed(verify_release(copied))["rows"]


def test_negative_w_is_found(copied):
    def change(columns):
        columns["hand_quat_wxyz"][0] = [-v for v in columns["hand_quat_wxyz"][0]]

    rewrite(copied, "grasps", change)
    assert "w < 0" in failed(verify_release(copied))["rows"]


def test_a_success_that_is_none_is_found(copied):
    def change(columns):
        columns["success"] = [True] * len(columns["success"])

    rewrite(copied, "verdicts_audit/paper-1-f", change)
    found = failed(verify_release(copied))
    assert "without a grasp is marked successful" in found["verdict tables"]


def test_rates_that_are_not_those_of_the_rows_are_found(copied):
    def change(columns):
        columns["suc_f"] = [not v for v in columns["suc_f"]]

    rewrite(copied, "grasps", change)
    found = failed(verify_release(copied))
    assert "rows pass test f" in found["rates"]
    assert "suc_f is not the verdict of its table" in found["verdict tables"]


def test_missing_rows_are_found(copied):
    def change(columns):
        for values in columns.values():
            values.pop()

    rewrite(copied, "contacts", change)
    assert "other rows than grasps" in failed(verify_release(copied))["tables"]
    for table in ("grasps", "verdicts/paper-1-f"):
        rewrite(copied, table, change)
    assert "rows in files" in failed(verify_release(copied))["tables"]


def test_a_shape_in_two_splits_is_found(copied):
    def change(columns):
        columns["shape_sha256"] = ["same"] * len(columns["shape_sha256"])

    rewrite(copied, "objects", change, split="")
    assert "in two splits" in failed(verify_release(copied, full=True))["splits"]


def test_another_shape_is_found(copied):
    rewrite(copied, "objects", put("shape_sha256", 0, "0" * 64), split="")
    found = failed(verify_release(copied, full=True))
    assert "does not have its stated hash" in found["shapes"]
    assert verify_release(copied).ok  # only recomputing can know


def test_another_hand_is_found(copied):
    path = copied / "hands" / "made" / "left" / "tree.json"
    tree = json.loads(path.read_text())
    path.write_text(json.dumps({**tree, "joint_names": tree["joint_names"][::-1]}))
    reseal(copied)
    assert "another hand" in failed(verify_release(copied))["hands"]


def test_a_changed_column_type_is_found(copied):
    path = copied / "grasps" / "train-00000.parquet"
    table = parquet.read_table(path)
    at = table.schema.get_field_index("steps")
    wide = table.set_column(
        at, pa.field("steps", pa.int64()), table.column("steps").cast(pa.int64())
    )
    parquet.write_table(path, wide)
    reseal(copied)
    assert "steps is int64, not int32" in failed(verify_release(copied))["tables"]


def test_turned_objects_keep_their_contacts(tmp_path):
    out = made_release(tmp_path / "r", setting="tabletop")
    report = verify_release(out, full=True)
    assert report.ok, failed(report)


def test_verdicts_are_judged_again_by_the_callback(packed):
    calls = []

    def truth(release, batch, solid, test):
        assert solid.object_id == batch["object_id"][0]
        assert test == "f"
        calls.append(batch)
        return Judged(batch["success"].copy(), ", hands borrowed")

    report = verify_release(packed, full=True, resimulate=truth, sample=20, seed=3)
    assert report.ok
    assert sum(map(len, calls)) == 20
    assert not all(np.concatenate([b["selected"] for b in calls]))  # audit rows too
    assert {s for b in calls for s in b["synth_status"].tolist()} == {Status.OK}
    told = report.checks[-1].detail
    assert "hands borrowed" in told
    assert told.count("borrowed") == 1

    def liar(release, batch, solid, test):
        return Judged(~batch["success"])

    found = failed(verify_release(packed, full=True, resimulate=liar, sample=2))
    assert "when test f was simulated again" in found["verdicts"]


def test_the_sample_is_that_of_its_seed(packed):
    def drawn(seed):
        ids = []

        def note(release, batch, solid, test):
            ids.extend(batch["grasp_id"].tolist())
            return Judged(batch["success"])

        verify_release(packed, full=True, resimulate=note, sample=5, seed=seed)
        return ids

    assert drawn(1) == drawn(1) != drawn(2)


def test_verdicts_of_another_engine_are_not_judged_again(tmp_path):
    settings = {"paper-1": {"engine": {"name": "mujoco_warp", "version": "1"}}}
    out = made_release(tmp_path / "r", protocols=settings)

    def never(*_):
        raise AssertionError("its last digits vary from run to run")

    report = verify_release(out, full=True, resimulate=never)
    assert report.ok, failed(report)
    assert "not judged again" in report.checks[-1].detail


def test_a_release_of_test_a_alone_says_why_nothing_is_judged_again(tmp_path):
    with_arms = ("paper-1", "a")

    def rows(object_id):
        made = made_rows(object_id)
        return [replace(made, verdicts={with_arms: made.verdicts[PAPER_F]})]

    out = made_release(tmp_path / "r", OBJECTS[:1], rows_of=rows, tests=[with_arms])

    def never(*_):
        raise AssertionError("a release has no models of arms")

    report = verify_release(out, full=True, resimulate=never)
    assert report.ok, failed(report)
    assert report.checks[-1].detail == (
        "no row has a verdict to be judged again; test a not, for a release has no models of arms"
    )


def test_every_law_stands_on_the_page():
    source = inspect.getsource(verify)
    laws = set(re.findall(r'\("([a-z ]+)", lambda|Check\(\s*"([a-z ]+)"', source))
    named = {a or b for a, b in laws}
    assert {"manifest", "files", "arms", "hands on arms", "verdicts"} <= named
    page = (Path(__file__).parents[2] / "docs" / "verifying.md").read_text(encoding="utf-8")
    tables = page.split("| law | what holds |")[1:]
    listed = [re.findall(r"^\| `([a-z ]+)` \|", t.split("\n\n")[0], re.M) for t in tables]
    assert named == {law for laws in listed for law in laws}


def test_untested_rows_are_not_judged_again(tmp_path):
    out = made_release(tmp_path / "r", tested=False)

    def never(release, batch, solid, test):
        raise AssertionError("there is nothing to judge")

    assert verify_release(out, full=True, resimulate=never).ok


def test_duplicates_across_scenes_are_found(tmp_path):
    # A writer that does not look would let the same id into two scenes of one object.
    rows = made_rows(OBJECTS[0])
    out = made_release(tmp_path / "r", (OBJECTS[0],), rows_of=lambda _: [rows])
    release = Release.open(out)
    twin = release.grasps(OBJECTS[0], size_mm=SIZES[0])["grasp_id"][0]
    at = PER_SCENE  # first row of the second scene
    for table in ("grasps", "contacts", "verdicts/paper-1-f"):
        rewrite(out, table, put("grasp_id", at, str(twin)))
    details = failed(verify_release(out))["rows"]
    assert "is there twice" in details or "out of order" in details
    assert isinstance(rows, ReleaseRows)


def test_the_training_form_is_rebuilt_from_the_tables(copied):
    before = (copied / "grasps.h5").read_bytes()
    (copied / "grasps.h5").unlink()
    rebuild_training_form(copied)
    assert (copied / "grasps.h5").read_bytes() == before


def test_a_hand_that_this_machine_lacks_is_no_damage(packed: Path):
    def lacks(*_: object) -> Judged:
        raise NotUsable("no such hand here")

    with pytest.raises(NotUsable, match="no such hand"):
        verify_release(packed, full=True, resimulate=lacks)


def test_a_schema_version_that_is_not_that_of_the_header_is_refused(copied):
    reseal(copied, lambda head: head.update(schema_version="2.0"))
    with pytest.raises(Contradiction, match=r"schema_version is '2\.0' and that of its header"):
        Release.open(copied)
    assert list(failed(verify_release(copied))) == ["manifest"]


def test_contacts_that_are_not_there_are_not_said_to_lie_well(tmp_path):
    def without(object_id):
        rows = made_rows(object_id)
        rows.batch["contact_index"][:] = -1
        for name in ("contact_point", "contact_normal", "contact_force"):
            rows.batch[name][:] = np.nan
        return [rows]

    said = contacts(Release.open(made_release(tmp_path / "release", rows_of=without)))
    assert said.endswith("none of which states a contact")
    assert "mm" not in said
