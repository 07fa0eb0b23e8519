"""The stage `arms` with its own solver: the number of workers changes no byte, and grasps are taken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from made_armed import made_run, write_rig

from bidexdata.arms.chain import chain_forward
from bidexdata.cli.main import run as bidexdata
from bidexdata.record import Status
from bidexdata.record.fields import KEY_FRAMES
from bidexdata.runs.run import Run


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("workers") / "library"
    words = ["prepare", "shapes:box,bracket", "--out", str(folder), "--quiet"]
    assert bidexdata([*words, "--executor", "inline"]) == 0
    return folder


def solved(run: Run, rig: str, *executor: str) -> dict[str, bytes]:
    """Shards of the arms of a run that one command solved."""
    words = ["arms", str(run.path), "--rig", rig, "--set", "search.nodes=16", "--quiet"]
    assert bidexdata([*words, *executor]) == 0
    return {p.name: p.read_bytes() for p in (run.path / "arms").glob("*/??/*.arrow")}


def assert_workers_change_nothing(library: Path, folder: Path, rig: str, hand: str) -> Run:
    found = []
    for how in (("inline",), ("processes", "--workers", "2")):
        run = made_run(library, folder / how[0], sizes=(300, 400, 500, 600), hand=hand)
        found.append(solved(run, rig, "--executor", *how))
    assert len(found[0]) == len(run.tasks) > 1
    assert found[0] == found[1]
    return Run.open(run.path)


def assert_grasps_are_taken(run: Run) -> None:
    """Some rows have motions, which bring the hands to the rows' own poses."""
    robot, count = run.robot(), 0
    for task in run.tasks:
        rows = run.task_arms(task, run.task_batch(task))
        assert ((rows["arm_status"] == Status.NO_GRASP) == (rows["synth_status"] != 0)).all()
        ok = rows["arm_status"] == Status.OK
        count += int(ok.sum())
        for h, arm in enumerate(robot.arms):
            q = rows["arm_joints"][ok, h, KEY_FRAMES.index("grasp"), : arm.chain.joints]
            pos, _ = chain_forward(arm.chain, q.astype(float))
            off = np.linalg.norm(pos - rows["hand_pos"][ok, h, 1], axis=-1)
            assert off.max(initial=0.0) < 1e-3
    assert count >= 2, count


@pytest.mark.slow
def test_one_worker_and_two_give_the_same_bytes(library: Path, tmp_path: Path):
    rig = write_rig(tmp_path / "rig")
    assert_grasps_are_taken(assert_workers_change_nothing(library, tmp_path, str(rig), "capsule"))


@pytest.mark.slow
def test_one_worker_and_two_give_the_same_bytes_on_real_arms(library, tmp_path, menagerie):
    assert_grasps_are_taken(
        assert_workers_change_nothing(library, tmp_path, "ur10e_post", "shadow")
    )
