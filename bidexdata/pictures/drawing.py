"""From the record to triangles: an object at a size, posed hands, contacts with normals.

World frame, metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bidexdata.frames import matrix_from_quat
from bidexdata.hands.kinematics import forward_kinematics
from bidexdata.hands.model import Hand
from bidexdata.objects.prepared import Solid
from bidexdata.pictures.posing import has_pose, poses_at
from bidexdata.pictures.scene import Colour, Part, Vector, arrow, disc, mesh_part, moved, sphere
from bidexdata.record import GraspBatch

Surface = Literal["mesh", "pieces"]

OBJECT_COLOUR: Colour = (0.93, 0.78, 0.50)
HAND_COLOURS: dict[str, Colour] = {"left": (0.25, 0.50, 0.85), "right": (0.30, 0.68, 0.45)}
HAND_COLOUR_NAMES = {"left": "blue", "right": "green"}
CONTACT_COLOUR: Colour = (0.85, 0.12, 0.16)
GROUND_COLOUR: Colour = (0.80, 0.80, 0.79)

CONTACT_RADIUS = 0.005
"""Radius of the ball that marks a contact point [m]."""
NORMAL_LENGTH = 0.03
"""Length of the arrow along an outward contact normal [m]."""
FORCE_LENGTH = 0.06
"""Length of the arrow of a contact force of one cap [m]."""


def grasp_parts(
    batch: GraspBatch,
    row: int,
    solid: Solid,
    hands: Sequence[Hand],
    *,
    stage: str | int | float = "grasp",
    surface: Surface = "mesh",
    contacts: bool = True,
) -> list[Part]:
    """Everything that a picture of one grasp shows.

    Args:
        batch: Rows with identity and pose columns; contact columns are shown where present.
        row: Which row.
        solid: Its object, at unit diagonal.
        hands: In the order of the batch's H axis.
        stage: Name of a stage, or a moment between 0 and 2.
        surface: The object's display mesh, or its convex pieces, each in its own colour.
        contacts: Mark contact points and outward normals.

    Returns:
        Parts labelled `object`, `left`, `right`, `contact`, `ground`. A row without a pose gives
        the object alone.
    """
    pos, quat = batch["object_pos"][row], batch["object_quat_wxyz"][row]
    size = float(batch["size"][row])
    parts = solid_parts(solid, size, pos, quat, surface=surface)
    if has_pose(batch, row):
        poses = poses_at(batch, row, stage)
        for h, hand in enumerate(hands):
            parts.append(hand_part(hand, poses.pos[h], poses.quat_wxyz[h], poses.joints[h]))
        if contacts:
            parts += contact_parts(batch, row)
    if str(batch["setting"][row]) == "tabletop":
        parts.append(table_part(size, (float(pos[0]), float(pos[1]))))
    return parts


def solid_parts(
    solid: Solid,
    size: float,
    pos: Vector = (0.0, 0.0, 0.0),
    quat_wxyz: Vector = (1.0, 0.0, 0.0, 0.0),
    *,
    surface: Surface = "mesh",
) -> list[Part]:
    """Draw an object with bounding-box diagonal `size` [m] at a pose in the world."""
    R, p = matrix_from_quat(np.asarray(quat_wxyz)), np.asarray(pos, np.float64)
    shapes = _pieces(solid) if surface == "pieces" else (_mesh(solid),)
    return [moved(s._replace(vertices=s.vertices * size), R, p) for s in shapes]


def hand_part(hand: Hand, pos: Vector, quat_wxyz: Vector, joints: NDArray[Any]) -> Part:
    """Draw a hand whose frame is at a pose in the world [m, rad], in its side's colour."""
    angles = np.asarray(joints, np.float64)[: len(hand.joint_names)]
    whole = bodies_part(hand, *forward_kinematics(hand, angles))
    return moved(whole, matrix_from_quat(np.asarray(quat_wxyz)), pos)


def bodies_part(hand: Hand, body_pos: NDArray[Any], body_rot: NDArray[Any]) -> Part:
    """Draw a hand whose bodies are at given places.

    Args:
        hand: The hand.
        body_pos: Origins of its bodies in its order [m], (B, 3).
        body_rot: Their rotations, (B, 3, 3).
    """
    placed = [moved(shape, body_rot[b], body_pos[b]) for b, shape in body_shapes(hand)]
    return joined(placed, HAND_COLOURS[hand.side], hand.side)


def table_part(size: float, centre: tuple[float, float] = (0.0, 0.0)) -> Part:
    """Draw the table z = 0 under an object of a size, round a place on it [m]."""
    return disc((*centre, 0.0), 1.5 * size, GROUND_COLOUR)


@lru_cache(maxsize=8)
def body_shapes(hand: Hand) -> tuple[tuple[int, Part], ...]:
    """Visual shapes of a hand with the number of the body that carries each, in body frames."""
    from bidexdata.hands.meshes import visual_meshes

    colour = HAND_COLOURS[hand.side]
    return tuple(
        (m.body, mesh_part(m.mesh.vertices, m.mesh.faces, colour, hand.side))
        for m in visual_meshes(hand)
    )


def contact_parts(batch: GraspBatch, row: int) -> list[Part]:
    """Mark the stored contact points with balls and the outward normals with arrows."""
    points, normals = contacts_in_world(batch, row)
    parts: list[Part] = []
    for point, normal in zip(points, normals, strict=True):
        parts.append(sphere(point, CONTACT_RADIUS, CONTACT_COLOUR, "contact"))
        shaft = arrow(point, point + NORMAL_LENGTH * normal, 0.0012, CONTACT_COLOUR, "contact")
        parts += [shaft] if shaft else []
    return parts


def contacts_in_world(
    batch: GraspBatch, row: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Contact points [m] and outward unit normals of one grasp in the world frame, (n, 3) each."""
    if "contact_point" not in batch or "contact_normal" not in batch:
        return np.zeros((0, 3)), np.zeros((0, 3))
    point = np.asarray(batch["contact_point"][row], np.float64).reshape(-1, 3)
    normal = np.asarray(batch["contact_normal"][row], np.float64).reshape(-1, 3)
    known = np.isfinite(point).all(axis=1) & np.isfinite(normal).all(axis=1)
    R = matrix_from_quat(batch["object_quat_wxyz"][row])
    return point[known] @ R.T + batch["object_pos"][row], normal[known] @ R.T


def forces_in_world(batch: GraspBatch, row: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Contact points [m] and forces on the object [cap] of one grasp in the world, (n, 3) each."""
    if "contact_point" not in batch or "contact_force" not in batch:
        return np.zeros((0, 3)), np.zeros((0, 3))
    point = np.asarray(batch["contact_point"][row], np.float64).reshape(-1, 3)
    force = np.asarray(batch["contact_force"][row], np.float64).reshape(-1, 3)
    known = np.isfinite(point).all(axis=1) & np.isfinite(force).all(axis=1)
    R = matrix_from_quat(batch["object_quat_wxyz"][row])
    return point[known] @ R.T + batch["object_pos"][row], force[known] @ R.T


def joined(parts: Sequence[Part], colour: Colour, label: str) -> Part:
    """One part of several; they keep their shading normals and lose their own colours."""
    if not parts:
        return mesh_part(np.zeros((0, 3)), np.zeros((0, 3), np.int32), colour, label)
    offsets = np.cumsum([0, *(len(p.vertices) for p in parts)])
    return Part(
        np.concatenate([p.vertices for p in parts]),
        np.concatenate([p.corner_normals for p in parts]),
        np.concatenate([p.faces + o for p, o in zip(parts, offsets, strict=False)]).astype(
            np.int32
        ),
        colour,
        label,
    )


def piece_colour(number: int) -> Colour:
    """A colour for a convex piece; neighbours in number are far apart in hue."""
    import colorsys

    hue = (0.08 + number * 0.618034) % 1.0
    return colorsys.hsv_to_rgb(hue, 0.45, 0.90 - 0.12 * (number % 3 == 1))


@lru_cache(maxsize=4)
def _mesh(solid: Solid) -> Part:
    return mesh_part(solid.mesh.vertices, solid.mesh.faces, OBJECT_COLOUR, "object")


@lru_cache(maxsize=4)
def _pieces(solid: Solid) -> tuple[Part, ...]:
    return tuple(
        mesh_part(piece.vertices, piece.faces, piece_colour(k), "object", smooth=False)
        for k, piece in enumerate(solid.pieces)
    )
