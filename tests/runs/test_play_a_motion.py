"""The script of docs/arms.md plays an exported motion: hands come to where the chains bring them."""

from __future__ import annotations

import re
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from made_armed import made_run, write_rig

from bidexdata.arms.chain import chain_forward
from bidexdata.arms.solutions import no_solutions
from bidexdata.cli.main import run as bidexdata
from bidexdata.record import Status
from bidexdata.runs.arms import arms_run
from bidexdata.runs.run import Run
from bidexdata.runs.stage import TaskExecution
from bidexdata.runs.trajectories import export_trajectories

PAGE = Path(__file__).resolve().parents[2] / "docs" / "arms.md"
TICK = 0.02
"""From one picture of the script to the next [s]; the last is less before the end."""
SECONDS, END = 0.5, 0.4


def swung(robot, field, scenes, targets, config, device="cpu"):
    """In place of the solver: all joints turn by END [rad] in SECONDS."""
    found = [no_solutions(robot, config, len(t.hand_pos), Status.OK) for t in targets]
    for one in found:
        knots = one.arm_path.shape[2]
        one.arm_time[:] = np.linspace(0, SECONDS, knots)
        for h, arm in enumerate(robot.arms):
            own = len(arm.chain.joint_names)
            one.arm_path[:, h, :, :own] = np.linspace(0, END, knots)[:, None]
    return found


def script(run: Path, folder: Path) -> str:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert code.count('"RUN"') == code.count('"DIR"') == 1
    return code.replace('"RUN"', repr(str(run))).replace('"DIR"', repr(str(folder)))


@pytest.mark.slow
def test_the_script_brings_hands_and_object_to_their_places(tmp_path: Path, monkeypatch):
    module = types.ModuleType("bidexdata.arms.solve")
    module.solve_scenes = swung  # ty: ignore
    monkeypatch.setitem(sys.modules, "bidexdata.arms.solve", module)
    sources = ("prepare", "shapes:box", "--out", str(tmp_path / "library"))
    assert bidexdata([*sources, "--executor", "inline", "--quiet"]) == 0
    run = made_run(tmp_path / "library", tmp_path / "run", sizes=(300,))
    rig = write_rig(tmp_path / "rig")
    arms_run(run, rig, execution=TaskExecution(executor="inline", quiet=True))
    export_trajectories(run.path, tmp_path / "csv", "csv", quiet=True)
    found: dict = {}
    exec(compile(script(run.path, tmp_path / "csv"), "arms.md", "exec"), found)

    run, model, data = Run.open(run.path), found["model"], found["data"]
    assert found["time"][-1] - found["seconds"] <= TICK + 1e-9
    angle = END * found["seconds"] / found["time"][-1]
    for h, arm in enumerate(run.robot().arms):
        at, _ = chain_forward(arm.chain, np.full((1, arm.chain.joints), angle))
        hand = data.body(f"hand{h}/{run.hands()[h].root_body}").xpos
        np.testing.assert_allclose(hand, at[0], atol=1e-6)
    rows = run.task_batch(run.tasks[0])
    np.testing.assert_allclose(data.xpos[-1], rows.object_pos[0], atol=1e-6)
    assert model.geom_bodyid.tolist().count(model.nbody - 1) == len(found["solid"].pieces)
