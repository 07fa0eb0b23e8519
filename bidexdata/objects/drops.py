"""Dropping a body on a plane in MuJoCo, many times, until it lies still, and putting it down.

A body touches a plane with its convex hull only, so the hull is dropped instead of the pieces: the
same contacts for a fraction of the time. It is put down as scenes have it, in pieces: a piece touches
at more points than the hull, and some poses need them. Nothing here depends on the size: at diagonal s every time
is longer by the square root of s.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.engine_log import engine_warnings_logged
from bidexdata.frames import matrix_from_quat, quat_canonical, quat_from_rotation_vector

from .prepared import TriangleMesh
from .simulated import add_pieces

if TYPE_CHECKING:
    import mujoco

_TIME_STEP = 0.004
"""[s], as in the protocols."""
_FRICTION = 0.6
"""Of the table in the protocol `paper-1`."""
_PART = 50
"""Steps between looks at which bodies lie still."""
_FREE = 1.5
"""Time [s] of undisturbed motion. What rocks or rolls on after it, round bodies can do so for
minutes, is slowed down."""
_SLOWING = 0.2
"""Time [s] in which rotation is slowed down to 1/e then."""
_STILL = 0.05
"""Speeds below this [m/s, rad/s] at unit diagonal count as still where a facet carries the body."""


class Drops(NamedTuple):
    """Where bodies came to lie."""

    downs: NDArray[np.float64]
    """Direction of gravity in the object frame at the end, (N, 3)."""
    still: NDArray[np.bool_]
    """Whether it lies still on a facet, (N,)."""


class Body(NamedTuple):
    """A rigid body with its centre of mass at the origin, at unit diagonal."""

    hull: TriangleMesh
    volume: float
    inertia: NDArray[np.float64]
    """At unit density, (3, 3)."""


def drop(
    body: Body,
    downs: NDArray[np.float64],
    normals: NDArray[np.float64],
    *,
    height: float,
    angle: float,
    seconds: float,
) -> Drops:
    """Release a body at rest in many orientations and wait until it lies on a facet.

    Args:
        body: The body.
        downs: Directions of the object frame that point down at the release, (N, 3).
        normals: Outward normals of the facets that can carry it, (K, 3).
        height: Its lowest point above the plane at the release.
        angle: A facet this flat [rad] on the plane counts as lying.
        seconds: Time after which what still moves is given up.
    """
    import mujoco
    from mujoco import rollout

    model = _model(body, (body.hull,))
    data = mujoco.MjData(model)
    state = np.zeros((len(downs), 1 + model.nq + model.nv))
    quats = np.array([facing_down(d) for d in downs]).reshape(-1, 4)
    state[:, 3] = np.max(downs @ body.hull.vertices.T, axis=1) + height
    state[:, 4:8] = quats
    moving = np.arange(len(downs))
    for part in range(int(np.ceil(seconds / _TIME_STEP / _PART))):
        if part * _PART * _TIME_STEP >= _FREE:
            model.dof_damping[3:] = np.trace(body.inertia) / 3 / body.volume / _SLOWING
        with engine_warnings_logged():
            path, _ = rollout.rollout(model, data, state[moving], nstep=_PART)
        state[moving] = path[:, -1]
        still = _lies(state[moving], normals, angle)
        moving = moving[~still]
        if len(moving) == 0:
            break
    still = np.ones(len(downs), bool)
    still[moving] = False
    return Drops(_downs(state), still)


def put_down(
    body: Body,
    pieces: Sequence[TriangleMesh],
    quats: NDArray[np.float64],
    heights: NDArray[np.float64],
    seconds: float,
) -> NDArray[np.float64]:
    """Put a body down in poses and tell by how much its z axis has turned after a while [rad], (K,).

    Args:
        body: The body.
        pieces: Convex pieces that it consists of.
        quats: The poses (K, 4) wxyz.
        heights: Of the origin above the plane in them, (K,).
        seconds: How long to wait.
    """
    import mujoco
    from mujoco import rollout

    if len(quats) == 0:
        return np.zeros(0)
    model = _model(body, pieces)
    state = np.zeros((len(quats), 1 + model.nq + model.nv))
    state[:, 3], state[:, 4:8] = heights, quats
    with engine_warnings_logged():
        path, _ = rollout.rollout(
            model, mujoco.MjData(model), state, nstep=round(seconds / _TIME_STEP)
        )
    cosines = np.sum(_downs(state) * _downs(path[:, -1]), axis=1)
    return np.arccos(np.clip(cosines, -1.0, 1.0))


def spread_directions(count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw unit vectors (count, 3), spread evenly, that quarter turns about the axes permute.

    The 24 rotations of a cube make 24 directions of one; each next one is, of many drawn, that
    whose copies are farthest from all before. So the sides of a box get their shares exactly, and
    an object turned by quarter turns falls as before.
    """
    turns = _cube_rotations()
    chosen = np.zeros((0, 3))
    for _ in range(count // len(turns)):
        drawn = rng.standard_normal((64, 3))
        drawn /= np.linalg.norm(drawn, axis=1, keepdims=True)
        copies = np.einsum("gij,dj->dgi", turns, drawn)
        nearest = np.einsum("di,dgi->dg", drawn, copies[:, 1:]).max(axis=1)
        if len(chosen):
            nearest = np.maximum(nearest, (drawn @ chosen.T).max(axis=1))
        chosen = np.concatenate([chosen, copies[np.argmin(nearest)]])
    return chosen


def _cube_rotations() -> NDArray[np.float64]:
    """Rotations of a cube, (24, 3, 3), the identity first."""
    signs = [np.diag(s) for s in itertools.product((1.0, -1.0), repeat=3)]
    orders = [np.eye(3)[list(p)] for p in itertools.permutations(range(3))]
    every = np.array([s @ o for o in orders for s in signs])
    return every[np.linalg.det(every) > 0]


def facing_down(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Shortest rotation (wxyz) that turns `direction` to -z; a half turn about x when it is +z."""
    down = np.array([0.0, 0.0, -1.0])
    axis = np.cross(direction, down)
    sine, cosine = np.linalg.norm(axis), float(direction @ down)
    if sine < 1e-9:
        return quat_canonical([1.0, 0, 0, 0] if cosine > 0 else [0.0, 1.0, 0, 0])
    return quat_from_rotation_vector(axis / sine * np.arctan2(sine, cosine))


def _lies(
    state: NDArray[np.float64], normals: NDArray[np.float64], angle: float
) -> NDArray[np.bool_]:
    flat = np.max(_downs(state) @ normals.T, axis=1, initial=-1.0) > np.cos(angle)
    return flat & (np.linalg.norm(state[:, 8:14].reshape(-1, 2, 3), axis=2).max(axis=1) < _STILL)


def _downs(state: NDArray[np.float64]) -> NDArray[np.float64]:
    return -matrix_from_quat(state[:, 4:8])[:, 2]


def _model(body: Body, pieces: Sequence[TriangleMesh]) -> mujoco.MjModel:
    import mujoco

    spec = mujoco.MjSpec()
    spec.option.timestep = _TIME_STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    # A flat plate breaks the triangle inequality of the moments by rounding.
    spec.compiler.balanceinertia = True
    friction = [_FRICTION, 0.0, 0.0]
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0], friction=friction
    )
    moving = spec.worldbody.add_body(name="body")
    moving.add_freejoint()
    moving.explicitinertial = True
    moving.mass = 1.0
    moving.ipos = [0.0, 0.0, 0.0]
    moving.fullinertia = (body.inertia / body.volume)[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    add_pieces(spec, moving, pieces, 1.0)
    for geom in moving.geoms:
        geom.friction = friction
    return spec.compile()
