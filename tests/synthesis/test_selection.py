"""Laws of the choice of attempts: what is kept follows from analytic figures alone."""

import numpy as np
import pytest

from bidexdata.record import Status
from bidexdata.synthesis.selection import (
    SelectionConfig,
    audit,
    best,
    doubts,
    judge,
    selection_order,
)
from bidexdata.synthesis.settling import Settled
from bidexdata.validation.protocols import load_protocol

CONFIG = SelectionConfig(largest_residual=0.5, clear_depth=0.001, start_depth=0.01, apart=0.0)
NOWHERE = np.zeros((1000, 2, 3))


def sample(seed=0, count=200):
    rng = np.random.default_rng(seed)
    status = rng.choice([Status.OK, Status.NO_PLACEMENT, Status.PENETRATION_LEFT], count)
    depth = rng.uniform(0, 0.003, count)
    residual = rng.uniform(0, 1, count)
    residual[status != Status.OK] = np.nan
    depth[status != Status.OK] = np.nan
    shifted = residual + rng.uniform(0, 1, count)
    return status.astype(np.int8), depth, residual, shifted


@pytest.mark.parametrize("count", [0, 1, 7, 1000])
def test_no_attempt_left_out_is_better_than_one_kept(count):
    status, depth, residual, shifted = sample()
    kept = best(status, depth, residual, shifted, NOWHERE[:200], count, CONFIG)
    able = (status == Status.OK) & (residual <= CONFIG.largest_residual)
    assert not np.any(kept & ~able)
    assert kept.sum() == min(count, able.sum())
    key = np.stack([depth > CONFIG.clear_depth, shifted], axis=1)
    if kept.any() and (able & ~kept).any():
        assert max(map(tuple, key[kept])) <= min(map(tuple, key[able & ~kept]))


def test_equal_attempts_are_kept_in_their_order():
    kept = best(np.zeros(6, np.int8), *np.zeros((3, 6)), NOWHERE[:6], 2, CONFIG)
    assert kept.tolist() == [True, True, False, False, False, False]


def test_doubt_grows_with_what_speaks_against_a_grasp_and_small_figures_count_alike():
    def doubt(shifted=0.1, pressed=0.002, touching=8.0, turned=0.05):
        rest = Settled(*(np.array([x]) for x in (pressed, touching, turned)))
        return doubts(np.array([shifted]), rest)[0]

    np.testing.assert_allclose(doubt(shifted=0.2) / doubt(), 2**0.3)
    np.testing.assert_allclose(doubt(turned=0.1) / doubt(), 2**0.8)
    np.testing.assert_allclose(doubt(pressed=0.008) / doubt(), 0.5)
    np.testing.assert_allclose(doubt(touching=9.0) / doubt(), np.exp(-0.3))
    assert doubt(shifted=0.0) == doubt(shifted=1e-8) > 0
    assert doubt(turned=0.0) == doubt(turned=1e-4) > 0
    assert np.isnan(doubt(shifted=np.nan))


def test_of_attempts_that_are_alike_the_best_comes_first_and_the_others_last():
    """By hand: 0 and 2 have both hands in one place, 1 shares one hand with them, 3 is far away."""
    places = np.zeros((4, 2, 3))
    places[1, 1, 0], places[3, :, 0], places[2, :, 0] = 0.2, 0.5, 0.01
    shifted = np.array([0.2, 0.3, 0.1, 0.4])
    rest = (np.zeros(4, np.int8), np.zeros(4), np.zeros(4), shifted, places)
    alike = SelectionConfig(apart=0.02)
    assert selection_order(*rest, alike).tolist() == [2, 1, 3, 0]
    assert selection_order(*rest, SelectionConfig(apart=0.0)).tolist() == [2, 0, 1, 3]
    assert best(*rest, 3, alike).tolist() == [False, True, True, True]


def test_the_order_of_unlike_attempts_is_a_shuffle_of_all():
    rng = np.random.default_rng(2)
    places = rng.uniform(-0.05, 0.05, (60, 2, 3))
    rest = (np.zeros(60, np.int8), np.zeros(60), np.zeros(60), rng.uniform(0, 1, 60), places)
    order = selection_order(*rest, SelectionConfig(apart=0.04))
    assert sorted(order.tolist()) == list(range(60))
    gaps = np.linalg.norm(places[order][:, None] - places[order][None], axis=-1).max(axis=-1)
    # A first part has no two alike, each of the rest is alike one before it in the first part.
    first = next(k for k in range(1, 61) if k == 60 or np.any(gaps[k, :k] < 0.04))
    assert np.all((gaps[:first, :first] >= 0.04) | np.eye(first, dtype=bool))
    assert np.all(np.any(gaps[first:, :first] < 0.04, axis=1))


def test_the_audit_does_not_look_at_attempts():
    drawn = audit(40, 10, np.random.default_rng(3))
    assert drawn.sum() == 10
    assert np.array_equal(drawn, audit(40, 10, np.random.default_rng(3)))
    assert not np.array_equal(drawn, audit(40, 10, np.random.default_rng(4)))
    # Over many seeds every attempt is drawn about as often.
    times = sum(audit(40, 10, np.random.default_rng(s)).astype(int) for s in range(2000))
    assert np.all(np.abs(times - 500) < 5 * np.sqrt(2000 * 0.25 * 0.75))


def test_a_scene_without_starts_gives_failed_audit_rows():
    assert audit(4, 10, np.random.default_rng(0)).sum() == 4


def test_each_failure_has_its_status():
    gaps = np.zeros((6, 2, 5))
    gaps[1, 0, :3] = 0.02  # left hand keeps two contacts
    gaps[2, 1, :2] = 0.02  # right hand keeps three
    gaps[3, :, 3:] = np.nan  # padding: three contacts a hand
    depth = np.array([0.0, 0.0, 0.0, 0.0, 0.011, np.nan])
    finite = np.array([True, True, True, True, True, False])
    expected = [
        Status.OK,
        Status.CONTACT_LOST,
        Status.OK,
        Status.OK,
        Status.PENETRATION_LEFT,
        Status.NOT_FINITE,
    ]
    none = np.zeros(6)
    assert judge(finite, gaps, depth, CONFIG, among_hands=none, table=none).tolist() == expected


def test_a_hand_with_fewer_contacts_than_are_needed_needs_them_all():
    gaps = np.full((2, 2, 5), np.nan)
    gaps[:, 0, :2] = 0.0  # two contact points on the left, five on the right
    gaps[:, 1] = 0.0
    gaps[1, 0, 1] = 0.02
    none = np.zeros(2)
    status = judge(np.ones(2, bool), gaps, none, CONFIG, among_hands=none, table=none)
    assert status.tolist() == [Status.OK, Status.CONTACT_LOST]


def test_no_accepted_grasp_is_deeper_than_the_limit():
    rng = np.random.default_rng(1)
    depth = rng.uniform(0, 0.02, 300)
    none = np.zeros(300)
    gaps = np.zeros((300, 2, 5))
    status = judge(np.ones(300, bool), gaps, depth, CONFIG, among_hands=none, table=none)
    kept = best(status, depth, *rng.uniform(0, 0.1, (2, 300)), NOWHERE[:300], 300, CONFIG)
    assert kept.any()
    assert depth[kept].max() <= CONFIG.start_depth


def test_hands_in_each_other_or_in_the_table_fail_by_their_own_names():
    finite, gaps = np.ones(5, bool), np.zeros((5, 2, 5))
    depth = np.array([0.0, 0.0, 0.0, 0.0, 0.011])
    among = np.array([0.010, 0.011, 0.0, 0.011, 0.011])
    table = np.array([0.005, 0.0, 0.006, 0.006, 0.011])
    status = judge(finite, gaps, depth, CONFIG, among_hands=among, table=table)
    assert status.tolist() == [
        Status.OK,
        Status.SELF_PENETRATION_LEFT,
        Status.TABLE_PENETRATION,
        Status.SELF_PENETRATION_LEFT,
        Status.PENETRATION_LEFT,
    ]


def test_what_selection_drops_the_start_check_would_have_dropped():
    """So that no grasp that could have passed is lost."""
    start = load_protocol("paper-1").start_depth
    assert min(SelectionConfig().start_depth, SelectionConfig().hands_depth) >= start
