"""What `verify` finds in the arm columns of a release: each law holds, and each is seen to be broken."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_arms import PATH, RIG
from made_release import made_release, made_rows

from bidexdata.errors import Contradiction
from bidexdata.formats.arm_checks import arm_poses, arm_rows
from bidexdata.formats.release import Release
from bidexdata.record import GraspBatch, Status
from bidexdata.record.fields import KEY_FRAMES

LEFT, RIGHT = 0, 1
AT = {name: k for k, name in enumerate(KEY_FRAMES)}


def changed_release(out: Path, change) -> Release:
    """A release of one object whose arm columns `change` has written to, on rows with a motion."""

    def rows_of(object_id: str):
        rows = made_rows(object_id, setting="tabletop", arms=True)
        columns = {name: values.copy() for name, values in rows.arms.items()}
        change(columns, np.flatnonzero(columns["arm_status"] == Status.OK))
        batch = GraspBatch(rows.batch.header, {**rows.batch.columns, **columns})
        return [replace(rows, batch=batch, arms=columns)]

    made_release(out, ("box-aaaaaaaa",), arms=True, rows_of=rows_of, form="parquet")
    return Release.open(out)


def config_of_rig(release: Release, **path) -> None:
    """Let the rig of a release say other things of motions."""
    file = release.path / "rigs" / RIG / "rig.json"
    document = json.loads(file.read_text())
    document["config"]["path"] |= path
    file.write_text(json.dumps(document))


@pytest.fixture(scope="module")
def right(tmp_path_factory) -> Release:
    return changed_release(tmp_path_factory.mktemp("right") / "release", lambda c, rows: None)


def test_a_right_release_passes(right: Release):
    assert "motions of" in arm_rows(right)
    assert "from their grasps" in arm_poses(right)


def other_key(c, rows):
    # A path that is another way to the same ends, and the ends of another: one angle is enough.
    c["arm_joints"][rows[0], RIGHT, AT["grasp"], 0] = np.nextafter(
        c["arm_joints"][rows[0], RIGHT, AT["grasp"], 0], np.float32(2)
    )


def other_path(c, rows):
    c["arm_path"][rows[0], LEFT, -1, 0] += 1e-3


def padded_key(c, rows):
    c["arm_joints"][rows[0], RIGHT, AT["home"], -1] = 0.0  # the right chain is the shorter one


@pytest.mark.parametrize("change", [other_key, other_path, padded_key])
def test_key_frames_are_the_knots_that_end_their_phases_to_the_bit(tmp_path, change):
    with pytest.raises(Contradiction, match=r"arm_joints are not those of its path|padded angles"):
        arm_rows(changed_release(tmp_path / "release", change))


def test_no_step_is_larger_than_the_rig_was_asked_for(right: Release, tmp_path):
    release = changed_release(tmp_path / "release", lambda c, rows: None)
    config_of_rig(release, largest_step=0.05)
    with pytest.raises(Contradiction, match=r"turns by more than 0\.05 rad"):
        arm_rows(release)


def test_a_lift_of_another_height_is_found(tmp_path):
    release = changed_release(tmp_path / "release", lambda c, rows: None)
    config_of_rig(release, lift=PATH.lift + 5e-4)  # the hands stay a millimetre below as it is
    with pytest.raises(Contradiction, match="the left hand is not at its lift"):
        arm_poses(release)


def test_palms_that_stay_at_the_grasp_are_looked_for_there(tmp_path):
    release = changed_release(tmp_path / "release", lambda c, rows: None)
    config_of_rig(release, squeeze_palm="fixed")
    with pytest.raises(Contradiction, match="the left hand is not at its squeeze"):
        arm_poses(release)


def far_standoff(c, rows):
    # Half a radian of the first joint: far aside, and turned.
    c["arm_joints"][rows, LEFT, AT["standoff"], 0] += 0.5


def test_a_stand_off_lies_about_the_pregrasp(tmp_path):
    with pytest.raises(Contradiction, match="the left hand is not at a stand-off"):
        arm_poses(changed_release(tmp_path / "release", far_standoff))


@pytest.mark.parametrize("name", ["ik_error_pos", "ik_error_rot"])
@pytest.mark.parametrize("frame", ["pregrasp", "grasp", "squeeze", "lift"])
def test_stored_errors_are_those_that_are_counted_again(tmp_path, name, frame):
    def claimed(c, rows):
        c[name][rows[0], RIGHT, AT[frame]] += 2e-4

    found = f"its {name} is not what the right hand is off at its {frame}"
    with pytest.raises(Contradiction, match=found):
        arm_poses(changed_release(tmp_path / "release", claimed))


@pytest.mark.parametrize("value", [np.nan, 0.002])
def test_the_stand_off_is_reached_as_well_as_was_accepted(tmp_path, value):
    def missed(c, rows):
        c["ik_error_pos"][rows[0], LEFT, AT["standoff"]] = value

    with pytest.raises(Contradiction, match="the left hand misses its stand-off"):
        arm_poses(changed_release(tmp_path / "release", missed))
