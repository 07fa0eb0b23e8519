"""Laws of looking on: nothing changes, and what is kept is what the rows and the judge say."""

import numpy as np
import pytest

from bidexdata.config import with_overrides
from bidexdata.hands.kinematics import hand_points
from bidexdata.record import Scene, Status
from bidexdata.synthesis.config import SynthConfig
from bidexdata.synthesis.explain import explain_attempt
from bidexdata.synthesis.pipeline import synthesize
from bidexdata.synthesis.selection import SelectionConfig, failures, judge
from bidexdata.synthesis.table import table_plane
from bidexdata.synthesis.trace import TERMS

GRASPS, CANDIDATES = 2, 4
# Stored as float32.
F32 = 1e-6
STEPS = {"approach": 20, "pregrasp": 6, "grasp": 7}
CONFIG = with_overrides(
    SynthConfig(),
    [
        "regions.anchors=60",
        *(f"optimise.{phase}.steps={n}" for phase, n in STEPS.items()),
        # Short runs end unbalanced; all that come through may be kept.
        "selection.largest_residual=100",
    ],
)


@pytest.fixture(scope="module")
def scene(obj):
    return Scene(obj.object_id, 300)


def explain(obj, hands, scene, number, config=CONFIG):
    counts = {"grasps": GRASPS, "candidates": CANDIDATES}
    return explain_attempt(obj, hands, scene, config, 3, number, run_fingerprint="r", **counts)


@pytest.fixture(scope="module")
def explained(obj, hands, scene):
    return [explain(obj, hands, scene, number) for number in range(CANDIDATES)]


def test_rows_that_were_watched_are_those_that_were_not(explained, obj, hands, scene):
    others = [scene, Scene(obj.object_id, 500)]
    counts = {"grasps": GRASPS, "candidates": CANDIDATES}
    made = synthesize(obj, hands, others, CONFIG, 3, run_fingerprint="r", **counts)
    made = made.select(made["scene_id"] == scene.scene_id)
    for one in explained:
        assert set(one.rows.columns) == set(made.columns)
        for name, column in made.columns.items():
            same = np.array_equal(one.rows[name], column, equal_nan=column.dtype.kind == "f")
            assert same, name


def test_every_step_is_seen_once_in_order_and_the_finished_grasp_last(explained):
    phases = [phase for phase, n in STEPS.items() for _ in range(n)]
    steps = [i for n in STEPS.values() for i in range(n)]
    for one in explained:
        assert list(one.trace.phase) == [*phases, "end"]
        assert one.trace.step.tolist() == [*steps, 0]


def test_a_trace_ends_in_the_energies_and_poses_of_the_row(explained):
    checked = 0
    for one in explained:
        row = np.flatnonzero(one.rows["attempt"] == one.number)
        if not len(row) or one.status is not Status.OK:
            continue
        i, last = row[0], dict(zip(TERMS, one.trace.energy[-1], strict=True))
        closure = last["closure_left"] + last["closure_right"] + last["closure_coupled"]
        for name, value in {
            "energy_qp": closure,
            "energy_distance": last["distance"],
            "energy_region": last["region"],
            "energy_pad": last["pad"],
            "energy_penetration": last["penetration"],
            "energy_self": last["self_penetration"],
        }.items():
            assert one.rows[name][i] == pytest.approx(value, rel=F32)
        at = {m.name: m for m in one.poses}
        assert list(at) == ["start", "quarter", "approach", "pregrasp", "grasp", "squeeze"]
        for s, name in enumerate(("pregrasp", "grasp", "squeeze")):
            np.testing.assert_allclose(one.rows["hand_pos"][i, :, s], at[name].position, atol=F32)
            for h, joints in enumerate(at[name].joints):
                stored = one.rows["joints"][i, h, s, : len(joints)]
                np.testing.assert_allclose(stored, joints, atol=F32)
        checked += 1
    assert checked


def test_a_start_hangs_where_it_was_placed_and_the_way_goes_on_from_there(explained):
    for one in explained:
        start, quarter = one.poses[0], one.poses[1]
        np.testing.assert_allclose(
            start.position, one.attempts.placed.hand_pos[one.number], atol=F32
        )
        assert np.min(np.concatenate(start.gaps)) > 0
        assert start.depth == 0
        assert not np.array_equal(start.position, quarter.position)


def test_the_weighted_sum_leaves_out_what_a_phase_does_not_have(explained):
    trace = explained[0].trace
    closed = np.isfinite(trace.energy[:, TERMS.index("closure_left")])
    assert closed.tolist() == [p in ("approach", "end") for p in trace.phase]
    for total, energy in zip(trace.total(), trace.energy, strict=True):
        parts = [w * e for w, e in zip(trace.weight, energy, strict=True) if np.isfinite(e)]
        assert total == pytest.approx(sum(parts))


def test_the_best_ranks_are_kept(explained):
    ranks = [one.rank for one in explained if one.rank is not None]
    assert sorted(ranks) == list(range(1, len(ranks) + 1))
    for one in explained:
        kept = one.rank is not None and one.rank <= GRASPS
        assert bool(one.found.selected[one.number]) is kept


def test_an_attempt_without_a_pair_has_nothing_to_show(obj, hands, scene):
    config = with_overrides(CONFIG, ["regions.gap=1.0", "regions.wide=10"])
    one = explain(obj, hands, scene, 1, config)
    assert one.status is Status.NO_REGION_PAIR
    assert (one.poses, one.trace, one.finished, one.rank) == ((), None, None, None)


def test_an_attempt_without_a_start_shows_its_last_draw(obj, hands):
    height = (0.0, 0.0, float(obj.rest_heights[0]) * 0.15)
    quat = tuple(float(x) for x in obj.rest_quats_wxyz[0])
    table = Scene(obj.object_id, 150, "tabletop", 0, height, quat)
    config = with_overrides(CONFIG, ["placement.table_raise=0", "placement.draws=1"])
    status = explain(obj, hands, table, 0, config).found.status
    number = int(np.argmax(status == Status.NO_PLACEMENT))
    one = explain(obj, hands, table, number, config)
    assert one.status is Status.NO_PLACEMENT
    assert [m.name for m in one.poses] == ["start"]
    assert (one.trace, one.finished, one.rank) == (None, None, None)
    lowest = 1.0
    for h, hand in enumerate(hands):
        start = one.poses[0]
        at = hand_points(hand, start.joints[h], start.position[h], start.quat_wxyz[h])
        up = at.sphere @ table_plane(table)[:3] + table_plane(table)[3]
        lowest = min(lowest, float(np.min(up - hand.sphere_radius)))
    clear = lowest >= config.placement.clearance - F32
    assert bool(one.attempts.placed.above[number]) is clear


def test_the_first_reason_that_holds_is_the_status():
    rng, config, n = np.random.default_rng(0), SelectionConfig(), 500
    finite = rng.random(n) < 0.8
    gaps = rng.uniform(-0.02, 0.02, (n, 2, 5))
    depth, among, table = rng.uniform(0, 0.02, (3, n))
    overlaps = {"among_hands": among, "table": table}
    status = judge(finite, gaps, depth, config, **overlaps)
    found = failures(finite, gaps, depth, config, **overlaps)
    for i in range(n):
        reasons = [r for r, failed in found.items() if failed[i]]
        assert status[i] == (reasons[0] if reasons else Status.OK)
    assert {Status(s) for s in status} == {*found, Status.OK}
