from __future__ import annotations

import numpy as np
import pytest
from box_solids import box_solid
from grasps import batch_of, squeeze

from bidexdata.simulation.distances import Distances, HandContacts
from bidexdata.validation import load_protocol, validate_grasps
from bidexdata.validation.metrics import grasp_metrics
from bidexdata.validation.protocols import MetricRules


def bodies_at(hands, *near):
    """Distances of all bodies: those named, without side prefix, and the cap for the others."""
    return tuple(
        np.array([at.get(name[3:], 0.01) for name in hand.body_names])
        for hand, at in zip(hands, near, strict=True)
    )


def distances(fingers=(0.01, 0.01), bodies=(), **depths):
    zero = dict.fromkeys(("self_collision", "inter_hand", "table", "object_table"), 0.0)
    bodies = tuple(np.array(b) for b in bodies)
    hand = np.concatenate([np.full(len(b), i) for i, b in enumerate(bodies)] or [np.zeros(0, int)])
    body = np.concatenate([np.arange(len(b)) for b in bodies] or [np.zeros(0, int)])
    points = np.zeros((len(hand), 3))
    nearest = HandContacts(hand, body, np.concatenate([*bodies, []]), points, points)
    return Distances(
        **({"hand_object": 0.01} | zero | depths),
        fingers=np.array(fingers),
        bodies=bodies,
        contacts=nearest,
    )


def test_figures_of_distances_computed_by_hand(hands):
    left = {"palm": 0.0019, "ffdistal": 0.0021, "mfdistal": -0.005, "ffknuckle": 0.0}
    d = distances(
        fingers=(0.004, -0.003, 0.01, 0.0),
        bodies=bodies_at(hands, left, {"palm": 0.002, "thdistal": 0.0}),
        hand_object=-0.005,
        self_collision=-0.001,
        inter_hand=-0.0025,
    )
    m = grasp_metrics(d, MetricRules(contact_within=0.002), hands)
    assert m.pd == 0.005
    assert m.spd == 0.0025
    assert m.cdc == pytest.approx(0.013)
    assert m.contact_number == 3  # bodies deep inside count, unlike in DexGraspBench
    bench = MetricRules(contact_within=0.002, deep_counts=False)
    assert grasp_metrics(d, bench, hands).contact_number == 2
    number = hands[0].body_names.index("lh_mfdistal")
    second = HandContacts(
        *(
            np.append(a, [b], 0)
            for a, b in zip(d.contacts, (0, number, 0.001, np.zeros(3), np.zeros(3)), strict=True)
        )
    )
    both = d._replace(contacts=second)  # deep in one piece, and close to another
    assert grasp_metrics(both, bench, hands).contact_number == 3
    every = MetricRules(contact_within=0.002, uncounted_bodies=())
    assert grasp_metrics(d, every, hands).contact_number == 4  # the knuckle too
    assert m.contact_distance == pytest.approx(0.014 / 4)


def test_a_table_that_counts_as_a_hand_deepens_the_figures(hands):
    d = distances(
        bodies=bodies_at(hands, {}, {}), hand_object=-0.001, table=-0.004, object_table=-0.003
    )
    as_hand = grasp_metrics(d, MetricRules(table_is_hand=True), hands)
    assert (as_hand.pd, as_hand.spd) == (0.003, 0.004)
    apart = grasp_metrics(d, MetricRules(), hands)
    assert (apart.pd, apart.spd) == (0.001, 0)


def test_without_any_contact_depths_are_zero_and_distances_at_the_cap(hands):
    m = grasp_metrics(
        distances(bodies=bodies_at(hands, {}, {})), MetricRules(contact_within=0.002), hands
    )
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
