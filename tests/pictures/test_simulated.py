"""Laws of simulated pictures: bodies are drawn where the simulator has them."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from picture_samples import box_solid, grasps

from bidexdata.frames import quat_angle
from bidexdata.pictures.drawing import grasp_parts
from bidexdata.pictures.sheet import Caption
from bidexdata.pictures.simulated import (
    read_simulated_pose,
    simulation_camera,
    simulation_frames,
    simulation_parts,
)
from bidexdata.pictures.video import save_video
from bidexdata.simulation.scene import build_scene
from bidexdata.simulation.state import set_pose

SIZE = 0.3
# Rows hold poses in single precision.
FLOAT32 = 1e-5
WORDS = Caption("t = 0.10 s", ("closing", "not judged yet"))


@pytest.fixture(scope="module")
def solid():
    return box_solid("box0-00000000")


@pytest.fixture(scope="module")
def batch(hands, solid):
    return grasps(hands, solid)


@pytest.fixture(scope="module")
def scene(hands, solid):
    return build_scene(hands, solid, SIZE, table=True)


def put(scene, batch, row=0, stage=1, height=0.0):
    up = np.array([0.0, 0.0, height])
    at = (batch["object_pos"][row] + up, batch["object_quat_wxyz"][row])
    hand = (batch["hand_pos"][row, :, stage] + up, batch["hand_quat_wxyz"][row, :, stage])
    set_pose(scene, *at, *hand, batch["joints"][row, :, stage])


def test_a_state_at_a_stored_pose_is_drawn_as_the_row_is(scene, batch, solid, hands):
    for row, stage in ((0, 0), (0, 1), (2, 2)):
        put(scene, batch, row, stage)
        shown = simulation_parts(read_simulated_pose(scene), solid, SIZE, hands)
        wanted = grasp_parts(batch, row, solid, hands, stage=stage, contacts=False)
        assert [p.label for p in shown] == [p.label for p in wanted]
        for one, other in zip(shown, wanted, strict=True):
            np.testing.assert_allclose(one.vertices, other.vertices, atol=FLOAT32)


def test_looking_changes_nothing_that_follows(scene, batch):
    def played(look):
        put(scene, batch, height=0.2)
        scene.model.opt.gravity[:] = (0, 0, -9.8)
        for _ in range(40):
            mujoco.mj_step(scene.model, scene.data)
            if look:
                read_simulated_pose(scene)
        scene.model.opt.gravity[:] = 0.0
        return scene.data.qpos.copy(), scene.data.qvel.copy()

    for plain, looked_at in zip(played(False), played(True), strict=True):
        assert np.array_equal(plain, looked_at)


def test_the_pose_is_that_of_the_state_after_the_last_step(scene, batch):
    put(scene, batch, height=0.3)
    scene.data.qvel[scene.object_qvel : scene.object_qvel + 6] = (1, 2, 3, 0, 0, 9)
    mujoco.mj_step(scene.model, scene.data, 3)
    pose = read_simulated_pose(scene)
    at = scene.object_qpos
    assert np.array_equal(pose.object_pos, scene.data.qpos[at : at + 3])
    assert quat_angle(pose.object_quat_wxyz, scene.data.qpos[at + 3 : at + 7][None]) < 1e-6
    for i, root in enumerate(scene.root_qpos):
        assert np.array_equal(pose.body_pos[i][0], scene.data.qpos[root : root + 3])
        assert len(pose.body_pos[i]) == len(scene.hands[i].body_names)


def test_the_table_is_drawn_where_it_is_asked_for(scene, batch, solid, hands):
    put(scene, batch, height=0.2)
    pose = read_simulated_pose(scene)
    without = simulation_parts(pose, solid, SIZE, hands)
    parts = simulation_parts(pose, solid, SIZE, hands, table=True)
    assert [p.label for p in parts] == [*(p.label for p in without), "ground"]
    assert np.all(parts[-1].vertices[:, 2] == 0)
    camera = simulation_camera([pose], solid, SIZE, hands, table=True)
    assert camera.position[2] > 0  # a table is not looked at from below


def test_a_replay_stands_still_keeps_everything_in_view_and_makes_a_video(
    scene, batch, solid, hands, tmp_path: Path
):
    poses = []
    for k in range(4):
        put(scene, batch, height=0.15 + 0.03 * k)
        poses.append(read_simulated_pose(scene))
    aspect = 120 / 90
    camera = simulation_camera(poses, solid, SIZE, hands, table=True, aspect=aspect)
    for pose in poses:
        for part in simulation_parts(pose, solid, SIZE, hands):
            x, y, z = ((part.vertices - camera.position) @ camera.R_world_camera).T
            assert np.all(np.abs(y) <= -z * camera.tan_half_height)
            assert np.all(np.abs(x) <= -z * camera.tan_half_height * aspect)
    size = {"width": 120, "height": 90, "table": True}

    def filmed(moments):
        return list(simulation_frames(moments, solid, SIZE, hands, camera, **size))

    frames = filmed([(p, WORDS) for p in poses])
    assert len({f.shape for f in frames}) == 1
    assert frames[0].shape[0] > 90
    assert not np.array_equal(frames[0][:90], frames[-1][:90])
    for pose, frame in zip(poses, frames, strict=True):
        (alone,) = filmed([(pose, WORDS)])
        # A moved scene may meet the other of two triangles at the edge that they share.
        assert np.mean(alone != frame) < 0.001
    (other,) = filmed([(poses[0], WORDS._replace(head="t = 0.20 s"))])
    assert np.array_equal(other[:90], frames[0][:90])
    assert not np.array_equal(other[90:], frames[0][90:])
    save_video(frames, tmp_path / "replay.mp4", 25)
    assert (tmp_path / "replay.mp4").stat().st_size > 500
