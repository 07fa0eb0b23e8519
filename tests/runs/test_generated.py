"""Laws of `Run.create`: poses that a caller has are tested, shown and packed like any other."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from made_release import OBJECTS, made_release

from bidexdata import Library, Run, describe, load_hands, load_protocol, pack_runs, validate_run
from bidexdata.errors import BadConfig, NotUsable, PathNotFound, UnknownName
from bidexdata.formats.release import Release
from bidexdata.record import Status
from bidexdata.runs.prepare import prepare_library
from bidexdata.runs.stage import TaskExecution

BOX = """OFF
8 6 0
0 0 0
0.3 0 0
0.3 0.3 0
0 0.3 0
0 0 0.3
0.3 0 0.3
0.3 0.3 0.3
0 0.3 0.3
4 0 3 2 1
4 4 5 6 7
4 0 1 5 4
4 1 2 6 5
4 2 3 7 6
4 3 0 4 7
"""
INLINE = TaskExecution(executor="inline", quiet=True)


@pytest.fixture(scope="module")
def hands():
    return load_hands("capsule")


@pytest.fixture(scope="module")
def library(tmp_path_factory) -> Library:
    root = tmp_path_factory.mktemp("generated")
    (root / "box.off").write_text(BOX)
    prepare_library([str(root / "box.off")], root / "library", executor="inline", quiet=True)
    return Library.open(root / "library")


@pytest.fixture(scope="module")
def release(tmp_path_factory, hands) -> Release:
    root = tmp_path_factory.mktemp("generated") / "release"
    return Release.open(made_release(root, OBJECTS[:1], hands=hands, setting="tabletop"))


def rows(hands, scene_ids, height=0.2) -> dict[str, np.ndarray]:
    """Open hands, far from objects that stand upright."""
    n = len(scene_ids)
    J = max(len(h.joint_names) for h in hands)
    joints = np.full((n, 2, 3, J), np.nan)
    for h, hand in enumerate(hands):
        joints[:, h, :, : len(hand.joint_names)] = hand.posture_open
    pos = np.zeros((n, 2, 3, 3))
    pos[:, 0], pos[:, 1] = [0.0, 0.8, 0.6], [0.0, -0.8, 0.6]
    return {
        "scene_id": np.array(scene_ids),
        "object_pos": np.tile([0.0, 0.0, height], (n, 1)),
        "object_quat_wxyz": np.tile([-1.0, 0.0, 0.0, 0.0], (n, 1)),
        "hand_pos": pos,
        "hand_quat_wxyz": np.tile([1.0, 0.0, 0.0, 0.0], (n, 2, 3, 1)),
        "joints": joints,
    }


def scenes_of(library: Library) -> list[str]:
    return [f"{library.object_ids[0]}/{mm}/table0" for mm in (500, 300, 500)]


def test_rows_come_back_with_ids_sizes_and_statuses(tmp_path, library, hands):
    given = rows(hands, scenes_of(library))
    run = Run.create(tmp_path / "run", given, source=library.path, hand="capsule", about={"a": 1})
    (batch,) = Run.open(run.path).batches()
    assert batch["scene_id"].tolist() == given["scene_id"].tolist()
    assert batch["size_mm"].tolist() == [500, 300, 500]
    assert batch["attempt"].tolist() == [0, 0, 1]
    assert len(set(batch["grasp_id"].tolist())) == 3
    assert (batch["synth_status"] == Status.OK).all()
    assert batch["selected"].all()
    np.testing.assert_array_equal(batch["hand_pos"], given["hand_pos"].astype(np.float32))
    assert (batch["object_quat_wxyz"][:, 0] == 1).all(), "quaternions are stored with w >= 0"
    assert run.spec.kind == "generated"
    assert describe(run.path)["figures"]["n"] == 3


def test_a_run_may_hold_its_own_library(tmp_path, library, hands):
    own = tmp_path / "run" / "library"
    shutil.copytree(library.path, own)
    run = Run.create(tmp_path / "run", rows(hands, scenes_of(library)), source=own, hand="capsule")
    assert run.spec.source == "library"
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").touch()
    with pytest.raises(NotUsable, match="is no run"):
        Run.create(tmp_path / "other", rows(hands, scenes_of(library)), source=own, hand="capsule")


def test_other_poses_are_another_run(tmp_path, library, hands):
    given = rows(hands, scenes_of(library))
    moved = {**given, "hand_pos": given["hand_pos"] + 0.01}
    options = {"source": library.path, "hand": "capsule"}
    a, b = (
        Run.create(tmp_path / name, columns, **options)
        for name, columns in (("a", given), ("b", moved))
    )
    assert a.fingerprint != b.fingerprint
    again = Run.create(tmp_path / "c", given, **options)
    assert again.fingerprint == a.fingerprint


def test_a_grasp_batch_of_a_run_can_be_written_anew(tmp_path, library, hands):
    options = {"source": library.path, "hand": "capsule"}
    run = Run.create(tmp_path / "a", rows(hands, scenes_of(library)), **options)
    (batch,) = run.batches()
    copy = Run.create(tmp_path / "b", batch, **options)
    np.testing.assert_array_equal(next(copy.batches())["joints"], batch["joints"])


def test_a_generated_run_is_tested_and_packed_as_any_other(tmp_path, library, hands):
    run = Run.create(
        tmp_path / "run", rows(hands, scenes_of(library)), source=library.path, hand="capsule"
    )
    validate_run(run, load_protocol("paper-1"), ("l",), execution=INLINE)
    (batch,) = run.batches("paper-1", "l")
    assert not batch["success"].any(), "hands that touch nothing lift nothing"
    assert (batch["verdict_status"] != Status.NOT_RUN).all()
    pack_runs(
        [run.path], tmp_path / "release", name="made", version="1.0.0", licences="ids-only",
        pictures=False, quiet=True,
    )  # fmt: skip
    assert Release.open(tmp_path / "release").figures["n"] == 3


def test_objects_of_a_release_are_tested_and_not_packed(tmp_path, release, hands):
    scene = release.scenes.column("scene_id").to_pylist()[0]
    run = Run.create(tmp_path / "run", rows(hands, [scene]), source=release.path, hand="capsule")
    validate_run(run, load_protocol("paper-1"), ("l",), execution=INLINE)
    assert len(next(run.batches("paper-1", "l"))) == 1
    with pytest.raises(NotUsable, match="needs the library"):
        pack_runs([run.path], tmp_path / "release", name="made", version="1.0.0", quiet=True)


def test_joints_out_of_range_are_a_row_without_a_pose(tmp_path, library, hands):
    given = rows(hands, scenes_of(library))
    given["joints"][0, 0, 1, 0] = hands[0].joint_upper[0] + 0.5
    given["joints"][1, 0, 2, 0] = hands[0].joint_upper[0] + 0.5  # the squeeze is a command
    run = Run.create(tmp_path / "run", given, source=library.path, hand="capsule")
    (batch,) = run.batches()
    assert batch["synth_status"].tolist() == [Status.JOINT_RANGE, Status.OK, Status.OK]
    assert np.isnan(batch["hand_pos"][0]).all()
    assert np.isfinite(batch["hand_pos"][1:]).all()


def test_what_cannot_be_a_run_is_refused_with_its_reason(tmp_path, library, release, hands):
    good, out = rows(hands, scenes_of(library)), tmp_path / "run"
    options = {"source": library.path, "hand": "capsule"}
    with pytest.raises(BadConfig, match="needs the column 'joints'"):
        Run.create(out, {n: v for n, v in good.items() if n != "joints"}, **options)
    with pytest.raises(BadConfig, match="'hand_pos' must have shape"):
        Run.create(out, {**good, "hand_pos": good["hand_pos"][:, :1]}, **options)
    with pytest.raises(BadConfig, match="not finite"):
        Run.create(out, {**good, "hand_pos": np.full_like(good["hand_pos"], np.nan)}, **options)
    with pytest.raises(BadConfig, match="at least one row"):
        Run.create(out, {n: v[:0] for n, v in good.items()}, **options)
    mixed = np.array([*good["scene_id"][:2], f"{library.object_ids[0]}/500/float"])
    with pytest.raises(NotUsable, match="one setting"):
        Run.create(out, {**good, "scene_id": mixed}, **options)
    other = np.array(["mug-00000000/500/table0"] * 3)
    with pytest.raises(UnknownName, match="no object"):
        Run.create(out, {**good, "scene_id": other}, **options)
    with pytest.raises(PathNotFound):
        Run.create(out, good, source=tmp_path / "nothing", hand="capsule")
    assert not out.exists()
    Run.create(out, good, **options)
    with pytest.raises(NotUsable, match="written once"):
        Run.create(out, good, **options)
