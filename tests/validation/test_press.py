"""Hands press as hard as the synthesis tells them to: two engines agree on a force."""

import mujoco
import numpy as np

from bidexdata.config import with_overrides
from bidexdata.objects.prepare import prepare_object
from bidexdata.record import Scene, Status
from bidexdata.simulation.state import set_pose
from bidexdata.synthesis.config import SynthConfig
from bidexdata.synthesis.forces import wanted_press
from bidexdata.synthesis.pipeline import synthesize
from bidexdata.validation import Execution, load_protocol
from bidexdata.validation.stages import close_hands
from bidexdata.validation.validate import grasp_of, scene_of_rows

SIZE = 0.5
DENSITY = 25.0
# Fingers are pushed open a little on the way, and their actuators with them.
NEAR = 0.25


def normal_forces(scene):
    """Sum of the normal forces between the object and each hand [N], (H,)."""
    found, force = np.zeros(len(scene.hands)), np.zeros(6)
    for number, geoms in enumerate(scene.data.contact.geom[: scene.data.ncon]):
        owners = scene.geom_owner[geoms]
        if scene.object_owner in owners and owners.min() >= 0:
            mujoco.mj_contactForce(scene.model, scene.data, number, force)
            found[owners.min()] += force[0]
    return found


def pressed_over_wanted(obj, hands, lead):
    """Of finished grasps by fingertips, after closing, (N, H)."""
    config = with_overrides(
        SynthConfig(),
        [
            f"staging.base_lead={lead}",
            f"staging.density={DENSITY}",
            "staging.extrapolate=0",
            "placement.contacts=[fingertips]",
        ],
    )
    scene_of = Scene(obj.object_id, round(1000 * SIZE))
    made = synthesize(obj, hands, [scene_of], config, seed=5, grasps=12, candidates=12)
    made = made.select(made["synth_status"] == Status.OK)
    protocol = load_protocol("paper-1-density25")
    scene = scene_of_rows(made, obj, hands, protocol, "f")
    staging = config.staging
    mass = np.array([obj.mass(SIZE, DENSITY)])
    wanted = wanted_press(mass, staging.force_floor, staging.force_per_weight)
    found = []
    for row in range(len(made)):
        grasp = grasp_of(made, row)
        at = (grasp.hand_pos[:, 0], grasp.hand_quat[:, 0], grasp.joints[:, 0])
        set_pose(scene, grasp.object_pos, grasp.object_quat, *at)
        close_hands(scene, protocol, grasp, Execution())
        found.append(normal_forces(scene) / wanted)
    return np.array(found)


def test_hands_press_as_hard_as_they_are_told_because_their_bases_lead(hands):
    obj = prepare_object("shapes:box")
    leading = np.median(pressed_over_wanted(obj, hands, 1.0))
    assert abs(leading - 1) < NEAR
    assert np.median(pressed_over_wanted(obj, hands, 0.0)) < 0.7 * leading
