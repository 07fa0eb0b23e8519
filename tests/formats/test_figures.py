"""Rates by their definitions, counted by hand."""

from pathlib import Path

import numpy as np
import pytest
from made_release import made_hands

from bidexdata.formats.figures import Tally
from bidexdata.record import GraspBatch, Header, Status
from bidexdata.record.status import TestStage

HEADER_HANDS = tuple(h.header() for h in made_hands())


def _setting(scene):
    return "floating" if scene.endswith("/float") else "tabletop"


def batch(rows, counts=None):
    """Rows of (scene, selected, audit, status)."""
    scenes = [r[0] for r in rows]
    return GraspBatch(
        Header(HEADER_HANDS, counts=counts or {}),
        {
            "grasp_id": np.array([str(i) for i in range(len(rows))]),
            "scene_id": np.array(scenes, dtype=np.str_),
            "object_id": np.array([s.split("/")[0] for s in scenes], dtype=np.str_),
            "size_mm": np.array([s.split("/")[1] for s in scenes], np.int32),
            "setting": np.array([_setting(s) for s in scenes], dtype=np.str_),
            "selected": np.array([r[1] for r in rows], bool),
            "audit": np.array([r[2] for r in rows], bool),
            "synth_status": np.array([r[3] for r in rows], np.int8),
        },
    )


def verdicts(success, pd=None):
    n = len(success)
    return {
        "f": {
            "success": np.array(success, bool),
            "verdict_status": np.where(success, Status.OK, Status.SLIP).astype(np.int8),
            **{m: np.array(pd or [0.001] * n, np.float32) for m in ("pd", "spd", "cdc")},
        }
    }


A, B = "box-1/300/float", "box-1/500/float"


def test_a_scene_is_without_grasp_until_some_batch_has_a_selected_row_of_it():
    tally = Tally()
    assert tally.without_grasp() == []
    tally.add(batch([(B, False, True, Status.OK)], {A: {"no_placement": 8}, B: {"ok": 8}}))
    assert tally.without_grasp() == [A, B]  # one without rows, one with an audit row alone
    tally.add(batch([(B, True, False, Status.OK)], {B: {"ok": 8}}))
    assert tally.without_grasp() == [A]


def test_a_scene_is_a_success_when_one_selected_row_of_it_is():
    other = "cup-1/300/float"
    tally = Tally()
    for good in (False, True):  # scene A loses in one batch and wins in the next
        tally.add(batch([(A, True, False, Status.OK)] * 2), verdicts([False, good]), run="r")
    tally.add(
        batch([(B, True, False, Status.OK), (B, False, True, Status.OK)]), verdicts([False, True])
    )
    tally.add(batch([(other, True, False, Status.OK)] * 3), verdicts([True, True, False]))
    tally.add(batch([("mug-1/300/float", True, False, Status.OK)]))  # not tested
    found = tally.figures()["tests"]["f"]
    assert (found["object_success"]["k"], found["object_success"]["n"]) == (2, 3)
    assert found["object_success"]["rate"] == pytest.approx(2 / 3)
    assert (found["selected"]["k"], found["selected"]["n"]) == (3, 8)


def test_rates_and_kept_share_by_hand():
    rows = [
        (A, True, False, Status.OK),
        (A, True, True, Status.OK),
        (A, False, True, Status.NO_PLACEMENT),
        (B, True, True, Status.OK),
    ]
    tally = Tally()
    counts = {A: {"ok": 5, "no_placement": 3}, B: {"ok": 1, "no_placement": 7}}
    tally.add(batch(rows, counts), verdicts([True, False, False, True]), run="r", grasps=2)
    figures = tally.figures()
    # Selected: rows 0, 1, 3, of which 0 and 3 pass. Unselected: 1 success of N x scenes = 4; scene
    # B filled one of its two audit rows, the other is a failure. Kept: 3 of 4.
    assert (figures["tests"]["f"]["selected"]["k"], figures["tests"]["f"]["selected"]["n"]) == (
        2,
        3,
    )
    assert (figures["tests"]["f"]["unselected"]["k"], figures["tests"]["f"]["unselected"]["n"]) == (
        1,
        4,
    )
    assert figures["kept"] == pytest.approx(3 / 4)
    assert figures["suc_f"] == pytest.approx(2 / 3)
    assert figures["by_status"] == {"no_placement": 10, "ok": 6}
    assert figures["by_size"]["300"]["kept"] == 1
    assert figures["by_size"]["500"]["kept"] == 0.5
    assert figures["by_size"]["500"]["unselected_f"]["n"] == 2
    assert (figures["n"], figures["selected_rows"], figures["audit_rows"]) == (4, 3, 3)
    assert (figures["objects"], figures["scenes"]) == (1, 2)


def test_attempts_and_energies_are_told_per_size_and_stage():
    rows = [
        (A, True, False, Status.OK),
        (A, True, False, Status.OK),
        (A, False, True, Status.OK),
        (B, True, False, Status.OK),
        (B, False, True, Status.CONTACT_LOST),
    ]
    counts = {A: {"ok": 5, "no_placement": 3}, B: {"ok": 1, "contact_lost": 2, "not_finite": 4}}
    energy = np.array([1.0, 2.0, 99.0, 5.0, np.nan], np.float32)
    told = batch(rows, counts).with_columns(energy_qp=energy)
    tally = Tally()
    tally.add(told, run="r", grasps=2)
    figures = tally.figures()
    nothing = {"regions": 0, "placement": 0, "optimisation": 0, "checks": 0, "ok": 0}
    assert figures["by_stage"] == {
        **nothing,
        "placement": 3,
        "optimisation": 4,
        "checks": 2,
        "ok": 6,
    }
    small, large = figures["by_size"]["300"], figures["by_size"]["500"]
    assert small["by_status"] == {"no_placement": 3, "ok": 5}
    assert small["by_stage"] == {**nothing, "placement": 3, "ok": 5}
    assert large["by_stage"] == {**nothing, "optimisation": 4, "checks": 2, "ok": 1}
    # Selected rows alone: 1 and 2 of the small, 5 of the large.
    assert small["energies"]["energy_qp"] == 1.5
    assert large["energies"]["energy_qp"] == 5
    assert figures["energies"]["energy_qp"] == pytest.approx(8 / 3)
    assert figures["energies"]["energy_pad"] is None


def test_settings_are_told_apart_and_together():
    table = "box-1/300/table0"
    tally = Tally(("f", "l"))
    floating = batch([(A, True, True, Status.OK), (A, False, True, Status.OK)], {A: {"ok": 8}})
    tally.add(floating, verdicts([True, False], [0.001, 0.009]), run="r", grasps=2)
    on_table = batch([(table, True, True, Status.OK)], {table: {"ok": 1, "no_placement": 7}})
    lifted = {"f": verdicts([False], [0.003])["f"], "l": verdicts([True])["f"]}
    tally.add(on_table, lifted, run="s", grasps=2)
    found = tally.figures()
    apart = found["by_setting"]
    assert list(apart) == ["floating", "tabletop"]

    def counts(figures, key):
        return figures[key]["k"], figures[key]["n"]

    assert counts(apart["floating"], "selected_f") == (1, 1)
    assert counts(apart["floating"], "unselected_f") == (1, 2)
    assert counts(apart["tabletop"], "selected_f") == (0, 1)
    assert counts(apart["tabletop"], "unselected_f") == (0, 2)  # one audit row of two wanted
    assert counts(apart["floating"], "selected_l") == (0, 0)  # never lifted
    assert counts(apart["tabletop"], "selected_l") == (1, 1)
    assert [a["scenes"] for a in apart.values()] == [1, 1]
    assert [(a["selected_rows"], a["audit_rows"]) for a in apart.values()] == [(1, 2), (1, 1)]
    assert [a["kept"] for a in apart.values()] == [0.5, 0.5]
    assert [a["pd"] for a in apart.values()] == pytest.approx([0.001, 0.003])
    assert counts(found["by_size"]["300"], "selected_f") == (1, 2)
    assert counts(apart["tabletop"]["by_size"]["300"], "selected_f") == (0, 1)
    assert set(found["tests"]["f"]["groups"]["setting"]) == {"floating", "tabletop"}


def test_a_scene_without_rows_counts_n_failures():
    tally = Tally()
    counts = {A: {"ok": 1}, B: {"no_region_pair": 8}}
    tally.add(batch([(A, True, True, Status.OK)], counts), verdicts([True]), run="r", grasps=1)
    figures = tally.figures()
    assert (figures["tests"]["f"]["unselected"]["k"], figures["tests"]["f"]["unselected"]["n"]) == (
        1,
        2,
    )
    assert figures["by_size"]["500"]["unselected_f"] == {
        "k": 0, "n": 1, "rate": 0.0, "low": 0.0,
        "high": figures["by_size"]["500"]["unselected_f"]["high"], "method": "wilson",
    }  # fmt: skip


def test_success_of_a_failed_attempt_does_not_count():
    tally = Tally()
    tally.add(batch([(A, False, True, Status.NOT_FINITE)]), verdicts([True]), run="r", grasps=1)
    assert tally.figures()["tests"]["f"]["unselected"]["k"] == 0


def test_imported_rows_have_no_unselected_rate():
    tally = Tally()
    tally.add(batch([(A, True, False, Status.OK)]), verdicts([True]), run="r", grasps=None)
    figures = tally.figures()
    assert figures["tests"]["f"]["unselected"]["n"] == 0
    assert figures["tests"]["f"]["unselected"]["rate"] is None
    assert figures["kept"] is None


def test_untested_rows_are_in_no_rate():
    tally = Tally()
    tally.add(batch([(A, True, True, Status.OK)]), {}, run="r", grasps=1)
    figures = tally.figures()
    assert figures["tests"]["f"]["selected"]["n"] == 0
    assert figures["tests"]["f"]["unselected"]["n"] == 0
    assert figures["suc_f"] is None
    assert figures["pd"] is None


def test_a_scene_grown_in_two_rounds_counts_its_target_once():
    one = batch([(A, True, True, Status.OK)], {A: {"ok": 4}})
    tally = Tally()
    tally.add(one, verdicts([True]), run="r", grasps=2)
    tally.add(one, verdicts([True]), run="r", grasps=2)
    assert (tally.figures()["tests"]["f"]["unselected"]["n"]) == 2
    assert tally.figures()["scenes"] == 1
    other_run = Tally()
    other_run.add(one, verdicts([True]), run="r", grasps=2)
    other_run.add(one, verdicts([True]), run="s", grasps=2)
    assert (other_run.figures()["tests"]["f"]["unselected"]["n"]) == 4


def test_a_scene_of_two_runs_is_one_scene_and_two_targets():
    tally = Tally()
    both = batch([(A, True, True, Status.OK), (B, True, True, Status.OK)])
    tally.add(both, verdicts([True, True]), run="r", grasps=2)
    tally.add(batch([(A, True, True, Status.OK)]), verdicts([True]), run="s", grasps=2)
    figures = tally.figures()
    assert (figures["objects"], figures["scenes"]) == (1, 2)
    # Three kept grasps where three pairs of run and scene wanted two each.
    assert figures["kept"] == pytest.approx(3 / 6)
    assert figures["by_size"]["300"]["kept"] == pytest.approx(2 / 4)


def test_metrics_are_means_over_selected_rows_that_were_measured():
    rows = [(A, True, False, Status.OK), (A, True, False, Status.OK), (A, False, True, Status.OK)]
    tally = Tally()
    tally.add(batch(rows), verdicts([True] * 3, [0.002, np.nan, 0.5]), run="r", grasps=2)
    assert tally.figures()["pd"] == pytest.approx(0.002)
    assert tally.figures()["by_size"]["300"]["cdc"] == pytest.approx(0.002)


def test_success_with_arms_is_the_share_they_reach_times_the_success_of_those():
    rows = [
        *[(A, True, True, Status.OK)] * 5,
        (A, True, False, Status.OK),
        (A, False, True, Status.NO_PLACEMENT),
        (B, False, True, Status.OK),
    ]
    statuses = [
        *(Status.OK, Status.OK, Status.IK_LIFT, Status.SLIP),
        Status.COLLISION_ARMS,  # while it was simulated
        *(Status.COLLISION_OBJECT, Status.NOT_RUN, Status.OK),
    ]
    stages = [*(TestStage.NONE,) * 3, TestStage.HOLD, TestStage.APPROACH, *(TestStage.NONE,) * 3]
    arms = verdicts([status is Status.OK for status in statuses])["f"] | {
        "verdict_status": np.array(statuses, np.int8),
        "failed_stage": np.array(stages, np.int8),
    }
    lift = verdicts([True] * 3 + [False] + [True] * 2 + [False, True])["f"]
    tally = Tally(("l", "a"))
    tally.add(batch(rows), {"l": lift, "a": arms}, grasps=6)
    found = tally.figures()["tests"]["a"]

    def counts(name, kind):
        rate = found[name][kind] if name else found[kind]
        return rate["k"], rate["n"]

    # Of the six selected rows four have a motion: not those with IK_LIFT and COLLISION_OBJECT.
    assert counts("", "selected") == (2, 6)
    assert counts("reachable", "selected") == (4, 6)
    assert counts("given_reachable", "selected") == (2, 4)
    assert counts("lift_given_reachable", "selected") == (3, 4)
    # Seven audit rows of two scenes with six each to fill.
    assert counts("", "unselected") == (3, 12)
    assert counts("reachable", "unselected") == (5, 12)
    assert counts("given_reachable", "unselected") == (3, 5)
    for kind in ("selected", "unselected"):
        rate, *parts = (found[kind]["rate"], found["reachable"][kind]["rate"],
                        found["given_reachable"][kind]["rate"])  # fmt: skip
        assert rate == pytest.approx(np.prod(parts))
    by_size = tally.figures()["by_size"]["300"]
    assert by_size["reachable_a"]["selected"] == found["reachable"]["selected"]
    assert "reachable" not in tally.figures()["tests"]["l"]


def test_every_key_of_the_figures_is_documented():
    tally = Tally(("f", "l"))
    one = batch([(A, True, True, Status.OK)])
    both = {t: verdicts([True])["f"] for t in ("f", "l")}
    tally.add(one, both, run="r", grasps=2)
    figures = tally.figures()
    page = Path(__file__).resolve().parents[2] / "docs" / "conventions.md"
    section = page.read_text(encoding="utf-8").split("\n## Figures\n")[1]
    keys = {*figures, *figures["tests"]["f"], *figures["tests"]["f"]["selected"]}
    keys |= {k for k in figures["by_size"]["300"] if not k.endswith("_l")}
    assert not [k for k in sorted(keys) if f"`{k}`" not in section]


def test_parts_add_up_whatever_the_order():
    rows_a = batch([(A, True, True, Status.OK), (A, False, True, Status.OK)], {A: {"ok": 2}})
    rows_b = batch([(B, True, True, Status.OK)], {B: {"ok": 2}})
    both = batch(
        [(A, True, True, Status.OK), (A, False, True, Status.OK), (B, True, True, Status.OK)],
        {A: {"ok": 2}, B: {"ok": 2}},
    )
    results = []
    for parts in (
        [(rows_a, [True, False]), (rows_b, [True])],
        [(rows_b, [True]), (rows_a, [True, False])],
        [(both, [True, False, True])],
    ):
        tally = Tally()
        for part, success in parts:
            tally.add(part, verdicts(success), run="r", grasps=2)
        results.append(tally.figures())
    assert results[0] == results[1] == results[2]
