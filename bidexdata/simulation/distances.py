"""Signed distances between hands, fingers and object in one pose, from one collision pass.

MuJoCo lists a contact when its distance is below margin + gap and lets it push below margin
(4.0.0; 3.3.2 differs), so distances are read with margin 0 and gap equal to the reach asked for,
on the object's geoms only: pairs of hand geoms appear only where they overlap. The broad phase
reads a margin per body that is fixed when the model is compiled; it is set along, else some pairs
go missing (as in DexGraspBench: 4 of its 160 example grasps report a finger at the cap that is
0.9 to 8 mm nearer).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bidexdata.engine_log import engine_warnings_logged
from bidexdata.hands.model import Hand
from bidexdata.objects.prepared import Solid

from .scene import SimScene, build_scene
from .state import set_pose

FloatArray = NDArray[np.float64]
REACH = 0.01
"""Distances beyond this read as this [m] (DexGraspBench: contact margin)."""


class HandContacts(NamedTuple):
    """Pairs of hand geom and piece that are nearer than the reach; K of them, world frame."""

    hand: NDArray[np.intp]
    """Number of the hand, (K,)."""
    body: NDArray[np.intp]
    """Number of the body within its hand, (K,)."""
    dist: FloatArray
    """Signed distance [m], (K,)."""
    point: FloatArray
    """Middle between the two nearest points [m], (K, 3)."""
    normal_in: FloatArray
    """Unit normal into the object, (K, 3)."""


class Distances(NamedTuple):
    """Smallest signed distances in one pose [m]; negative = depth of an overlap."""

    hand_object: float
    """Over all hand geoms and pieces; at most the reach."""
    self_collision: float
    """Within each hand, at most 0."""
    inter_hand: float
    """Between hands, at most 0."""
    table: float
    """Between hands and table; 0 unless they overlap."""
    object_table: float
    """Between object and table; 0 unless they overlap."""
    fingers: FloatArray
    """Of each finger of all hands to the object, at most the reach, (F,)."""
    bodies: tuple[FloatArray, ...]
    """Of each body to the object, at most the reach, per hand (B,)."""
    contacts: HandContacts


class PregraspDepths(NamedTuple):
    """Deepest overlaps of N poses [m], zero or more; NaN where a pose is not finite."""

    hand_object: FloatArray
    """Hands and object, (N,)."""
    among_hands: FloatArray
    """Within a hand or between hands, (N,)."""
    table: FloatArray
    """Hands and table; 0 in a scene without one, (N,)."""


def measure_distances(
    scene: SimScene,
    object_pos: ArrayLike,
    object_quat: ArrayLike,
    hand_pos: ArrayLike,
    hand_quat: ArrayLike,
    joints: ArrayLike,
    *,
    reach: float = REACH,
    full_broad_phase: bool = True,
    last_body_counts: bool = True,
) -> Distances:
    """Measure one pose. The scene's state is overwritten.

    Args:
        scene: The scene.
        object_pos: As in `set_pose`, likewise the next four.
        object_quat: (4,).
        hand_pos: (H, 3).
        hand_quat: (H, 4).
        joints: (H, J).
        reach: Pairs farther apart than this are not looked for [m].
        full_broad_phase: Find all of the nearer ones; else those that a broad phase without
            margin leaves (`MetricRules.full_broad_phase`).
        last_body_counts: The last body of the left hand takes part in self and inter-hand depths.
    """
    set_pose(scene, object_pos, object_quat, hand_pos, hand_quat, joints)
    owners, geoms, dist, points, normals = list_contacts(
        scene, reach, full_broad_phase=full_broad_phase
    )
    of_object = scene.object_owner
    with_object = (owners[:, 0] >= 0) & (owners[:, 1] == of_object)
    among_hands = (owners[:, 0] >= 0) & (owners[:, 1] < of_object)
    if not last_body_counts and scene.hands:
        mine = next((i for i, h in enumerate(scene.hands) if h.side == "left"), 0)
        last = (mine, len(scene.hands[mine].body_names) - 1)
        is_last = (owners == last[0]) & (scene.geom_body[geoms] == last[1])
        among_hands &= ~is_last.any(axis=1)
    same = owners[:, 0] == owners[:, 1]
    object_on_table = (owners[:, 0] < 0) & (owners[:, 1] == of_object)
    with_table = (owners[:, 0] < 0) & (owners[:, 1] < of_object)
    touching, near = geoms[with_object, 0], np.minimum(dist[with_object], reach)
    fingers = np.full(len(scene.finger_names) + 1, reach)
    np.minimum.at(fingers, scene.geom_finger[touching], near)  # -1: the spare last place
    bodies = []
    for i, hand in enumerate(scene.hands):
        own = scene.geom_owner[touching] == i
        nearest = np.full(len(hand.body_names), reach)
        np.minimum.at(nearest, scene.geom_body[touching[own]], near[own])
        bodies.append(nearest)
    return Distances(
        hand_object=float(np.min(near, initial=reach)),
        self_collision=float(np.min(dist[among_hands & same], initial=0.0)),
        inter_hand=float(np.min(dist[among_hands & ~same], initial=0.0)),
        table=float(np.min(dist[with_table], initial=0.0)),
        object_table=float(np.min(dist[object_on_table], initial=0.0)),
        fingers=fingers[:-1],
        bodies=tuple(bodies),
        contacts=HandContacts(
            scene.geom_owner[touching],
            scene.geom_body[touching],
            dist[with_object],
            points[with_object],
            normals[with_object],
        ),
    )


def pregrasp_penetration(
    hands: Sequence[Hand],
    solid: Solid,
    size: float,
    object_pos: ArrayLike,
    object_quat: ArrayLike,
    hand_pos: ArrayLike,
    hand_quat: ArrayLike,
    joints: ArrayLike,
    *,
    scene: SimScene | None = None,
    table: bool = False,
) -> PregraspDepths:
    """Measure the deepest overlaps of each pose.

    Args:
        hands: H hands.
        solid: The object.
        size: Its bounding-box diagonal [m].
        object_pos: Origin of the object frame, the same for all [m], (3,).
        object_quat: Orientation of the object frame, (4,).
        hand_pos: [m], (N, H, 3).
        hand_quat: (N, H, 4).
        joints: [rad], (N, H, J).
        scene: A scene of the same hands and object-size to use again.
        table: Whether the scene that is built has the table z = 0.
    """
    scene = scene or build_scene(hands, solid, size, table=table)
    hand_pos, hand_quat = np.asarray(hand_pos, float), np.asarray(hand_quat, float)
    joints = np.asarray(joints, float)
    depths = np.full((3, len(hand_pos)), np.nan)
    for n in range(len(hand_pos)):
        if not (np.isfinite(hand_pos[n]).all() and np.isfinite(hand_quat[n]).all()):
            continue
        if not all(
            np.isfinite(joints[n, i, : len(a)]).all() for i, a in enumerate(scene.joint_qpos)
        ):
            continue
        pose = (hand_pos[n], hand_quat[n], joints[n])
        d = measure_distances(scene, object_pos, object_quat, *pose, reach=0.0)
        among = min(d.self_collision, d.inter_hand)
        depths[:, n] = -min(d.hand_object, 0.0), -among, -d.table
    return PregraspDepths(*depths)


class Contacts(NamedTuple):
    """All contacts of a state; K of them, world frame, the lower owner first."""

    owners: NDArray[np.intp]
    """As in `SimScene.geom_owner`, (K, 2)."""
    geoms: NDArray[np.intp]
    """(K, 2)."""
    dist: FloatArray
    """Signed distance [m], (K,)."""
    points: FloatArray
    """Middle between the two nearest points [m], (K, 3)."""
    normals: FloatArray
    """Unit normal from the first geom to the second, (K, 3)."""


def list_contacts(scene: SimScene, reach: float, *, full_broad_phase: bool) -> Contacts:
    """List the contacts of the scene's state.

    Args:
        scene: Its state is looked at.
        reach: Pairs farther apart than this are not looked for [m].
        full_broad_phase: As in `measure_distances`.
    """
    import mujoco

    model, data = scene.model, scene.data
    of_object = scene.geom_owner == scene.object_owner
    body = model.geom_bodyid[of_object]
    model.geom_gap[of_object] = reach
    if full_broad_phase:
        model.body_margin[body] = reach  # compiled, never updated from the geoms' values
    try:
        with engine_warnings_logged():
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_collision(model, data)
    finally:
        model.geom_gap[of_object] = 0.0
        model.body_margin[body] = 0.0
    geoms = np.array(data.contact.geom, dtype=np.intp).reshape(-1, 2)
    dist = np.array(data.contact.dist, dtype=np.float64)
    points = np.array(data.contact.pos, dtype=np.float64).reshape(-1, 3)
    normals = np.array(data.contact.frame, dtype=np.float64).reshape(-1, 9)[:, :3]
    owners = scene.geom_owner[geoms]
    swap = owners[:, 0] > owners[:, 1]
    geoms[swap], owners[swap] = geoms[swap][:, ::-1], owners[swap][:, ::-1]
    normals[swap] *= -1.0
    return Contacts(owners, geoms, dist, points, normals)
