"""Laws of the figures that `benchmarks.arm_give` prints."""

from __future__ import annotations

import math

import pytest

from benchmarks.arm_give import WELD, Carrying, Given, parse_gain, summary, table

NAN = math.nan


def given(name: str, carrier: str, status: str, mm: float) -> Given:
    wrist = [NAN, NAN] if carrier == WELD else [math.radians(2.0)] * 2
    pose = [mm / 1e3] * 2, [math.radians(1.0)] * 2, wrist
    speed = [NAN if carrier == WELD else 0.1] * 2
    return Given(
        name, 300, carrier, status, *pose, [5.0, 7.0], speed, NAN if carrier == WELD else 0.25
    )


def test_passes_are_counted_and_compared_with_those_on_the_weld():
    rows = [
        *(given("a", WELD, "ok", 1.0), given("b", WELD, "ok", 2.0), given("c", WELD, "slip", 3.0)),
        *(given("a", "arms", "ok", 2.0), given("b", "arms", "slip", 4.0)),
        given("c", "arms", "ok", 6.0),
    ]
    found = summary(rows)
    assert list(found) == [WELD, "arms"]
    assert (found[WELD]["passed"], found[WELD]["passed_of_held"]) == (2, 2)
    assert (found["arms"]["passed"], found["arms"]["passed_of_held"]) == (2, 1)
    assert found["arms"]["failed"] == {"slip": 1}
    assert found["arms"]["shift_mm_median"] == pytest.approx(4.0)
    assert found["arms"]["turn_deg_median"] == pytest.approx(1.0)
    assert found[WELD]["wrist_deg_median"] is None
    assert found["arms"]["force_n_median"] == pytest.approx(6.0)
    lines = table(found).splitlines()
    assert len({line.count("|") for line in lines}) == 1
    assert "| arms | 3 | 2 | 1 of 2 | 0.10 (0.10) | 25.0 | 4.00 " in lines[-1]


def test_a_grasp_that_is_not_closed_counts_without_figures():
    lost = Given("d", 300, "arms", "thrown", *[[NAN] * 2] * 5, NAN)
    found = summary([given("a", "arms", "ok", 2.0), lost])["arms"]
    assert (found["rows"], found["passed"], found["shift_mm_median"]) == (2, 1, pytest.approx(2.0))
    assert "thrown" in summary([lost])["arms"]["failed"]
    assert "-" in table(summary([lost]))


def test_gains_are_one_number_or_two():
    assert parse_gain("4") == (4.0, 4.0)
    assert parse_gain("1:0.5") == (1.0, 0.5)
    assert str(Carrying(4.0, 4.0)) == "arms, gains x 4"
    assert str(Carrying(1.0, 4.0, bound=False)) == "arms, gains x 1, wrist x 4, without the bound"
