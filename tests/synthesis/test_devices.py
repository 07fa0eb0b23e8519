"""The same kernels run on every device: no stage stays on the CPU unasked, and grasps are as good."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from bidexdata.hands import load_hands
from bidexdata.objects.distance_field import signed_distance
from bidexdata.record import Scene, Status
from bidexdata.synthesis.pipeline import synthesize
from bidexdata.synthesis.regions import RegionConfig, select_region_pairs
from bidexdata.synthesis.regions_build import build_regions
from bidexdata.synthesis.regions_gap import regions_apart
from bidexdata.synthesis.regions_rank import balance_residuals

CONFIG = RegionConfig()
NOWHERE = "cuda:99"
GPU = pytest.mark.skipif(not torch.cuda.is_available(), reason="this machine has no GPU")
GRASPS = 8


@pytest.fixture(scope="module")
def scenes(obj):
    return [Scene(obj.object_id, 400), Scene(obj.object_id, 600)]


@pytest.fixture(scope="module")
def regions(obj):
    return build_regions(obj, 0.4, CONFIG, np.random.default_rng(0))


def test_each_part_of_the_regions_goes_where_it_is_told_to(obj, regions):
    pairs, rng = np.array([[0, 1], [2, 3]]), np.random.default_rng(0)
    parts = (
        lambda device: build_regions(obj, 0.4, CONFIG, rng, device=device),
        lambda device: regions_apart(regions, pairs, 0.05, device=device),
        lambda device: balance_residuals(regions, pairs, CONFIG, 0.2, device=device),
        lambda device: select_region_pairs(
            obj, Scene(obj.object_id, 400), CONFIG, rng, device=device
        ),
    )
    for part in parts:
        part("cpu")
        with pytest.raises((ValueError, RuntimeError), match=NOWHERE):
            part(NOWHERE)


def test_a_synthesis_goes_where_it_is_told_to(obj, scenes):
    with pytest.raises((ValueError, RuntimeError), match=NOWHERE):
        synthesize(obj, load_hands("capsule"), scenes, grasps=1, device=NOWHERE)


@GPU
def test_regions_of_a_gpu_are_those_of_the_cpu(obj, regions):
    there = build_regions(obj, 0.4, CONFIG, np.random.default_rng(0), device="cuda:0")
    assert np.array_equal(there.points, regions.points)
    assert np.array_equal(there.contact_points, regions.contact_points)
    a, b = np.triu_indices(60, k=1)
    pairs = np.stack([a, b], axis=1)
    apart = [regions_apart(regions, pairs, 0.05, device=d) for d in ("cpu", "cuda:0")]
    assert np.array_equal(apart[0], apart[1])
    ranked = [balance_residuals(regions, pairs, CONFIG, 0.2, device=d) for d in ("cpu", "cuda:0")]
    np.testing.assert_allclose(ranked[1], ranked[0], rtol=1e-2, atol=1e-4)  # float32, 40 steps


@GPU
def test_grasps_of_a_gpu_are_as_good_as_those_of_the_cpu(obj, scenes):
    hands = load_hands("capsule")
    here, there = (
        synthesize(obj, hands, scenes, seed=3, grasps=GRASPS, candidates=GRASPS, device=device)
        for device in ("cpu", "cuda:0")
    )
    fine = [batch["synth_status"] == Status.OK for batch in (here, there)]
    assert fine[1].sum() >= fine[0].sum() - 2
    for row in np.flatnonzero(fine[1]):
        touching = there["contact_index"][row] >= 0
        points = there["contact_point"][row][touching].astype(float)
        distance, _ = signed_distance(obj.sdf, there["size_mm"][row] / 1000, points)
        assert np.all(np.abs(distance) < 2e-3)
    middle = [
        np.median(batch["qp_residual"][ok]) for batch, ok in zip((here, there), fine, strict=True)
    ]
    assert middle[1] < 2 * middle[0] + 0.01
