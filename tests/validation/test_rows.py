"""Rows that no simulator should see, and callers that mix things up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from box_solids import box_mesh, box_solid
from grasps import batch_of, squeeze

from bidexdata.errors import NotUsable
from bidexdata.record import Status
from bidexdata.record.fields import columns_written_by
from bidexdata.validation import load_protocol, validate_grasps

PAPER = load_protocol("paper-1")
FAR = (0.1, 0.1, 0.1)


def status_of(hands, change, **columns):
    grasp = [a.copy() for a in squeeze(hands, gaps=FAR)]
    change(*grasp)
    batch = batch_of(hands, [tuple(grasp)], **columns)
    out = validate_grasps(batch, box_solid(), hands, PAPER)
    assert set(out) == set(columns_written_by("validate"))
    assert not out["success"][0]
    return out["verdict_status"][0], out


def set_to(part, index, value):
    def change(pos, quat, joints):
        {"pos": pos, "quat": quat, "joints": joints}[part][index] = value

    return change


@pytest.mark.parametrize(
    "change",
    [
        set_to("joints", (0, 1, 3), np.nan),
        set_to("joints", (1, 2, 0), np.inf),
        set_to("joints", (1, 2, 0), 1e6),
        set_to("pos", (0, 0, 0), np.nan),
        set_to("pos", (0, 0, 0), 3e38),
        set_to("quat", (1, 2), (0.0, 0, 0, 0)),
        set_to("quat", (1, 2), (2.0, 0, 0, 0)),
        set_to("quat", (1, 0), (3e38, 3e38, 0, 0)),
        set_to("quat", (0, 1), np.nan),
    ],
)
def test_numbers_that_are_no_pose_get_a_status_and_no_figures(hands, change):
    status, out = status_of(hands, change)
    assert status == Status.BAD_POSE
    assert np.isnan(out["pd"][0])
    assert out["contact_number"][0] == -1


@pytest.mark.parametrize("at", [(100.0, 0, 0), (0, -999.0, 0)])
def test_an_object_far_away_is_not_held(hands, at):
    status, _ = status_of(hands, lambda *a: None, object_pos=[at])
    assert status == Status.NO_CONTACT


def test_an_object_without_a_pose_gets_a_status(hands):
    assert status_of(hands, lambda *a: None, object_quat=[(0.0, 0, 0, 0)])[0] == Status.BAD_POSE
    assert status_of(hands, lambda *a: None, object_pos=[(1e9, 0, 0)])[0] == Status.BAD_POSE


def test_rows_without_a_grasp_are_not_run_even_if_their_pose_is_missing(hands):
    nothing = tuple(np.full_like(a, np.nan) for a in squeeze(hands))
    far = squeeze(hands, gaps=FAR)
    status = np.array([Status.NO_PLACEMENT, Status.OK])
    batch = batch_of(hands, [nothing, far], synth_status=status)
    out = validate_grasps(batch, box_solid(), hands, PAPER)
    assert out["verdict_status"].tolist() == [Status.NOT_RUN, Status.NO_CONTACT]
    assert np.isnan(out["cdc"][0])


def test_no_rows_give_no_verdicts(hands):
    batch = batch_of(hands, [squeeze(hands)]).select(np.zeros(1, bool))
    out = validate_grasps(batch, box_solid(), hands, PAPER)
    assert {len(v) for v in out.values()} == {0}
    assert len(batch.with_columns(**out)) == 0


def test_the_columns_fit_the_record(hands):
    batch = batch_of(hands, [squeeze(hands, gaps=FAR)])
    out = validate_grasps(batch, box_solid(), hands, PAPER)
    assert batch.with_columns(**out).pd.dtype == np.float32


def test_an_object_that_the_simulator_refuses_gives_a_status(hands):
    flat = replace(
        box_solid(), pieces=(box_mesh((0, 0, 0), (1, 1, 0)),), volume=0.0, inertia=np.zeros((3, 3))
    )
    out = validate_grasps(batch_of(hands, [squeeze(hands)]), flat, hands, PAPER)
    assert out["verdict_status"].tolist() == [Status.NO_SCENE]


def test_another_object_other_hands_and_unknown_tests_are_refused(hands):
    batch = batch_of(hands, [squeeze(hands)])
    with pytest.raises(NotUsable, match="'box', not of 'cup'"):
        validate_grasps(batch, box_solid(object_id="cup"), hands, PAPER)
    with pytest.raises(NotUsable, match="joints"):
        validate_grasps(batch, box_solid(), hands[::-1], PAPER)
    with pytest.raises(NotUsable, match="no test 'z'; it has: f, l"):
        validate_grasps(batch, box_solid(), hands, PAPER, "z")
