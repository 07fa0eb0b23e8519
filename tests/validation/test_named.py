"""The named protocols and protocols of the user's own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from box_solids import box_solid
from grasps import batch_of, squeeze

from bidexdata.errors import BadConfig, NotUsable, PathNotFound, UnknownKey
from bidexdata.record import Status
from bidexdata.simulation.scene import build_scene
from bidexdata.validation import load_protocol, protocol_names, validate_grasps

BOX = box_solid()


def test_the_bench_is_what_its_facts_state():
    p = load_protocol("dexgraspbench-1")
    assert (p.load, p.gravity * p.scene.mass) == ("force", 1.0)
    assert p.directions == ("-x", "+x", "-y", "+y", "-z", "+z")
    assert (p.hold, p.check_every, p.checks, p.check_closing) == (2.0, 0.2, 10, False)
    assert (p.lift.height, p.lift.changes * p.lift.steps * p.scene.timestep) == (0.10, 0.4)
    assert p.lift_checks == 0
    biman = load_protocol("bimandexgraspbench-1")
    assert biman.lift.changes * biman.lift.steps * biman.scene.timestep == 1.0
    assert biman.segment_changes * biman.segment_steps * biman.scene.timestep == 1.0


@pytest.mark.parametrize(
    ("name", "mass"),
    [
        ("paper-1", 2.5),
        ("paper-1-density25", 25.0),
        ("paper-1-density250", 250.0),
    ],
)
def test_variants_of_the_load_change_the_density_and_nothing_else(name, mass):
    paper, other = load_protocol("paper-1"), load_protocol(name)
    same = replace(other, name=paper.name, description=paper.description, scene=paper.scene)
    assert same == paper
    scene = build_scene((), BOX, 0.5, other.scene)
    assert scene.object_mass == pytest.approx(BOX.volume * 0.125 * mass)


def test_a_nominal_mass_does_not_depend_on_the_size():
    rules = load_protocol("paper-1-mass500g").scene
    for size in (0.3, 0.8):
        scene = build_scene((), BOX, size, rules)
        assert scene.model.body("object").mass[0] == pytest.approx(0.5)


@pytest.mark.parametrize("name", protocol_names())
def test_a_firm_squeeze_of_a_light_box_passes_and_hands_far_away_fail(hands, name):
    if name == "paper-1-density250":
        pytest.skip("a box of 250 kg/m^3 is beyond two palms")
    rules = replace(load_protocol(name), hold=0.4)
    rows = [squeeze(hands), squeeze(hands, gaps=(0.1,) * 3)]
    out = validate_grasps(batch_of(hands, rows), BOX, hands, rules)
    assert out["success"].tolist() == [True, False]
    assert out["verdict_status"][1] == Status.NO_CONTACT


def test_hands_on_slides_follow_their_targets(hands):
    """The base of bimandexgraspbench-1 puts a hand where the record says, and keeps it there."""
    import mujoco

    from bidexdata.frames import quat_angle, random_quat
    from bidexdata.simulation.state import set_pose

    rules = load_protocol("bimandexgraspbench-1").scene
    scene = build_scene(hands, None, 0.0, rules)
    rng = np.random.default_rng(2)
    for quat in [random_quat(rng, (2,)), np.array([[1.0, 0, 0, 0], [0.0, 1, 0, 0]])]:
        pos = rng.normal(size=(2, 3))
        set_pose(scene, np.zeros(3), [1.0, 0, 0, 0], pos, quat, np.zeros((2, 22)))
        mujoco.mj_forward(scene.model, scene.data)
        for i, hand in enumerate(hands):
            body = scene.model.body(f"hand{i}/{hand.root_body}").id
            np.testing.assert_allclose(scene.data.xpos[body], pos[i], atol=1e-9)
            assert quat_angle(scene.data.xquat[body][None], quat[i])[0] < 1e-6
        mujoco.mj_step(scene.model, scene.data, 50)
        body = scene.model.body(f"hand0/{hands[0].root_body}").id
        np.testing.assert_allclose(scene.data.xpos[body], pos[0], atol=5e-3)


def test_the_fork_s_hinges_turn_about_a_point_below_the_palm(hands):
    rules = load_protocol("bimandexgraspbench-1").scene
    model = build_scene(hands, None, 0.0, rules).model
    np.testing.assert_array_equal(model.jnt_pos[:6], [[0, 0, -0.034]] * 6)


def test_the_fork_s_fingers_keep_the_torques_of_their_hand(menagerie):
    from bidexdata.hands import load_hands

    rules = load_protocol("bimandexgraspbench-1").scene
    model = build_scene(load_hands("shadow"), None, 0.0, rules).model
    found: dict[str, set[float]] = {}
    for i in range(model.nu):
        joint = model.actuator(i).name.rpartition("h_")[2]
        if model.actuator_forcelimited[i]:
            found.setdefault(joint[:2], set()).add(float(model.actuator_forcerange[i, 1]))
    assert found.pop("TH") == {1.0, 2.0, 3.0}
    assert found == {finger: {1.0} for finger in ("FF", "MF", "RF", "LF")}


def test_a_weld_holds_any_point_of_the_hand_at_its_target(hands):
    """The anchor moves the point that is held, not the place of the hand."""
    import mujoco

    from bidexdata.simulation.state import set_pose

    rules = replace(load_protocol("paper-1").scene, weld_anchor=(0.0, 0.02, -0.034))
    scene = build_scene(hands, None, 0.0, rules)
    quat = np.array([[0.6, 0.0, 0.8, 0.0], [1.0, 0, 0, 0]])
    set_pose(scene, np.zeros(3), [1.0, 0, 0, 0], np.eye(2, 3), quat, np.zeros((2, 22)))
    mujoco.mj_forward(scene.model, scene.data)
    weld = scene.data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    np.testing.assert_allclose(scene.data.efc_pos[weld][:6], 0, atol=1e-9)


def test_a_file_changes_settings_of_a_known_protocol(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("base: paper-1\nname: mine-1\ndescription: my own loads\nhold: 1.0\n")
    mine = load_protocol(path)
    assert mine.hold == 1.0
    assert replace(mine, hold=3.0, name="paper-1", description="") == replace(
        load_protocol("paper-1"), description=""
    )


@pytest.mark.parametrize(
    ("text", "error", "says"),
    [
        ("base: paper-1\nhold: 1.0\n", BadConfig, "its own name and description"),
        ("name: mine\ndescription: x\nhodl: 1.0\n", UnknownKey, "did you mean 'hold'"),
        ("name: My Own\ndescription: x\n", BadConfig, "lower-case"),
        ("name: mine\ndescription: x\ndirections: [up]\n", BadConfig, r"\+x"),
        ("name: mine\ndescription: x\ntests: [q]\n", BadConfig, "may name f, l, a"),
        ("name: mine\ndescription: x\ntests: [a]\n", BadConfig, "needs `arm`"),
        ("base: paper-1\nname: mine\ndescription: x\narm: {wait: -1}\n", BadConfig, "arm.wait"),
        ("base: paper-1\nname: paper-1\ndescription: x\nhold: 1.0\n", NotUsable, "another name"),
    ],
)
def test_a_file_that_makes_no_protocol_is_refused(tmp_path, text, error, says):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(error, match=says):
        load_protocol(path)


def test_a_missing_file_is_named():
    with pytest.raises(PathNotFound, match=r"none\.yaml"):
        load_protocol("none.yaml")
