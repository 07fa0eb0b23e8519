"""What a solid does when it is put on a plane in MuJoCo, every piece a geom of its own."""

from __future__ import annotations

import mujoco
import numpy as np

from bidexdata.frames import matrix_from_quat

SIZE = 0.5  # m
DENSITY = 100.0  # kg/m^3


def tilts_after(pieces, volume, inertia, poses, seconds=1.5) -> np.ndarray:
    """Put the solid down in each pose and return by how much its z axis has turned [deg]."""
    spec = mujoco.MjSpec()
    spec.compiler.balanceinertia = True
    friction = [0.6, 0.02, 0.0001]
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0], friction=friction
    )
    body = spec.worldbody.add_body()
    body.add_freejoint()
    body.explicitinertial = True
    body.mass, body.ipos = volume * SIZE**3 * DENSITY, [0.0, 0.0, 0.0]
    moments = inertia * SIZE**5 * DENSITY
    body.fullinertia = moments[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    for k, piece in enumerate(pieces):
        spec.add_mesh(
            name=f"piece{k}",
            uservert=(piece.vertices * SIZE).ravel(),
            userface=piece.faces.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"piece{k}", friction=friction)
    model = spec.compile()
    data = mujoco.MjData(model)
    tilts = []
    for quat, height in zip(*poses, strict=True):
        mujoco.mj_resetData(model, data)
        data.qpos[:3], data.qpos[3:] = [0, 0, height * SIZE], quat
        for _ in range(round(seconds / model.opt.timestep)):
            mujoco.mj_step(model, data)
        up, now = matrix_from_quat(quat)[2], matrix_from_quat(data.qpos[3:7])[2]
        tilts.append(np.degrees(np.arccos(np.clip(up @ now, -1, 1))))
    return np.array(tilts)
