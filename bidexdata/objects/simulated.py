"""Does the simulator take the pieces: asked once when an object is made, not first by a scene."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bidexdata.record.status import Status
from bidexdata.wording import one_line

from .failure import PrepareFailure
from .prepared import TriangleMesh

_SMALLEST = 0.01
"""Smallest bounding-box diagonal that `synth` takes [m]: MuJoCo refuses what is too small."""


def add_pieces(spec: Any, body: Any, pieces: Sequence[TriangleMesh], size: float) -> None:
    """Give a body of an `MjSpec` the convex pieces of an object as its geoms.

    Args:
        spec: Gets the meshes.
        body: Of the spec.
        pieces: At unit diagonal.
        size: Bounding-box diagonal of the object [m].
    """
    import mujoco

    for number, piece in enumerate(pieces):
        name = f"piece{number}"
        spec.add_mesh(
            name=name,
            uservert=(piece.vertices * size).ravel(),
            userface=piece.faces.ravel(),
            # Scenes give the inertia; this choice only keeps flat pieces from being refused.
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name)


def check_simulated(pieces: Sequence[TriangleMesh]) -> None:
    """Compile convex pieces of an object of unit diagonal, as a scene has them.

    Raises:
        PrepareFailure: MuJoCo refuses one.
    """
    import mujoco

    spec = mujoco.MjSpec()
    add_pieces(spec, spec.worldbody, pieces, _SMALLEST)
    try:
        spec.compile()
    except ValueError as err:
        reason = one_line(err)
        raise PrepareFailure(
            Status.DECOMPOSITION_FAILED, f"MuJoCo refuses a convex piece: {reason}"
        ) from err
