"""prepare_object: one mesh becomes the solid that every later stage sees.

Read, repair, split into convex pieces, or take the pieces that the source gives; then everything
is computed on the union of the pieces: mass, frame (origin at the centre of mass, unit box
diagonal), surface points, signed distances, hull, rest poses.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bidexdata.errors import NotUsable, PathNotFound
from bidexdata.objects.readers.inside import regular_bytes
from bidexdata.objects.sources import SourceItem
from bidexdata.objects.sources.shapes import shape_mesh
from bidexdata.record.status import Status
from bidexdata.wording import counted

from .assemble import UnitSolid, assembled, unit_solid
from .closed import as_manifold
from .config import PrepareConfig
from .convex import Decomposition, decompose
from .debris import without_debris
from .deviation import hausdorff
from .failure import PrepareFailure
from .given import GivenPieces, given_pieces
from .identity import Identity, identity_of, object_id_of, source_identity
from .loading import LoadedMesh, load_mesh, unit_mesh
from .physics import mass_properties
from .prepared import PreparedObject, TriangleMesh
from .repair import Repaired, repair
from .selection import outside
from .traits import mesh_hash, traits

VOLUME_DOUBT = 0.25
"""Relative difference between the volumes of pieces and mesh above which a warning says so."""


def prepare_object(
    source: str | Path | TriangleMesh | SourceItem, config: PrepareConfig | None = None
) -> PreparedObject:
    """Prepare one object.

    Args:
        source: A mesh file, `shapes:FAMILY` or `shapes:FAMILY/NUMBER`, triangles (any unit, z
            up), or an item that `resolve_sources` listed (and `fetched` completed).
        config: Every tolerance and bound; the defaults when omitted.

    Returns:
        The object at unit diagonal. The same source and configuration give the same arrays.

    Raises:
        PrepareFailure: The source cannot become a solid; `.status` and `.reason` say why.
        PathNotFound: A named file does not exist.
        NotUsable: The item is one of Objaverse whose file `fetched` has not brought.

    Example:
        >>> obj = prepare_object("shapes:box")
        >>> len(obj.pieces), len(obj.rest_heights)
        (1, 6)
    """
    config = config or PrepareConfig()
    item, identity = _item_and_identity(source, config.load.max_bytes)
    given, doubts = _usable_pieces(item, config)
    if given is not None and not doubts:
        return _of_given(item, identity, given, config)
    whole = _loaded(source, item, given, config)
    loaded, dropped = without_debris(whole, config.repair, config.load)
    if dropped:
        doubts += (f"{counted(dropped, 'small part')} dropped, apart from the rest",)
    repaired = repair(loaded.mesh, config.repair)
    shape = _shape(repaired.mesh, config)
    split = decompose(repaired.mesh, config.convex)
    solid = unit_solid(split.pieces)
    provenance = _provenance(item, identity, loaded, repaired, split, solid, config) | shape
    provenance["source_faces"] = len(whole.mesh.faces)
    provenance["repair_steps"] = ["drop_debris"] * bool(dropped) + provenance["repair_steps"]
    provenance["warnings"] = [*doubts, *provenance["warnings"]]
    object_id = object_id_of(item, identity.sha256)
    return assembled(object_id, solid, repaired.mesh, provenance, config)


def check_selected(item: SourceItem, config: PrepareConfig) -> None:
    """Find out whether the selection keeps an input, at the cost of reading and repairing it.

    Raises:
        PrepareFailure: It leaves the input out, or the input cannot become a closed mesh.
    """
    source_identity(item, config.load.max_bytes)  # refuses what prepare_object refuses
    given, doubts = _usable_pieces(item, config)
    if given is not None and not doubts:
        _shape(_union(unit_solid(given.pieces)), config)
        return
    loaded, _ = without_debris(_loaded(item, item, given, config), config.repair, config.load)
    _shape(repair(loaded.mesh, config.repair).mesh, config)


def _usable_pieces(
    item: SourceItem, config: PrepareConfig
) -> tuple[GivenPieces | None, tuple[str, ...]]:
    """The pieces that the source gives, and why they are not taken."""
    if not item.pieces:
        return None, ()
    given = given_pieces(item, config.load)
    if not given.not_convex:
        return given, ()
    count = f"{given.not_convex} of {len(given.pieces)} given pieces"
    return given, (f"{count} are not convex: decomposed anew",)


def _loaded(
    source: str | Path | TriangleMesh | SourceItem,
    item: SourceItem,
    given: GivenPieces | None,
    config: PrepareConfig,
) -> LoadedMesh:
    """Read what is no set of given pieces, at unit diagonal."""
    if given is not None:
        return unit_mesh(given.shown or given.whole, config.load)
    if isinstance(source, TriangleMesh):
        return unit_mesh(source, config.load)
    if item.shape is not None:
        return unit_mesh(shape_mesh(item.shape), config.load, metres_per_unit=1.0)
    assert item.path is not None
    data = regular_bytes(item.path, config.load.max_bytes)
    return load_mesh(item.path, data, config.load)


def _union(solid: UnitSolid) -> TriangleMesh:
    """The surface of a solid in the frame that its pieces came in."""
    return TriangleMesh(solid.mesh.vertices * solid.diagonal + solid.centre, solid.mesh.faces)


def _provenance(
    item: SourceItem,
    identity: Identity,
    loaded: LoadedMesh,
    repaired: Repaired,
    split: Decomposition,
    solid: UnitSolid,
    config: PrepareConfig,
) -> dict[str, Any]:
    """Where the object is from, what was done to it, and how far that moved its surface."""
    ratio = solid.volume * solid.diagonal**3 / mass_properties(repaired.mesh).volume
    samples = config.repair.hausdorff_samples
    in_file = loaded.centre + loaded.diagonal * solid.centre
    moved = _union(solid)
    metres = loaded.metres_per_unit
    return {
        **_origin(item, identity),
        "source_diagonal": loaded.diagonal,
        "source_metres_per_unit": metres,
        # x_file = origin_in_file + unit_in_file * x_object, after the turn to z up.
        "origin_in_file": [float(x) for x in in_file],
        "unit_in_file": loaded.diagonal * solid.diagonal,
        "repair": repaired.method,
        "repair_steps": list(repaired.steps),
        "hausdorff": repaired.hausdorff,
        "piece_method": split.method,
        "pieces": len(split.pieces),
        "volume_ratio": ratio,
        "solid_hausdorff": hausdorff(moved, repaired.mesh, samples),
        "warnings": [*loaded.warnings, *repaired.warnings, *split.warnings, *_of_volume(ratio)],
    }


def _of_given(
    item: SourceItem, identity: Identity, given: GivenPieces, config: PrepareConfig
) -> PreparedObject:
    """Assemble an object of the pieces that its source gives, as they are."""
    solid = unit_solid(given.pieces)
    union = _union(solid)
    shown, samples = given.shown or union, config.repair.hausdorff_samples
    provenance = {
        **_origin(item, identity),
        "source_faces": len(given.whole.faces),
        "source_diagonal": float(np.linalg.norm(np.ptp(given.whole.vertices, axis=0))),
        "source_radius": given.radius,
        "source_metres_per_unit": None,
        "origin_in_file": [float(x) for x in solid.centre],
        "unit_in_file": solid.diagonal,
        "repair": "none",
        "repair_steps": [],
        "hausdorff": _apart(solid, given.whole, samples),
        "piece_method": "given",
        "pieces": len(solid.pieces),
        "solid_hausdorff": _apart(solid, shown, samples),
        "warnings": list(given.warnings),
    }
    provenance |= _shape(union, config)
    closed = as_manifold(shown) if given.shown else None
    if closed is not None and closed.volume() > 0:
        ratio = solid.volume * solid.diagonal**3 / closed.volume()
        provenance["volume_ratio"] = ratio
        provenance["warnings"] += _of_volume(ratio)
    return assembled(object_id_of(item, identity.sha256), solid, shown, provenance, config)


def _of_volume(ratio: float) -> list[str]:
    """Warn of pieces that fill what is hollow in the mesh: hands would grasp what is not there."""
    if abs(ratio - 1) <= VOLUME_DOUBT:
        return []
    return [f"the convex pieces have {ratio:.2f} times the volume of the mesh"]


def _shape(mesh: TriangleMesh, config: PrepareConfig) -> dict[str, Any]:
    """What a selection looks at.

    Raises:
        PrepareFailure: The selection leaves such shapes out.
    """
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    found = traits(TriangleMesh(mesh.vertices / diagonal, mesh.faces))._asdict()
    reason = outside(found, config.select)
    if reason:
        raise PrepareFailure(Status.NOT_SELECTED, reason)
    return {**found, "mesh_hash": mesh_hash(mesh)}


def _apart(solid: UnitSolid, mesh: TriangleMesh, samples: int) -> float:
    """`hausdorff` of a solid at unit diagonal and a mesh in the frame its pieces came in."""
    moved = (mesh.vertices - solid.centre) / solid.diagonal
    return hausdorff(solid.mesh, TriangleMesh(moved, mesh.faces), samples)


def _origin(item: SourceItem, identity: Identity) -> dict[str, Any]:
    """Where an object is from."""
    known = {
        "source_name": item.source_name,
        "source": item.source,
        "licence": item.licence,
        "author": item.author,
        "category": item.category,
        "source_sha256": identity.sha256,
        "source_bytes": identity.size,
    }
    if item.normalisation:
        known["source_normalisation"] = item.normalisation
    return known


def _item_and_identity(
    source: str | Path | TriangleMesh | SourceItem, most: int
) -> tuple[SourceItem, Identity]:
    if isinstance(source, TriangleMesh):
        corners = np.ascontiguousarray(source.vertices, "<f8").tobytes()
        faces = np.ascontiguousarray(source.faces, "<i4").tobytes()
        item = SourceItem(source_name="triangles", path=Path("triangles"))
        return item, identity_of([corners, faces])
    if isinstance(source, SourceItem):
        if source.uid and source.path is None and not source.problem:
            raise NotUsable(
                f"{source.source_name} has no file yet; call bidexdata.objects.sources.fetched on the "
                "items of resolve_sources first"
            )
        return source, source_identity(source, most)
    text = str(source)
    if text.startswith("shapes:") and not Path(text).exists():
        from bidexdata.objects.sources.shapes import named_shape

        item = named_shape(text.removeprefix("shapes:"))
    else:
        path = Path(source)
        if not path.is_file():
            raise PathNotFound(path, "a mesh file or shapes:FAMILY")
        item = SourceItem(source_name=path.name, path=path)
    return item, source_identity(item, most)
