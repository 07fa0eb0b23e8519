"""From a spec and a model to a complete `Hand`.

Contact points and spheres are made for the side that the spec is written for; the other side gets
their mirror image (mirror.py), so a mirrored problem has the mirrored solution.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from bidexdata.errors import BadConfig
from bidexdata.hands.mirror import mirrored, palm_frame_of
from bidexdata.hands.model import FloatArray, Hand, Side
from bidexdata.hands.pairs import self_pairs
from bidexdata.hands.source import HandMjcf, load_model, mounted_spec
from bidexdata.hands.spec import HandSpec
from bidexdata.hands.spheres import fit_spheres
from bidexdata.hands.tree import HandTree, coupling_matrix, read_tree


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
    hand = _with_pads(spec, _bare_hand(spec, spec.written_for, mjcf, read_tree(model), folder))
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
    model = mjcf.make_spec().compile()
    bare = _bare_hand(spec, side, mjcf, read_tree(model), folder)
    return mirrored(spec, written, bare, (written.make_spec().compile(), model))


def drawn_hand(spec: HandSpec, side: Side, folder: Path) -> Hand:
    """Make one side as far as it is drawn: kinematics and shapes, no contact points, no spheres.

    Raises:
        NotUsable: The model cannot be had, or does not fit the spec.
    """
    mjcf = load_model(spec, side, folder)
    return _bare_hand(spec, side, mjcf, read_tree(mjcf.make_spec().compile()), folder)


def _bare_hand(spec: HandSpec, side: Side, mjcf: HandMjcf, tree: HandTree, folder: Path) -> Hand:
    """Everything that the model and the spec's names give: no contacts, no spheres, all at zero."""
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
        contact_part=(),
        fingers={f: tuple(prefix + b for b in names) for f, names in spec.fingers.items()},
        sphere_body=none,
        sphere_pos=few,
        sphere_radius=np.zeros(0),
        self_pairs=np.zeros((0, 2), np.int32),
        T_hand_palm=palm_frame_of(spec, side),
        posture_open=np.zeros(len(tree.joint_names)),
        posture_curved=np.zeros(len(tree.joint_names)),
        make_spec=mjcf.make_spec,
        licence_text=mjcf.licence_text,
        prefix=prefix,
        make_mounted=partial(mounted_spec, spec, side, folder),
    )


def _with_pads(spec: HandSpec, hand: Hand) -> Hand:
    """Add the contact points and the postures."""
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
        contact_part=tuple(c.part for c in spec.contacts),
        posture_open=_posture(spec.postures.open, hand, "open"),
        posture_curved=_posture(spec.postures.curved, hand, "curved"),
    )


def _posture(angles: Mapping[str, float], hand: Hand, name: str) -> FloatArray:
    posture = np.zeros(len(hand.joint_names))
    for joint, angle in angles.items():
        posture[_index(hand.joint_names, hand.prefix + joint, f"posture {name}")] = angle
    for joint, angle, low, high in zip(
        hand.joint_names, posture, hand.joint_lower, hand.joint_upper, strict=True
    ):
        if not low <= angle <= high:
            given = "" if joint.removeprefix(hand.prefix) in angles else " (not named, so zero)"
            raise BadConfig(
                f"posture {name}: {joint.removeprefix(hand.prefix)} = {angle:g}{given} lies outside "
                f"its limits [{low:g}, {high:g}] rad"
            )
    return posture


def _index(names: tuple[str, ...], name: str, where: str) -> int:
    if name not in names:
        raise BadConfig(f"{where} names {name!r}, which the model lacks; it has {', '.join(names)}")
    return names.index(name)
