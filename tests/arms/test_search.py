"""Laws of the search: for each of its pieces a case that only this piece solves, or sees.

Arms are the made-up ones. Walls are fixtures, which spheres know and which hands may not touch either.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from box_solids import box_solid
from test_solve import CONFIG, targets
from test_statuses import down, palms_at

from bidexdata.arms import Robot, Targets
from bidexdata.arms.arm_scene import build_arm_scene
from bidexdata.arms.arm_spheres import place_spheres
from bidexdata.arms.candidates import find_candidates, object_along, ways
from bidexdata.arms.chain import chain_forward
from bidexdata.arms.clearance import Surroundings, apart_at, clear_at
from bidexdata.arms.config import ArmConfig
from bidexdata.arms.generic_pairs import shape_grid
from bidexdata.arms.ranking import posture_cost
from bidexdata.arms.smoothing import roughness
from bidexdata.arms.solutions import ArmSolutions, join_targets
from bidexdata.arms.solve import solve_arms, solve_scenes, surroundings
from bidexdata.arms.spec import FixtureSpec
from bidexdata.arms.stand_offs import stand_offs
from bidexdata.arms.waypoints import Poses
from bidexdata.arms.ways_home import OVER, PLANNED, STRAIGHT, WaysHome, waiting
from bidexdata.frames import invert, quat_from_matrix
from bidexdata.record.status import Status

CUBE = 0
"""Number of the cube among the generic shapes; its half edge at a diagonal of 1 is 1 / sqrt(12)."""
APPROACH = CONFIG.path.knots[0] + 1


def searched(**changes) -> ArmConfig:
    return replace(
        CONFIG, search=replace(CONFIG.search, **{"nodes": 0, "straight": 0.0, **changes})
    )


def label(motions: ArmSolutions) -> str:
    return Status(int(motions.arm_status[0])).label


def walled(robot: Robot, *walls: FixtureSpec) -> Robot:
    """The robot whose left arm has more in its way."""
    left, right = robot.arms
    return replace(robot, arms=(replace(left, fixtures=(*left.fixtures, *walls)), right))


@pytest.fixture(scope="module")
def scenes(made) -> list[Targets]:
    return targets(made, count=12, seed=1)


@pytest.fixture(scope="module")
def solutions(made, scenes) -> list[ArmSolutions]:
    """Of an empty table, without planner."""
    return solve_scenes(made, None, None, scenes, searched())


def test_more_than_one_pair_of_postures_is_tried(made, scenes, solutions):
    # Palms so close that the best postures of the two arms meet, and others do not.
    close = targets(made, size=0.2, count=40, seed=7)
    more = [*solutions, *solve_scenes(made, None, None, close, searched())]
    one = solve_scenes(made, None, None, [*scenes, *close], searched(pairs=1))
    lost = [label(first) for first, all_ in zip(one, more, strict=True) if all_.ok[0] > first.ok[0]]
    assert len(lost) >= 3
    assert set(lost) == {"collision_arms"}
    assert not any(first.ok[0] > all_.ok[0] for first, all_ in zip(one, more, strict=True))


def crossing(robot: Robot, reach: float) -> Targets:
    """Palms that look down beside each other, and meet when they close `reach` behind the middle."""
    stages = []
    for x, y in ((0.2, 0.0), (0.0, -reach), (0.0, -reach)):
        palms = []
        for side in (1.0, -1.0):
            T = down(side)
            T[:2, 3] = side * x, side * y
            palms.append(T)
        stages.append(palms_at(robot, palms).hand_pos[:, :, 0])
    still = palms_at(robot, [down(1.0), down(-1.0)])
    return still._replace(hand_pos=np.stack(stages, axis=2))


def test_arms_may_not_meet_after_the_approach(made):
    # Where the pre-grasps are, they stand apart; only on the way to the grasp forearms cross.
    slow = replace(searched(), path=replace(CONFIG.path, knots=(24, 4, 20, 2, 4)))
    assert label(solve_arms(made, None, None, crossing(made, 0.0), slow)) == "ok"
    assert label(solve_arms(made, None, None, crossing(made, 0.15), slow)) == "collision_arms"


def both(paths: np.ndarray, robot: Robot) -> np.ndarray:
    """Clearance between the arms with open hands at knots (2, K, A) that they pass together [m]."""
    rows = np.zeros(paths.shape[1], np.int64)
    grasps = join_targets([palms_at(robot, [np.eye(4)] * 2)])
    around = surroundings(robot, None, grasps)
    return apart_at(robot.arms, paths[0], paths[1], (rows, rows), around)


def straight(robot: Robot, motions: ArmSolutions) -> np.ndarray:
    """Both arms from rest to the stand-offs of a motion in one line of joint space, (2, K, A)."""
    share = np.linspace(0, 1, APPROACH)[:, None]
    ends = motions.arm_joints[0, :, 1]
    return np.stack(
        [(1 - share) * a.chain.rest + share * q for a, q in zip(robot.arms, ends, strict=True)]
    )


@pytest.fixture(scope="module")
def waited(made) -> ArmSolutions:
    """A grasp whose arms meet where both go home's way at once, in any pair of postures."""
    return solve_arms(made, None, None, targets(made, count=12, seed=2)[7], searched())


def test_one_arm_waits_where_they_would_meet_on_the_way(made, waited):
    assert waited.ok[0]
    assert both(straight(made, waited), made).min() < 0
    assert both(waited.arm_path[0, :, :APPROACH], made).min() >= 0


def test_what_has_a_kink_is_smoother_afterwards(made, waited):
    # Whoever waits starts at once, and stops at once: the way as it was found is one of these.
    ends = [
        np.stack([a.chain.rest, q])
        for a, q in zip(made.arms, waited.arm_joints[0, :, 1], strict=True)
    ]
    found = [waiting((ends[0], ends[1]), first, CONFIG) for first in range(2)]
    kinked = min(sum(roughness(path) for path in two) for two in found)
    smooth = sum(roughness(path[:APPROACH]) for path in waited.arm_path[0])
    assert smooth < 0.2 * kinked


def hand_way(robot: Robot, motions: ArmSolutions) -> np.ndarray:
    """Where the left hand comes by on its approach, (K, 3) [m]."""
    return chain_forward(robot.arms[0].chain, motions.arm_path[0, 0, :APPROACH])[0]


def block(at: np.ndarray, half: tuple[float, float, float]) -> FixtureSpec:
    return FixtureSpec(pos=tuple(float(v) for v in at), half=half)


def test_round_some_walls_only_a_planned_way_leads(made, scenes, solutions):
    halves = [(0.02, 0.02, 0.25), (0.25, 0.02, 0.02), (0.1, 0.1, 0.02)]
    rows, planned = np.zeros(APPROACH, np.int64), 0
    for one, found in zip(scenes, solutions, strict=True):
        for half in halves if found.ok[0] else ():
            robot = walled(made, block(hand_way(made, found)[6], half))
            without = solve_arms(robot, None, None, one, searched())
            with_planner = solve_arms(robot, None, None, one, searched(nodes=96))
            assert with_planner.ok[0] >= without.ok[0]
            if with_planner.ok[0] == without.ok[0]:
                continue
            planned += 1
            around = surroundings(robot, None, join_targets([one]))
            path = with_planner.arm_path[0, 0, :APPROACH]
            assert clear_at(robot.arms[0], path, rows, around, 0).min() >= 0
            line = straight(robot, with_planner)[0]
            assert clear_at(robot.arms[0], line, rows, around, 0).min() < 0
    assert planned >= 2


def test_blocks_on_the_way_home_are_passed_over_a_pose_behind_or_above(made, scenes, solutions):
    fine = replace(searched(), path=replace(CONFIG.path, knots=(60, *CONFIG.path.knots[1:])))
    near = replace(fine, search=replace(fine.search, back_off=0.01))
    row, passed = np.zeros(1, np.int64), 0
    for one, found in zip(scenes, solutions, strict=True):
        if not found.ok[0]:
            continue
        goal = found.arm_joints[0, 0, 1][None, None]
        line = made.arms[0].chain.rest + 0.6 * (goal[0, 0] - made.arms[0].chain.rest)
        in_the_way = block(chain_forward(made.arms[0].chain, line)[0], (0.03, 0.03, 0.03))
        robot = walled(made, in_the_way)
        around = surroundings(robot, None, join_targets([one]))
        args = (robot, 0, goal, np.ones((1, 1), bool), around)
        home, beside = WaysHome(*args, fine), WaysHome(*args, near)
        for ways_home in (home, beside):
            ways_home.find(STRAIGHT, row)
            assert not ways_home.ok[0, 0]
            assert ways_home.status[0] == Status.COLLISION_SELF
        home.find(OVER, row)
        # Poses a centimetre beside the goal lead into the block as well; planned: of no nodes.
        for effort in (OVER, PLANNED):
            beside.find(effort, row)
        if home.ok[0, 0] and not beside.ok[0, 0]:
            passed += 1
            assert len(home.corners[0, 0]) > 2
            path = home.path[0, 0]
            rows = np.zeros(len(path), np.int64)
            assert clear_at(robot.arms[0], path, rows, around, 0).min() >= 0
    assert passed >= 2


def test_mujoco_sees_what_spheres_do_not(made, scenes, solutions):
    # The search is told of no object; MuJoCo has a box in the left forearm at the grasp.
    q = solutions[4].arm_joints[0, 0, 3]
    elbow = place_spheres(made.arms[0].chain, made.arms[0].spheres, q)
    at = elbow[made.arms[0].spheres.joint == 3][0]
    scene = build_arm_scene(made, box_solid(), 0.1)
    one, away = scenes[4]._replace(size=0.1, object_pos=at), np.array([3.0, 0.0, 0.0])
    aside = solve_arms(made, None, scene, one._replace(object_pos=at + away), searched())
    assert label(aside) == "ok"
    assert aside.clear_object[0] == CONFIG.clearance.reach
    assert label(solve_arms(made, None, None, one, searched(pairs=1))) == "ok"
    assert label(solve_arms(made, None, scene, one, searched(pairs=1))) == "collision_object"


def candidates(robot: Robot, one: Targets, field, config=None, side: int = 0):
    config = config or searched()
    grasps = join_targets([one])
    around = surroundings(robot, field, grasps)
    way = ways(robot, side, around, grasps, config)
    return find_candidates(robot.arms[side], way, object_along(field, grasps, config), config), way


def test_candidates_keep_clear_of_the_object(made, scenes, solutions):
    # A cube round the forearm of the best posture at the grasp stops this one, and it is named.
    alone, way = candidates(made, scenes[0], None)
    assert alone.free[0, 0]
    centre = place_spheres(made.arms[0].chain, made.arms[0].spheres, alone.q[0, 0, way.grasp])
    at = centre[made.arms[0].spheres.joint == 3][0]
    beside = scenes[0]._replace(object_pos=at, size=0.15)
    found, _ = candidates(made, beside, shape_grid(CUBE))
    best = alone.q[0, 0, way.grasp]
    same = np.abs(found.q[0, :, way.grasp] - best).max(axis=1) < 1e-3
    assert not (found.free[0] & same).any()
    around = object_along(shape_grid(CUBE), join_targets([beside]), CONFIG)
    for q in found.q[0, found.free[0]]:
        gaps = clear_at(made.arms[0], q, np.arange(len(q)), around, with_hand=False)
        assert gaps[1, way.grasp] >= 0  # of the object
    sunk = scenes[0]._replace(size=3.0)
    buried, _ = candidates(made, sunk, shape_grid(CUBE))
    assert set(buried.status[0, buried.gate[0] > 0].tolist()) == {Status.COLLISION_OBJECT}


def test_room_counts_against_turns_away_from_rest(made, scenes):
    # Neither of the two alone orders the candidates; the report on reach goes by the same sum.
    by_turn = by_room = 0
    for one in scenes:
        found, way = candidates(made, one, None)
        free = found.free[0]
        q, room, cost = found.q[0, free], found.room[0, free], found.cost[0, free]
        rest = made.arms[0].chain.rest
        away = np.abs(q[:, way.grasp] - rest).max(axis=1)
        np.testing.assert_allclose(cost, posture_cost(q[:, way.grasp], rest, room), atol=1e-12)
        assert (np.diff(cost) >= 0).all()
        by_turn += bool((np.diff(away) < 0).any())
        by_room += bool((np.diff(room) > 0).any())
        around = Surroundings(None, rows=1)
        for path, least in zip(q, room, strict=True):
            gaps = clear_at(made.arms[0], path, np.zeros(len(path), np.int64), around,
                            with_hand=False)  # fmt: skip
            looked = gaps.min(axis=0)[[0, way.grasp, -1]]
            assert least <= min(looked.min(), CONFIG.clearance.enough) + 1e-5
    assert by_turn >= 2
    assert by_room >= 2


@pytest.mark.parametrize("rim", [False, True])
def test_a_hand_goes_back_beside_a_rim_behind_it(made, rim):
    # A cube of 0.12 m edges stands 4 cm behind the back of a palm that looks along x.
    hand, T = made.hands[0], np.eye(4)
    T[:3, :3] = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # fingers down
    T[:3, 3] = (0.0, 0.0, 0.6)
    at = T @ invert(hand.T_hand_palm)
    edge = 0.12
    behind = np.array([-0.04 - 0.06 - edge / 2, 0.0, 0.6]) if rim else np.array([0.5, 0, 0.6])
    one = palms_at(made, [T, T])._replace(object_pos=behind, size=edge * np.sqrt(3))
    grasps = join_targets([one])
    around = surroundings(made, shape_grid(CUBE), grasps)
    before = Poses(at[None, :3, 3], quat_from_matrix(at[None, :3, :3]))
    back = stand_offs(hand, 0, before, around, CONFIG, np.zeros(1, np.int64)).pos[0] - at[:3, 3]
    assert np.linalg.norm(back) == pytest.approx(CONFIG.path.standoff)
    along = back @ -T[:3, 2] / CONFIG.path.standoff
    assert (along > 0.99) == (not rim)
