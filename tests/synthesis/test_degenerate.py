"""Laws of synthesis on objects that are hardly objects: statuses and numbers, never an exception or NaN."""

from __future__ import annotations

from dataclasses import replace

import manifold3d
import numpy as np
import pytest

from bidexdata.objects.closed import as_mesh
from bidexdata.objects.config import PrepareConfig, SdfConfig
from bidexdata.objects.prepare import prepare_object
from bidexdata.objects.prepared import TriangleMesh
from bidexdata.record import Status
from bidexdata.runs.plan import scene_ids_of, scene_of
from bidexdata.synthesis.pipeline import synthesize

GRASPS = 3
ATTEMPTS = 4 * GRASPS
POSES = ("hand_pos", "hand_quat_wxyz", "joints")
# Coarser than a library's grid, as the objects' shapes are simple: the same code in less time.
CONFIG = replace(PrepareConfig(), sdf=SdfConfig(cells=80))


def cube(*sides) -> TriangleMesh:
    return as_mesh(manifold3d.Manifold.cube(sides, True))


def without_a_face(mesh: TriangleMesh) -> TriangleMesh:
    return TriangleMesh(mesh.vertices, mesh.faces[1:])


# Metres; each is tried at sizes from its own or a small one to the largest of the paper.
SOURCES = {
    "plate of 1 mm": (cube(0.3, 0.2, 0.001), (360, 800)),
    "needle": (cube(0.001, 0.001, 0.3), (300, 800)),
    "ball of 5 mm": (as_mesh(manifold3d.Manifold.sphere(0.0025, 48)), (9, 800)),
    "box with a hole": (without_a_face(cube(0.3, 0.25, 0.2)), (300, 800)),
}


@pytest.fixture(scope="module")
def objects():
    return {name: prepare_object(mesh, CONFIG) for name, (mesh, _) in SOURCES.items()}


def assert_numbers(batch, rows):
    """Every figure of these rows is one, but for places behind the contacts that an attempt has."""
    touching = batch["contact_index"] >= 0
    for name, values in batch.columns.items():
        if values.dtype.kind == "f":
            given = touching[rows] if name.startswith("contact_") else slice(None)
            assert np.isfinite(values[rows][given]).all(), name


def test_the_hole_is_filled_and_the_needle_made_as_thick_as_can_be_simulated(objects):
    found = {name: obj.provenance["repair"] for name, obj in objects.items()}
    assert found["box with a hole"] == "fill_holes"
    assert found["needle"] == "thicken"


@pytest.mark.parametrize("setting", ["floating", "tabletop"])
@pytest.mark.parametrize("name", SOURCES)
def test_a_degenerate_object_ends_in_statuses(objects, hands, name, setting):
    obj, sizes = objects[name], SOURCES[name][1]
    ids = scene_ids_of(obj.object_id, sizes, setting, min(2, len(obj.rest_heights)))
    made = synthesize(obj, hands, [scene_of(i, obj) for i in ids], seed=0, grasps=GRASPS)
    assert set(made.header.counts) == set(ids)
    for counts in made.header.counts.values():
        assert sum(counts.values()) == ATTEMPTS
        assert set(counts) <= {status.label for status in Status}
        assert "not_finite" not in counts
    ok = made["synth_status"] == Status.OK
    assert_numbers(made, ok)
    for column in POSES:
        assert np.isnan(made[column][~ok]).all(), column


# 8 objects, floating and on a table, in 6 sizes: 100,800 attempts, some 240 in a second of one core.
FAMILIES = ("box", "sphere", "bottle", "mug", "plate", "bracket", "cross", "ring")
SIZES_MM = (300, 400, 500, 600, 700, 800)
PER_SCENE = 1050


@pytest.mark.slow
def test_no_attempt_of_100_000_has_a_nan(hands):
    """Every attempt has a row here; one whose search leaves the numbers would say `not_finite`."""
    made = 0
    for k, family in enumerate(FAMILIES):
        obj = prepare_object(f"shapes:{family}", CONFIG)
        for setting in ("floating", "tabletop"):
            for scene_id in scene_ids_of(obj.object_id, SIZES_MM, setting, 1):
                scene = scene_of(scene_id, obj)
                batch = synthesize(
                    obj, hands, [scene], seed=k, grasps=PER_SCENE, candidates=PER_SCENE
                )
                assert len(batch) == sum(batch.header.counts[scene_id].values()) == PER_SCENE
                assert "not_finite" not in batch.header.counts[scene_id]
                ok = batch["synth_status"] == Status.OK
                assert_numbers(batch, ok)
                for column in POSES:
                    assert np.isnan(batch[column][~ok]).all(), column
                made += len(batch)
    assert made >= 100_000
