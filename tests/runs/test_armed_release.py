"""Laws of arm solutions in a release: same rows and order, one rig, and what verify finds."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from made_armed import made_run, write_rig

from bidexdata.arms.chain import chain_forward
from bidexdata.arms.config import ArmConfig, PathConfig
from bidexdata.arms.inverse_kinematics import IkConfig
from bidexdata.arms.solutions import no_solutions
from bidexdata.cli.main import run as bidexdata
from bidexdata.errors import BadConfig, Contradiction, NotUsable, UnknownName
from bidexdata.formats.arm_checks import LARGEST, NONE_ASKED, arm_poses, arm_rows
from bidexdata.formats.content_hash import content_hash
from bidexdata.formats.release import Release
from bidexdata.formats.rig_files import hand_poses, read_rig_files
from bidexdata.formats.verify import verify_release
from bidexdata.frames import quat_canonical, quat_from_matrix
from bidexdata.record import GraspBatch, Status
from bidexdata.record.fields import KEY_FRAMES, columns_written_by
from bidexdata.runs import arms as stage
from bidexdata.runs.pack import pack_runs
from bidexdata.runs.run import Run
from bidexdata.runs.shards import read_shard, shard_path, write_shard
from bidexdata.runs.stage import TaskExecution

INLINE = TaskExecution(executor="inline", quiet=True)
CONFIG = ArmConfig(path=PathConfig(lift=0.001, standoff=0.01))
PACK = {
    "name": "armed",
    "version": "1.0.0",
    "pictures": False,
    "quiet": True,
    "licences": "ids-only",
}


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("armed") / "library"
    assert bidexdata(["prepare", "shapes:box,bracket", "--out", str(folder),
                      "--executor", "inline", "--quiet"]) == 0  # fmt: skip
    return folder


def motions(batch, field, scenes, robot, config, device="cpu"):
    """Random motions inside the limits for all rows with a grasp but the first.

    Hands are at the pre-grasp from the stand-off on, and stay at the squeeze: the lift of `CONFIG`
    is a millimetre, which they may miss.
    """
    ends = np.cumsum([0, *config.path.knots])
    rng = np.random.default_rng(3)
    found = no_solutions(robot, config, len(batch))
    for row in np.flatnonzero(batch["synth_status"] == Status.OK)[1:]:
        for h, arm in enumerate(robot.arms):
            low, high = arm.chain.lower, arm.chain.upper
            keys = low + (high - low) * rng.uniform(0.45, 0.55, (6, arm.chain.joints))
            keys[1], keys[5] = keys[2], keys[4]
            path = np.stack([np.interp(np.arange(ends[-1] + 1), ends, q) for q in keys.T], axis=1)
            found.arm_path[row, h, :, : arm.chain.joints] = path
            found.arm_joints[row, h, :, : arm.chain.joints] = path[ends]
        found.ik_error_pos[row, :, 1:] = found.ik_error_rot[row, :, 1:] = 0
        found.ik_error_pos[row, :, 5] = config.path.lift
        found.arm_time[row] = np.linspace(0, 3, found.arm_time.shape[1])
        steps = np.abs(np.diff(found.arm_path[row].astype(np.float32), axis=1))
        found.arm_step[row], found.arm_status[row] = np.nanmax(steps), Status.OK
    columns = found.to_columns()
    header = dataclasses.replace(batch.header, counts={}, arms=stage_headers(robot, config))
    ordered = {n: columns[n] for n in columns_written_by("arms")}
    return GraspBatch(header, {"grasp_id": batch["grasp_id"], **ordered}), len(batch)


def stage_headers(robot, config):
    from bidexdata.arms.solutions import arm_headers

    return arm_headers(robot, config)


@pytest.fixture
def solved(library: Path, tmp_path: Path, monkeypatch) -> Run:
    """A run whose hands are where its made-up motions bring them."""
    monkeypatch.setattr(stage, "arm_columns", motions)
    made = made_run(library, tmp_path / "run")
    rig = write_rig(tmp_path / "rig")
    stage.arms_run(made, rig, CONFIG, execution=INLINE)
    run = Run.open(made.path)
    robot = run.robot()
    for task in run.tasks:
        batch = run.task_batch(task)
        arms = run.task_arms(task, batch)
        columns = {n: c.copy() for n, c in batch.columns.items()}
        ok = arms["arm_status"] == Status.OK
        for h, arm in enumerate(robot.arms):
            for s, name in enumerate(("pregrasp", "grasp", "squeeze")):
                q = arms["arm_joints"][ok, h, KEY_FRAMES.index(name), : arm.chain.joints]
                pos, rot = chain_forward(arm.chain, q.astype(np.float64))
                columns["hand_pos"][ok, h, s] = pos
                columns["hand_quat_wxyz"][ok, h, s] = quat_canonical(quat_from_matrix(rot))
        path = shard_path(run.stage_folder("rows"), task.task_id)
        write_shard(path, GraspBatch(batch.header, columns).to_arrow(), run.fingerprint)
    return run


def all_rows(release: Release) -> GraspBatch:
    return GraspBatch.concat([release.with_arms(release.stored(o)) for o in release.object_ids])


@pytest.mark.parametrize("form", ["both", "parquet", "hdf5"])
def test_a_release_has_the_solutions_of_the_run_row_by_row(solved: Run, tmp_path, form):
    pack_runs([solved.path], tmp_path / "release", form=form, **PACK)
    release = Release.open(tmp_path / "release")
    assert (release.rig, release.manifest["rigs"]) == ("made", ["made"])
    stored = all_rows(release)
    by_id = {i: n for n, i in enumerate(stored["grasp_id"].tolist())}
    for task in solved.tasks:
        rows = solved.task_arms(task, solved.task_batch(task))
        at = [by_id[i] for i in rows["grasp_id"].tolist()]
        for name in columns_written_by("arms"):
            assert np.array_equal(
                rows[name], stored[name][at], equal_nan=rows[name].dtype.kind == "f"
            )
    assert content_hash(release) == release.manifest["content_hash"]
    report = verify_release(release.path, full=True)
    failed = [c for c in report.checks if not c.ok and "arm" in c.name]
    assert not failed
    assert {"arms", "hands on arms"} <= {c.name for c in report.checks} or not report.ok


def test_laws_of_the_arms_hold_and_find_what_is_wrong(solved: Run, tmp_path):
    pack_runs([solved.path], tmp_path / "release", form="parquet", **PACK)
    release = Release.open(tmp_path / "release")
    assert "motions of" in arm_rows(release)
    assert "mm from their grasps" in arm_poses(release)
    rig = read_rig_files(release.path, release.header.arms)
    robot = solved.robot()
    for arm in robot.arms:
        q = np.random.default_rng(1).uniform(
            arm.chain.lower, arm.chain.upper, (20, arm.chain.joints)
        )
        for ours, theirs in zip(
            hand_poses(rig.document["chains"][arm.side], q),
            chain_forward(arm.chain, q),
            strict=True,
        ):
            np.testing.assert_allclose(ours, theirs, atol=1e-12)


def test_a_release_without_arms_names_none(library: Path, tmp_path):
    made = made_run(library, tmp_path / "run")
    pack_runs([made.path], tmp_path / "release", form="parquet", **PACK)
    release = Release.open(tmp_path / "release")
    assert release.rig == ""
    assert "rigs" not in release.manifest
    assert not list(release.path.glob("arms*"))
    assert "arms" not in json.loads(release.manifest["header"])
    with pytest.raises(NotUsable, match="no arm solutions"):
        release.with_arms(release.stored())


def test_rows_that_were_not_asked_for_say_so(solved: Run, library, tmp_path):
    other = made_run(library, tmp_path / "plain", sizes=(500,))
    pack_runs([solved.path, other.path], tmp_path / "release", form="parquet", **PACK)
    stored = all_rows(Release.open(tmp_path / "release"))
    none = stored["size_mm"] == 500
    assert (stored["arm_status"][none] == NONE_ASKED).all()
    assert (stored["arm_status"][~none] != NONE_ASKED).all()


def test_runs_of_different_rigs_are_packed_apart_or_by_name(solved: Run, library, tmp_path):
    other = made_run(library, tmp_path / "two", sizes=(500,))
    stage.arms_run(other, write_rig(tmp_path / "b", name="other"), execution=INLINE)
    paths = [solved.path, other.path]
    with pytest.raises(NotUsable, match="say which with --rig"):
        pack_runs(paths, tmp_path / "release", **PACK)
    with pytest.raises(UnknownName, match="other"):
        pack_runs(paths, tmp_path / "release", rig="made", **PACK)
    stage.arms_run(other, write_rig(tmp_path / "rig"), CONFIG, execution=INLINE)
    report = pack_runs(paths, tmp_path / "release", rig="made", form="parquet", **PACK)
    assert (report.rig, report.other_rigs) == ("made", ("other",))
    assert Release.open(tmp_path / "release").rig == "made"


def test_the_flat_table_of_run_and_release_says_the_same_of_the_arms(solved: Run, tmp_path, capsys):
    import pyarrow.parquet as pq

    pack_runs([solved.path], tmp_path / "release", form="parquet", **PACK)
    found = []
    for source in (solved.path, tmp_path / "release"):
        out = tmp_path / f"{source.name}.parquet"
        assert bidexdata(["table", str(source), "--out", str(out), "--quiet"]) == 0
        table = pq.read_table(out).sort_by("grasp_id")
        found.append(table.select(["grasp_id", "rig", "arm_status", "arm_step", "clear_table"]))
    assert found[0].equals(found[1])
    assert set(found[0].column("rig").to_pylist()) == {"made"}
    assert {"ok", "no_grasp"} == set(found[0].column("arm_status").to_pylist())
    assert (
        bidexdata(["table", str(solved.path), "--out", str(tmp_path / "x.csv"), "--rig", "no"]) == 3
    )


def test_a_migrated_release_keeps_the_arms(solved: Run, tmp_path):
    from bidexdata.formats.rewrite import Rewriting, rewrite

    pack_runs([solved.path], tmp_path / "release", form="parquet", **PACK)
    first = Release.open(tmp_path / "release")
    rewrite([first], tmp_path / "again", Rewriting(how="migrate", name="armed", version="1.0.0"))
    again = Release.open(tmp_path / "again")
    assert again.rig == "made"
    assert again.manifest["content_hash"] == first.manifest["content_hash"]
    rigs = [(r.path / "rigs" / "made" / "rig.json").read_bytes() for r in (first, again)]
    assert rigs[0] == rigs[1]


def test_a_hand_elsewhere_is_found(solved: Run, tmp_path):
    task = solved.tasks[0]
    path = shard_path(solved.stage_folder("rows"), task.task_id)
    batch = GraspBatch.from_arrow(read_shard(path))
    moved = {n: c.copy() for n, c in batch.columns.items()}
    moved["hand_pos"][:, 1, 1, 0] += 0.01
    write_shard(path, GraspBatch(batch.header, moved).to_arrow(), solved.fingerprint)
    pack_runs([solved.path], tmp_path / "release", form="parquet", **PACK)
    release = Release.open(tmp_path / "release")
    with pytest.raises(Contradiction, match="the right hand is not at its grasp"):
        arm_poses(release)


@pytest.mark.parametrize(("accepted", "legal"), [(0.004, False), (0.0092, True), (1.0, False)])
def test_a_hand_may_be_as_far_off_as_the_solver_was_told_to_accept(
    solved: Run, tmp_path, accepted, legal
):
    off = 0.01 if accepted < 0.01 else 0.02  # beyond 1 cm no rig is believed
    task = solved.tasks[0]
    path = shard_path(solved.arms_folder(), task.task_id)
    arms = solved.task_arms(task, solved.task_batch(task))
    told = {n: c.copy() for n, c in arms.columns.items()}
    told["ik_error_pos"][:, 1, KEY_FRAMES.index("grasp")] = off
    write_shard(path, GraspBatch(arms.header, told).to_arrow(), solved.arms_mark())
    path = shard_path(solved.stage_folder("rows"), solved.tasks[0].task_id)
    batch = GraspBatch.from_arrow(read_shard(path))
    moved = {n: c.copy() for n, c in batch.columns.items()}
    moved["hand_pos"][:, 1, 1, 0] += off
    write_shard(path, GraspBatch(batch.header, moved).to_arrow(), solved.fingerprint)
    pack_runs([solved.path], tmp_path / "release", form="parquet", **PACK)
    release = Release.open(tmp_path / "release")
    rig = release.path / "rigs" / "made" / "rig.json"
    document = json.loads(rig.read_text())
    document["config"]["ik"]["accept_pos"] = accepted
    rig.write_text(json.dumps(document))
    if legal:
        assert "at most 10.00 mm" in arm_poses(release)
    else:
        with pytest.raises(Contradiction, match="the right hand is not at its grasp"):
            arm_poses(release)


@pytest.mark.parametrize("name", ["accept_pos", "accept_rot"])
@pytest.mark.parametrize("value", [0.0, 1e-9, 0.2, 10.0])
def test_what_the_solver_accepts_has_a_sensible_range(name, value):
    with pytest.raises(BadConfig, match=f"{name} must lie between"):
        IkConfig(**{name: value})
    assert IkConfig(**{name: LARGEST[name]})  # the most that verify believes


def test_run_and_release_export_the_same_motions(solved: Run, tmp_path, capsys):
    pack_runs([solved.path], tmp_path / "release", form="parquet", **PACK)
    files = []
    for source in (solved.path, tmp_path / "release"):
        out = tmp_path / f"{source.name}-csv"
        words = ["export", str(source), "--format", "trajectories-csv", "--out", str(out)]
        assert bidexdata([*words, "--quiet", "--rig", "made"]) == 0
        found = {p.relative_to(out).as_posix(): p.read_bytes() for p in out.glob("*/*.csv")}
        files.append({**found, "INDEX.csv": sorted((out / "INDEX.csv").read_bytes().splitlines())})
    assert files[0] == files[1]
    assert len(files[0]) > 1
    capsys.readouterr()
    words = ["export", str(solved.path), "--format", "trajectories-csv", "--split", "train"]
    assert bidexdata([*words, "--out", str(tmp_path / "x")]) == 3
    assert "splits are made by pack" in capsys.readouterr().err
    assert bidexdata([*words[:4], "--out", str(tmp_path / "x"), "--only", "success"]) == 3
    assert "--tests a` gives them" in capsys.readouterr().err
