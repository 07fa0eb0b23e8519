"""Laws of what a selection looks at: analytic bodies, invariance, telling shapes apart."""

from typing import NamedTuple

import numpy as np
import pytest
import trimesh

from bidexdata.frames import matrix_from_quat, random_quat
from bidexdata.objects.config import SurfaceConfig
from bidexdata.objects.prepared import TriangleMesh
from bidexdata.objects.sources.shapes import shape_mesh
from bidexdata.objects.surface import surface_points
from bidexdata.objects.traits import descriptor, mesh_hash, traits, unlikeness

rng = np.random.default_rng(10)
FAMILIES = ("box", "cylinder", "bottle", "mug", "bowl", "ring")


def mesh_of(solid):
    vertices = np.asarray(solid.vertices, float)
    scale = np.linalg.norm(np.ptp(vertices, axis=0))
    return TriangleMesh(vertices / scale, np.asarray(solid.faces, np.int32))


def joined(*solids):
    return mesh_of(trimesh.util.concatenate(solids))


def test_a_box_has_its_proportions_and_thickness():
    sides = np.array([4.0, 2.0, 1.0])
    found = traits(mesh_of(trimesh.creation.box(sides)))
    a, b, c = sides / np.linalg.norm(sides)
    assert found.aspect == pytest.approx(4.0)
    assert found.thickness == pytest.approx(a * b * c / (a * b + b * c + c * a))
    assert (found.components, found.genus) == (1, 0)


def test_a_plate_is_as_thick_as_it_is():
    found = traits(mesh_of(trimesh.creation.box((1.0, 1.0, 1e-3))))
    assert found.thickness == pytest.approx(1e-3 / np.sqrt(2), rel=5e-3)


def test_handles_are_counted_over_all_bodies_and_cavities_are_no_body():
    ring = trimesh.creation.torus(1.0, 0.2)
    assert traits(mesh_of(ring)).genus == 1
    other = ring.copy().apply_translation((5, 0, 0))
    box = trimesh.creation.box().apply_translation((0, 0, 5))
    two = traits(joined(ring, other, box))
    assert (two.components, two.genus) == (3, 2)
    outer, inner = trimesh.creation.icosphere(2, 1.0), trimesh.creation.icosphere(2, 0.5)
    inner.invert()
    hollow = traits(joined(outer, inner))
    assert (hollow.components, hollow.genus) == (1, 0)


def turned(mesh, R, scale, shift):
    return TriangleMesh(scale * mesh.vertices @ R.T + shift, mesh.faces)


class Shape(NamedTuple):
    """A built-in shape and the points that preparing draws on it."""

    solid: TriangleMesh
    surface_points: np.ndarray


@pytest.fixture(scope="module")
def shapes():
    found = {}
    for family in FAMILIES:
        solid = mesh_of(shape_mesh(f"{family}/0"))
        found[family] = Shape(solid, surface_points(solid, SurfaceConfig())[0])
    return found


def test_a_descriptor_is_the_same_for_a_turned_moved_scaled_and_newly_sampled_shape(shapes):
    obj = shapes["mug"]
    one = descriptor(obj.surface_points, obj.solid)
    R, shift = matrix_from_quat(random_quat(rng)), np.array([3.0, -1.0, 2.0])
    points = 2.5 * obj.surface_points.astype(float) @ R.T + shift
    again = descriptor(points, turned(obj.solid, R, 2.5, shift))
    np.testing.assert_allclose(again, one, atol=1e-6)
    fresh = descriptor(obj.surface_points[1::2], obj.solid)
    assert unlikeness(one, fresh[None])[0] < 0.01


def test_different_families_are_further_apart_than_samples_of_one_shape(shapes):
    found = np.array([descriptor(o.surface_points, o.solid) for o in shapes.values()])
    apart = np.array([unlikeness(d, found) for d in found])
    assert apart[~np.eye(len(found), dtype=bool)].min() > 0.015
    assert np.all(np.diag(apart) == 0)


def test_a_hash_knows_a_mesh_by_its_corners_alone(shapes):
    mesh = shapes["bottle"].solid
    order = rng.permutation(len(mesh.vertices))
    back = np.argsort(order).astype(np.int32)
    shuffled = TriangleMesh(
        1000 * mesh.vertices[order] + 7.0, back[mesh.faces][rng.permutation(len(mesh.faces))]
    )
    assert mesh_hash(shuffled) == mesh_hash(mesh)
    bent = TriangleMesh(mesh.vertices * [1, 1, 1.01], mesh.faces)
    assert mesh_hash(bent) != mesh_hash(mesh)
