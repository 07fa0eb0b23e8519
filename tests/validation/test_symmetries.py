"""Verdicts do not depend on handedness, on the record's files, on repetition or on the timestep."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from box_solids import box_solid
from grasps import batch_of, squeeze, turned

from bidexdata.config import with_overrides
from bidexdata.frames import random_quat
from bidexdata.objects.prepare import prepare_object
from bidexdata.record import GraspBatch, Status
from bidexdata.record.fields import columns_written_by
from bidexdata.record.scene import Scene
from bidexdata.simulation.scene import MOST_PIECES
from bidexdata.synthesis.pipeline import synthesize
from bidexdata.validation import load_protocol, validate_grasps

PAPER = load_protocol("paper-1")
HEAVY = replace(PAPER, name="heavy", hold=1.0, scene=replace(PAPER.scene, density=120.0))
MIRROR = np.array([-1.0, 1.0, 1.0])
MIRROR_QUAT = np.array([1.0, 1.0, -1.0, -1.0])


def judged(hands, batch, protocol=HEAVY, solid=None):
    return validate_grasps(batch, solid or box_solid(), hands, protocol)


def graded(hands):
    """Grips of a box from firm to weak, off its centre so that no symmetry helps."""
    return [squeeze(hands, (0.02, 0.01, g), offset=(0.01, 0.04)) for g in (0.0, 0.007, 0.009)]


def mirrored(grasp):
    """Left does what right did, on the other side of the plane x = 0."""
    pos, quat, joints = grasp
    return (pos * MIRROR)[::-1], (quat * MIRROR_QUAT)[::-1], joints[::-1]


def test_mirrored_scenes_give_mirrored_results(hands):
    turn = random_quat(np.random.default_rng(1))
    rows = [turned(grasp, turn, 0.0) for grasp in graded(hands)]
    turns = np.tile(turn, (len(rows), 1))
    plain = judged(hands, batch_of(hands, rows, object_quat=turns))
    twins = [mirrored(grasp) for grasp in rows]
    mirror = judged(hands, batch_of(hands, twins, object_quat=turns * MIRROR_QUAT))
    assert 0 < plain["success"].sum() < len(rows)
    np.testing.assert_array_equal(mirror["success"], plain["success"])
    np.testing.assert_array_equal(mirror["verdict_status"], plain["verdict_status"])
    for name in ("pd", "spd", "cdc", "contact_distance"):
        np.testing.assert_allclose(mirror[name], plain[name], atol=2e-6, err_msg=name)


def test_rows_through_arrow_and_back_get_the_same_bits(hands):
    batch = batch_of(hands, graded(hands))
    again = GraspBatch.from_arrow(batch.to_arrow())
    first, second = judged(hands, batch), judged(hands, again)
    for name in columns_written_by("validate"):
        np.testing.assert_array_equal(first[name], second[name], err_msg=name)


def test_ten_thousand_pieces_are_a_status_and_not_an_hour(hands):
    solid = box_solid()
    many = replace(solid, pieces=solid.pieces * 10_000)
    assert len(many.pieces) > MOST_PIECES
    out = judged(hands, batch_of(hands, [squeeze(hands)]), solid=many)
    assert out["verdict_status"].tolist() == [Status.NO_SCENE]


@pytest.fixture(scope="module")
def unselected(hands):
    """Audit rows of three objects at three sizes, as they were drawn, with heavy objects."""
    found = []
    for family in ("bottle", "mug", "box"):
        obj = prepare_object(f"shapes:{family}")
        scenes = [Scene(obj.object_id, size) for size in (300, 500, 800)]
        batch = synthesize(obj, hands, scenes, seed=5, grasps=20)
        found.append((obj, batch.select(batch.audit & (batch.synth_status == Status.OK))))
    return found


@pytest.mark.slow
def test_half_the_timestep_keeps_nearly_all_verdicts(hands, unselected):
    coarse = with_overrides(PAPER, ["scene.density=40.0", "name=heavier"])
    fine = with_overrides(coarse, ["scene.timestep=0.002", "segment_steps=20", "name=finer"])
    pairs = [
        (judged(hands, b, coarse, obj)["success"], judged(hands, b, fine, obj)["success"])
        for obj, b in unselected
    ]
    plain, halved = (np.concatenate(column) for column in zip(*pairs, strict=True))
    assert len(plain) >= 150
    assert 0.1 < plain.mean() < 0.95
    assert np.mean(plain == halved) >= 0.97
