"""Laws of motions: what is stored reaches the grasp, steadily, and depends on nothing else."""

from __future__ import annotations

from dataclasses import replace
from math import radians

import numpy as np
import pytest
from palms import targets

from bidexdata.arms import ArmConfig, Targets
from bidexdata.arms.candidates import ways
from bidexdata.arms.chain import chain_forward
from bidexdata.arms.config import PathConfig, SearchConfig
from bidexdata.arms.generic_pairs import shape_grid
from bidexdata.arms.inverse_kinematics import LEAST_ERROR, IkConfig
from bidexdata.arms.solutions import ArmSolutions, join_targets
from bidexdata.arms.solve import solve_arms, solve_scenes, surroundings
from bidexdata.errors import BadConfig
from bidexdata.frames import invert, matrix_from_quat, quat_angle, quat_from_matrix
from bidexdata.record.status import Status

CONFIG = ArmConfig(path=PathConfig(knots=(24, 4, 4, 2, 4)), search=SearchConfig(nodes=32))
POS, ROT, STEP = 1e-3, radians(0.5), 0.2  # what the issue asks for
MIRRORED = 5e-3  # joints that are redundant drift in float32


def solved(robot, scenes: list[Targets], config: ArmConfig = CONFIG) -> ArmSolutions:
    found = [solve_arms(robot, None, None, one, config) for one in scenes]
    return ArmSolutions(*(np.concatenate(columns) for columns in zip(*found, strict=True)))


def assert_same(a: ArmSolutions, b: ArmSolutions) -> None:
    for name, values in a._asdict().items():
        np.testing.assert_array_equal(values, getattr(b, name), err_msg=name)


def test_palms_are_where_they_should_be_from_stand_off_to_lift_and_steps_are_small(robot):
    """By what the record stores, on every rig: under 1 mm, half a degree, 0.2 rad."""
    scenes = targets(robot, count=12, seed=3)
    parts = solve_scenes(robot, None, None, scenes, CONFIG)
    good = [(scene, part) for scene, part in zip(scenes, parts, strict=True) if part.ok.all()]
    assert len(good) >= 4
    for scene, part in good:
        columns = part.to_columns()
        assert np.abs(np.diff(columns["arm_path"], axis=2))[np.isfinite(
            np.diff(columns["arm_path"], axis=2))].max() <= STEP  # fmt: skip
        grasps = join_targets([scene])
        around = surroundings(robot, None, grasps)
        for h, (arm, hand) in enumerate(zip(robot.arms, robot.hands, strict=True)):
            q = columns["arm_joints"][0, h, 1:, : arm.chain.joints].astype(float)
            pos, rot = chain_forward(arm.chain, q)
            # The grasp says where the hand is from pre-grasp to lift, the search where it stands off.
            (before,) = ways(robot, h, around, grasps, CONFIG).poses.pos[:, 0]
            stages = scene.hand_pos[0, h]
            lifted = stages[2] + [0.0, 0.0, CONFIG.path.lift]
            at = np.stack([before, *stages, lifted])
            wanted = matrix_from_quat(scene.hand_quat_wxyz[0, h, [0, 0, 1, 2, 2]])
            palm = hand.T_hand_palm
            off = (pos + rot @ palm[:3, 3]) - (at + wanted @ palm[:3, 3])
            turn = quat_angle(
                quat_from_matrix(rot @ palm[:3, :3]), quat_from_matrix(wanted @ palm[:3, :3])
            )
            assert np.linalg.norm(off, axis=1).max() < POS
            assert turn.max() < ROT


@pytest.mark.parametrize("name", ["accept_pos", "accept_rot"])
def test_the_least_error_that_can_be_asked_for_gives_a_status(made, name):
    config = replace(CONFIG, ik=replace(CONFIG.ik, **{name: LEAST_ERROR}))
    found = solve_arms(made, None, None, targets(made, count=1)[0], config)
    assert np.isin(found.arm_status, [int(s) for s in Status]).all()
    with pytest.raises(BadConfig, match=name):
        IkConfig(**{name: 0.99 * LEAST_ERROR})


def test_the_mirror_image_of_a_scene_has_the_mirror_image_of_its_motion(made):
    """For arms that are mirror images: even joints turn alike, odd ones the other way."""
    # From the rest postures alone: starts that are spread over the ranges are not mirror images.
    ik = IkConfig(starts=1, pool=1, iterations=100)
    search = SearchConfig(near_rest=1, kept=1, detours=1, nodes=0)
    config = replace(CONFIG, ik=ik, search=search)
    flip, sign = np.diag([1.0, -1.0, 1.0]), np.array([-1.0, 1, -1, 1, -1, 1, -1])
    scenes, mirrored = targets(made, count=16, seed=5), []
    for one in scenes:
        pos, quat = one.hand_pos.copy(), one.hand_quat_wxyz.copy()
        for h, (hand, other) in enumerate(zip(made.hands, made.hands[::-1], strict=True)):
            rot = matrix_from_quat(one.hand_quat_wxyz[0, h])
            for s in range(3):
                T = np.eye(4)
                T[:3, :3], T[:3, 3] = rot[s], one.hand_pos[0, h, s]
                palm = T @ hand.T_hand_palm
                palm[:3, :3] = flip @ palm[:3, :3] @ flip
                palm[:3, 3] = flip @ palm[:3, 3]
                there = palm @ invert(other.T_hand_palm)
                pos[0, 1 - h, s], quat[0, 1 - h, s] = there[:3, 3], quat_from_matrix(there[:3, :3])
        mirrored.append(one._replace(hand_pos=pos, hand_quat_wxyz=quat))
    pairs = zip(
        *(solve_scenes(made, None, None, s, config) for s in (scenes, mirrored)), strict=True
    )
    compared = 0
    for first, second in pairs:
        assert first.arm_status == second.arm_status
        expected = sign * first.arm_path[:, ::-1]
        np.testing.assert_allclose(second.arm_path, expected, atol=MIRRORED)
        compared += int(first.ok[0])
    assert compared >= 2


@pytest.fixture(scope="module")
def found(made) -> tuple[list[Targets], ArmSolutions]:
    scenes = targets(made)
    return scenes, solved(made, scenes)


def test_stored_angles_bring_the_hands_to_the_key_frames(made, found):
    scenes, motions = found
    assert motions.ok.sum() >= 3
    columns = motions.to_columns()
    for n in np.flatnonzero(motions.ok):
        for h, arm in enumerate(made.arms):
            q = columns["arm_joints"][n, h].astype(float)
            pos, rot = chain_forward(arm.chain, q)
            for frame, stage in ((2, 0), (3, 1), (4, 2)):
                off = np.linalg.norm(pos[frame] - scenes[n].hand_pos[0, h, stage])
                turn = quat_angle(
                    quat_from_matrix(rot[None, frame]), scenes[n].hand_quat_wxyz[:, h, stage]
                )
                assert off < POS
                assert turn < ROT
            lift = pos[5] - pos[4]
            np.testing.assert_allclose(lift, [0, 0, CONFIG.path.lift], atol=2 * POS)
    assert np.nanmax(motions.ik_error_pos[motions.ok]) < POS
    assert np.nanmax(motions.ik_error_rot[motions.ok]) < ROT


def test_motions_begin_at_home_stay_in_the_limits_and_take_no_large_step(made, found):
    _scenes, motions = found
    columns = motions.to_columns()
    ends = np.cumsum([0, *CONFIG.path.knots])
    for n in np.flatnonzero(motions.ok):
        path, time = columns["arm_path"][n], columns["arm_time"][n]
        assert np.all(np.diff(time) > 0)
        assert np.abs(np.diff(path, axis=1)).max() <= STEP
        np.testing.assert_array_equal(path[:, ends], columns["arm_joints"][n])
        for h, arm in enumerate(made.arms):
            np.testing.assert_array_equal(path[h, 0], arm.chain.rest.astype(np.float32))
            assert np.all(path[h] >= arm.chain.lower - 1e-6)
            assert np.all(path[h] <= arm.chain.upper + 1e-6)
            speed = np.abs(np.diff(path[h], axis=0)) / np.diff(time)[:, None]
            assert np.all(speed <= CONFIG.path.speed * arm.chain.velocity * 1.001)


def test_a_grasp_out_of_reach_cannot_be_reached_and_has_no_motion(made):
    far = [one._replace(hand_pos=one.hand_pos + np.array([2.0, 0, 0])) for one in targets(made)[:2]]
    motions = solved(made, far)
    assert set(motions.arm_status) == {Status.IK_GRASP}
    assert np.isnan(motions.arm_path).all()


def test_rows_without_a_grasp_are_not_asked_about(made):
    one = targets(made)[0]
    motions = solve_arms(made, None, None, one._replace(hand_pos=one.hand_pos * np.nan), CONFIG)
    assert motions.arm_status.tolist() == [Status.NO_GRASP]


def test_an_object_in_the_way_is_named(made):
    # The arms' own links lie in an object of three metres.
    one = targets(made)[0]._replace(size=3.0)
    motions = solve_arms(made, shape_grid(0), None, one, CONFIG)
    assert motions.arm_status.tolist() == [Status.COLLISION_OBJECT]


def test_a_grasp_does_not_depend_on_those_beside_it(made, found):
    scenes, motions = found
    together = solve_scenes(made, None, None, scenes[::-1], CONFIG)
    for n, one in enumerate(together[::-1]):
        assert_same(one, motions.select(slice(n, n + 1)))


def test_the_same_grasp_has_the_same_motion_twice(made, found):
    scenes, motions = found
    assert_same(solved(made, scenes), motions)


def test_no_grasps_have_no_motions(made):
    one = targets(made, count=1)[0]
    none = one._replace(hand_pos=one.hand_pos[:0], hand_quat_wxyz=one.hand_quat_wxyz[:0],
                        joints=one.joints[:0])  # fmt: skip
    assert len(solve_arms(made, None, None, none, CONFIG).arm_status) == 0
    assert solve_scenes(made, None, None, [], CONFIG) == []
