"""From a spec and a model to a complete `Hand`.

Contact points and spheres are made for the side that the spec is written for; the other side gets
their mirror image (x -> -x of the hand frame), so a mirrored problem has the mirrored solution.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from bidexdata.errors import BadConfig
from bidexdata.frames import invert
from bidexdata.hands.kinematics import forward_kinematics
from bidexdata.hands.model import FloatArray, Hand, IntArray, Side
from bidexdata.hands.pairs import self_pairs
from bidexdata.hands.source import HandMjcf, load_model
from bidexdata.hands.spec import HandSpec
from bidexdata.hands.spheres import fit_spheres
from bidexdata.hands.tree import HandTree, coupling_matrix, read_tree

_MIRROR = np.diag([-1.0, 1.0, 1.0])


def written_hand(spec: HandSpec, folder: Path) -> Hand:
    """Make the side that the spec is written for.

    Args:
        spec: The hand.
        folder: Folder of the YAML spec; relative sources start here.

    Raises:
        NotUsable: The model cannot be had, or does not fit the spec.
    """
    mjcf = load_model(spec, spec.written_for, folder)
    model = mjcf.make_spec().compile()
    hand = _with_pads(spec, _bare_hand(spec, spec.written_for, mjcf, read_tree(model)))
    spheres = fit_spheres(hand, model, spec.spheres)
    hand = replace(
        hand, sphere_body=spheres.body, sphere_pos=spheres.pos, sphere_radius=spheres.radius
    )
    return replace(hand, self_pairs=self_pairs(hand, model))


def mirrored_hand(spec: HandSpec, written: Hand, folder: Path) -> Hand:
    """Make the other side: its own model, the mirror image of everything else.

    Raises:
        NotUsable: The model cannot be had, or does not fit the spec.
    """
    side: Side = "left" if written.side == "right" else "right"
    mjcf = load_model(spec, side, folder)
    return _mirrored(
        spec, written, _bare_hand(spec, side, mjcf, read_tree(mjcf.make_spec().compile()))
    )


def _bare_hand(spec: HandSpec, side: Side, mjcf: HandMjcf, tree: HandTree) -> Hand:
    """Everything that the model and the spec's names give: contacts and spheres are empty."""
    prefix = spec.side(side).prefix
    for finger, bodies in spec.fingers.items():
        for body in bodies:
            _index(tree.body_names, prefix + body, f"finger {finger}")
    none, few = np.zeros(0, np.int32), np.zeros((0, 3))
    return Hand(
        name=spec.name,
        side=side,
        spec_hash=hashlib.sha256(f"{spec.content_hash()}{mjcf.digest}{side}".encode()).hexdigest(),
        licence=spec.licence,
        **tree._asdict(),
        coupling=coupling_matrix(
            tree.joint_names, {prefix + a: prefix + b for a, b in spec.coupled.items()}
        ),
        contact_names=(),
        contact_body=none,
        contact_pos=few,
        contact_radius=np.zeros(0),
        contact_normal=few,
        contact_finger=(),
        fingers={f: tuple(prefix + b for b in names) for f, names in spec.fingers.items()},
        sphere_body=none,
        sphere_pos=few,
        sphere_radius=np.zeros(0),
        self_pairs=np.zeros((0, 2), np.int32),
        T_hand_palm=_palm_frame(spec, side),
        posture_open=_posture(spec.postures.open, tree, prefix, "open"),
        posture_curved=_posture(spec.postures.curved, tree, prefix, "curved"),
        make_spec=mjcf.make_spec,
        licence_text=mjcf.licence_text,
    )


def _with_pads(spec: HandSpec, hand: Hand) -> Hand:
    prefix = spec.side(hand.side).prefix
    body = [_index(hand.body_names, prefix + c.body, f"contact {c.name}") for c in spec.contacts]
    normal = np.array([c.normal for c in spec.contacts]).reshape(-1, 3)
    return replace(
        hand,
        contact_names=tuple(c.name for c in spec.contacts),
        contact_body=np.array(body, np.int32),
        contact_pos=np.array([c.pos for c in spec.contacts]).reshape(-1, 3),
        contact_radius=np.array([c.radius for c in spec.contacts]),
        contact_normal=normal / np.linalg.norm(normal, axis=1, keepdims=True),
        contact_finger=tuple(c.finger for c in spec.contacts),
    )


def _mirrored(spec: HandSpec, written: Hand, bare: Hand) -> Hand:
    """Fill `bare` with the mirror image of the written side's contacts and spheres."""
    twin = _twins(spec, written, bare)
    mirror = np.eye(4)
    mirror[:3, :3] = _MIRROR
    # From a body's frame over the hand frame at zero angles, reflected, to its twin's frame: it
    # does not matter how the two models orient their body frames.
    T = invert(_zero_poses(bare))[twin] @ mirror @ _zero_poses(written)
    contact, sphere = T[written.contact_body], T[written.sphere_body]
    return replace(
        bare,
        contact_names=written.contact_names,
        contact_body=twin[written.contact_body],
        contact_pos=_moved(contact, written.contact_pos),
        contact_radius=written.contact_radius,
        contact_normal=np.einsum("cij,cj->ci", contact[:, :3, :3], written.contact_normal),
        contact_finger=written.contact_finger,
        sphere_body=twin[written.sphere_body],
        sphere_pos=_moved(sphere, written.sphere_pos),
        sphere_radius=written.sphere_radius,
        self_pairs=written.self_pairs,
    )


def _twins(spec: HandSpec, written: Hand, bare: Hand) -> IntArray:
    """Index in `bare` of each of the written side's bodies, by name behind the prefix, (B,)."""
    theirs, mine = spec.side(written.side).prefix, spec.side(bare.side).prefix
    names = [mine + name.removeprefix(theirs) for name in written.body_names]
    return np.array([_index(bare.body_names, n, f"the {bare.side} side") for n in names], np.int32)


def _zero_poses(hand: Hand) -> FloatArray:
    pos, rot = forward_kinematics(hand, np.zeros(len(hand.joint_names)))
    T = np.tile(np.eye(4), (len(hand.body_names), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = rot, pos
    return T


def _moved(T: FloatArray, points: FloatArray) -> FloatArray:
    return np.einsum("kij,kj->ki", T[:, :3, :3], points) + T[:, :3, 3]


def _palm_frame(spec: HandSpec, side: Side) -> FloatArray:
    frame = spec.palm_frame
    x, z = np.array(frame.x), np.array(frame.z)
    T = np.eye(4)
    T[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    T[:3, 3] = frame.pos
    if side != spec.written_for:
        # x -> -x of the hand frame is y -> -y of the palm frame.
        T[:3, :3] = _MIRROR @ T[:3, :3] @ np.diag([1.0, -1.0, 1.0])
        T[:3, 3] = _MIRROR @ T[:3, 3]
    return T


def _posture(angles: Mapping[str, float], tree: HandTree, prefix: str, name: str) -> FloatArray:
    posture = np.zeros(len(tree.joint_names))
    for joint, angle in angles.items():
        index = _index(tree.joint_names, prefix + joint, f"posture {name}")
        low, high = tree.joint_lower[index], tree.joint_upper[index]
        if not low <= angle <= high:
            raise BadConfig(
                f"posture {name}: {joint} = {angle} lies outside its limits [{low:g}, {high:g}] rad"
            )
        posture[index] = angle
    return posture


def _index(names: tuple[str, ...], name: str, where: str) -> int:
    if name not in names:
        raise BadConfig(f"{where} names {name!r}, which the model lacks; it has {', '.join(names)}")
    return names.index(name)
