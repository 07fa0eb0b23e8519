"""A release that lies is found though every hash is right: hands, card, figures, training form."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from made_release import PER_SCENE, made_hand, made_release, made_rows
from sealing import edit_json, failed, reseal, swap

from bidexdata.cli.main import run
from bidexdata.cli.verify import verify
from bidexdata.formats.card import write_card
from bidexdata.formats.figure_checks import in_order
from bidexdata.formats.rows import RunInfo
from bidexdata.formats.verify import verify_release


def test_golden_poses_are_those_of_both_engines(packed):
    told = {c.name: c.detail for c in verify_release(packed, full=True).checks}
    assert "34 golden poses posed by numpy and tree.json" in told["golden"]
    assert "34 golden poses posed by MuJoCo and hand.xml" in told["golden again"]


def test_golden_poses_span_the_limits(packed):
    golden = json.loads((packed / "hands" / "made" / "golden.json").read_text())
    for side in ("left", "right"):
        hand, joints = made_hand(side), np.array(golden[side]["joints"])
        np.testing.assert_allclose(joints[0], hand.joint_lower)
        np.testing.assert_allclose(joints[1], hand.joint_upper)
        assert np.all((joints >= hand.joint_lower) & (joints <= hand.joint_upper))
        assert np.shape(golden[side]["contacts"]) == (len(joints), len(hand.contact_names), 3)
        assert golden[side]["fingertip_bodies"] == [hand.body_names[-1]]


def test_a_moved_golden_point_is_found(copied):
    def change(data):
        data["right"]["contacts"][5][1][2] += 1e-4

    edit_json(copied, "hands/made/golden.json", change)
    assert "numpy and tree.json put the contacts" in failed(verify_release(copied))["golden"]


def test_a_tree_of_another_length_is_found(copied):
    def change(data):
        data["body_pos"][2][2] += 0.002

    edit_json(copied, "hands/made/left/tree.json", change)
    assert "of a golden pose 2 mm" in failed(verify_release(copied))["golden"]


def test_an_mjcf_of_another_length_is_found_by_the_second_engine(copied):
    path = copied / "hands" / "made" / "left" / "hand.xml"
    text = path.read_text()
    assert 'pos="0 0 0.04"' in text
    path.write_text(text.replace('pos="0 0 0.04"', 'pos="0 0 0.041"'))
    reseal(copied)
    assert verify_release(copied).ok
    assert "MuJoCo and hand.xml" in failed(verify_release(copied, full=True))["golden again"]
    path.write_text("<mujoco")
    reseal(copied)
    found = failed(verify_release(copied, full=True))["golden again"]
    assert "MuJoCo cannot pose it" in found


def test_a_hand_without_golden_poses_is_found(copied):
    (copied / "hands" / "made" / "golden.json").unlink()
    reseal(copied)
    assert "unreadable golden poses" in failed(verify_release(copied))["golden"]


def test_an_edited_card_is_found(copied):
    for name in ("DATASET_CARD.md", "README.md"):
        path = copied / name
        text = path.read_text()
        path.write_text(text.replace("24", "42"))
        reseal(copied)
        assert f"{name} is not what" in failed(verify_release(copied))["card"]
        path.write_text(text)
    reseal(copied)
    assert verify_release(copied).ok


@pytest.mark.parametrize(
    ("keys", "value", "said"),
    [
        (("tests", "f", "selected", "low"), 0.99, "paper-1.tests.f.selected.low is 0.99"),
        (("tests", "f", "unselected", "n"), 240, "paper-1.tests.f.unselected.n is 240"),
        (("pd",), 0.0001, "paper-1.pd is 0.0001"),
        (("d",), 0.1, "paper-1.d is 0.1"),
        (("by_size", "300", "energies", "energy_qp"), 0.0, "by_size.300.energies.energy_qp is 0.0"),
        (("by_status", "ok"), 1000, "by_status.ok is 1000"),
        (("tests", "f", "groups", "size", "500", "objects"), 7, "groups.size.500.objects is 7"),
        (("made_up",), 1, "paper-1.made_up is 1"),
    ],
)
def test_a_sealed_figure_that_is_not_of_the_rows_is_found(copied, keys, value, said):
    def change(head):
        place = head["figures"]
        for key in keys[:-1]:
            place = place[key]
        place[keys[-1]] = value

    reseal(copied, change)
    head = json.loads((copied / "manifest.json").read_text())
    write_card(copied, {**head, "figures": in_order(head["figures"])})  # the liar is thorough
    reseal(copied)
    assert verify_release(copied).ok  # only counting again can know
    assert said in failed(verify_release(copied, full=True))["figures"]


def test_figures_of_another_version_are_compared_by_their_counts(copied):
    def older(head):
        head["generator"]["version"] = "0.0.1"
        head["figures"]["pd"] = 0.5

    reseal(copied, older)
    report = verify_release(copied, full=True)
    assert report.ok, failed(report)
    told = {c.name: c.detail for c in report.checks}
    assert "counts alone were compared" in told["figures"]
    assert "bidexdata 0.0.1 wrote it" in told["card"]

    reseal(copied, lambda head: head["figures"]["by_status"].update(ok=71))
    assert "by_status.ok is 71" in failed(verify_release(copied, full=True))["figures"]


def test_figures_of_several_runs_are_counted_again(tmp_path):
    def two(object_id):
        first = made_rows(object_id, run="a", seed=1)
        second = made_rows(object_id, run="b", seed=2, sizes=(500,), tested=False)
        return [first, second]

    runs = [RunInfo("a", "a" * 16, PER_SCENE), RunInfo("b", "b" * 16, PER_SCENE)]
    report = verify_release(made_release(tmp_path / "r", rows_of=two, runs=runs), full=True)
    assert report.ok, failed(report)
    assert "left out" not in {c.name: c.detail for c in report.checks}["figures"]


def test_what_the_tables_do_not_tell_is_left_out_and_said(tmp_path):
    """Scenes without a row, of one of two runs of equal N: either may have failed at them."""

    def two(object_id):
        first, second = made_rows(object_id, run="a", seed=1), made_rows(object_id, run="b", seed=2)
        empty = {f"{object_id}/800/float": {"no_regions": 4}}
        header = replace(second.batch.header, counts={**second.batch.header.counts, **empty})
        return [first, replace(second, batch=replace(second.batch, header=header))]

    runs = [RunInfo("a", "a" * 16, PER_SCENE), RunInfo("b", "b" * 16, PER_SCENE)]
    report = verify_release(made_release(tmp_path / "r", rows_of=two, runs=runs), full=True)
    assert report.ok, failed(report)
    assert "unselected rates left out" in {c.name: c.detail for c in report.checks}["figures"]


def change_h5(root: Path, change: Callable) -> None:
    with h5py.File(root / "grasps.h5", "r+") as file:
        change(file)
    reseal(root)


def test_a_number_of_the_training_form_that_is_not_of_the_tables_is_found(copied):
    def change(file):
        file["selected/train/values"][3, 5] += np.float32(1e-6)

    change_h5(copied, change)
    assert verify_release(copied).ok
    found = failed(verify_release(copied, full=True))["training form"]
    assert "of row 3 is not that of the tables" in found


def test_an_integer_of_the_training_form_that_is_not_of_the_tables_is_found(copied):
    def change(file):
        file["audit/test/suc_f"][0] = 1 - file["audit/test/suc_f"][0]

    change_h5(copied, change)
    found = failed(verify_release(copied, full=True))["training form"]
    assert "audit/test: suc_f of row 0" in found


@pytest.mark.parametrize(
    ("options", "said"),
    [({"dtype": ">i4"}, "little-endian"), ({"chunks": (4,)}, "contiguous"), ({"rows": 3}, "rows")],
)
def test_a_training_form_that_cannot_be_mapped_is_found(copied, options, said):
    def change(file):
        group = file["selected/train"]
        values = group["size_mm"][:]
        del group["size_mm"]
        kept = values[: options.get("rows", len(values))].astype(options.get("dtype", "<i4"))
        group.create_dataset("size_mm", data=kept, chunks=options.get("chunks"))

    change_h5(copied, change)
    assert said in failed(verify_release(copied))["layout"]


def test_a_training_form_without_a_column_is_found(copied):
    def change(file):
        del file["selected/train/steps"]

    change_h5(copied, change)
    found = failed(verify_release(copied, full=True))["training form"]
    assert "column steps is missing" in found


def test_swapped_files_are_found_with_and_without_their_hashes(copied):
    first, second = copied / "grasps" / "train-00000.parquet", copied / "objects.parquet"
    swap(first, second)
    found = failed(verify_release(copied))["files"]
    assert "grasps/train-00000.parquet has" in found
    assert "objects.parquet has" in found
    swap(first, second)
    for table in ("grasps", "contacts", "verdicts/paper-1-f"):
        swap(*(copied / table / f"{split}-00000.parquet" for split in ("train", "test")))
    reseal(copied)
    assert not verify_release(copied).ok


def test_a_content_hash_and_statistics_that_are_not_of_the_rows_are_found(copied):
    reseal(copied, lambda head: head.update(content_hash="0" * 64))

    def change(data):
        data["splits"]["train"]["joints"]["mean"][0] += 0.01

    edit_json(copied, "statistics.json", change)
    found = failed(verify_release(copied, full=True))
    assert "the manifest says 0000" in found["content hash"]
    assert "joints of train is not that of the rows" in found["statistics"]


def test_objects_may_be_in_two_splits_where_sizes_decide(copied):
    """Rows of one size train, those of the other test; no scene is in both."""
    reseal(copied, lambda head: head["split"].update(by="size"))
    found = failed(verify_release(copied))["splits"]
    assert "size 300 is in two splits" in found


def test_the_command_says_one_sentence_and_ends_with_4(copied, capsys):
    (copied / "notes.txt").write_text("x")
    assert run(["verify", str(copied), "--json"]) == 4
    told = capsys.readouterr()
    data = json.loads(told.out)
    assert set(data) == {"path", "ok", "full", "seconds", "checks"}
    assert [set(check) for check in data["checks"]] == [{"name", "ok", "detail"}]
    assert told.err.count("\n") == 1
    assert "notes.txt is not in the manifest" in told.err
    for key in data:
        assert key in verify.__doc__
