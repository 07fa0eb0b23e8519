"""Laws of arms in the synthesis: they only refuse, and what they refuse is counted and not kept."""

from __future__ import annotations

import numpy as np
import pytest

from bidexdata.config import with_overrides
from bidexdata.frames import matrix_from_quat
from bidexdata.record import Scene, Status
from bidexdata.runs.plan import scene_of
from bidexdata.synthesis.attempts import draw_attempts
from bidexdata.synthesis.baselines.bodex_config import BodexConfig
from bidexdata.synthesis.config import SynthConfig
from bidexdata.synthesis.pipeline import synthesize

GRASPS, CANDIDATES = 3, 12
CONFIG = with_overrides(
    SynthConfig(),
    ["regions.anchors=60", "optimise.approach.steps=20", "selection.largest_residual=100"],
)


class Arms:
    """Stands where `Reach` stands: takes places and grasps by the height of the left hand alone."""

    def __init__(self, obj, lowest: float = -np.inf, places: float = -np.inf) -> None:
        self.lowest, self.places = lowest, places
        self.asked: list[np.ndarray] = []

    def placements(self, scene: Scene, hand_pos, hand_quat_wxyz) -> np.ndarray:
        return hand_pos[:, 0, 2] > self.places

    def grasps(self, scenes) -> list[np.ndarray]:
        self.asked += [one.hand_pos for one in scenes]
        ok, no = np.int8(Status.OK), np.int8(Status.IK_GRASP)
        return [np.where(one.hand_pos[:, 0, 1, 2] > self.lowest, ok, no) for one in scenes]


@pytest.fixture(scope="module")
def scenes(obj):
    return [scene_of(f"{obj.object_id}/{mm}/table0", obj) for mm in (300, 500)]


@pytest.fixture(scope="module")
def plain(obj, hands, scenes):
    return made(obj, hands, scenes)


def made(obj, hands, scenes, reach=None, config=CONFIG):
    counts = {"grasps": GRASPS, "candidates": CANDIDATES}
    return synthesize(obj, hands, scenes, config, 3, run_fingerprint="r", reach=reach, **counts)


def same(a, b) -> bool:
    return set(a.columns) == set(b.columns) and all(
        np.array_equal(a[n], b[n], equal_nan=a[n].dtype.kind == "f") for n in a.columns
    )


def test_arms_that_refuse_nothing_change_nothing(obj, hands, scenes, plain):
    arms = Arms(obj)
    found = made(obj, hands, scenes, arms)
    assert found.header.counts == plain.header.counts
    assert same(found, plain)
    assert len(arms.asked) == len(scenes)


def test_the_arms_are_asked_about_grasps_as_they_are_stored(obj, hands, scenes):
    arms = Arms(obj)
    every = {"grasps": CANDIDATES, "candidates": CANDIDATES}
    found = synthesize(obj, hands, scenes, CONFIG, 3, reach=arms, **every)
    good = found.select(found["synth_status"] == Status.OK)
    np.testing.assert_array_equal(np.concatenate(arms.asked), good["hand_pos"].astype(float))


def test_grasps_that_the_arms_refuse_are_counted_and_not_kept(obj, hands, scenes, plain):
    good = plain.select(plain["synth_status"] == Status.OK)
    middle = float(np.median(good["hand_pos"][:, 0, 1, 2]))
    found = made(obj, hands, scenes, Arms(obj, lowest=middle))
    kept = found.select(found["selected"])
    assert len(kept)
    assert (kept["hand_pos"][:, 0, 1, 2] > middle).all()
    for scene_id, counts in found.header.counts.items():
        before = plain.header.counts[scene_id]
        assert counts.get("ok", 0) + counts.get("not_reachable", 0) == before["ok"]
    assert sum(c.get("not_reachable", 0) for c in found.header.counts.values()) > 0
    # Lots draw the audit before any filter.
    audit = [set(b["grasp_id"][b["audit"]].tolist()) for b in (found, plain)]
    assert audit[0] == audit[1]


def test_starts_that_the_arms_refuse_are_drawn_anew(obj, hands, scenes):
    scene = scenes[1]
    one = draw_attempts(obj, hands, scene, CONFIG, 3, CANDIDATES)
    assert one.placed is not None
    heights = world_heights(scene, one.placed)
    least = float(np.quantile(heights[one.placed.ok], 0.3))
    some = draw_attempts(obj, hands, scene, CONFIG, 3, CANDIDATES, reach=Arms(obj, places=least))
    assert some.placed is not None
    assert (world_heights(scene, some.placed)[some.placed.ok] > least).all()
    # Whoever was high enough is where it was; of the others some have found a better place.
    stay = one.placed.ok & (heights > least)
    np.testing.assert_array_equal(some.placed.hand_pos[stay], one.placed.hand_pos[stay])
    assert (some.placed.ok & ~stay).any()
    lost = some.status == Status.NOT_REACHABLE
    np.testing.assert_array_equal(lost, ~some.placed.reachable & ~some.placed.ok)


def world_heights(scene: Scene, placed) -> np.ndarray:
    """Of the left hands [m]."""
    up = matrix_from_quat(np.array(scene.object_quat_wxyz))[2]
    return placed.hand_pos[:, 0] @ up + scene.object_pos[2]


def test_arms_that_reach_nothing_leave_no_grasp_and_no_exception(obj, hands, scenes):
    found = made(obj, hands, scenes, Arms(obj, places=np.inf))
    assert not found["selected"].any()
    assert (found["synth_status"] == Status.NOT_REACHABLE).all()
    assert found["audit"].sum() == GRASPS * len(scenes)
    for counts in found.header.counts.values():
        assert counts == {"not_reachable": CANDIDATES}


def test_a_peer_s_grasps_are_asked_about_when_they_are_finished(obj, hands, scenes):
    config = with_overrides(BodexConfig(), [])
    some = made(obj, hands, scenes[:1], config=config)
    none = made(obj, hands, scenes[:1], Arms(obj, lowest=np.inf, places=np.inf), config)
    (before,), (after,) = some.header.counts.values(), none.header.counts.values()
    assert after["not_reachable"] == before["ok"]
    assert {k: n for k, n in after.items() if k != "not_reachable"} == {
        k: n for k, n in before.items() if k != "ok"
    }
