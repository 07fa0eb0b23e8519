"""Hard meshes as they come and as they are prepared, side by side, as one picture.

`python -m benchmarks.before_after LIBRARY FOLDER --out FILE.png NAME ...` draws, of every named
object of a library that was made of a folder, the file's triangles, the repaired mesh and the
convex pieces with one camera. Triangles that are seen from behind are red: a hole or a turned part.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bidexdata.objects.config import LoadConfig
from bidexdata.objects.library import Library
from bidexdata.objects.loading import file_mesh
from bidexdata.objects.prepared import TriangleMesh
from bidexdata.pictures.camera import framed
from bidexdata.pictures.drawing import solid_parts
from bidexdata.pictures.picture import drawn_by
from bidexdata.pictures.raycast import RayScene
from bidexdata.pictures.scene import Part, mesh_part
from bidexdata.pictures.sheet import Caption, Tile, contact_sheet
from bidexdata.pictures.views import DEFAULT_DIRECTION, subject_points

WIDTH, HEIGHT = 250, 210
COLUMNS = 2
FRONT, BACK = (0.62, 0.66, 0.70), (0.80, 0.22, 0.18)
LIFT = 1e-4
"""How far behind its front the back of a triangle is drawn, in parts of the diagonal [-]."""


def file_parts(mesh: TriangleMesh) -> list[Part]:
    """The triangles of a file, grey from their front and red from behind."""
    corners = mesh.vertices[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    backs = (corners - LIFT * normal[:, None]).reshape(-1, 3)
    turned = np.arange(len(backs), dtype=np.int32).reshape(-1, 3)[:, ::-1]
    return [
        mesh_part(mesh.vertices, mesh.faces, FRONT, "front"),
        mesh_part(backs, turned, BACK, "back"),
    ]


def tile(library: Library, row: dict, folder: Path) -> Tile:
    """Three pictures of one object with one camera, and what was done to it."""
    obj = library.load(row["object_id"])
    known = obj.provenance
    name = Path(row["source_name"]).name
    mesh = file_mesh(folder / name, LoadConfig())
    placed = (mesh.vertices - known["origin_in_file"]) / known["unit_in_file"]
    shown = [
        file_parts(TriangleMesh(placed, mesh.faces)),
        *(solid_parts(obj, 1.0, surface=s) for s in ("mesh", "pieces")),
    ]
    points = np.concatenate([subject_points(parts) for parts in shown])
    camera = framed(points, DEFAULT_DIRECTION, WIDTH / HEIGHT)
    pixels = [RayScene(parts, "cpu").draw(camera, WIDTH, HEIGHT) for parts in shown]
    steps = ", ".join(s.replace("_", " ") for s in known["repair_steps"])
    words = (
        f"{row['source_faces']:,} triangles; {steps}; {known['hausdorff']:.1%} off",
        f"{known['pieces']} pieces of {known['volume_ratio']:.2f} times the volume",
        *known["warnings"],
    )
    return Tile(np.concatenate(pixels, axis=1), Caption(name, words))


def main(arguments: Sequence[str]) -> int:
    """Draw and save the sheet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("library", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="+", metavar="NAME", help="a file's name in the folder")
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args(arguments)
    library = Library.open(asked.library)
    rows = {Path(r["source_name"]).name: r for r in map(library.row, library.object_ids)}
    unknown = [n for n in asked.names if n not in rows]
    if unknown:
        print(f"{asked.library} has no object made of {unknown[0]}", file=sys.stderr)
        return 3
    tiles = [tile(library, rows[n], asked.folder) for n in asked.names]
    sheet = contact_sheet(
        tiles,
        title="As they come, repaired, and as convex pieces",
        footer=f"red: seen from behind. {drawn_by('cpu')}",
        columns=COLUMNS,
    )
    sheet.quantize(128).save(asked.out, optimize=True)
    print(f"{len(tiles)} objects in {asked.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
