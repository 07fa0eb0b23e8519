"""What is counted, compared and written when systems are judged."""

from __future__ import annotations

import json

import numpy as np
import pytest
from bidexgrasp_model.ablation import ROWS, ablate
from bidexgrasp_model.enough import count
from bidexgrasp_model.evaluation import EvalRequest, evaluate
from bidexgrasp_model.judging import Judged, diversity, figures, paired
from bidexgrasp_model.report import markdown
from bidexgrasp_model.systems import (
    AS_SAMPLED,
    BEST,
    DIRECT,
    FULL,
    PAPER_ORDER,
    SYNTHESIS,
    TRANSFER,
    System,
)
from bidexgrasp_model.training import TrainRequest


def judged(success, objects):
    n = len(success)
    return Judged(
        scene_id=np.array([f"{o}/300/table0" for o in objects]),
        object_id=np.array(objects),
        size_mm=np.full(n, 300),
        success={"l": np.array(success, bool)},
        means={"pd": np.full(n, 0.01), "spd": np.full(n, 0.0), "cdc": np.full(n, np.nan)},
        vectors=np.zeros((n, 4)),
    )


OBJECTS = ["a", "a", "b", "b", "c", "c"]


def test_rates_and_lengths_are_means_over_rows():
    found = figures(judged([1, 1, 1, 0, 0, 0], OBJECTS))
    assert found["n"] == 6
    assert found["suc_l"]["mean"] == 0.5
    assert found["suc_l"]["low"] <= 0.5 <= found["suc_l"]["high"]
    assert found["pd"]["mean"] == pytest.approx(0.01)
    assert found["cdc"]["mean"] is None
    assert found["by_size"]["300"]["suc_l"]["mean"] == 0.5


def test_differences_are_paired_by_object():
    a, b = judged([1, 1, 1, 1, 0, 0], OBJECTS), judged([1, 0, 1, 0, 0, 0], OBJECTS)
    found = paired(a, b, "l")
    assert found["difference"] == pytest.approx(2 / 6)
    assert found["objects"] == 3
    assert paired(b, a, "l")["difference"] == pytest.approx(-2 / 6)
    same = paired(a, a, "l")
    assert (same["difference"], same["low"]) == (0, None), "what never differs has no interval"
    with pytest.raises(ValueError, match="cannot be paired"):
        paired(a, judged([1, 1, 1, 1, 1], OBJECTS[:5]), "l")


def test_diversity_is_the_share_of_the_first_component():
    rng = np.random.default_rng(0)
    line = rng.normal(size=(50, 1)) * np.ones((1, 3))
    assert diversity(line) == pytest.approx(1.0)
    ball = rng.normal(size=(20_000, 4))
    assert diversity(ball) == pytest.approx(0.25, abs=0.01)
    assert diversity(line[:1]) is None


def row(mean):
    rate = {"n": 10, "mean": mean, "low": mean - 0.1, "high": mean + 0.1}
    length = {"n": 10, "mean": 0.012, "low": 0.01, "high": 0.02}
    both = {"suc_l": rate, "pd": length, "spd": length, "cdc": length, "d": 0.2, "n": 10}
    return {**both, "by_size": {"300": both}, "by_verdict": {}}


def step(difference, low, high):
    return {"l": {"difference": difference, "low": low, "high": high, "objects": 5}}


def page(rates, steps=()):
    systems = {name: row(r) for name, r in rates.items()}
    systems[TRANSFER]["reference_minus_this"] = {
        "l": {"difference": 0.3, "low": 0.2, "high": 0.4, "objects": 5}
    }
    release = {"name": "small", "version": "1.0.0"}
    return markdown(
        {"release": release, "objects": 5, "scenes": 10, "samples": 3, "tests": ["l"],
         "systems": systems, "reference": FULL, "order": {"": None, AS_SAMPLED: steps}}
    )  # fmt: skip


def test_the_page_says_how_often_and_whether_the_paper_s_order_appears():
    rising = {**dict(zip(PAPER_ORDER, (0.1, 0.2, 0.3, 0.6), strict=True)), TRANSFER: 0.3}
    text = page(rising)
    assert "| 0.30 m |" in text
    assert f"| {FULL} | 60.0 (50.0-70.0) | 1.20 | 1.20 | 1.20 | 0.200 |" in text
    assert f"{FULL} has 2.00 times the success of {TRANSFER}" in text
    assert f"{FULL} minus {TRANSFER}: +30.0 points (+20.0 to +40.0)" in text
    assert "order" not in text, "where rows are missing nothing is said of their order"
    rows = (step(0.1, -0.1, 0.2), step(0.1, 0.05, 0.2), step(0.3, 0.2, 0.4))
    text = page(rising, rows)
    assert f"({' < '.join(PAPER_ORDER)}){AS_SAMPLED} appears here" in text
    assert (
        "+10.0, +10.0, +30.0 points; of their intervals 2 lie above zero, 0 below, 1 hold" in text
    )
    text = page(rising, (step(-0.1, -0.2, -0.05), *rows[1:]))
    assert "does not appear here" in text
    assert "2 lie above zero, 1 below, 0 hold zero" in text


def test_enough_counts_selected_grasps_that_passed(release):
    grasps, objects = count(release)
    assert 0 < objects <= grasps


@pytest.fixture(scope="module")
def asked(release, trained, tmp_path_factory) -> EvalRequest:
    systems = (
        System(FULL, "model", trained),
        System(DIRECT, "model", trained, {"model.coordination": "direct"}),
        System(TRANSFER, "transfer", trained),
        System(SYNTHESIS, "synthesis"),
    )
    return EvalRequest(
        release=release, out=tmp_path_factory.mktemp("judged"), systems=systems, reference=FULL,
        samples=1, objects=1, tests=("l",), workers=1, quiet=True,
    )  # fmt: skip


@pytest.mark.slow
def test_systems_are_judged_on_the_same_scenes_and_a_second_call_changes_nothing(asked):
    found = evaluate(asked, say=lambda _: None)
    systems = found["systems"]
    assert list(systems) == [FULL, DIRECT, TRANSFER, SYNTHESIS]
    assert {systems[n]["n"] for n in (FULL, DIRECT, TRANSFER)} == {found["scenes"]}
    assert systems[FULL]["seconds_per_64"] > 0
    assert 0 <= systems[FULL]["views"]["right_top1"] <= systems[FULL]["views"]["right_top5"] <= 1
    assert "reference_minus_this" in systems[DIRECT]
    assert json.loads((asked.out / "results.json").read_text("utf-8"))["scenes"] == found["scenes"]
    runs = sorted((asked.out / "runs").rglob("*.arrow"))
    assert len(runs) >= 6, "grasps and verdicts of three systems"
    before = [p.stat().st_mtime_ns for p in runs]
    again = evaluate(asked, say=lambda _: None)
    assert [p.stat().st_mtime_ns for p in runs] == before, "runs that are there are kept"
    for name, one in systems.items():
        assert again["systems"][name]["suc_l"] == one["suc_l"]


@pytest.mark.slow
def test_the_ablation_trains_every_row_and_a_second_call_trains_none(
    release, config, asked, tmp_path
):
    request = TrainRequest(release=release, out=tmp_path, config=config, steps=1, quiet=True)
    judging = EvalRequest(
        release=release, out=tmp_path, systems=(), samples=1, objects=1, tests=("l",), workers=1,
        quiet=True,
    )  # fmt: skip
    said: list[str] = []
    found = ablate(request, judging, said.append)
    assert {*ROWS, BEST, DIRECT, TRANSFER, SYNTHESIS} == set(found["systems"])
    assert sum("training" in line for line in said) == len(ROWS)
    said.clear()
    assert ablate(request, judging, said.append)["systems"].keys() == found["systems"].keys()
    assert not any("training" in line for line in said)
