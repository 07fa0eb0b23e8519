"""Objects of DexGraspNet and BimanGrasp: `<object>/coacd/decomposed.obj`, all convex pieces in one file.

The simulated solid is the union of the pieces, as for `prepare dexgraspnet:PATH`. What is stated of
an object's origin is in `INDEX.csv` beside the objects' folders, or unknown.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bidexdata.formats.importers.format import BadFile, ObjectSource
from bidexdata.objects.assemble import assembled, unit_solid
from bidexdata.objects.closed import as_mesh, convex_hull
from bidexdata.objects.components import components
from bidexdata.objects.config import PrepareConfig
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.given import GivenPieces, fills_hull, given_pieces
from bidexdata.objects.prepared import PreparedObject, TriangleMesh
from bidexdata.objects.sources.files import usable_list
from bidexdata.objects.sources.item import UNKNOWN, SourceItem
from bidexdata.record.status import Status

DECOMPOSED = ("coacd", "decomposed.obj")
FOLDERS = ("objects", "meshdata")
"""Folders in the imported one that are searched for an object, the second as DexGraspNet's are."""
_ABOUT = ("source", "licence", "author", "category")


def find_object(name: str, root: Path, objects: Path | None) -> ObjectSource:
    """Find the folder of an object by its name: in `objects`, or in `FOLDERS` of the imported one.

    Raises:
        BadFile: It is not there.
    """
    places = [(objects / name, objects)] if objects is not None else []
    places += [(root / folder / name, root) for folder in FOLDERS]
    found = next((p for p in places if p[0].joinpath(*DECOMPOSED).is_file()), None)
    if not name or name in (".", "..") or "/" in name or found is None:
        tried = ", ".join(str(p) for p, _ in places)
        wanted = "/".join(DECOMPOSED)
        raise BadFile(
            f"its object {name!r} has no {wanted} (looked in {tried}); --objects names another folder"
        )
    folder, top = found
    file = folder.joinpath(*DECOMPOSED)
    return ObjectSource.of(name, folder, (file,), stated_origin(folder), top=top)


def stated_origin(folder: Path) -> dict[str, str]:
    """What an `INDEX.csv` beside an object's folder says of its origin."""
    return dict((usable_list(folder.parent) or {}).get(folder.name, {}))


def load_object(source: ObjectSource, config: PrepareConfig) -> PreparedObject:
    """Take the pieces as they are: no repair, no decomposition.

    Raises:
        PrepareFailure: The file cannot be read, or a piece in it is not convex.
    """
    item = SourceItem(source_name=source.name, path=source.files[0], pieces=source.files)
    given = given_pieces(item, config.load)
    pieces = given.pieces if not given.not_convex else _bodies(given)
    solid = unit_solid(pieces)
    union = TriangleMesh(solid.mesh.vertices * solid.diagonal + solid.centre, solid.mesh.faces)
    provenance: dict[str, Any] = {
        "source_name": source.name,
        **{key: source.about.get(key, UNKNOWN) for key in _ABOUT},
        "source_sha256": source.sha256,
        "source_bytes": source.bytes,
        "source_faces": len(given.whole.faces),
        "source_diagonal": float(np.linalg.norm(np.ptp(given.whole.vertices, axis=0))),
        "source_metres_per_unit": None,
        "origin_in_file": [float(x) for x in solid.centre],
        "unit_in_file": solid.diagonal,
        "repair": "none",
        "piece_method": "given",
        "pieces": len(solid.pieces),
        "warnings": list(given.warnings),
    }
    return assembled(source.object_id, solid, union, provenance, config)


def _bodies(given: GivenPieces) -> tuple[TriangleMesh, ...]:
    """The closed bodies of a file that does not name its pieces."""
    bodies = components(given.whole)
    hulls = tuple(as_mesh(convex_hull(b.vertices)) for b in bodies)
    odd = sum(not fills_hull(b, h) for b, h in zip(bodies, hulls, strict=True))
    if odd:
        raise PrepareFailure(
            Status.DECOMPOSITION_FAILED, f"{odd} of {len(bodies)} bodies in it are not convex"
        )
    return hulls
