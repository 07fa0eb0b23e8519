from __future__ import annotations

import numpy as np
import pytest
from box_solids import box_solid
from grasps import batch_of, squeeze

from bidexdata.simulation.distances import Distances
from bidexdata.validation import load_protocol, validate_grasps
from bidexdata.validation.metrics import grasp_metrics


def distances(fingers=(0.01, 0.01), bodies=((0.01,),), **depths):
    depths = {"hand_object": 0.01, "self_collision": 0.0, "inter_hand": 0.0, "table": 0.0} | depths
    return Distances(**depths, fingers=np.array(fingers), bodies=tuple(np.array(b) for b in bodies))


def test_figures_of_distances_computed_by_hand():
    d = distances(
        fingers=(0.004, -0.003, 0.01, 0.0),
        bodies=((0.0019, 0.0021, -0.005), (0.002, 0.0)),
        hand_object=-0.005,
        self_collision=-0.001,
        inter_hand=-0.0025,
    )
    m = grasp_metrics(d, contact_within=0.002)
    assert m.pd == 0.005
    assert m.spd == 0.0025
    assert m.cdc == pytest.approx(0.013)
    assert m.contact_number == 3  # bodies deep inside count, unlike in DexGraspBench
    assert m.contact_distance == pytest.approx(0.014 / 4)


def test_without_any_contact_depths_are_zero_and_distances_at_the_cap():
    m = grasp_metrics(distances(), contact_within=0.002)
    assert (m.pd, m.spd, m.cdc, m.contact_number, m.contact_distance) == (0, 0, 0, 0, 0.01)


def test_a_known_overlap_is_the_penetration_depth(hands):
    """Moving both hands in by d deepens the overlap by d."""
    gaps = np.array([0.02, 0.004, 0.002, 0.0])
    rows = [squeeze(hands, gaps=(0.1, g, 0.1)) for g in gaps]
    batch = batch_of(hands, rows)
    out = validate_grasps(batch, box_solid(), hands, load_protocol("paper-1"))
    assert out["pd"][0] == 0
    assert out["pd"][1] > 0
    np.testing.assert_allclose(np.diff(out["pd"][1:]), 0.002, atol=2e-5)
