"""What a rig's YAML may say, what is refused in one sentence, and what arms can carry."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from made_rig import arm_xml, rig_data, write_rig

from bidexdata.arms.arm_spheres import spheres_as_arrays, spheres_from_arrays
from bidexdata.arms.payload import TooHeavy, check_payload, require_payload
from bidexdata.arms.registry import DEFAULT_RIG, load_rig, rig_names, rig_spec
from bidexdata.arms.robot import mount_robot, robot_spec
from bidexdata.arms.spec import read_rig
from bidexdata.config import from_plain, to_plain
from bidexdata.errors import BadConfig, NotUsable, PathNotFound, UnknownKey, UnknownName
from bidexdata.hands import load_hand, load_hands


def changed(folder: Path, *keys: str, value: object) -> Path:
    """The made-up rig with one nested key set; without it where the value is None."""
    data = rig_data()
    part = data
    for key in keys[:-1]:
        part = part[key]
    if value is None:
        del part[keys[-1]]
    else:
        part[keys[-1]] = value
    path = write_rig(folder)
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return path


@pytest.mark.parametrize("name", ["ur10e_post", "iiwa14_facing", "xarm7_leap"])
def test_the_rigs_of_the_package_can_be_read(name):
    assert name in rig_names()
    spec = rig_spec(name)
    assert spec.name == name
    assert from_plain(type(spec), to_plain(spec)) == spec


def test_the_default_rig_is_there():
    assert DEFAULT_RIG in rig_names()


def test_comments_do_not_change_the_digest_and_the_model_does(tmp_path):
    path = write_rig(tmp_path)
    first = load_rig(path).digest
    path.write_text("# a comment\n" + path.read_text())
    assert load_rig(path).digest == first
    other = write_rig(tmp_path / "other")
    (other.parent / "arm.xml").write_text(arm_xml().replace('mass="5"', 'mass="6"'))
    assert load_rig(other).digest != first
    third = write_rig(tmp_path / "third", description="another")
    assert load_rig(third).digest != first


def test_an_unknown_rig_and_an_unknown_key_name_the_nearest(tmp_path):
    with pytest.raises(UnknownName, match="did you mean 'ur10e_post'"):
        load_rig("ur10_post")
    with pytest.raises(UnknownKey, match="did you mean 'fixtures'"):
        read_rig(write_rig(tmp_path, fixture=[]))


IMPOSSIBLE = [
    (("arm", "payload"), 0.0, r"arm.payload must be positive"),
    (("arm", "joints", "j2", "upper"), 7.0, r"arm.joints.j2.lower and upper"),
    (("arm", "joints", "j2", "velocity"), -1.0, r"arm.joints.j2.velocity must be positive"),
    (("left", "rest"), [0.0, 0.0], r"left.rest must give 7 angles"),
    (("right", "rest"), [0.0, 2.5, 0.0, 0.0, 0.0, 0.0, 0.0], r"right.rest: j2 = 2.5 lies outside"),
    (("left", "quat_wxyz"), [1.0, 1.0, 0.0, 0.0], r"left.quat_wxyz must have length 1"),
    (("mounts",), {}, r"mounts is empty"),
    (("mounts", "*", "wrist_joints"), ["w"], r"wrist_rest must give one angle"),
    (("fixtures",), [{"pos": [0, 0, 0], "half": [0.1, 0, 0.1]}], r"half must be three positive"),
    (("left",), None, r"lacks left"),
    (("arm", "flange"), None, r"arm lacks flange"),
]


@pytest.mark.parametrize(("keys", "value", "says"), IMPOSSIBLE, ids=[i[2][:28] for i in IMPOSSIBLE])
def test_an_impossible_value_is_refused_by_its_key(tmp_path, keys, value, says):
    with pytest.raises(BadConfig, match=says):
        read_rig(changed(tmp_path, *keys, value=value))


MISFITS = [
    (("arm", "flange"), "flang", r"no site or body 'flang'; its sites: flange"),
    (("arm", "joints"), {"j1": rig_data()["arm"]["joints"]["j1"]}, r"must be those of the model"),
    (("arm", "joints", "j2", "upper"), 2.5, r"leaves the model's"),
    (("exclude_contacts",), [["base", "nose"]], r"body 'nose', which the arm lacks"),
]


@pytest.mark.parametrize(("keys", "value", "says"), MISFITS, ids=[m[2][:28] for m in MISFITS])
def test_a_rig_that_does_not_fit_its_model_says_where(tmp_path, keys, value, says):
    path = changed(tmp_path, *keys, value=value)
    if keys[-1] == "joints":
        # One joint, so one angle of rest.
        data = yaml.safe_load(path.read_text())
        data["left"]["rest"] = data["right"]["rest"] = [0.0]
        path.write_text(yaml.safe_dump(data, sort_keys=False))
    with pytest.raises(BadConfig, match=says):
        load_rig(path)


def test_a_missing_model_and_a_missing_mesh_are_one_sentence_that_names_the_file(tmp_path):
    path = write_rig(tmp_path)
    (tmp_path / "arm.xml").write_text(
        arm_xml().replace(
            "<worldbody>", '<asset><mesh name="m" file="gone.stl"/></asset><worldbody>'
        )
    )
    with pytest.raises(
        BadConfig, match=r"mesh 'm' names the file .*gone.stl, which cannot be read"
    ):
        load_rig(path)
    (tmp_path / "arm.xml").unlink()
    with pytest.raises(PathNotFound, match=r"arm.xml"):
        load_rig(path)


def test_a_joint_without_an_actuator_and_a_slide_are_refused(tmp_path):
    path = write_rig(tmp_path)
    model = arm_xml()
    (tmp_path / "arm.xml").write_text(model.replace('<position name="a4" joint="j4"/>', ""))
    with pytest.raises(BadConfig, match="joint 'j4' of the model has no actuator"):
        load_rig(path)
    later = write_rig(tmp_path / "slide")
    (later.parent / "arm.xml").write_text(model.replace('name="j4"', 'name="j4" type="slide"'))
    with pytest.raises(BadConfig, match="'j4' of the model is no hinge"):
        load_rig(later)


def test_a_hand_without_a_mount_is_named(tmp_path):
    mount = rig_data()["mounts"]["*"]
    rig = load_rig(write_rig(tmp_path, mounts={"leap": mount}))
    with pytest.raises(BadConfig, match=r"no mount for the hand 'capsule', only for leap"):
        mount_robot(rig, load_hands("capsule"))
    with pytest.raises(NotUsable, match="a left and a right hand"):
        mount_robot(rig, [load_hand("capsule", "left")])
    later = load_rig(write_rig(tmp_path / "top", mounts={"*": {**mount, "top": "forearm"}}))
    with pytest.raises(BadConfig, match="no body 'lh_forearm'"):
        mount_robot(later, load_hands("capsule"))


def test_the_palm_is_mounted_the_same_on_both_sides(made):
    # At mirrored angles the palms are mirror images, whatever the hands' own root frames are.
    from bidexdata.arms.chain import chain_forward

    palms = []
    for arm, hand in zip(made.arms, made.hands, strict=True):
        pos, rot = chain_forward(arm.chain, arm.chain.rest)
        palms.append((pos + rot @ hand.T_hand_palm[:3, 3], rot @ hand.T_hand_palm[:3, :3]))
    mirror = np.diag([1.0, -1.0, 1.0])
    np.testing.assert_allclose(mirror @ palms[0][0], palms[1][0], atol=1e-6)
    np.testing.assert_allclose(mirror @ palms[0][1] @ mirror, palms[1][1], atol=1e-6)


def test_the_shadow_hand_above_its_root_is_its_own_model(menagerie):
    hand = load_hand("shadow", "left")
    model = hand.make_mounted("forearm").compile()
    own = hand.make_spec().compile()
    assert [model.joint(j).name for j in range(2)] == ["lh_WRJ2", "lh_WRJ1"]
    assert model.nu == own.nu + 2
    for name in hand.body_names:
        a, b = model.body(name), own.body(name)
        np.testing.assert_array_equal(a.mass, b.mass)
        if name != hand.root_body:
            np.testing.assert_array_equal(a.pos, b.pos)
    with pytest.raises(BadConfig, match="does not carry the hand's root"):
        hand.make_mounted("ffknuckle")


def test_the_models_options_and_keyframes_do_not_come_along(made):
    spec = robot_spec(made)
    assert not list(spec.keys)
    assert not list(spec.lights)
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    model = spec.compile()
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert model.nkey == 0


def test_arms_that_are_too_weak_are_refused_with_both_masses(tmp_path, made):
    for finding in check_payload(made):
        assert finding.fits
        hand = made.hands[0].make_spec().compile().body_mass.sum()
        assert abs(finding.carried - hand - 0.125) < 1e-6
        assert 0 < finding.torque_share < 1
    require_payload(made)
    weak = rig_data()["arm"] | {"payload": 0.5}
    robot = mount_robot(load_rig(write_rig(tmp_path, arm=weak)), load_hands("capsule"))
    with pytest.raises(
        TooHeavy, match=r"the left arm of rig 'made' carries 0.5 kg, and hand capsule"
    ):
        require_payload(robot)


def test_torque_at_rest_is_that_of_a_static_equilibrium(made):
    # The share is linear in what is held: with no object it is the arm's and the hand's own.
    light, heavy = check_payload(made, 0.0)[0], check_payload(made, 2.0)[0]
    assert heavy.torque_share > light.torque_share
    twice = check_payload(made, 4.0)[0]
    rise = heavy.torque_share - light.torque_share
    assert abs(twice.torque_share - heavy.torque_share - rise) < 0.02


@pytest.mark.parametrize("rig", ["ur10e_post", "iiwa14_facing", "xarm7_leap"])
def test_the_licence_of_an_arm_stands_beside_its_model(menagerie, rig):
    loaded = load_rig(rig)
    assert loaded.left.licence_text
    assert re.search("BSD|Redistribution", loaded.left.licence_text)


def test_spheres_that_are_known_are_taken_as_they_are(made, tmp_path):
    arrays = [spheres_as_arrays(arm.spheres) for arm in made.arms]
    read = [spheres_from_arrays(a) for a in arrays]
    for arm, again in zip(made.arms, read, strict=True):
        for name, values in arm.spheres._asdict().items():
            assert np.array_equal(values, getattr(again, name)), name
            assert np.asarray(values).dtype == np.asarray(getattr(again, name)).dtype, name
    other = load_rig(write_rig(tmp_path, description="another rig, so that it is mounted anew"))
    asked = []
    robot = mount_robot(
        other, made.hands, lambda digest: asked.append(digest) or (read[0], read[1])
    )
    assert asked == [robot.digest]
    assert [arm.spheres for arm in robot.arms] == read
