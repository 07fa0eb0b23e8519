"""`bidexdata bench speed`: every figure is of work that was done."""

from __future__ import annotations

import json
import time

from typer.testing import CliRunner

from bidexdata.cli.main import app
from bidexdata.config import with_overrides
from bidexdata.hands import load_hands
from bidexdata.objects.prepare import prepare_object
from bidexdata.runs import bench_stages
from bidexdata.runs.bench_stages import Amounts, stage_speeds, step_microseconds
from bidexdata.synthesis.config import SynthConfig

FEW = Amounts(families=("box",), sizes_mm=(400,), attempts=4)


def test_rates_are_of_the_time_that_passed():
    start = time.perf_counter()
    found = stage_speeds(amounts=FEW)
    passed = time.perf_counter() - start
    grasps = found["attempts"] * found["attempts_with_a_grasp"]
    own = (
        found["prepare_seconds"]
        + found["attempts"] / found["attempts_per_second"]
        + grasps / found["verdicts_per_second"]
    )
    assert (found["objects"], found["attempts"]) == (1, 4)
    assert 0 < own < passed
    assert 0 < found["suc_f"] <= 1
    assert found["microseconds_per_bimanual_step"] > 0


def test_without_a_start_there_is_no_cost_of_a_step(monkeypatch):
    # No two regions are a metre apart.
    nowhere = with_overrides(SynthConfig(), ["regions.gap=1.0", "regions.wide=10"])
    monkeypatch.setattr("bidexdata.synthesis.config.SynthConfig", lambda: nowhere)
    assert step_microseconds(prepare_object("shapes:box"), load_hands("capsule"), [400], 2) is None


def test_the_command_prints_what_was_measured(monkeypatch):
    monkeypatch.setattr(bench_stages, "Amounts", lambda: FEW)
    ran = CliRunner().invoke(app, ["bench", "speed", "--json"])
    assert ran.exit_code == 0, ran.output
    keys = json.loads(ran.stdout)
    assert keys["attempts"] == FEW.attempts
    assert keys["verdicts_per_second"] > 0
