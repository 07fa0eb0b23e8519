"""The 3D part of a page: an object, posed hands and contacts as nodes of a viser scene.

A hand's bodies are sent to the browser once; a pose moves their frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bidexdata.frames import quat_from_matrix
from bidexdata.hands.kinematics import forward_kinematics
from bidexdata.pictures.drawing import (
    CONTACT_COLOUR,
    CONTACT_RADIUS,
    FORCE_LENGTH,
    HAND_COLOURS,
    NORMAL_LENGTH,
    Surface,
    body_shapes,
    contacts_in_world,
    forces_in_world,
    joined,
    solid_parts,
)
from bidexdata.pictures.posing import HandPoses
from bidexdata.pictures.scene import Colour, Part, Vector, sphere
from bidexdata.record import GraspBatch

if TYPE_CHECKING:
    import viser

    from bidexdata.hands.model import Hand
    from bidexdata.objects.prepared import Solid

FORCE_COLOUR: Colour = (0.95, 0.55, 0.10)


class HandNodes:
    """One hand in a scene."""

    def __init__(self, scene: viser.SceneApi, hand: Hand):
        self.hand = hand
        self.base = scene.add_frame(f"/{hand.side}", show_axes=False)
        self.bodies: dict[int, viser.FrameHandle] = {}
        for body, vertices, faces in body_meshes(hand):
            name = f"/{hand.side}/{hand.body_names[body]}"
            self.bodies[body] = scene.add_frame(name, show_axes=False)
            colour = _bytes(HAND_COLOURS[hand.side])
            scene.add_mesh_simple(f"{name}/mesh", vertices, faces, color=colour, side="double")

    def move(
        self, pos: NDArray[np.float64], quat: NDArray[np.float64], joints: NDArray[Any]
    ) -> None:
        """Pose the hand: its frame in the world [m], its joints [rad]."""
        body_pos, body_rot = forward_kinematics(self.hand, joints[: len(self.hand.joint_names)])
        self.base.position, self.base.wxyz = pos, quat
        quats = quat_from_matrix(body_rot)
        for body, frame in self.bodies.items():
            frame.position, frame.wxyz = body_pos[body], quats[body]

    def show(self, visible: bool) -> None:
        """Show or hide all of it."""
        self.base.visible = visible


class GraspNodes:
    """Everything that one page shows."""

    def __init__(self, scene: viser.SceneApi, hands: Sequence[Hand]):
        self._scene = scene
        self.hands = [HandNodes(scene, hand) for hand in hands]
        self.object: list[Any] = []
        self.contacts: list[Any] = []
        self.forces: list[Any] = []
        self.ground: Any = None
        self._shown: tuple[Any, ...] | None = None
        self._pos = np.zeros(3)
        self.marks = scene.add_frame("/marks", show_axes=False)  # carries contacts and forces
        scene.set_up_direction("+z")

    def show_object(
        self,
        solid: Solid,
        size: float,
        pos: Vector,
        quat_wxyz: Vector,
        surface: Surface,
    ) -> None:
        """Replace the object: at bounding-box diagonal `size` [m] and a pose in the world."""
        # Most steps go to another grasp of the same scene: the mesh is in the browser already.
        shown = (solid.object_id, size, tuple(pos), tuple(quat_wxyz), surface)
        if shown == self._shown:
            return
        self._shown, self._pos = shown, np.asarray(pos, np.float64)
        _remove(self.object)
        for number, part in enumerate(solid_parts(solid, size, surface=surface)):
            node = add_part(self._scene, f"/object/{number}", part)
            node.position, node.wxyz = self._pos, np.asarray(quat_wxyz, np.float64)
            self.object.append(node)

    def raise_object(self, by: NDArray[np.float64]) -> None:
        """Shift object and marks from where the scene has them, (3,) [m]."""
        for node in self.object:
            node.position = self._pos + by
        self.marks.position = by

    def show_scene(self, solid: Solid, batch: GraspBatch, row: int, surface: Surface) -> None:
        """Show the object of a row as its scene has it, and the table where there is one."""
        size = float(batch["size"][row])
        pos, quat = batch["object_pos"][row], batch["object_quat_wxyz"][row]
        self.show_object(solid, size, pos, quat, surface)
        self.show_ground(size if str(batch["setting"][row]) == "tabletop" else None)

    def show_ground(self, size: float | None) -> None:
        """Show the table's surface z = 0 as a grid for objects of `size` [m]; None hides it."""
        if self.ground is not None:
            self.ground.remove()
            self.ground = None
        if size is not None:
            extent = 4 * size
            self.ground = self._scene.add_grid(
                "/ground", width=extent, height=extent, cell_size=0.1, section_size=0.5
            )

    def show_contacts(self, batch: GraspBatch, row: int) -> None:
        """Replace contact points, normals and forces by those of a row."""
        self.clear_contacts()
        points, normals = contacts_in_world(batch, row)
        if len(points):
            ball = sphere((0, 0, 0), CONTACT_RADIUS, CONTACT_COLOUR, "contact")
            self.contacts = [
                self._scene.add_batched_meshes_simple(
                    "/marks/points",
                    ball.vertices.astype(np.float32),
                    ball.faces,
                    batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (len(points), 1)),
                    batched_positions=points,
                    batched_colors=_bytes(CONTACT_COLOUR),
                ),
                self._arrows("/marks/normals", points, NORMAL_LENGTH * normals, CONTACT_COLOUR),
            ]
        at, forces = forces_in_world(batch, row)
        if len(at):
            # Drawn from outside, its head at the contact point: how the finger pushes.
            shown = FORCE_LENGTH * forces
            self.forces = [self._arrows("/marks/forces", at - shown, shown, FORCE_COLOUR)]

    def clear_contacts(self) -> None:
        """Remove contacts and forces."""
        _remove(self.contacts)
        _remove(self.forces)

    def pose(self, poses: HandPoses | None) -> None:
        """Move the hands; None hides them."""
        for h, nodes in enumerate(self.hands):
            if poses is not None:
                nodes.move(poses.pos[h], poses.quat_wxyz[h], poses.joints[h])
            nodes.show(poses is not None)

    def set_visible(self, *, contacts: bool, forces: bool) -> None:
        """Show or hide what marks the contacts."""
        for node in self.contacts:
            node.visible = contacts
        for node in self.forces:
            node.visible = forces

    def _arrows(self, name: str, start: NDArray, along: NDArray, colour: Colour) -> Any:
        return self._scene.add_arrows(
            name,
            np.stack([start, start + along], axis=1),
            _bytes(colour),
            shaft_radius=0.0012,
            head_radius=0.003,
            head_length=0.008,
        )


@lru_cache(maxsize=8)
def body_meshes(hand: Hand) -> tuple[tuple[int, NDArray[np.float32], NDArray[np.int32]], ...]:
    """One mesh per body that has a shape, in the body's frame: number, vertices, faces."""
    shapes: dict[int, list[Part]] = {}
    for body, shape in body_shapes(hand):
        shapes.setdefault(body, []).append(shape)
    colour = HAND_COLOURS[hand.side]
    return tuple(
        (body, *split_at_creases(joined(parts, colour, hand.side)))
        for body, parts in shapes.items()
    )


def add_part(scene: viser.SceneApi, name: str, part: Part) -> Any:
    """Add a part as one mesh that looks smooth where it is smooth and keeps its edges."""
    vertices, faces = split_at_creases(part)
    return scene.add_mesh_simple(name, vertices, faces, color=_bytes(part.colour), side="double")


def split_at_creases(part: Part) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Give corners with different shading normals a vertex of their own.

    The browser computes one normal per vertex from the faces around it; this keeps edges sharp.

    Returns:
        Vertices (V, 3) and faces (F, 3).
    """
    corners = part.vertices[part.faces.ravel()]
    key = np.column_stack([corners.round(7), part.corner_normals.reshape(-1, 3).round(3)])
    _, first, which = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return corners[first].astype(np.float32), which.reshape(-1, 3).astype(np.int32)


def _remove(nodes: list[Any]) -> None:
    for node in nodes:
        node.remove()
    nodes.clear()


def _bytes(colour: Colour) -> tuple[int, int, int]:
    r, g, b = (round(255 * c) for c in colour)
    return r, g, b
