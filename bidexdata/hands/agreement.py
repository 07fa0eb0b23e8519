"""Do the two sides agree with each other, and the engines about one side?"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bidexdata.frames import apply, matrix_from_quat, random_quat
from bidexdata.hands.checks import depth_along
from bidexdata.hands.findings import Finding, worst
from bidexdata.hands.geometry import body_shapes
from bidexdata.hands.kinematics import forward_kinematics
from bidexdata.hands.mirror import (
    SAME_SHAPE,
    mirror_image,
    shape_difference,
    twin_bodies,
    twin_joints,
    twin_transforms,
)
from bidexdata.hands.model import FloatArray, Hand, IntArray

if TYPE_CHECKING:
    import mujoco

    from bidexdata.hands.spec import HandSpec

MIRRORED = 0.003
"""Largest way of a point of the other side from the mirror image at any angles [m]."""
PAD_SHAPE = 0.003
"""The same of the collision geometry of bodies with a contact point near it [m]."""
LIMITS = 0.05
"""Largest difference of twins' joint limits [rad]."""
ENGINES = 1e-5
"""Largest difference between the engines [m]: float32 at a metre resolves 1e-7."""
_POSTURES = 200


def check_mirror(
    spec: HandSpec, written: Hand, other: Hand, models: tuple[mujoco.MjModel, mujoco.MjModel]
) -> Finding:
    """The other side is the mirror image of the written one in its joints and pads.

    Limits and the geometry of bodies without a pad may differ; what does is said.

    Args:
        spec: The hand.
        written: The side that the spec is written for.
        other: The other one.
        models: Compiled models of both, in this order.
    """
    joint, factor = twin_joints(spec, written, other)
    faults = []
    ends = np.sort(factor[:, None] * np.stack([written.joint_lower, written.joint_upper], 1), 1)
    theirs = np.stack([other.joint_lower, other.joint_upper], 1)[joint]
    differing = np.flatnonzero(np.abs(ends - theirs).max(axis=1) > LIMITS)
    way, body = _largest_way(spec, written, other)
    key = f"sides.{other.side}.palm_frame" if spec.sides[other.side].palm_frame else "mirror"
    advice = f"check `{key}`, which says how the {other.side} side mirrors the {written.side}"
    if way > MIRRORED:
        faults.append(
            f"{body} strays {1e3 * way:.1f} mm from the mirror image as it moves; {advice}"
        )
    T, twin = twin_transforms(spec, written, other), twin_bodies(spec, written, other)
    shapes = body_shapes(models[0]), body_shapes(models[1])
    off = [shape_difference(shapes[0][b], shapes[1][twin[b]], T[b]) for b in range(len(twin))]
    for c, b in enumerate(written.contact_body):
        if _pad_difference(written, other, c, shapes) > PAD_SHAPE:
            faults.append(
                f"the pad of contact {written.contact_names[c]} on {other.body_names[twin[b]]} is not "
                f"the mirror image of its twin; {advice}"
            )
    own = [other.body_names[twin[b]] for b in np.flatnonzero(np.array(off) > SAME_SHAPE)]
    fine = f"{1e3 * way:.2f} mm apart at any angles"
    if own:
        fine += f"; collision geometry differs, so spheres of their own: {', '.join(own)}"
    if len(differing):
        names = ", ".join(other.joint_names[joint[j]] for j in differing)
        fine += f"; limits are no mirror images (no harm where the postures are in both): {names}"
    return worst("mirror", faults, fine)


def check_engines(hand: Hand, model: mujoco.MjModel) -> Finding:
    """Three engines place bodies, contact points and spheres alike.

    Ours (the Warp kernels that synthesis runs), MuJoCo and pytorch-kinematics.
    """
    rng = np.random.default_rng(0)
    joints = _postures(hand, rng)
    pos, quat = rng.uniform(-0.5, 0.5, (len(joints), 3)), random_quat(rng, (len(joints),))
    engines = {
        "mujoco": _by_mujoco(hand, model, joints, pos, quat),
        "warp": _by_warp(hand, joints, pos, quat),
        "pytorch-kinematics": _by_torch(hand, joints, pos, quat),
    }
    faults, largest = [], 0.0
    names = list(engines)
    for i, a in enumerate(names):
        for b in names[i + 1 :]:
            off = np.abs(engines[a] - engines[b]).max(axis=(0, 2))
            largest = max(largest, float(off.max()))
            if not off.max() <= ENGINES:
                which = hand.body_names[_points_of(hand)[0][np.argmax(off)]]
                faults.append(
                    f"{a} and {b} place {which} {1e3 * off.max():.3g} mm apart; this is a bug of "
                    "bidexdata or of an engine: report it with the spec and the model"
                )
    fine = f"mujoco, warp and pytorch-kinematics agree to {1e6 * largest:.2f} um"
    return worst("engines", [f"{hand.side}: {f}" for f in faults], f"{hand.side}: {fine}")


def _largest_way(spec: HandSpec, written: Hand, other: Hand) -> tuple[float, str]:
    """How far points on the bodies are from the mirror image at most [m], and on which body."""
    twin, T = twin_bodies(spec, written, other), twin_transforms(spec, written, other)
    joint, factor = twin_joints(spec, written, other)
    joints = _postures(written, np.random.default_rng(0))
    theirs = np.zeros((len(joints), len(other.joint_names)))
    theirs[:, joint] = factor * joints
    body, local = _points_of(written)
    expected = apply(mirror_image(spec), _placed(written, joints, body, local))
    image = np.stack([apply(T[b], point[None])[0] for b, point in zip(body, local, strict=True)])
    found = _placed(other, theirs, twin[body], image)
    way = np.linalg.norm(found - expected, axis=2).max(axis=0)
    at = int(np.argmax(way))
    return float(way[at]), other.body_names[twin[body[at]]]


def _pad_difference(written: Hand, other: Hand, contact: int, shapes: tuple[list, list]) -> float:
    """Difference of the two pads' surfaces where the contact normal leaves them [m]."""
    there, here = written.contact_body[contact], other.contact_body[contact]
    if not (shapes[0][there] and shapes[1][here]):
        return 0.0
    a = depth_along(shapes[0][there], written.contact_pos[contact], written.contact_normal[contact])
    b = depth_along(shapes[1][here], other.contact_pos[contact], other.contact_normal[contact])
    return abs(a - b)


def _postures(hand: Hand, rng: np.random.Generator) -> FloatArray:
    lower, upper = hand.joint_lower, hand.joint_upper
    random = rng.uniform(lower, upper, (_POSTURES, len(lower)))
    return np.concatenate([[lower, upper, hand.posture_open, hand.posture_curved], random])


def _points_of(hand: Hand) -> tuple[IntArray, FloatArray]:
    """Body numbers (P,) and places (P, 3) of bodies' origins, contact points and spheres."""
    origins = np.zeros((len(hand.body_names), 3))
    own = np.arange(len(origins), dtype=np.int32)
    body = np.concatenate([own, hand.contact_body, hand.sphere_body])
    return body, np.concatenate([origins, hand.contact_pos, hand.sphere_pos])


def _placed(hand: Hand, joints: FloatArray, body: IntArray, local: FloatArray) -> FloatArray:
    """Points of bodies in the hand frame [m], (n, P, 3)."""
    pos, rot = forward_kinematics(hand, joints)
    return pos[:, body] + np.einsum("npij,pj->npi", rot[:, body], local)


def _by_mujoco(
    hand: Hand, model: mujoco.MjModel, joints: FloatArray, pos: FloatArray, quat: FloatArray
) -> FloatArray:
    import mujoco

    data = mujoco.MjData(model)
    body, local = _points_of(hand)
    found = []
    for q in joints:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        rot = data.xmat[1:].reshape(-1, 3, 3)[body]
        found.append(data.xpos[1:][body] + np.einsum("pij,pj->pi", rot, local))
    return _based(np.array(found), pos, quat)


def _by_torch(hand: Hand, joints: FloatArray, pos: FloatArray, quat: FloatArray) -> FloatArray:
    import torch

    from bidexdata.hands.torch_layer import HandModel

    pose = HandModel(hand)(*(torch.as_tensor(x, dtype=torch.float64) for x in (pos, quat, joints)))
    return torch.cat([pose.body_pos, pose.contact_point, pose.sphere_pos], dim=1).numpy()


def _by_warp(hand: Hand, joints: FloatArray, pos: FloatArray, quat: FloatArray) -> FloatArray:
    from dataclasses import replace

    import warp as wp

    from bidexdata.hands.device import allocate, device_hand, forward

    # Every joint on its own, so that the angles of coupled joints are the same as elsewhere.
    dev = device_hand(replace(hand, coupling=np.eye(len(hand.joint_names))))
    state = allocate(dev, len(joints))
    rotation = matrix_from_quat(quat).astype(np.float32)
    forward(
        dev,
        state,
        wp.array(pos.astype(np.float32), dtype=wp.vec3),
        wp.array(rotation, dtype=wp.mat33, shape=(len(pos),)),
        wp.array(joints.astype(np.float32), dtype=float),
    )
    parts = [state.body_pos.numpy(), state.contact.numpy(), state.sphere.numpy()]
    return np.concatenate(parts, axis=1).astype(np.float64)


def _based(points: FloatArray, pos: FloatArray, quat: FloatArray) -> FloatArray:
    return points @ np.swapaxes(matrix_from_quat(quat), -1, -2) + pos[:, None]
