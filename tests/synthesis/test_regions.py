"""Laws of regions, of the pairs allowed together and of their rankings."""

from dataclasses import replace

import numpy as np
import pytest
from made_objects import ball_object, box_object

from bidexdata.errors import BadConfig
from bidexdata.hands import load_hands
from bidexdata.record.fields import FIELDS
from bidexdata.record.scene import Scene
from bidexdata.synthesis.attempts import draw_attempts
from bidexdata.synthesis.config import SynthConfig
from bidexdata.synthesis.optimise_config import ClosureConfig, OptimiseConfig
from bidexdata.synthesis.regions import RegionConfig, select_region_pairs
from bidexdata.synthesis.regions_build import (
    Regions,
    accessible_anchors,
    build_regions,
    flatness,
    hull_depth,
)
from bidexdata.synthesis.regions_gap import PairFilter, regions_apart
from bidexdata.synthesis.regions_rank import (
    balance_residuals,
    diverse,
    force_scores,
    torque_order,
)
from bidexdata.wrench.support import sampled_score

CONFIG = RegionConfig()
BOX = box_object()
BALL = ball_object()
# Float32 positions of objects under a metre.
FLOAT32 = 1e-6


def scene(size_mm, **options):
    return Scene("made-00000000", size_mm, **options)


def regions_of(obj, size, config=CONFIG, seed=0):
    return build_regions(obj, size, config, np.random.default_rng(seed))


@pytest.mark.parametrize("obj", [BOX, BALL], ids=["box", "ball"])
@pytest.mark.parametrize("size", [0.05, 0.3, 0.8])
def test_a_region_holds_the_points_near_its_anchor_on_its_sheet(obj, size):
    r = regions_of(obj, size)
    assert r.points.shape == (200, 256, 3)
    anchors = r.anchor_points.astype(np.float32)
    assert np.all((r.points == anchors[:, None]).all(axis=-1).any(axis=1))
    far = np.linalg.norm(r.points - r.anchor_points[:, None], axis=-1)
    assert far.max() <= CONFIG.radius + FLOAT32
    assert np.allclose(far.max(axis=1), r.reach, atol=FLOAT32)
    cosine = np.einsum("aki,ai->ak", r.normals, r.anchor_normals)
    assert cosine.min() > CONFIG.same_side
    # Nothing near is left out where the region has places to spare.
    points = obj.surface_points * np.float32(size)
    for a in (0, 7, 199):
        near = np.linalg.norm(points - points[a], axis=1) <= CONFIG.radius
        near &= obj.surface_normals @ obj.surface_normals[a] > CONFIG.same_side
        members = {tuple(p) for p in r.points[a]}
        assert len(members) == min(256, near.sum())
        assert members <= {tuple(p) for p in points[near]}


def test_contacts_are_members_of_their_region_and_differ():
    r = regions_of(BOX, 0.5)
    for a in range(0, 200, 13):
        members = {tuple(p) for p in r.points[a]}
        drawn = [tuple(p) for p in r.contact_points[a].reshape(-1, 3)]
        assert set(drawn) <= members
        assert len(set(drawn)) == CONFIG.sets * CONFIG.contacts


def test_an_object_with_fewer_points_than_anchors_gives_what_it_has():
    tiny = box_object(points=3)
    r = regions_of(tiny, 0.3)
    assert r.points.shape == (3, 256, 3)
    assert np.all(np.isfinite(r.mean_normals))


@pytest.mark.parametrize("half_angle", [0.05, 0.1, 0.6])
def test_the_flatness_of_a_cap_is_known(half_angle):
    # A cap of directions, uniform by area: |mean| = (1 + cos a) / 2, so V = 1 - cos a.
    rng = np.random.default_rng(0)
    z = rng.uniform(np.cos(half_angle), 1, 200_000)
    phi = rng.uniform(0, 2 * np.pi, len(z))
    n = np.stack([np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z], axis=1)
    assert float(flatness(n)) == pytest.approx(1 - np.cos(half_angle), rel=0.02)


def test_a_plane_has_no_variance():
    assert float(flatness(np.tile([0.0, 0.0, 1.0], (9, 1)))) == 0.0


def test_depth_below_the_hull_is_the_distance_to_the_nearest_face():
    depth, normal = hull_depth(BOX, 0.5, np.array([[0.0, 0.0, 0.0], [0.15, 0.0, 0.0]]))
    sides = 0.5 * np.ptp(BOX.hull.vertices, axis=0)
    assert depth == pytest.approx([sides[2] / 2, sides[0] / 2 - 0.15])
    assert np.allclose(normal[1], [1, 0, 0])


def test_every_region_of_a_convex_object_is_near_the_hull():
    r = regions_of(BALL, 0.5)
    depth, _ = hull_depth(BALL, 0.5, r.anchor_points)
    assert np.all(depth < CONFIG.depth)
    assert accessible_anchors(BALL, 0.5, r, CONFIG).sum() > 150


def test_the_kernel_measures_the_gap_exactly():
    r = regions_of(BOX, 0.4)
    rng = np.random.default_rng(1)
    pairs = np.sort(rng.integers(0, 200, (120, 2)), axis=1)
    for gap in (0.0, 0.05, 0.12):
        apart = regions_apart(r, pairs, gap)
        for (a, b), verdict in zip(pairs, apart, strict=True):
            u, v = r.points[a].astype(np.float64), r.points[b].astype(np.float64)
            least = np.linalg.norm(u[:, None] - v[None], axis=-1).min()
            if abs(least - gap) > FLOAT32:
                assert verdict == (least >= gap)


@pytest.mark.parametrize("size_mm", [200, 300, 500, 800])
@pytest.mark.parametrize("score", ["random", "force", "torque"])
def test_kept_pairs_keep_the_rules(size_mm, score):
    config = RegionConfig(score=score)
    size = size_mm / 1000
    longest = size * np.ptp(BOX.solid.vertices, axis=0).max()
    r = select_region_pairs(BOX, scene(size_mm), config, np.random.default_rng(0))
    assert 1 <= len(r.score) <= config.kept
    assert np.all(np.diff(r.score) <= 0)
    gap = np.array([np.linalg.norm(p[0][:, None] - p[1][None], axis=-1).min() for p in r.points])
    apart = np.linalg.norm(r.centres[:, 0] - r.centres[:, 1], axis=1)
    assert np.all((gap >= config.gap - FLOAT32) | (apart >= config.wide * longest))
    # No two pairs alike, whichever way round.
    a, b = r.centres[:, 0], r.centres[:, 1]
    far = lambda u, v: np.linalg.norm(u[:, None] - v[None], axis=-1)  # noqa: E731
    same = np.maximum(far(a, a), far(b, b)) + np.eye(len(a)) * 9
    crossed = np.maximum(far(a, b), far(b, a)) + np.eye(len(a)) * 9
    assert min(same.min(), crossed.min()) > config.diversity * longest


@pytest.mark.parametrize(
    ("sides", "setting", "ordered"),
    [
        ("preferred", "floating", True),
        ("table", "tabletop", True),
        ("table", "floating", False),
        ("random", "tabletop", False),
    ],
)
def test_the_left_hand_is_farther_to_the_left_where_that_is_wanted(sides, setting, ordered):
    """Left is the hand farther along world +y; by lot, half of the pairs are."""
    where = scene(400, setting=setting, rest_pose=0 if setting == "tabletop" else -1)
    r = select_region_pairs(BOX, where, RegionConfig(sides=sides), np.random.default_rng(0))
    left = r.centres[:, 0, 1] >= r.centres[:, 1, 1]
    assert np.all(left) == ordered
    assert ordered or 0.2 < np.mean(left) < 0.8


@pytest.mark.parametrize("score", ["force", "torque"])
def test_the_best_of_all_pairs_is_first(score):
    """Where the torque score is asked to rank every pair by all draws."""
    config = RegionConfig(score=score, anchors=40, wide=2.0, reranked=1000, refined=1000)
    regions = regions_of(BOX, 0.5, config)
    longest = 0.5 * np.ptp(BOX.solid.vertices, axis=0).max()
    usable = accessible_anchors(BOX, 0.5, regions, config)
    allowed = PairFilter(regions, usable, config.gap, config.wide * longest)
    every = allowed.pairs[allowed.first(np.arange(len(allowed.pairs)), 10**9)]
    assert 100 < len(every) < config.refined

    length = float(ClosureConfig().torque_lengths(np.array(longest)))

    def scores(pairs):
        if score == "force":
            return force_scores(regions, pairs, config.force_friction)
        return -balance_residuals(regions, pairs, config, length)

    r = select_region_pairs(BOX, scene(500), config, np.random.default_rng(0))
    close = {"rel": 1e-4, "abs": 1e-9}  # residuals are float32 means, summed in another order
    assert r.score[0] == pytest.approx(scores(every).max(), **close)
    assert scores(r.anchors[:1])[0] == pytest.approx(r.score[0], **close)


def test_the_torque_ranking_starts_with_pairs_that_balance():
    r = select_region_pairs(BOX, scene(500), CONFIG, np.random.default_rng(0))
    by_lot = RegionConfig(score="random")
    lot = select_region_pairs(BOX, scene(500), by_lot, np.random.default_rng(0))
    regions = regions_of(BOX, 0.5, seed=9)  # other contacts than those that were ranked
    length = 0.5 * 0.5 * np.ptp(BOX.solid.vertices, axis=0).max()
    ranked = balance_residuals(regions, r.anchors[:10], CONFIG, length)
    drawn = balance_residuals(regions, lot.anchors, CONFIG, length)
    assert np.median(ranked) < 0.1 * np.median(drawn)
    assert np.all(r.score <= 0)


def test_the_first_pairs_are_ranked_by_all_draws_and_the_others_come_after_them():
    config = replace(CONFIG, reranked=60, refined=30)
    regions = regions_of(BOX, 0.5, config)
    usable = accessible_anchors(BOX, 0.5, regions, config)
    allowed = PairFilter(regions, usable, config.gap, 1.0)
    pairs, score = torque_order(regions, allowed, config, 0.15, np.random.default_rng(0))
    first, rest = pairs[: config.refined], pairs[config.refined :]
    every = balance_residuals(regions, first, config, 0.15)
    np.testing.assert_allclose(-score[: config.refined], every, rtol=1e-4, atol=1e-9)
    one = balance_residuals(regions, rest, config, 0.15, slice(1))
    np.testing.assert_allclose(-score[config.refined :], one, rtol=1e-4, atol=1e-9)
    assert np.all(np.diff(score[: config.refined]) <= 0)
    assert np.all(np.diff(score[config.refined :]) <= 0)
    assert balance_residuals(regions, first, config, 0.15, slice(1)).max() <= one.min() + 1e-6


def test_regions_and_closure_divide_torques_by_one_length():
    lengths = ClosureConfig().torque_lengths(np.array([0.06, 0.2, 0.5]))
    np.testing.assert_array_equal(lengths, [0.1, 0.1, 0.25])
    assert BOX.longest_side == np.ptp(BOX.solid.vertices, axis=0).max()
    tall = SynthConfig(optimise=OptimiseConfig(closure=ClosureConfig(torque_length=3.0)))
    hands, where = load_hands("capsule"), scene(400)
    by_default, by_tall = (draw_attempts(BOX, hands, where, c, 0, 1) for c in (SynthConfig(), tall))
    assert not np.array_equal(by_tall.pairs.score, by_default.pairs.score)
    rng = (np.random.default_rng([by_tall.seed, 0]) for _ in range(2))
    same = select_region_pairs(BOX, where, CONFIG, next(rng), closure=tall.optimise.closure)
    np.testing.assert_array_equal(same.score, by_tall.pairs.score)
    other = select_region_pairs(BOX, where, CONFIG, next(rng))
    np.testing.assert_array_equal(other.score, by_default.pairs.score)


def test_pairs_come_out_the_same_for_the_same_seed():
    a, b, c = (
        select_region_pairs(BOX, scene(400), CONFIG, np.random.default_rng(s)) for s in (5, 5, 6)
    )
    assert all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))
    assert not np.array_equal(a.score, c.score)


def test_a_turned_object_gives_the_left_hand_what_lies_left_in_the_world():
    quarter = (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))  # about z: object x becomes world y
    turned = scene(400, setting="tabletop", rest_pose=0, object_quat_wxyz=quarter)
    r = select_region_pairs(BOX, turned, CONFIG, np.random.default_rng(0))
    assert np.all(r.centres[:, 0, 0] >= r.centres[:, 1, 0])


def test_no_two_regions_of_a_pebble_are_apart():
    config = RegionConfig(wide=10.0)
    r = select_region_pairs(BALL, scene(60), config, np.random.default_rng(0))
    assert len(r.score) == 0
    assert r.points.shape == (0, 2, 256, 3)


def test_additive_scores_rank_as_the_sampled_estimate_of_the_paper():
    from scipy.stats import spearmanr

    rng = np.random.default_rng(2)
    regions = regions_of(BOX, 0.5, config=replace(CONFIG, sets=1))
    usable = accessible_anchors(BOX, 0.5, regions, CONFIG)
    allowed = PairFilter(regions, usable, CONFIG.gap, 1.0)
    pairs = allowed.pairs[rng.choice(len(allowed.pairs), 100, replace=False)]
    added = force_scores(regions, pairs, CONFIG.force_friction)
    u = rng.standard_normal((1000, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)

    def sampled(smooth):
        return np.array(
            [
                sampled_score(
                    regions.contact_points[p, 0].reshape(-1, 3).astype(float),
                    -regions.contact_normals[p, 0].reshape(-1, 3).astype(float),
                    u, mu=CONFIG.force_friction, length=0.2, smooth=smooth,
                )
                for p in pairs
            ]
        )  # fmt: skip

    # Sampling the same wrench space gives the same number; TDG's smooth support points, which
    # count contacts that face away against a pair, still rank nearly alike.
    exact = sampled(False)
    assert np.all(exact <= added + 1e-9)
    assert np.abs(exact - added).max() < 0.1 * added.max()
    # A box has many equal scores, which sampling orders by chance.
    assert spearmanr(added, exact).statistic > 0.97
    assert spearmanr(added, sampled(True)).statistic > 0.85


def facing_regions(shift, length=0.4, contacts=5):
    """Four flat regions on two parallel planes: 0 faces 1; 0 and 2 are shifted sideways."""
    rng = np.random.default_rng(3)
    disc = 0.05 * rng.uniform(-1, 1, (contacts, 3)) * [0, 1, 1]
    centres = np.array([[-length / 2, 0, 0], [length / 2, 0, 0], [length / 2, shift, 0]])
    normals = np.array([[-1.0, 0, 0], [1.0, 0, 0], [1.0, 0, 0]])
    points = (centres[:, None] + disc).astype(np.float32)
    out = np.repeat(normals[:, None], contacts, axis=1).astype(np.float32)
    drawn = (points[:, None], out[:, None])
    return Regions(np.arange(3), centres, normals, points, out, normals, np.full(3, 0.08), *drawn)


def test_the_torque_ranking_prefers_facing_regions_which_the_force_score_cannot_tell():
    regions = facing_regions(shift=0.3)
    pairs = np.array([[0, 1], [0, 2]])
    force = force_scores(regions, pairs, CONFIG.force_friction)
    assert force[0] == pytest.approx(force[1])
    residual = balance_residuals(regions, pairs, CONFIG, 0.2)
    assert residual[0] < 0.01 < residual[1]


def test_an_empty_list_of_pairs_has_no_residuals_and_no_choice():
    regions = facing_regions(shift=0.1)
    none = np.zeros((0, 2), np.int64)
    assert balance_residuals(regions, none, CONFIG, 0.2).shape == (0,)
    assert diverse(regions.anchor_points, none, 0.1, 40).shape == (0,)


IMPOSSIBLE = [
    *({"anchors": 1}, {"anchors": 32_768}, {"radius": 0.0}, {"kept": 0}, {"wide": float("nan")}),
    *({"same_side": -2.1}, {"table_fingertip": 0.2}, {"refined": -1}, {"sets": 0}),
]


@pytest.mark.parametrize("change", IMPOSSIBLE)
def test_impossible_numbers_are_refused_by_name(change):
    with pytest.raises(BadConfig, match=f"RegionConfig.{next(iter(change))} must lie between"):
        RegionConfig(**change)


def test_the_number_of_every_anchor_fits_the_records_column():
    """A table may hide the first points, so that an anchor has a higher number than there are anchors."""
    largest = np.iinfo(FIELDS["region_id"].dtype).max
    assert RegionConfig(anchors=largest).anchors == largest
    hidden, seen = largest - 60, 200
    normals = np.random.default_rng(0).standard_normal((hidden + seen, 3)).astype(np.float32)
    normals[:, 2] = np.abs(normals[:, 2]) + 1.0
    normals[:hidden, 2] *= -1.0
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    ball = replace(BALL, surface_points=0.3 * normals, surface_normals=normals)
    halved = np.array([0.0, 0.0, 1.0, 0.0])
    regions = build_regions(ball, 0.4, CONFIG, np.random.default_rng(0), table=halved)
    np.testing.assert_array_equal(regions.anchors, np.arange(hidden, largest + 1))
