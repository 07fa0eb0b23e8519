"""Laws of reach: what the search says, of each grasp alone; a quick look at where hands start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_solve import CONFIG, targets

from bidexdata.arms.generic_pairs import shape_grid
from bidexdata.arms.reach import Reach
from bidexdata.arms.solutions import stored_targets
from bidexdata.arms.solve import solve_scenes
from bidexdata.record import Scene, Status

SIZE = 0.3
FAR_AWAY = 2.0
"""Beyond the made-up arms [m]."""


@pytest.fixture(scope="module")
def reach(made) -> Reach:
    return Reach(robot=made, field=None, scenes=None, config=CONFIG)


@pytest.fixture(scope="module")
def scenes(made):
    return targets(made, SIZE, count=10)


@pytest.fixture(scope="module")
def starts(scenes) -> tuple[np.ndarray, np.ndarray]:
    """Both hands of each, where they grasp."""
    pos = np.concatenate([one.hand_pos[:, :, 1] for one in scenes])
    quat = np.concatenate([one.hand_quat_wxyz[:, :, 1] for one in scenes])
    return pos, quat


@pytest.fixture(scope="module")
def placed(reach: Reach, starts) -> np.ndarray:
    return reach.placements(scene_at(), *starts)


def scene_at(height: float = 0.15) -> Scene:
    return Scene("none-00000000", 300, "tabletop", 0, (0.0, 0.0, height))


def test_grasps_have_the_statuses_that_the_search_gives(reach: Reach, made, scenes):
    wanted = solve_scenes(made, None, None, scenes, CONFIG)
    for status, motions in zip(reach.grasps(scenes), wanted, strict=True):
        np.testing.assert_array_equal(status, motions.arm_status)


def test_grasps_with_a_motion_have_places_that_the_arms_reach(reach: Reach, scenes, placed):
    good = np.concatenate(reach.grasps(scenes)) == Status.OK
    assert good.sum() >= 3
    # Where there is a whole motion there is a posture: the quick look may only be too hopeful.
    assert placed[good].all()


def test_a_place_is_judged_by_itself(reach: Reach, starts, placed):
    alone = [bool(reach.placements(scene_at(), *(x[n : n + 1] for x in starts))[0])
             for n in range(len(placed))]  # fmt: skip
    assert alone == placed.tolist()
    backwards = reach.placements(scene_at(), *(x[::-1] for x in starts))
    np.testing.assert_array_equal(backwards[::-1], placed)


def test_none_of_no_places_is_reached(reach: Reach, starts):
    assert reach.placements(scene_at(), *(x[:0] for x in starts)).shape == (0,)
    assert reach.grasps([]) == []


@pytest.mark.parametrize("side", [0, 1])
def test_one_hand_that_is_too_far_away_is_enough(reach: Reach, starts, side):
    pos = starts[0].copy()
    pos[:, side, 1] += FAR_AWAY * (1 if side == 0 else -1)
    assert not reach.placements(scene_at(), pos, starts[1]).any()


def test_a_place_below_the_table_is_not_reached(reach: Reach, starts, placed):
    assert placed.any()
    below = starts[0] - [0.0, 0.0, 0.7]
    assert not reach.placements(scene_at(), below, starts[1]).any()


def test_hands_at_one_place_leave_the_arms_no_room(reach: Reach, starts, placed):
    both = [np.repeat(x[:, :1], 2, axis=1) for x in starts]
    assert not reach.placements(scene_at(), *both).any()


def test_an_object_round_the_arms_takes_every_place(reach: Reach, starts, placed):
    full = replace(reach, field=shape_grid(0))
    assert placed.any()
    wide = replace(scene_at(), size_mm=4000)
    assert not full.placements(wide, *starts).any()


def test_targets_are_what_the_record_gives_back(rng):
    pos, quat = rng.normal(size=(3, 2, 3, 3)), rng.normal(size=(3, 2, 3, 4))
    quat /= np.linalg.norm(quat, axis=-1, keepdims=True)
    joints = rng.normal(size=(3, 2, 3, 5))
    stored = [x.astype(np.float32) for x in (np.zeros(3), quat[0, 0, 0])]
    found = stored_targets(
        *stored, np.float32(SIZE), *(x.astype(np.float32) for x in (pos, quat, joints))
    )
    assert found.size == SIZE
    np.testing.assert_array_equal(found.hand_pos, pos.astype(np.float32))
    np.testing.assert_allclose(np.linalg.norm(found.hand_quat_wxyz, axis=-1), 1, atol=1e-15)
    np.testing.assert_allclose(found.hand_quat_wxyz, quat, atol=1e-7)
