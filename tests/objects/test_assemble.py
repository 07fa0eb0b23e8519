"""Laws of pieces that are taken as they are: masses add up, and the way back to the file holds."""

from dataclasses import replace

import numpy as np
import pytest

from bidexdata.objects.assemble import assembled, summed_mass, unit_solid, unit_solid_of_sum
from bidexdata.objects.closed import as_mesh
from bidexdata.objects.config import (
    PrepareConfig,
    RepairConfig,
    RestConfig,
    SdfConfig,
    SurfaceConfig,
)
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.physics import mass_properties
from bidexdata.objects.prepared import Solid, TriangleMesh
from bidexdata.objects.simulated import check_simulated
from bidexdata.record.status import Status

FLOAT32 = 1e-6  # positions at unit diagonal are rounded to it
FACES = np.array(
    [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4], [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]],
    np.int32,
)  # fmt: skip


def box(centre, half):
    corners = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], float)
    return TriangleMesh(np.asarray(centre) + corners * half, FACES)


# Two boxes that share a third of the smaller one: 3 x 2 x 2 and 2 x 2 x 2, 1 x 2 x 2 in both.
PIECES = (box((1.5, 0, 0), (1.5, 1, 1)), box((0, 0, 0), (1, 1, 1)))


def test_overlapping_pieces_weigh_their_sum_and_the_union_less():
    apart, joined = unit_solid_of_sum(PIECES), unit_solid(PIECES)
    diagonal = np.linalg.norm([4, 2, 2])
    assert apart.diagonal == pytest.approx(diagonal)
    assert apart.volume * diagonal**3 == pytest.approx(12 + 8, rel=FLOAT32)
    assert joined.volume * diagonal**3 == pytest.approx(16, rel=FLOAT32)
    # Centres at x = 1.5 and 0 with masses 12 and 8.
    np.testing.assert_allclose(apart.centre, [12 * 1.5 / 20, 0, 0], atol=FLOAT32)
    np.testing.assert_allclose(joined.centre, [1, 0, 0], atol=FLOAT32)
    # By Steiner: each box m (a^2 + b^2) / 12, moved to 0.9.
    across = 12 * (9 + 4) / 12 + 12 * 0.6**2 + 8 * (4 + 4) / 12 + 8 * 0.9**2
    along = (12 + 8) * (4 + 4) / 12
    inertia = np.diag([along, across, across]) / diagonal**5
    np.testing.assert_allclose(apart.inertia, inertia, atol=FLOAT32)
    # The surface is that of the union in both.
    assert mass_properties(apart.mesh).volume == pytest.approx(16 / diagonal**3, rel=FLOAT32)


def test_pieces_that_do_not_overlap_are_the_same_both_ways():
    pieces = (box((0.5, 0, 0), (0.5, 1, 1)), box((-2, 0, 0), (2, 1, 1)))
    apart, joined = unit_solid_of_sum(pieces), unit_solid(pieces)
    assert apart.volume == pytest.approx(joined.volume, rel=FLOAT32)
    np.testing.assert_allclose(apart.inertia, joined.inertia, atol=FLOAT32)
    np.testing.assert_allclose(apart.centre, joined.centre, atol=FLOAT32)


def test_summed_mass_of_one_mesh_is_its_own():
    one = box((3, -2, 1), (0.3, 0.2, 0.1))
    own, summed = mass_properties(one), summed_mass([one])
    assert summed.volume == pytest.approx(own.volume)
    np.testing.assert_allclose(summed.centre, own.centre)
    np.testing.assert_allclose(summed.inertia, own.inertia, atol=1e-15)


@pytest.mark.parametrize("pieces", [(), (PIECES[0], box((9, 9, 9), (1, 1, 0)))])
def test_a_piece_without_volume_is_refused(pieces):
    with pytest.raises(PrepareFailure) as caught:
        unit_solid_of_sum(pieces)
    assert caught.value.status == Status.NO_VOLUME


def solid(**provenance):
    nothing = np.zeros(0)
    return Solid(
        object_id="x",
        mesh=PIECES[0],
        pieces=PIECES,
        volume=0.5,
        inertia=np.eye(3),
        rest_quats_wxyz=np.zeros((0, 4)),
        rest_heights=nothing,
        rest_probabilities=nothing,
        provenance=provenance,
    )


def test_the_source_origin_is_where_the_file_has_zero():
    made = solid(origin_in_file=[1.0, -2.0, 4.0], unit_in_file=2.0)
    in_file = np.array([1.0, -2.0, 4.0]) + 2.0 * made.source_origin
    np.testing.assert_array_equal(in_file, 0)
    np.testing.assert_array_equal(solid().source_origin, 0)


def test_the_nominal_volume_is_the_solid_s_where_none_is_stated():
    assert solid().nominal_volume == 0.5
    assert solid(nominal_volume=0.6).nominal_volume == 0.6


def test_a_piece_that_the_simulator_refuses_is_named_when_the_object_is_made():
    check_simulated(PIECES)
    flat = TriangleMesh(PIECES[0].vertices * [1, 1, 0], PIECES[0].faces)
    with pytest.raises(PrepareFailure) as caught:
        check_simulated((PIECES[0], flat))
    assert caught.value.status == Status.DECOMPOSITION_FAILED
    assert "piece1" in caught.value.reason
    assert "\n" not in caught.value.reason


CUBE = box((0, 0, 0), (1, 1, 1))


def made(pieces, shown=None, **changes):
    config = replace(
        PrepareConfig(), sdf=SdfConfig(cells=24, error=1.0), surface=SurfaceConfig(points=50)
    )
    solid = unit_solid(pieces)
    return assembled("x", solid, shown or solid.mesh, {}, replace(config, **changes))


def test_an_object_is_refused_where_the_simulator_refuses_a_piece():
    crumb = box((0, 0, 0), (1e-7, 1e-7, 1e-7))
    with pytest.raises(PrepareFailure) as caught:
        made((CUBE, crumb))
    assert caught.value.status == Status.DECOMPOSITION_FAILED


def test_an_object_without_a_rest_pose_says_so():
    none = replace(RestConfig(), min_probability=0.9)  # a box has six sides
    obj = made((CUBE,), rest=none)
    assert len(obj.rest_heights) == 0
    assert obj.provenance["warnings"] == [
        "no rest pose: it comes to rest on a table in no orientation"
    ]
    assert made((CUBE,)).provenance["warnings"] == []


def test_the_mesh_to_show_has_about_as_many_faces_as_are_asked_for():
    import manifold3d

    ball = as_mesh(manifold3d.Manifold.sphere(0.5, 96))
    shown = made((CUBE,), ball, repair=replace(RepairConfig(), display_faces=1000)).mesh
    assert 300 < len(shown.faces) <= 1000 < len(ball.faces)
    assert len(made((CUBE,), ball).mesh.faces) == len(ball.faces)
