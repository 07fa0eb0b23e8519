"""Spheres of an arm and of the wrist and forearm of its hand, for searching.

Spheres of the model stay as they are; capsules and cylinders become strings of spheres along their
axes, meshes and boxes a greedy cover. MuJoCo has the final word on every path, so spheres need not
be exact: they may stand out by, or leave uncovered, at most `TOLERANCE`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bidexdata.arms.chain import Chain, chain_frames
from bidexdata.arms.keyed_cache import KeyedCache
from bidexdata.hands.geometry import Shape, body_shapes
from bidexdata.hands.model import FloatArray
from bidexdata.hands.spec import SphereFitSpec
from bidexdata.hands.spheres import cover

if TYPE_CHECKING:
    import mujoco

TOLERANCE = 0.025
"""How far the surface of a link may lie outside its spheres, and they outside of it [m]."""
POSTURES = 2000
"""Random postures that decide which spheres of one arm can meet."""
ALWAYS = 0.95
"""Share of the postures from which on two spheres that overlap are neighbours by design [-]."""
_NEAR = 0.02
"""Gap in the nearest of those postures up to which two spheres count [m]: there are others."""
_STEP = 1.0
"""Distance of the spheres of a string, in radii [-]."""
_SWELL = 1.06
"""Radius of the spheres of a string, in radii of the capsule: what they stand out and what they
leave uncovered between them is then about equal [-]."""
_MESH = SphereFitSpec(min_radius=0.02, max_radius=0.09, protrusion=0.006, slack=0.15, worth=8e-4,
                      worth_share=0.02, thin=0.008, spacing=0.01)  # fmt: skip


class ArmSpheres(NamedTuple):
    """K spheres, those that the first joints move first."""

    joint: Int[np.ndarray, " K"]
    """The last joint of the chain that moves each, rising; -1 for the base, which stands still."""
    pos: Float[np.ndarray, "K 3"]
    """Centres in that joint's frame, in the world for -1 [m]."""
    radius: Float[np.ndarray, " K"]
    """[m]."""
    part: tuple[str, ...]
    """Body of each, for messages."""
    against_self: Int[np.ndarray, "P 2"]
    """Pairs that may collide, that nearly do in some posture, and that do not always overlap."""


def fit_arm_spheres(model: mujoco.MjModel, chain: Chain, bodies: list[str]) -> ArmSpheres:
    """Give the spheres of an arm.

    Args:
        model: One arm at its place with its hand.
        chain: Its chain.
        bodies: Names in the model of the bodies that move with the arm alone: arm, forearm, wrist.
    """
    shapes = body_shapes(model)
    joint, pos, radius, owner = [], [], [], []
    last, placed = _carriers(model, chain)
    for body in sorted((int(model.body(name).id) for name in bodies), key=lambda b: (last[b], b)):
        centres, radii = shape_spheres(shapes[body - 1])
        T = placed[body]
        joint += [last[body]] * len(radii)
        pos.append(centres @ T[:3, :3].T + T[:3, 3])
        radius.append(radii)
        owner += [body] * len(radii)
    spheres = ArmSpheres(
        joint=np.array(joint, np.int32),
        pos=np.concatenate([np.zeros((0, 3)), *pos]),
        radius=np.concatenate([np.zeros(0), *radius]),
        part=tuple(model.body(b).name.rpartition("/")[2] for b in owner),
        against_self=np.zeros((0, 2), np.int32),
    )
    pairs = _meeting_pairs(chain, spheres, _may_collide(model, np.array(owner, int)))
    return spheres._replace(against_self=pairs)


def spheres_as_arrays(spheres: ArmSpheres) -> dict[str, np.ndarray]:
    """Arrays by name, for a file; `spheres_from_arrays` reads them."""
    return {**spheres._asdict(), "part": np.array(spheres.part, np.str_)}


def spheres_from_arrays(arrays: Mapping[str, np.ndarray]) -> ArmSpheres:
    """Give the spheres that became arrays.

    Raises:
        KeyError: One is missing.
    """
    found = {name: np.asarray(arrays[name]) for name in ArmSpheres._fields if name != "part"}
    return ArmSpheres(**found, part=tuple(arrays["part"].tolist()))


def place_spheres(
    chain: Chain, spheres: ArmSpheres, q: Float[np.ndarray, "*b A"]
) -> Float[np.ndarray, "*b K 3"]:
    """Centres of the spheres in the world [m] at joint angles [rad]."""
    pos, rot = chain_frames(chain, q)
    fixed = spheres.joint < 0
    joint = np.where(fixed, 0, spheres.joint)
    moving = pos[..., joint, :] + np.einsum("...kij,kj->...ki", rot[..., joint, :, :], spheres.pos)
    return np.where(fixed[:, None], spheres.pos, moving)


def shape_spheres(shapes: list[Shape]) -> tuple[FloatArray, FloatArray]:
    """Spheres for the collision geometry of one body: centres (k, 3) and radii (k,) [m]."""
    found = [(np.zeros((0, 3)), np.zeros(0))]
    covered = [shape for shape in shapes if shape.kind in ("mesh", "box")]
    for shape in shapes:
        if shape.kind == "sphere":
            found.append((shape.pos[None], shape.size[:1]))
        elif shape.kind in ("capsule", "cylinder"):
            found.append(_string(shape))
    if covered:
        found.append(_COVERS.get(_key(covered), lambda: _covered(covered)))
    return np.concatenate([c for c, _ in found]), np.concatenate([r for _, r in found])


def _covered(shapes: list[Shape]) -> tuple[FloatArray, FloatArray]:
    """The cover of meshes and boxes."""
    return cover(shapes, np.zeros((0, 3)), np.zeros(0), _MESH)


_COVERS = KeyedCache[tuple[FloatArray, FloatArray]](64)
"""Both arms of a rig are the same model as a rule."""


def _key(shapes: list[Shape]) -> bytes:
    told = hashlib.sha256()
    for shape in shapes:
        told.update(shape.kind.encode())
        for values in (shape.size, shape.pos, shape.R, shape.vertices, shape.faces):
            told.update(np.ascontiguousarray(values).tobytes())
    return told.digest()


def _string(shape: Shape) -> tuple[FloatArray, FloatArray]:
    radius, half = float(shape.size[0]), float(shape.size[1])
    if shape.kind == "cylinder":
        # The rim of a flat end is covered by a sphere half a radius inside of it.
        half = max(half - 0.5 * radius, 0.0)
    count = int(np.ceil(2 * half / (_STEP * radius))) + 1
    z = np.linspace(-half, half, count) if count > 1 else np.zeros(1)
    centres = shape.pos + z[:, None] * shape.R[:, 2]
    return centres, np.full(count, _SWELL * radius)


def _carriers(model: mujoco.MjModel, chain: Chain) -> tuple[dict[int, int], dict[int, FloatArray]]:
    """For each body the last joint of the chain that moves it, and its pose in that joint's frame.

    Poses of bodies that stand still are in the world. Bodies behind other joints are left out.
    """
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    pos, rot = chain_frames(chain, np.zeros(chain.joints))
    number = {name: k for k, name in enumerate(chain.joint_names)}
    last, placed = {0: -1}, {0: np.eye(4)}
    for body in range(1, model.nbody):
        parent = int(model.body_parentid[body])
        if parent not in last:
            continue
        mine = last[parent]
        if model.body_jntnum[body]:
            name = model.joint(int(model.body_jntadr[body])).name.rpartition("/")[2]
            if name not in number:
                continue
            mine = number[name]
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
        if mine >= 0:
            base = np.eye(4)
            base[:3, :3], base[:3, 3] = rot[mine], pos[mine]
            T = np.linalg.inv(base) @ T
        last[body], placed[body] = mine, T
    return last, placed


def _may_collide(model: mujoco.MjModel, owner: np.ndarray) -> np.ndarray:
    """Pairs of spheres whose bodies the simulation lets collide, (K, K) bool.

    MuJoCo leaves out bodies that are welded together, parent and child unless the parent stands
    still, and excluded pairs.
    """
    weld = model.body_weldid[owner]
    allowed = weld[:, None] != weld
    parent = model.body_weldid[model.body_parentid[weld]]
    child_of = (parent[:, None] == weld) & (weld != 0)
    allowed &= ~(child_of | child_of.T)
    # An excluded pair is packed as (body1 << 16) + body2.
    for signature in model.exclude_signature:
        a, b = int(signature) >> 16, int(signature) & 0xFFFF
        pair = (owner[:, None] == a) & (owner == b)
        allowed &= ~(pair | pair.T)
    return allowed


def _meeting_pairs(
    chain: Chain, spheres: ArmSpheres, allowed: np.ndarray
) -> Int[np.ndarray, "P 2"]:
    a, b = np.triu_indices(len(spheres.radius), k=1)
    keep = allowed[a, b] & (spheres.joint[a] != spheres.joint[b])
    a, b = a[keep], b[keep]
    share = np.random.default_rng(0).random((POSTURES, chain.joints))
    # Folded arms, with many joints at a limit, are where links meet.
    share[::2] = np.clip(3 * share[::2] - 1, 0, 1)
    q = chain.lower + share * (chain.upper - chain.lower)
    met, near = np.zeros(len(a)), np.zeros(len(a), bool)
    for block in np.array_split(q, 20):
        centre = place_spheres(chain, spheres, block)
        apart = np.linalg.norm(centre[:, a] - centre[:, b], axis=-1)
        gap = apart - spheres.radius[a] - spheres.radius[b]
        met += (gap < 0).sum(axis=0)
        near |= (gap < _NEAR).any(axis=0)
    some = near & (met < ALWAYS * POSTURES)
    return np.stack([a[some], b[some]], axis=1).astype(np.int32)
