"""Grasps of an object that nobody has prepared: a mesh, or a measured cloud."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from bidexdata import Library, Run, prepare_library
from bidexgrasp_model.checkpoint import Checkpoint
from bidexgrasp_model.config import with_settings
from bidexgrasp_model.hand_shape import HandShapes
from bidexgrasp_model.places import (
    Place,
    cloud_of_points,
    depth_clouds,
    library_clouds,
    places_of_object,
)
from bidexgrasp_model.rotations import matrix_from_quat
from bidexgrasp_model.sampling import Touch, run_columns, sample
from bidexgrasp_model.surfaces import Surface, estimated_surface, known_surface, tables_under
from bidexgrasp_model.systems import scene_columns

CLOUDS = (".npy", ".txt", ".xyz", ".csv")
"""Endings of files of points: x y z per row [m], z up, as it stands on the table."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleRequest:
    """What `bidexgrasp-model sample` was asked for."""

    source: Path
    """A mesh, or a cloud with an ending of `CLOUDS`."""
    checkpoint: Path
    out: Path
    """Folder of the run; the object is prepared in `library` in it."""
    sizes_mm: tuple[int, ...] = (500,)
    """Diagonals of the box that a mesh is scaled to; a cloud has the size it has."""
    rest_poses: int = 1
    grasps: int = 64
    """Of each scene."""
    seed: int = 0
    single_view: bool = False
    """Show the model what one camera sees of a mesh, and not its whole surface."""
    refine: int | None = None
    """Steps that fit grasps to the surface; the checkpoint's when omitted."""
    draws: int | None = None
    """Samples made for each grasp, of which the best is kept; the checkpoint's when omitted."""
    device: str = "cpu"
    quiet: bool = False


def sample_unseen(request: SampleRequest) -> Run:
    """Prepare the object, make grasps of it and write them as a run.

    The run has a library of its own, so `bidexdata validate`, `view`, `render` and `pack` take it.
    Of a cloud that library holds the convex hull: there is no other solid to simulate.

    Raises:
        ValueError: The file holds no points, or nothing that can be prepared.
    """
    checkpoint = Checkpoint.load(request.checkpoint)
    points = checkpoint.config.model.points
    measured = _read_points(request.source) if request.source.suffix.lower() in CLOUDS else None
    with tempfile.TemporaryDirectory() as folder:
        mesh = request.source
        if measured is not None:
            mesh = Path(folder) / f"{request.source.stem}.off"
            _write_hull(mesh, measured)
        library = _prepared(mesh, request)
    object_id = library.object_ids[0]
    if measured is not None:
        place, cloud = _as_measured(library, object_id, measured, checkpoint.setting)
        places, clouds = [place], cloud_of_points(cloud, points)
    else:
        places = places_of_object(
            library, object_id, request.sizes_mm, checkpoint.setting, request.rest_poses
        )
        if request.single_view:
            clouds = depth_clouds(library, places, points, np.random.default_rng(request.seed))
        else:
            clouds = library_clouds(library, places, points)
    if measured is None and not request.single_view:
        surface = known_surface(library, places)
    else:
        surface = estimated_surface(clouds, tables_under(places))
    return _write(request, checkpoint, places, clouds, surface)


def _write(
    request: SampleRequest,
    checkpoint: Checkpoint,
    places: list[Place],
    clouds: Float[Tensor, "B P 3"],
    surface: Surface,
) -> Run:
    device = torch.device(request.device)
    model = checkpoint.model().to(device)
    asked = {"refine.steps": request.refine, "refine.draws": request.draws}
    changes = {key: value for key, value in asked.items() if value is not None}
    model.config = with_settings(checkpoint.config, changes)
    touch, refine = None, model.config.refine
    if refine.wanted:
        shapes = HandShapes.of_names(checkpoint.hands.names, 1).to(device)
        touch = Touch(Surface(*(part.to(device) for part in surface)), shapes)
    generator = torch.Generator().manual_seed(request.seed)
    found = sample(model, clouds.to(device), request.grasps, checkpoint.hands, generator, touch)
    rows = run_columns(found.poses, checkpoint.hands)
    chosen = [places[b] for b in found.cloud.tolist()]
    rows |= {**scene_columns(chosen), "size": np.array([p.size for p in chosen], np.float32)}
    about = {"release": checkpoint.release.name, "step": checkpoint.step}
    return Run.create(
        request.out,
        rows,
        source=request.out / "library",
        hand=",".join(dict.fromkeys(checkpoint.hands.names)),
        about={"model": about, "source": request.source.name},
        seed=request.seed,
    )


def _prepared(mesh: Path, request: SampleRequest) -> Library:
    out = request.out / "library"
    report = prepare_library([str(mesh)], out, quiet=request.quiet)
    library = Library.open(out)
    if not library.object_ids:
        reason = report.rows[0].get("reason", "") if report.rows else ""
        raise ValueError(f"{mesh}: the object could not be prepared ({reason or 'no mesh found'})")
    return library


def _read_points(path: Path) -> Float[np.ndarray, "P 3"]:
    try:
        if path.suffix.lower() == ".npy":
            points = np.load(path, allow_pickle=False)
        else:
            comma = "," if path.suffix.lower() == ".csv" else None
            points = np.loadtxt(path, delimiter=comma)
    except (OSError, ValueError) as err:
        raise ValueError(f"{path}: no readable cloud ({err})") from err
    points = np.asarray(points, np.float64)
    if points.ndim != 2 or points.shape[1] < 3:
        raise ValueError(f"{path}: a cloud has rows of x y z, not shape {points.shape}")
    points = points[np.isfinite(points).all(axis=1), :3]
    if len(points) < 16:
        raise ValueError(f"{path}: {len(points)} finite points; a cloud needs at least 16")
    return points


def _write_hull(path: Path, points: Float[np.ndarray, "P 3"]) -> None:
    """Write the convex hull of points as a mesh, wound outward."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except QhullError as err:
        raise ValueError("the cloud is flat: it has no hull that could be grasped") from err
    used = np.unique(hull.simplices)
    faces = np.searchsorted(used, hull.simplices)
    corners = points[used]
    a, b, c = (corners[faces[:, k]] for k in range(3))
    inward = (np.cross(b - a, c - a) * (a - corners.mean(0))).sum(1) < 0
    faces[inward] = faces[inward][:, ::-1]
    lines = ["OFF", f"{len(corners)} {len(faces)} 0"]
    lines += [" ".join(f"{v:.9g}" for v in corner) for corner in corners]
    lines += [f"3 {i} {j} {k}" for i, j, k in faces]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _as_measured(
    library: Library, object_id: str, points: Float[np.ndarray, "P 3"], setting: str
) -> tuple[Place, Float[np.ndarray, "P 3"]]:
    """The scene of a cloud that stands as it was measured, and the cloud in its world frame."""
    solid = library.load_solid(object_id)
    size = float(solid.provenance["unit_in_file"])
    origin = np.asarray(solid.provenance["origin_in_file"], np.float64)
    moved = points - origin
    upright = (1.0, 0.0, 0.0, 0.0)
    mm = max(1, round(1000 * size))
    if setting == "floating":
        middle = (0.0, 0.0, 0.0)
        place = Place(f"{object_id}/{mm}/float", object_id, size, middle, upright, on_table=False)
        return place, moved
    height = -min(float((piece.vertices[:, 2] * size).min()) for piece in solid.pieces)
    number = 0
    if len(solid.rest_quats_wxyz):
        turns = matrix_from_quat(torch.from_numpy(np.array(solid.rest_quats_wxyz, np.float64)))
        number = int(turns[:, 2, 2].argmax())  # the rest pose that is most upright
    pos = (0.0, 0.0, height)
    name = f"{object_id}/{mm}/table{number}"
    return Place(name, object_id, size, pos, upright, on_table=True), moved + np.array(pos)
