"""The other side of a hand: the mirror image of what the spec says of the side it is written for.

A spec gives contact points, palm frame, postures and spheres once. They are reflected in the hand
frame, or from palm frame to palm frame where the models of the two sides have different hand frames,
and handed to the bodies and joints of the other side's own model. Where a body's collision geometry
is not the mirror image of its twin's, its spheres are fitted to what it has; where a joint turns the
other way, its angles have the other sign.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from bidexdata.errors import BadConfig
from bidexdata.frames import apply, invert
from bidexdata.hands.geometry import Shape, body_shapes, depth, surface_samples
from bidexdata.hands.kinematics import forward_kinematics
from bidexdata.hands.model import FloatArray, Hand, IntArray
from bidexdata.hands.pairs import self_pairs
from bidexdata.hands.spec import HandSpec, PalmFrameSpec
from bidexdata.hands.spheres import fit_spheres

if TYPE_CHECKING:
    import mujoco

    from bidexdata.hands.model import Side

SAME_SHAPE = 0.001
"""Collision geometry that is nowhere farther than this from its twin's mirror image has its twin's
spheres [m]. Ours: below the margin that spheres keep from an object and the protrusion of the fit."""
_FLIP = np.diag([1.0, -1.0, 1.0, 1.0])
"""Between a palm frame and its mirror image: y -> -y."""
_SAMPLES = 0.01
"""Largest edge of the triangles whose centres are compared [m]."""


class NoMirrorImage(BadConfig):
    """The model of the other side cannot take what the spec says of the written one."""


def mirror_image(spec: HandSpec) -> FloatArray:
    """Map points of the written side's hand frame to their images in the other side's, (4, 4)."""
    own = next((s.palm_frame for s in spec.sides.values() if s.palm_frame is not None), None)
    if own is None:
        image = np.eye(4)
        axis = "xyz".index(spec.mirror or "x")
        image[axis, axis] = -1.0
        return image
    return palm_frame(own) @ _FLIP @ invert(palm_frame(spec.palm_frame))


def palm_frame(frame: PalmFrameSpec) -> FloatArray:
    """Palm frame in the hand frame, as a spec gives it, (4, 4)."""
    x, z = np.array(frame.x), np.array(frame.z)
    T = np.eye(4)
    T[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    T[:3, 3] = frame.pos
    return T


def palm_frame_of(spec: HandSpec, side: Side) -> FloatArray:
    """Palm frame in the hand frame of one side, (4, 4)."""
    own = spec.sides[side].palm_frame
    if side == spec.written_for or own is not None:
        return palm_frame(own or spec.palm_frame)
    return mirror_image(spec) @ palm_frame(spec.palm_frame) @ _FLIP


def twin_bodies(spec: HandSpec, written: Hand, other: Hand) -> IntArray:
    """Index in `other` of each of the written side's bodies, by name behind the prefix, (B,).

    Raises:
        NoMirrorImage: The models have different bodies.
    """
    theirs, mine = spec.side(written.side).prefix, spec.side(other.side).prefix
    return _twins(written.body_names, other.body_names, (theirs, mine), f"the {other.side} side")


def twin_joints(spec: HandSpec, written: Hand, other: Hand) -> tuple[IntArray, FloatArray]:
    """Find the joint of `other` that each of the written side's has as its twin.

    Returns:
        Its index in `other`, (J,), and the factor of its angle: 1, or -1 where it turns the other
        way, (J,). A reflection M turns a rotation about a into one by the same angle about -M a.

    Raises:
        NoMirrorImage: The models have different joints.
    """
    theirs, mine = spec.side(written.side).prefix, spec.side(other.side).prefix
    where = f"the {other.side} side"
    twin = _twins(written.joint_names, other.joint_names, (theirs, mine), where)
    image = -_axes(written) @ mirror_image(spec)[:3, :3].T
    along = np.sum(_axes(other)[twin] * image, axis=1)
    return twin, np.where(along < 0, -1.0, 1.0)


def twin_transforms(spec: HandSpec, written: Hand, other: Hand) -> FloatArray:
    """Map points of each written body's frame to their images in its twin's frame, (B, 4, 4).

    The way leads over the hand frames at zero angles, so it does not matter how the two models
    orient the frames of their bodies.
    """
    twin = twin_bodies(spec, written, other)
    return invert(_zero_poses(other))[twin] @ mirror_image(spec) @ _zero_poses(written)


def mirrored(
    spec: HandSpec,
    written: Hand,
    bare: Hand,
    models: tuple[mujoco.MjModel, mujoco.MjModel],
) -> Hand:
    """Fill `bare` with the mirror image of the written side's contacts and spheres.

    Args:
        spec: The hand.
        written: The side that the spec is written for, complete.
        bare: The other side, without contacts and spheres.
        models: Compiled models of the written and of the other side.

    Raises:
        NoMirrorImage: The models differ in their names, or the postures do not fit the other one.
    """
    twin, T = twin_bodies(spec, written, bare), twin_transforms(spec, written, bare)
    joint, factor = twin_joints(spec, written, bare)
    order = np.argsort(joint)
    free = [n.removeprefix(bare.prefix) not in spec.coupled for n in bare.joint_names]
    contact, sphere = T[written.contact_body], T[written.sphere_body]
    hand = replace(
        bare,
        contact_names=written.contact_names,
        contact_body=twin[written.contact_body],
        contact_pos=_moved(contact, written.contact_pos),
        contact_radius=written.contact_radius,
        contact_normal=np.einsum("cij,cj->ci", contact[:, :3, :3], written.contact_normal),
        contact_finger=written.contact_finger,
        contact_part=written.contact_part,
        sphere_body=twin[written.sphere_body],
        sphere_pos=_moved(sphere, written.sphere_pos),
        sphere_radius=written.sphere_radius,
        self_pairs=written.self_pairs,
        posture_open=(factor * written.posture_open)[order],
        posture_curved=(factor * written.posture_curved)[order],
        coupling=bare.coupling * factor[order][:, None] * factor[order][free],
    )
    _require_within(hand)
    theirs, mine = body_shapes(models[0]), body_shapes(models[1])
    off = [shape_difference(theirs[b], mine[twin[b]], T[b]) for b in range(len(twin))]
    differ = twin[np.array(off) > SAME_SHAPE]
    return _refitted(spec, hand, models[1], differ) if len(differ) else hand


def shape_difference(theirs: list[Shape], mine: list[Shape], T: FloatArray) -> float:
    """How far the surface of one body's shapes is from the image of another's [m].

    Args:
        theirs: Shapes of the one.
        mine: Shapes of the other.
        T: From the frame of the one to that of the other, a reflection, (4, 4).
    """
    if not theirs or not mine:
        return 0.0 if bool(theirs) == bool(mine) else np.inf
    there = depth(mine, apply(T, surface_samples(theirs, _SAMPLES)[0]))
    back = depth(theirs, apply(invert(T), surface_samples(mine, _SAMPLES)[0]))
    return float(max(np.abs(there).max(initial=0.0), np.abs(back).max(initial=0.0)))


def _refitted(spec: HandSpec, hand: Hand, model: mujoco.MjModel, bodies: IntArray) -> Hand:
    """Give some bodies spheres that are fitted to their own geometry, behind all others."""
    own = fit_spheres(hand, model, spec.spheres)
    tips = hand.fingertips
    kept = ~np.isin(hand.sphere_body, bodies)
    kept[:tips] = True
    new = np.isin(own.body, bodies)
    new[:tips] = False
    hand = replace(
        hand,
        sphere_body=np.concatenate([hand.sphere_body[kept], own.body[new]]),
        sphere_pos=np.concatenate([hand.sphere_pos[kept], own.pos[new]]),
        sphere_radius=np.concatenate([hand.sphere_radius[kept], own.radius[new]]),
    )
    return replace(hand, self_pairs=self_pairs(hand, model))


def _require_within(hand: Hand) -> None:
    """Refuse mirrored postures that are beyond the other side's own limits."""
    for posture, name in ((hand.posture_open, "open"), (hand.posture_curved, "curved")):
        beyond = np.flatnonzero((posture < hand.joint_lower) | (posture > hand.joint_upper))
        if len(beyond):
            j = beyond[0]
            raise NoMirrorImage(
                f"posture {name}: {hand.joint_names[j]} = {posture[j]:g}, mirrored for the "
                f"{hand.side} side, lies outside its limits [{hand.joint_lower[j]:g}, "
                f"{hand.joint_upper[j]:g}] rad; check `mirror`, or choose an angle that both have"
            )


def _twins(
    written: tuple[str, ...], other: tuple[str, ...], prefixes: tuple[str, str], where: str
) -> IntArray:
    """Index in `other` of the names of `written` with the other prefix, (n,)."""
    names = [prefixes[1] + name.removeprefix(prefixes[0]) for name in written]
    if set(names) != set(other):
        lacks, extra = set(names) - set(other), set(other) - set(names)
        said = [f"lacks {', '.join(sorted(lacks))}"] if lacks else []
        said += [f"has {', '.join(sorted(extra))} besides"] if extra else []
        raise NoMirrorImage(f"{where} {' and '.join(said)}; both sides need the same names")
    return np.array([other.index(name) for name in names], np.int32)


def _axes(hand: Hand) -> FloatArray:
    """Axes of the joints in the hand frame at zero angles, (J, 3)."""
    _, rot = forward_kinematics(hand, np.zeros(len(hand.joint_names)))
    mover = [int(np.flatnonzero(hand.body_joint == j)[0]) for j in range(len(hand.joint_names))]
    return np.einsum("jik,jk->ji", rot[mover], hand.joint_axis)


def _zero_poses(hand: Hand) -> FloatArray:
    pos, rot = forward_kinematics(hand, np.zeros(len(hand.joint_names)))
    T = np.tile(np.eye(4), (len(hand.body_names), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = rot, pos
    return T


def _moved(T: FloatArray, points: FloatArray) -> FloatArray:
    return np.einsum("kij,kj->ki", T[:, :3, :3], points) + T[:, :3, 3]
