"""Does the simulator take the pieces: asked once when an object is made, not first by a scene."""

from __future__ import annotations

from collections.abc import Sequence

from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.prepared import TriangleMesh
from bidexdata.record.status import Status

_SMALLEST = 0.01
"""Smallest bounding-box diagonal that `synth` takes [m]: MuJoCo refuses what is too small."""


def check_simulated(pieces: Sequence[TriangleMesh]) -> None:
    """Compile convex pieces of an object of unit diagonal, as a scene has them.

    Raises:
        PrepareFailure: MuJoCo refuses one.
    """
    import mujoco

    spec = mujoco.MjSpec()
    for number, piece in enumerate(pieces):
        name = f"piece{number}"
        spec.add_mesh(
            name=name,
            uservert=(piece.vertices * _SMALLEST).ravel(),
            userface=piece.faces.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        spec.worldbody.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name)
    try:
        spec.compile()
    except ValueError as err:
        reason = " ".join(str(err).split())
        raise PrepareFailure(
            Status.DECOMPOSITION_FAILED, f"MuJoCo refuses a convex piece: {reason}"
        ) from err
