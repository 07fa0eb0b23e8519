"""Documentation of a library's files, generated from the tables here and that of the index.

`python -m bidexdata.objects.library_page` writes `docs/library.md`; tests hold it fresh and compare the
tables with prepared objects.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from .config import RepairConfig, RestConfig
from .library import COLUMNS
from .storage import SCHEMA_VERSION

PAGE = Path("docs/library.md")

KEYS: tuple[tuple[str, str, str], ...] = (
    ("schema_version", "string", "of the folder's files; another major version cannot be read"),
    ("object_id", "string", "identity, and the folder's name"),
    ("volume", "number", "of the solid"),
    ("inertia", "3 x 3", "of the solid about its centre of mass, unit density"),
    ("rest_quats_wxyz", "K x 4", "orientations in which it rests on a table, most probable first"),
    ("rest_heights", "K", "height of the origin over the table in those"),
    (
        "rest_probabilities",
        "K",
        "their probabilities; the sum may be less than 1, since poses below `rest.min_probability` "
        f"({RestConfig().min_probability:g}), those after the first `rest.max_poses` "
        f"({RestConfig().max_poses}) and those in which no drop came to rest are not listed",
    ),
    ("provenance", "object", "where it is from and what was done to it, below"),
    ("config", "object", "configuration that decided the bytes; not in a release"),
)
"""Keys of `object.json`: name, type or shape, meaning."""

PROVENANCE: tuple[tuple[str, str, str], ...] = (
    ("source_name", "string", "as in the index"),
    ("source", "string", "as in the index"),
    ("licence", "string", "as in the index"),
    ("author", "string", "as in the index"),
    ("category", "string", "as in the index"),
    ("source_sha256", "string", "as in the index"),
    ("source_bytes", "int", "as in the index"),
    ("source_faces", "int", "as in the index"),
    ("source_diagonal", "number", "as in the index"),
    ("source_metres_per_unit", "number", "length of the file's unit [m]; null where nobody says"),
    ("source_radius", "number", "only given pieces: farthest vertex from the file's origin"),
    ("source_normalisation", "string", "only trees: how the source scaled the object"),
    (
        "origin_in_file",
        "3",
        "origin of the object frame in file coordinates, after the turn to z up",
    ),
    ("unit_in_file", "number", "length of the object frame's unit in file units"),
    ("repair", "string", "as in the index; `none` for given pieces"),
    ("repair_steps", "strings", "as in the index"),
    ("hausdorff", "number", "as in the index"),
    ("piece_method", "string", "as in the index"),
    ("pieces", "int", "as in the index"),
    ("volume_ratio", "number", "as in the index; left out where it is empty there"),
    ("solid_hausdorff", "number", "as in the index"),
    ("aspect", "number", "as in the index"),
    ("thickness", "number", "as in the index"),
    ("components", "int", "as in the index"),
    ("genus", "int", "as in the index"),
    ("mesh_hash", "string", "as in the index"),
    ("descriptor", "51", "shape descriptor by which near duplicates are found (sources.md)"),
    ("warnings", "strings", "as in the index"),
    ("mass_properties", "string", "only imports: `sum of pieces`, overlaps count twice"),
    ("nominal_volume", "number", "only imports: volume at unit diagonal that the masses refer to"),
)
"""Keys of `provenance`: name, type or shape, meaning."""

ARRAYS: tuple[tuple[str, str, str, str, str], ...] = (
    ("pieces.npz", "vertices_00, ...", "float32", "V 3", "corners of each convex piece"),
    ("pieces.npz", "faces_00, ...", "int32", "F 3", "its triangles, wound outward"),
    ("geometry.npz", "solid_vertices", "float32", "V 3", "surface of the union of the pieces"),
    ("geometry.npz", "solid_faces", "int32", "F 3", "its triangles, wound outward"),
    ("geometry.npz", "hull_vertices", "float32", "V 3", "convex hull of the solid"),
    ("geometry.npz", "hull_faces", "int32", "F 3", "its triangles, wound outward"),
    (
        *("geometry.npz", "surface_points", "float32", "P 3"),
        "points on the solid's surface in farthest-point order: a prefix is a coarser cloud",
    ),
    ("geometry.npz", "surface_normals", "float32", "P 3", "outward unit normals there"),
    (
        *("geometry.npz", "sdf_values", "float32", "X Y Z"),
        "signed distances to the solid, negative inside",
    ),
    ("geometry.npz", "sdf_origin", "float64", "3", "position of the first node"),
    (
        *("geometry.npz", "sdf_cell", "float64", ""),
        "spacing: node (i, j, k) lies at `sdf_origin + sdf_cell * (i, j, k)`",
    ),
)
"""Arrays: file, name, type, shape, meaning."""

NOT_IMPORTED = (
    *("repair_steps", "hausdorff", "volume_ratio", "solid_hausdorff", "aspect", "thickness"),
    *("components", "genus", "mesh_hash", "duplicate_of", "near_duplicate_of"),
)
"""Columns of the index that an import leaves null."""

_INTRO = f"""# A library on disk

Generated by `python -m bidexdata.objects.library_page`; do not edit. Schema {SCHEMA_VERSION}.

What `bidexdata prepare` writes. `bidexdata import` writes a library of the objects of another project's
grasps, with less in it: no `report.html`, no `.times/`, no `thumbnail.png`, and what it does not
measure is null in the index and left out of the provenance: {", ".join(f"`{n}`" for n in NOT_IMPORTED)}.
[sources.md](sources.md) says how the files come about.

| path | what |
|---|---|
| `index.parquet` | one row per input, in the order of the sources |
| `objects/<2 hex digits>/<object_id>/` | one folder per object; the digits are the first of its hash |
| `report.html` | every input with its picture, repair, warnings and seconds |
| `.times/` | the seconds: the only files that differ from run to run |
| `.logs/` | tracebacks of unexpected errors; only after some |

An object's folder has `mesh.glb` (the repaired mesh, for display, glTF 2.0; above
`repair.display_faces` = {RepairConfig().display_faces:,} triangles it is simplified), `pieces.npz` (the convex pieces),
`geometry.npz` (what is computed on their union), `object.json`, and `thumbnail.png`. A release has the
folder without `geometry.npz` and the picture.

**Frame and unit.** All of an object's geometry is in the object frame at unit diagonal: the origin is the
centre of mass of the solid, the axes are those of the source after the turn to z up, and the diagonal of
the solid's axis-aligned box is 1. Times the size s [m], lengths and signed distances are metres; volume
grows with s^3 and inertia with s^5, at unit density (times the density [kg/m^3] it is kg m^2). Only
`mesh.glb` has y up, as glTF wants it: its node turns it, the stored coordinates are those of the object
frame. `bidexdata.Library.open(PATH).load(OBJECT_ID)` reads all of it and checks it against the
index.
"""

_INDEX = """An input without an object has nulls where nothing is known. The metadata of the Parquet
schema hold `schema_version`, `prepare_config` (what decided the bytes) and `asked` (what decided which
inputs gave none), as JSON. An index of another major schema version is not read; of another minor one,
columns that it lacks read as nulls and those that it has more stay. Statuses are listed in [fields.md](fields.md#statuses).

`hausdorff` and `solid_hausdorff` are distances between bodies, not between surfaces: the farthest that a
point of the surface of one is from the body of the other, the larger of both ways. What lies inside the
other body counts nothing, so a closed cavity that only one has does not show. `hausdorff` compares with the input after the weld and without its debris, and
`source_diagonal` is that of the input without its debris, too. `volume_ratio` is the volume of the union of
the pieces to that of the repaired mesh; where the source gives the pieces, to that of its closed
mesh, and empty where it has none."""


def page() -> str:
    """The whole page."""
    index = [(f"`{name}`", f"`{kind}`", text) for name, kind, text in COLUMNS]
    keys = [(f"`{name}`", kind, text) for name, kind, text in KEYS]
    provenance = [(f"`{name}`", kind, text) for name, kind, text in PROVENANCE]
    arrays = [(f"`{file}`", f"`{name}`", *rest) for file, name, *rest in ARRAYS]
    return "\n".join(
        [
            _INTRO,
            _section(
                "index.parquet",
                _INDEX,
                ("column", "type", "meaning"),
                index,
            ),
            _section(
                "object.json",
                "K rest poses, maybe none (a smooth ball).",
                ("key", "type or shape", "meaning"),
                keys,
            ),
            _section(
                "provenance",
                "The key `provenance` of `object.json`. "
                "`x_file = origin_in_file + unit_in_file * x_object` gives coordinates of the file, "
                "turned to z up.",
                ("key", "type or shape", "meaning"),
                provenance,
            ),
            _section(
                "Arrays",
                "Object frame, unit diagonal. No file holds Python objects.",
                ("file", "array", "type", "shape", "meaning"),
                arrays,
            ),
        ]
    )


def main() -> None:
    """Write the page into the checkout that this runs in."""
    PAGE.parent.mkdir(exist_ok=True)
    PAGE.write_text(page(), encoding="utf-8")


def _section(title: str, text: str, heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [f"## {title}", "", text, "", f"| {' | '.join(heads)} |", "|" + "---|" * len(heads)]
    lines += ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
