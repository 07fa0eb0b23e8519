"""Laws of the repair: what goes in broken comes out closed, with the volume one can work out."""

from __future__ import annotations

from dataclasses import replace

import manifold3d
import numpy as np
import pytest

from bidexdata.objects.closed import as_manifold, as_mesh
from bidexdata.objects.components import oriented
from bidexdata.objects.config import (
    LoadConfig,
    PrepareConfig,
    RepairConfig,
    SdfConfig,
    SurfaceConfig,
)
from bidexdata.objects.debris import without_debris
from bidexdata.objects.deviation import hausdorff
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.holes import filled
from bidexdata.objects.loading import unit_mesh
from bidexdata.objects.mesh_queries import distances
from bidexdata.objects.physics import mass_properties, thickness
from bidexdata.objects.prepare import prepare_object
from bidexdata.objects.prepared import TriangleMesh
from bidexdata.objects.repair import repair
from bidexdata.objects.solids import winding_number
from bidexdata.objects.sources.shapes import shape_mesh
from bidexdata.objects.surface import sample_surface
from bidexdata.objects.weld import weld
from bidexdata.record.status import Status

CONFIG = RepairConfig()
COARSE = PrepareConfig(sdf=SdfConfig(cells=24), surface=SurfaceConfig(points=100))
CELL = 1 / CONFIG.remesh_cells
FLOAT32 = 1e-6  # distances are searched in float32


def cube(size, centre=(0.0, 0, 0)) -> TriangleMesh:
    return as_mesh(manifold3d.Manifold.cube(size, True).translate(centre))


def joined(*parts: TriangleMesh) -> TriangleMesh:
    start = np.cumsum([0] + [len(p.vertices) for p in parts])
    faces = [p.faces + s for p, s in zip(parts, start, strict=False)]
    return TriangleMesh(
        np.concatenate([p.vertices for p in parts]), np.concatenate(faces).astype(np.int32)
    )


def soup(mesh: TriangleMesh) -> TriangleMesh:
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    return TriangleMesh(corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3))


def turned(mesh: TriangleMesh) -> TriangleMesh:
    return TriangleMesh(mesh.vertices, mesh.faces[:, ::-1])


def volume(mesh: TriangleMesh) -> float:
    solid = as_manifold(mesh)
    assert solid is not None, "not closed"
    return solid.volume()


def test_a_soup_of_triangles_is_welded_and_nothing_else(box):
    repaired = repair(soup(box), CONFIG)
    assert repaired.method == "as_is"
    assert len(repaired.mesh.vertices) == 8
    assert volume(repaired.mesh) == pytest.approx(0.09)
    assert hausdorff(repaired.mesh, box, 1000) < FLOAT32


def test_an_inward_mesh_is_turned(box):
    repaired = repair(turned(box), CONFIG)
    assert volume(repaired.mesh) == pytest.approx(0.09)
    assert repaired.warnings == ("faces turned outward",)


def test_cracks_wider_than_the_first_weld_are_closed_by_the_second(ball):
    cracked = soup(ball)
    noise = np.random.default_rng(0).uniform(-2e-5, 2e-5, cracked.vertices.shape)
    repaired = repair(TriangleMesh(cracked.vertices + noise, cracked.faces), CONFIG)
    assert repaired.method == "loose_weld"
    assert repaired.warnings == ("seams of up to 0.01% of the diagonal welded",)
    assert volume(repaired.mesh) == pytest.approx(volume(ball), rel=1e-3)


def test_faces_that_point_both_ways_are_made_consistent(ball):
    flip = np.random.default_rng(1).random(len(ball.faces)) < 0.5
    faces = np.where(flip[:, None], ball.faces[:, ::-1], ball.faces)
    repaired = repair(TriangleMesh(ball.vertices, faces), CONFIG)
    assert repaired.method == "orient"
    assert repaired.steps == ("orient",)
    assert volume(repaired.mesh) == pytest.approx(volume(ball), rel=1e-9)


def test_double_faces_and_a_small_hole_are_repaired_lightly(ball):
    faces = np.concatenate([ball.faces[1:], ball.faces[5:50]])
    repaired = repair(TriangleMesh(ball.vertices, faces), CONFIG)
    assert repaired.method == "fill_holes"
    assert repaired.steps == ("drop_double_faces", "fill_holes")
    assert repaired.warnings[0] == "45 double faces dropped"
    assert volume(repaired.mesh) == pytest.approx(volume(ball), rel=1e-9)


def test_a_good_mesh_needs_no_step(ball):
    repaired = repair(ball, CONFIG)
    assert (repaired.method, repaired.steps, repaired.warnings) == ("as_is", (), ())


def test_overlapping_parts_count_once():
    repaired = repair(joined(cube((0.5, 0.1, 0.1)), cube((0.1, 0.5, 0.1))), CONFIG)
    assert volume(repaired.mesh) == pytest.approx(2 * 0.005 - 0.001)
    assert repaired.warnings == ("overlapping or nested components, 10% of their volume, united",)
    apart = repair(joined(cube((0.5, 0.1, 0.1)), cube((0.5, 0.1, 0.1), (0, 0.3, 0))), CONFIG)
    assert (apart.steps, apart.warnings) == (("unite",), ())


def test_a_cavity_is_filled_and_said_so(ball):
    inner = TriangleMesh(0.5 * ball.vertices, ball.faces)
    hollow = repair(joined(ball, turned(inner)), CONFIG)
    assert volume(hollow.mesh) == pytest.approx(volume(ball), rel=1e-9)
    assert hollow.warnings == ("1 inner cavity filled",)
    nested = repair(joined(ball, inner), CONFIG)
    assert volume(nested.mesh) == pytest.approx(volume(ball), rel=1e-9)


def test_an_inward_part_that_is_no_cavity_is_turned():
    parts = joined(cube((0.2, 0.2, 0.2)), turned(cube((0.2, 0.2, 0.2), (0.5, 0, 0))))
    repaired = repair(parts, CONFIG)
    assert volume(repaired.mesh) == pytest.approx(0.016)
    assert repaired.warnings == ("1 component turned outward",)


def test_debris_of_outward_parts_does_not_hide_a_part_that_was_turned():
    specks = [cube((1e-4,) * 3, (0.105, 0, k)) for k in (0.0, 0.05)]
    parts = [cube((0.2, 0.2, 0.2)), turned(cube((0.2, 0.2, 0.2), (0.5, 0, 0)))]
    repaired = repair(joined(*parts, *specks), CONFIG)
    assert repaired.warnings == ("1 component turned outward", "2 specks dropped")


def test_open_crumbs_are_dropped_and_their_area_is_named(box):
    fan = np.array([[0.0, 0], [1, 0], [1.5, 1], [0.5, 2], [-0.5, 1]]) * 0.01
    crumb = TriangleMesh(
        np.column_stack([np.full(5, 0.31), fan]),
        np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4]], np.int32),
    )
    repaired = repair(joined(box, crumb), CONFIG)
    assert repaired.method == "components"
    assert volume(repaired.mesh) == pytest.approx(0.09)
    assert "dropped" in repaired.warnings[-1]


def test_a_ball_without_its_cap_gets_a_flat_lid_and_keeps_the_rest(ball):
    middle = ball.vertices[ball.faces].mean(axis=1)
    open_ball = TriangleMesh(ball.vertices, ball.faces[middle[:, 2] < 0.2])
    repaired = repair(open_ball, CONFIG)
    assert repaired.method == "fill_holes"
    assert repaired.hausdorff > CONFIG.near
    away = f"the repair is up to {repaired.hausdorff:.1%} of the diagonal from the file"
    assert repaired.warnings[-1] == away
    cap = np.pi * 0.1**2 * (3 * 0.3 - 0.1) / 3
    assert volume(repaired.mesh) == pytest.approx(volume(ball) - cap, rel=0.02)
    assert len(repaired.mesh.vertices) == len(np.unique(open_ball.faces))


@pytest.mark.parametrize("seed", range(5))
def test_holes_anywhere_are_closed_without_moving_a_vertex(ball, seed):
    """Single faces, rings that touch at a vertex, and cracks: every edge is used once each way."""
    rng = np.random.default_rng(seed)
    gone = rng.random(len(ball.faces)) < 0.05
    found = filled(TriangleMesh(ball.vertices, ball.faces[~gone]))
    assert found is not None
    a, b = found.mesh.faces.ravel(), np.roll(found.mesh.faces, -1, axis=1).ravel()
    assert sorted(zip(a, b, strict=True)) == sorted(zip(b, a, strict=True))
    assert as_manifold(found.mesh) is not None
    assert volume(found.mesh) == pytest.approx(volume(ball), rel=0.02)
    assert np.array_equal(found.mesh.faces[: int((~gone).sum())], ball.faces[~gone])


def test_a_lid_does_not_use_an_edge_that_the_surface_has(ball):
    """Four corners in a ring whose diagonal is an edge of the other side: the lid gets a middle."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    for faces in ([[0, 2, 1], [0, 3, 2]], [[0, 3, 1], [1, 3, 2]]):
        sheet = TriangleMesh(corners, np.array(faces, np.int32))
        found = filled(sheet)
        assert found is not None
        edges = np.sort(np.stack([found.mesh.faces, np.roll(found.mesh.faces, -1, 1)], 2), 2)
        _, count = np.unique(edges.reshape(-1, 2), axis=0, return_counts=True)
        assert (count == 2).all()
        assert np.array_equal(found.mesh.vertices[:4], corners)


def test_a_mesh_of_many_faces_is_thinned_out_before_a_remesh(monkeypatch, ball):
    middle = ball.vertices[ball.faces].mean(axis=1)
    dome = TriangleMesh(ball.vertices, ball.faces[middle[:, 2] > 0.03])
    whole = repair(dome, CONFIG)
    monkeypatch.setattr("bidexdata.objects.remesh._MANY", 100)
    thinned = repair(dome, CONFIG)
    assert thinned.method == whole.method == "remesh_shell"
    assert volume(thinned.mesh) == pytest.approx(volume(whole.mesh), rel=0.05)
    assert thinned.hausdorff < whole.hausdorff + CELL / 2


def test_slivers_are_lost_with_the_face_that_they_are_of(monkeypatch):
    sheets = joined(*(cube((0.5, 0.4, t), (0, 0, t)) for t in (0.002, 0.3)))
    rim = np.isclose(sheets.vertices[sheets.faces].mean(axis=1)[:, 0], 0.25)
    torn = TriangleMesh(sheets.vertices, sheets.faces[~rim])
    whole = repair(torn, CONFIG)
    monkeypatch.setattr("bidexdata.objects.remesh._SAMPLES", 300)
    asked = repair(torn, CONFIG)
    assert asked.steps == whole.steps
    assert volume(asked.mesh) == pytest.approx(volume(whole.mesh), rel=0.02)


def test_walls_that_a_fine_grid_keeps_are_not_made_thicker():
    # A tray of 0.01: thinner than a cell of the coarse grid, thicker than one of the fine grid.
    outer, inner = cube((0.6, 0.6, 0.4)), cube((0.58, 0.58, 0.4), (0, 0, 0.01))
    tray = as_mesh(as_manifold(outer) - as_manifold(inner))
    middle = tray.vertices[tray.faces].mean(axis=1)
    torn = TriangleMesh(tray.vertices, tray.faces[~np.isclose(middle[:, 2], 0.2)])
    assert "remesh_shell" not in repair(torn, CONFIG).steps
    coarse = replace(CONFIG, fine_cells=CONFIG.remesh_cells)
    assert "remesh_shell" in repair(torn, coarse).steps


def test_more_components_than_are_united_get_a_new_surface():
    parts = joined(*(cube((0.3, 0.2, 0.2), (0.25 * k, 0, 0)) for k in range(3)))
    assert repair(parts, replace(CONFIG, max_components=3)).method == "as_is"
    many = repair(parts, replace(CONFIG, max_components=2))
    assert many.method == "remesh"
    assert volume(many.mesh) == pytest.approx(0.8 * 0.2 * 0.2, rel=0.05)


def test_more_components_that_do_not_touch_are_refused_with_their_number():
    parts = joined(*(cube((0.2, 0.2, 0.2), (0.3 * k, 0, 0)) for k in range(3)))
    with pytest.raises(PrepareFailure) as caught:
        repair(parts, replace(CONFIG, max_components=2))
    assert caught.value.status == Status.TOO_COMPLEX
    assert "3 separate parts; repair.max_components is 2" in caught.value.reason


def test_winding_that_differs_across_an_edge_has_no_lids(ball):
    faces = ball.faces.copy()
    faces[7] = faces[7, ::-1]
    assert filled(TriangleMesh(ball.vertices, faces)) is None
    assert filled(oriented(TriangleMesh(ball.vertices, faces))).holes == 0


def test_a_cup_of_two_walls_that_do_not_meet_stays_hollow(ball):
    # Outer and inner wall of a bowl, the rim between them missing.
    bowl = ball.faces[ball.vertices[ball.faces].mean(axis=1)[:, 2] < 0.15]
    outer = TriangleMesh(ball.vertices, bowl)
    inner = turned(TriangleMesh(0.85 * ball.vertices + [0, 0, 0.0225], bowl))
    repaired = repair(joined(outer, inner), CONFIG)
    assert "remesh" in repaired.steps
    assert winding_number(repaired.mesh, np.array([0.0, 0, 0])) == pytest.approx(0, abs=1e-6)
    assert repaired.hausdorff < 2 * CELL  # half of the rim that was missing


def test_what_is_closed_keeps_its_surface_when_a_sheet_beside_it_is_thickened():
    block = cube((0.4, 0.3, 0.2))
    flag = TriangleMesh(
        np.array([[0.15, 0, 0.05], [0.6, 0, 0.05], [0.6, 0, 0.4], [0.15, 0.05, 0.4]]),
        np.array([[0, 1, 2], [0, 2, 3]], np.int32),
    )
    repaired = repair(joined(block, flag), CONFIG)
    assert repaired.method == "remesh_shell"
    corners = block.vertices[:, None] - repaired.mesh.vertices[None]
    assert np.linalg.norm(corners, axis=2).min(axis=1).max() < FLOAT32
    assert repaired.hausdorff < 1.5 * CELL


def test_walls_thinner_than_a_cell_do_not_become_lace():
    # Four walls and a floor of 0.006 with the floor's lower face missing, cut so that no lid is small.
    outer, inner = cube((0.6, 0.6, 0.4)), cube((0.588, 0.588, 0.4), (0, 0, 0.006))
    tray = as_mesh(as_manifold(outer) - as_manifold(inner))
    middle = tray.vertices[tray.faces].mean(axis=1)
    rim = np.isclose(middle[:, 2], 0.2)
    repaired = repair(TriangleMesh(tray.vertices, tray.faces[~rim]), CONFIG)
    assert repaired.hausdorff < CELL
    solid = as_manifold(repaired.mesh)
    assert solid.genus() == 0
    assert solid.volume() == pytest.approx(volume(tray), rel=0.25)


def test_paper_is_made_thicker():
    outer, inner = cube((0.6, 0.5, 0.4)), cube((0.5994, 0.4994, 0.4), (0, 0, 0.0003))
    carton = as_mesh(as_manifold(outer) - as_manifold(inner))
    assert thickness(carton) < CONFIG.thin
    repaired = repair(carton, CONFIG)
    assert repaired.method == "remesh_shell"
    assert thickness(repaired.mesh) > CONFIG.thin


THIN = {"plate": (0.8, 0.55, 0.0004), "needle": (0.0012, 0.0012, 0.99)}


@pytest.mark.parametrize("name", THIN)
def test_a_plate_or_needle_is_made_as_thick_as_can_be_simulated(name):
    size = np.array(THIN[name])
    repaired = repair(soup(cube(size)), CONFIG)
    assert (repaired.method, repaired.steps) == ("thicken", ("weld", "thicken"))
    wanted = np.maximum(size, CONFIG.plate)
    np.testing.assert_allclose(np.ptp(repaired.mesh.vertices, axis=0), wanted, atol=FLOAT32)
    assert volume(repaired.mesh) == pytest.approx(np.prod(wanted))
    # Nothing sticks out farther than the corners have moved.
    moved = (wanted - size) / 2
    assert repaired.hausdorff == pytest.approx(np.linalg.norm(moved), abs=FLOAT32)
    (warning,) = repaired.warnings
    assert "of the diagonal thick: made 0.50% thick" in warning


def test_a_plate_that_is_thick_enough_keeps_its_thickness():
    size = (0.8, 0.55, 1.2 * CONFIG.thin)
    repaired = repair(cube(size), CONFIG)
    assert (repaired.method, repaired.steps, repaired.warnings) == ("as_is", (), ())
    assert volume(repaired.mesh) == pytest.approx(np.prod(size))


def test_a_thickened_plate_is_an_object_that_a_simulator_takes():
    obj = prepare_object(cube((0.8, 0.55, 0.0001)), COARSE)
    assert obj.provenance["repair"] == "thicken"
    assert np.ptp(obj.solid.vertices, axis=0).min() == pytest.approx(CONFIG.plate, rel=0.05)
    assert len(obj.rest_heights) == 2  # on either side


def test_a_large_part_without_volume_is_no_debris(ball):
    """A sheet of two sides has no volume, and must not vanish for that."""
    sheet = np.array([[0.0, 0, 0.2], [0.5, 0, 0.6], [0.5, 0.3, 0.6], [0, 0.3, 0.2]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]], np.int32)
    repaired = repair(joined(ball, TriangleMesh(sheet, faces)), CONFIG)
    assert repaired.hausdorff < 1.5 * CELL


def test_an_open_sheet_gets_the_stated_thickness():
    # A bent sheet encloses no volume; with thickness t its volume is about area x t.
    u, v = np.meshgrid(np.linspace(-0.35, 0.35, 15), np.linspace(-0.3, 0.3, 13), indexing="ij")
    vertices = np.stack([u, v, 0.2 * u * u], axis=-1).reshape(-1, 3)
    k = np.arange(14 * 12)
    corner = (k // 12) * 13 + k % 12
    faces = np.concatenate(
        [
            np.stack([corner, corner + 13, corner + 14], axis=1),
            np.stack([corner, corner + 14, corner + 1], axis=1),
        ]
    ).astype(np.int32)
    repaired = repair(TriangleMesh(vertices, faces), CONFIG)
    assert repaired.method == "remesh_shell"
    thick = 2 * CONFIG.shell_cells * CELL
    assert volume(repaired.mesh) == pytest.approx(0.7 * 0.6 * thick, rel=0.15)
    assert hausdorff(repaired.mesh, TriangleMesh(vertices, faces), 2000) < 1.1 * thick / 2 + CELL


def test_a_dome_stays_hollow(ball):
    middle = ball.vertices[ball.faces].mean(axis=1)
    dome = TriangleMesh(ball.vertices, ball.faces[middle[:, 2] > 0.03])
    repaired = repair(dome, CONFIG)
    assert repaired.method == "remesh_shell"
    assert winding_number(repaired.mesh, np.array([0.0, 0, 0.15])) == pytest.approx(0, abs=1e-6)
    thick = 2 * CONFIG.shell_cells * CELL
    assert volume(repaired.mesh) == pytest.approx(2 * np.pi * 0.3 * 0.27 * thick, rel=0.15)


def test_what_lies_in_a_plane_has_no_volume(box):
    flat = TriangleMesh(box.vertices * [1, 1, 0], box.faces)
    with pytest.raises(PrepareFailure) as caught:
        repair(flat, CONFIG)
    assert caught.value.status == Status.NO_VOLUME


def test_weld_keeps_a_closed_mesh_closed_when_triangles_collapse(ball):
    # A pole squeezed to a needle: many triangles there are smaller than the tolerance.
    squeeze = np.where(ball.vertices[:, 2:] > 0.28, [[0.02, 0.02, 1.0]], 1.0)
    coarse = weld(TriangleMesh(ball.vertices * squeeze, ball.faces), 0.002)
    assert 1000 < len(coarse.vertices) < len(ball.vertices)
    assert len(coarse.faces) < len(ball.faces)
    edges = np.sort(np.stack([coarse.faces, np.roll(coarse.faces, -1, 1)], 2).reshape(-1, 2), 1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert (count % 2 == 0).all()


def test_winding_number_counts_how_often_a_surface_goes_round(ball):
    inside, outside = np.array([0.1, 0, 0]), np.array([1.0, 0, 0])
    assert winding_number(ball, inside) == pytest.approx(1)
    assert winding_number(ball, outside) == pytest.approx(0, abs=1e-9)
    assert winding_number(turned(ball), inside) == pytest.approx(-1)
    assert winding_number(joined(ball, ball), inside) == pytest.approx(2)


def test_hausdorff_of_shifted_boxes_is_the_shift_and_ignores_swallowed_walls(box):
    shifted = TriangleMesh(box.vertices + np.array([0.07, 0, 0]), box.faces)
    assert hausdorff(box, shifted, 500) == pytest.approx(0.07, abs=1e-6)
    inner = TriangleMesh(0.3 * box.vertices, box.faces)
    assert hausdorff(box, joined(box, inner), 500) < FLOAT32
    assert mass_properties(joined(box, inner)).volume > 0.09


@pytest.mark.parametrize("family", ["box", "cylinder", "bottle", "bowl"])
def test_a_flat_lid_over_an_opening_counts_with_its_whole_width(family):
    """On the lid the open mesh winds exactly half around: an estimate of that may be either side."""
    shape = shape_mesh(f"{family}/0")
    mesh = TriangleMesh(
        shape.vertices / np.linalg.norm(np.ptp(shape.vertices, axis=0)), shape.faces
    )
    height = mesh.vertices[mesh.faces][:, :, 2]
    for level in (mesh.vertices[:, 2].min(), mesh.vertices[:, 2].max()):
        lid = (np.abs(height - level) < 1e-6).all(axis=1)
        if not lid.any():
            continue
        open_mesh = TriangleMesh(mesh.vertices, mesh.faces[~lid])
        drawn, face = sample_surface(mesh, 5000, np.random.default_rng(0))
        _, away = distances(open_mesh, drawn[lid[face]])
        assert hausdorff(mesh, open_mesh, 5000) >= 0.99 * away.max()


def test_a_closed_cavity_of_one_body_counts_nothing(ball):
    hollow = joined(ball, turned(TriangleMesh(0.5 * ball.vertices, ball.faces)))
    assert hausdorff(ball, hollow, 500) < FLOAT32


def test_specks_are_dropped_and_the_object_keeps_its_scale(ball):
    specks = [TriangleMesh(0.002 * ball.vertices + [x, 0, 0], ball.faces) for x in (5.0, -7.0)]
    alone = prepare_object(ball, COARSE)
    among = prepare_object(joined(ball, *specks), COARSE)
    assert among.volume == pytest.approx(alone.volume, rel=0.05)  # 64 vertices each
    assert among.provenance["unit_in_file"] == pytest.approx(0.6 * np.sqrt(3), rel=0.05)
    assert "2 small parts dropped, apart from the rest" in among.provenance["warnings"]


def test_details_that_are_attached_or_close_are_no_debris(ball):
    loaded = unit_mesh(
        joined(
            ball,
            *(
                TriangleMesh(0.005 * ball.vertices + [x, 0, 0], ball.faces)
                for x in (0.3, 0.303, 0.4)
            ),
        ),
        LoadConfig(),
    )
    kept, dropped = without_debris(loaded, CONFIG, LoadConfig())
    assert dropped == 1
    assert len(kept.mesh.faces) == 3 * len(ball.faces)
    assert kept.diagonal < loaded.diagonal


def test_one_far_triangle_does_not_set_the_scale(ball):
    far = TriangleMesh(np.eye(3) * 0.01 + [300.0, 0, 0], np.array([[0, 1, 2]], np.int32))
    alone, among = prepare_object(ball, COARSE), prepare_object(joined(ball, far), COARSE)
    assert among.volume == pytest.approx(alone.volume, rel=1e-3)
    assert among.provenance["repair"] == "as_is"
    assert among.provenance["repair_steps"] == ["drop_debris"]


def test_a_lid_is_flat_where_a_new_surface_would_only_bulge(ball):
    middle = ball.vertices[ball.faces].mean(axis=1)
    repaired = repair(TriangleMesh(ball.vertices, ball.faces[middle[:, 2] < 0.12]), CONFIG)
    assert repaired.method == "fill_holes"
