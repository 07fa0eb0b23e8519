"""What benchmarks make of times and verdicts."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.baselines import tables
from benchmarks.end_to_end import Cost, scenes_that_pass, speeds
from benchmarks.reach import Judged, tallies
from benchmarks.selection import tuned_on
from benchmarks.throughput import Done, speed_of
from bidexdata.record import GraspBatch, Header, Status


def test_each_worker_counts_from_the_end_of_its_own_first_task_on():
    done = [Done(1, 10.0, 120, 9.0), Done(1, 12.0, 120, 1.2), Done(2, 14.0, 120, 9.0)]
    done += [Done(1, 14.5, 120, 1.2), Done(2, 15.0, 60, 0.6)]
    speed = speed_of(done)
    assert speed is not None
    assert speed.per_second == pytest.approx(240 / 5 + 60 / 1)
    assert speed.cpu_seconds == pytest.approx(3.0 / 300)


@pytest.mark.parametrize("processes", [[], [1], [1, 2], [1, 1, 2]])
def test_there_is_no_speed_where_a_worker_has_done_no_second_task(processes: list[int]):
    assert speed_of([Done(p, float(k), 120, 1.0) for k, p in enumerate(processes)]) is None


def test_both_kinds_of_validated_grasps_have_all_of_the_time():
    assert speeds({"raw": 40, "selected": 60}, Cost(1.0, 2.0), Cost(4.0, 6.0)) == {
        "validated_raw_per_second": 8.0,
        "validated_raw_per_cpu_second": 5.0,
        "validated_selected_per_second": 12.0,
        "validated_selected_per_cpu_second": 7.5,
    }


def test_constants_were_tuned_on_the_first_half_of_the_digits():
    names = ["mug-0a", "a-b-7f00", "9-8e", "7-f0"]
    assert [tuned_on(name) for name in names] == [True, True, False, False]


def test_a_scene_passes_when_it_has_selected_rows_and_all_of_them_pass():
    # A passes: its failed row is an audit row. B has a selected row that fails, C none, D no row.
    scenes, selected = np.array([*"AAABBC"]), np.array([1, 1, 0, 1, 1, 0], bool)
    rows = GraspBatch(
        Header((), counts={name: {"ok": 8} for name in "DCBA"}),
        {"scene_id": scenes, "selected": selected},
    )
    success = np.array([1, 1, 0, 1, 0, 1], bool)
    assert scenes_that_pass(rows, success) == [True, False, False, False]


def test_the_comparison_has_a_dash_where_nothing_was_timed_or_nothing_passed():
    rate = {"rate": 0.5, "low": 0.4, "high": 0.6}
    one = {"unselected": rate, "selected": rate, "kept": 1.0, "pd": 0.001, "by_size": {"300": 0.5}}
    methods = {
        "bidexgrasp": {**one, "per_cpu_second": 60.0, "successes_per_cpu_second": 30.0},
        "bodex": {**one, "per_cpu_second": 20.0, "successes_per_cpu_second": 0.0},
        "bimangrasp": {**one, "per_cpu_second": None, "successes_per_cpu_second": None},
    }
    _, _, ours, slow, untimed, *_ = tables({"methods": methods, "sizes_mm": [300]})
    assert ours.endswith("| 60.00 | 30.00 | 1.00 grasps, 1.00 successes |")
    assert slow.endswith("| 20.00 | 0.00 | 3.00 grasps, - successes |")
    assert untimed.endswith("| - | - | - grasps, - successes |")


def test_reach_counts_grasps_that_lift_and_what_the_arms_make_of_all_rows():
    ok, jump, self_, slip = (
        int(s) for s in (Status.OK, Status.JUMP, Status.COLLISION_SELF, Status.SLIP)
    )
    size = np.array([300, 300, 500, 500])
    arms, lifts = np.array([ok, jump, ok, ok]), np.array([1, 1, 1, 0], bool)
    rows = [
        Judged("a-00", size, arms, lifts, np.array([ok, jump, self_, slip])),
        Judged("b-00", size[:1], np.array([jump]), None, None),  # no test was run
    ]
    found = tallies(iter(rows))
    assert list(found) == ["0.30 m", "0.50 m", "all"]
    whole = found["all"]
    rates = {
        name: (r.k, r.n)
        for name in ("lift_reached/lift", "good/rows", "reached/rows", "good_reached/reached")
        for r in [whole.rate(*name.split("/"))]
    }
    assert rates == {
        "lift_reached/lift": (2, 3),
        "good/rows": (1, 4),
        "reached/rows": (3, 4),
        "good_reached/reached": (1, 3),
    }
    assert dict(whole.arms) == {"ok": 2, "jump": 1}
    assert dict(whole.verdicts) == {"jump": 1, "collision_self": 1, "slip": 1}
