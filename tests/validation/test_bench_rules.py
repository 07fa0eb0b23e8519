"""DexGraspBench's own rules, which `dexgraspbench-1` keeps, on cases computed by hand."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from box_solids import box_mesh, box_solid
from grasps import HALF, SIZE_MM, batch_of, squeeze, turned

from bidexdata.frames import quat_from_rotation_vector
from bidexdata.record import Status
from bidexdata.record.fields import DIRECTIONS
from bidexdata.record.status import TestStage
from bidexdata.simulation.distances import Distances, HandContacts
from bidexdata.simulation.scene import build_scene
from bidexdata.simulation.state import set_pose
from bidexdata.validation import load_protocol, validate_grasps
from bidexdata.validation.checks import check, reference
from bidexdata.validation.metrics import grasp_metrics, measure
from bidexdata.validation.validate import grasp_of
from bidexdata.validation.verdict import start_overlap

BENCH, PAPER = load_protocol("dexgraspbench-1"), load_protocol("paper-1")
BOX = box_solid()
SIZE = SIZE_MM / 1000
REACH = BENCH.metrics.reach
IDENTITY = np.array([1.0, 0, 0, 0])


def one_hand_at(hand, **near):
    """Distances of one hand whose bodies are where they are said to be [m], others at the reach."""
    bodies = np.array([near.get(name, REACH) for name in hand.plain_body_names])
    owners, points = np.zeros(len(bodies), int), np.zeros((len(bodies), 3))
    of = [[hand.body_names.index(b) for b in own] for own in hand.fingers.values()]
    return Distances(
        hand_object=float(bodies.min()),
        self_collision=0.0,
        inter_hand=0.0,
        table=0.0,
        object_table=0.0,
        fingers=np.array([bodies[mine].min() for mine in of]),
        bodies=(bodies,),
        contacts=HandContacts(owners, np.arange(len(bodies)), bodies, points, points),
    )


def test_the_little_finger_owns_the_metacarpal_and_no_finger_the_palm(hands):
    hand = hands[0]
    tips = {f"{finger}distal": 0.004 for finger in hand.fingers}
    d = one_hand_at(hand, **tips, lfmetacarpal=-0.001, palm=-0.003)
    by_spec = grasp_metrics(d, PAPER.metrics, (hand,))
    assert by_spec.cdc == 0.0
    assert by_spec.contact_distance == pytest.approx(0.004)
    by_name = grasp_metrics(d, BENCH.metrics, (hand,))
    assert by_name.cdc == pytest.approx(0.005)  # 4 mm of the others and 1 mm in
    assert by_name.contact_distance == pytest.approx(4 * 0.004 / 5)
    assert by_name.pd == by_spec.pd == 0.003


def test_of_an_object_in_pieces_it_finds_what_touches_the_box_round_them(hands):
    """The box round both halves is the cube: its own broad phase stops where that is not touched.

    The palm's fingers lie 3 mm behind its face, so 9 mm off the cube; the thumb's base is in it.
    """
    side = 1 / np.sqrt(3)
    cut = np.array([-side / 2, 0.0, side / 2])
    halves = tuple(
        box_mesh((-side / 2, low, -side / 2), (side / 2, high, side / 2))
        for low, high in pairwise(cut)
    )
    scene = build_scene(hands, replace(BOX, pieces=halves), SIZE, BENCH.scene)
    grasp = grasp_of(batch_of(hands, [squeeze(hands, gaps=(0.1, 0.006, 0.0))]), 0)
    every = measure(scene, PAPER.metrics, grasp).fingers
    thumbs = np.array([name.endswith("th") for name in scene.finger_names])
    np.testing.assert_allclose(every[~thumbs], 0.009, atol=1e-5)
    assert (every[thumbs] < 0).all()
    found = measure(scene, BENCH.metrics, grasp).fingers
    np.testing.assert_array_equal(found, np.where(thumbs, every, REACH))


def test_a_turn_about_the_centre_moves_the_origin_of_the_source(hands):
    """By the chord 2 r sin(angle / 2), r the way from the centre of mass to that origin."""
    angle = np.radians(10.0)
    for distance in (0.2, 0.3):
        origin = {"origin_in_file": [distance, 0.0, 0.0], "unit_in_file": SIZE}
        solid = replace(BOX, provenance=origin)
        scene = build_scene((), solid, SIZE, BENCH.scene)
        nothing = np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 0))
        found = {}
        for protocol in (BENCH, PAPER):
            set_pose(scene, np.zeros(3), IDENTITY, *nothing)
            start = reference(scene, protocol)
            set_pose(scene, np.zeros(3), quat_from_rotation_vector([0, 0, angle]), *nothing)
            found[protocol.name] = check(scene, protocol, start)
        chord = 2 * distance * np.sin(angle / 2)  # 35 and 52 mm
        assert found["dexgraspbench-1"].moved == pytest.approx(chord)
        assert found["dexgraspbench-1"].status == (Status.OK if chord < 0.05 else Status.SLIP)
        assert found["paper-1"].moved == 0
        assert found["paper-1"].status is Status.OK


def test_what_leaves_the_limits_while_closing_is_judged_at_the_first_check_of_a_load(hands):
    pos, quat, joints = squeeze(hands)
    pos[:, 2] += (0.06, 0, 0)  # both hands carry the cube 6 cm away
    batch = batch_of(hands, [(pos, quat, joints)])
    out = {}
    for closing in (False, True):
        rules = replace(BENCH, check_closing=closing)
        assert (rules == BENCH) is not closing
        found = validate_grasps(batch, BOX, hands, rules)
        out[closing] = {k: v[0] for k, v in found.items()}
        assert out[closing]["drift_pos"] == pytest.approx(0.06, abs=0.005)
    assert out[True]["verdict_status"] == Status.THROWN
    assert out[True]["failed_stage"] == TestStage.CLOSING
    assert out[True]["direction"] == -1
    assert out[False]["verdict_status"] == Status.THROWN
    assert out[False]["failed_stage"] == TestStage.HOLD
    assert DIRECTIONS[out[False]["direction"]] == BENCH.directions[0] == "-x"
    assert out[False]["time"] == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("name", "by_object"),
    [("dexgraspbench-1", True), ("bimandexgraspbench-1", False), ("paper-1", False)],
)
def test_at_the_start_the_table_is_a_hand_to_the_object_and_an_obstacle_to_hands(
    hands, name, by_object
):
    protocol = load_protocol(name)
    scene = build_scene(hands, BOX, SIZE, protocol.scene, table=True)

    def refused(height, hand_height):
        """With the object's lowest point and the palms at these heights [m]."""
        pos, quat, joints = turned(
            squeeze(hands, gaps=(0.2,) * 3), IDENTITY, np.array([0.0, 0.0, hand_height])
        )
        batch = batch_of(hands, [(pos, quat, joints)], object_pos=[(0, 0, height + HALF)])
        found = start_overlap(scene, protocol, grasp_of(batch, 0))
        assert found is None or found.status is Status.START_PENETRATION
        return found is not None

    assert not refused(0.0, 0.5)
    assert not refused(-0.009, 0.5)
    assert refused(-0.011, 0.5) is by_object
    assert refused(0.0, 0.0)
