"""The other side of a hand: about any axis, between any two frames, with joints of either sense."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from bidexdata.errors import BadConfig
from bidexdata.hands import load_hand
from bidexdata.hands.kinematics import hand_points
from bidexdata.hands.mirror import mirror_image
from bidexdata.hands.registry import hand_spec

# One finger along +x with an abduction about z, then a flexion about -y; the palm faces +z.
MODEL = """<mujoco><worldbody><body name="palm" {palm}>
  <geom type="box" size=".04 .03 .01" pos="{shift}"/>
  <body name="base" pos="{base}"><joint name="spread" axis="0 0 {sense}" range="{range}"/>
    <geom type="capsule" fromto="0 0 0 .04 0 0" size=".008"/>
    <body name="tip" pos=".05 0 0"><joint name="bend" axis="0 -1 0" range="-.2 1.6"/>
      <geom type="capsule" fromto="0 0 0 .03 0 0" size=".008"/></body></body></body></worldbody>
  <actuator><position joint="spread"/><position joint="bend"/></actuator>
  <compiler angle="radian"/></mujoco>"""


def written(tmp_path: Path, left: dict[str, str], side: dict[str, object], **keys: object) -> str:
    """A spec whose right hand has its finger at y = +0.02; `left` says how the left model differs."""
    right = {"palm": "", "shift": "0 0 0", "base": ".05 .02 0", "sense": "1", "range": "-.3 .9"}
    (tmp_path / "right.xml").write_text(MODEL.format(**right))
    (tmp_path / "left.xml").write_text(MODEL.format(**right | left))
    spec = {
        "name": "finger", "description": "one finger", "licence": "Apache-2.0",
        "sides": {"right": {"source": "right.xml"}, "left": {"source": "left.xml", **side}},
        "written_for": "right", "root": "palm", "fingers": {"f": ["base", "tip"]}, "coupled": {},
        "postures": {"open": {"spread": 0.2, "bend": 0.3}, "curved": {"bend": 0.6}},
        "contacts": [{"name": "f", "finger": "f", "body": "tip", "pos": [0.03, 0.001, 0],
                      "radius": 0.008, "normal": [0.5, 0.1, 0.8]}],
        "palm_frame": {"pos": [0, 0, 0.01], "x": [1, 0, 0], "z": [0, 0, 1]},
    } | keys  # fmt: skip
    path = tmp_path / "finger.yaml"
    path.write_text(yaml.safe_dump(spec))
    return str(path)


SAME_SENSE = {"base": ".05 -.02 0", "range": "-.9 .3"}
"""A left model whose spread has the same axis, so that its mirror image turns the other way."""
OWN_ORIGIN = {"shift": ".1 -.02 .3", "base": ".15 -.04 .3", "sense": "-1"}
"""The left hand frame is somewhere else; its spread turns as the mirror image does."""


@pytest.mark.parametrize(
    ("left", "side", "keys", "factor"),
    [
        (SAME_SENSE, {}, {"mirror": "y"}, -1.0),
        ({"base": ".05 -.02 0", "sense": "-1"}, {}, {"mirror": "y"}, 1.0),
        (OWN_ORIGIN, {"palm_frame": {"pos": [0.1, -0.02, 0.31], "x": [1, 0, 0], "z": [0, 0, 1]}},
         {}, 1.0),
    ],
    ids=["same sense", "mirrored sense", "own origin"],
)  # fmt: skip
def test_mirrored_angles_give_the_mirror_image(tmp_path, left, side, keys, factor):
    path = written(tmp_path, left, side, **keys)
    right, other = load_hand(path, "right"), load_hand(path, "left")
    image = mirror_image(hand_spec(path))
    assert np.linalg.det(image[:3, :3]) == pytest.approx(-1)
    for posture in ("posture_open", "posture_curved"):
        mine, theirs = getattr(other, posture), getattr(right, posture)
        np.testing.assert_allclose(mine, theirs * [factor, 1.0], atol=1e-12)
        found, expected = hand_points(other, mine), hand_points(right, theirs)
        for a, b in ((found.contact, expected.contact), (found.sphere, expected.sphere)):
            np.testing.assert_allclose(a, b @ image[:3, :3].T + image[:3, 3], atol=1e-6)
        np.testing.assert_allclose(found.normal, expected.normal @ image[:3, :3].T, atol=1e-6)
    flipped = np.diag([1.0, -1.0, 1.0, 1.0])
    np.testing.assert_allclose(other.T_hand_palm, image @ right.T_hand_palm @ flipped, atol=1e-12)


def test_a_link_of_another_shape_has_spheres_of_its_own(tmp_path):
    path = written(tmp_path, SAME_SENSE | {"shift": "0 0.012 0"}, {}, mirror="y")
    right, left = load_hand(path, "right"), load_hand(path, "left")
    palm = left.sphere_pos[left.sphere_body == 0]
    assert (palm[:, 1].min(), palm[:, 1].max()) == pytest.approx((-0.008, 0.032), abs=0.004)
    tips = [hand.sphere_radius[hand.sphere_body > 0] for hand in (left, right)]
    np.testing.assert_array_equal(*tips)
    assert left.sphere_body[0] == right.sphere_body[0] == 2  # contact spheres come first


def test_an_angle_beyond_the_other_sides_limits_is_refused(tmp_path):
    left = SAME_SENSE | {"range": "-.1 .3"}
    path = written(tmp_path, left, {}, mirror="y")
    with pytest.raises(BadConfig, match=r"spread = -0.2, mirrored for the left side"):
        load_hand(path, "left")


def test_sides_with_other_names_are_refused_with_the_names(tmp_path):
    path = written(tmp_path, SAME_SENSE, {}, mirror="y")
    nail = '<body name="nail"><geom size=".01"/></body><body name="base"'
    text = (tmp_path / "left.xml").read_text().replace('<body name="base"', nail)
    (tmp_path / "left.xml").write_text(text)
    with pytest.raises(BadConfig, match="left side has nail besides"):
        load_hand(path, "left")


def test_a_joint_that_no_posture_names_must_be_able_to_stand_at_zero(tmp_path):
    path = written(tmp_path, SAME_SENSE, {}, mirror="y")
    text = (tmp_path / "right.xml").read_text().replace("-.3 .9", ".1 .9")
    (tmp_path / "right.xml").write_text(text)
    with pytest.raises(BadConfig, match=r"curved: spread = 0 \(not named, so zero\)"):
        load_hand(path, "right")


def test_a_palm_frame_of_the_written_side_stands_in_one_place(tmp_path):
    frame = {"pos": [0, 0, 0.01], "x": [1, 0, 0], "z": [0, 0, 1]}
    sides = {"right": {"source": "right.xml", "palm_frame": frame}}
    with pytest.raises(BadConfig, match="the spec's own"):
        load_hand(written(tmp_path, SAME_SENSE, {}, sides=sides), "right")
