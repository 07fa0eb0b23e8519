"""A scene whose object was scaled in place measures what one that was compiled so does."""

from __future__ import annotations

import numpy as np
import pytest
from box_solids import box_solid

from bidexdata import prepare_object
from bidexdata.frames import random_quat
from bidexdata.objects.config import PrepareConfig, RestConfig, SdfConfig, SurfaceConfig
from bidexdata.simulation.distances import measure_distances
from bidexdata.simulation.resize import COMPILED_SIZE, SizedScenes
from bidexdata.simulation.scene import build_scene

SIZES = (0.3, 0.8, 0.45, 0.3)
COARSE = PrepareConfig(
    sdf=SdfConfig(cells=40), surface=SurfaceConfig(points=600), rest=RestConfig(drops=24)
)
"""The pieces, which a scene is made of, are those of the defaults."""


@pytest.fixture(scope="module", params=["two boxes", "mug"])
def solid(request):
    return box_solid() if request.param == "two boxes" else prepare_object("shapes:mug", COARSE)


@pytest.mark.parametrize("table", [False, True])
def test_distances_are_those_of_a_scene_compiled_at_that_size(hands, solid, table):
    scenes = SizedScenes(build_scene(hands, solid, COMPILED_SIZE, table=table))
    rng = np.random.default_rng(0)
    touched = 0
    for size in SIZES:
        fresh = build_scene(hands, solid, size, table=table)
        for _ in range(12):
            joints = np.stack([rng.uniform(h.joint_lower, h.joint_upper) for h in hands])
            pos = rng.uniform(-0.5, 0.5, (2, 3)) * size
            object_pos, turn = rng.normal(0, 0.05, 3), random_quat(rng)
            pose = (object_pos, turn, pos, random_quat(rng, (2,)), joints)
            one, other = measure_distances(scenes.at(size), *pose), measure_distances(fresh, *pose)
            for name in ("hand_object", "self_collision", "inter_hand", "table", "object_table"):
                # Vertices are float32 in the engine.
                assert getattr(one, name) == pytest.approx(getattr(other, name), abs=1e-6), name
            np.testing.assert_allclose(one.fingers, other.fingers, atol=1e-6)
            touched += other.hand_object < 0
    assert touched > 5
