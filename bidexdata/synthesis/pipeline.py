"""Synthesis of two-handed grasps of one object: the stages in their order.

The object may appear in several scenes (sizes, rest poses); their grasps are optimised together.
Poses are in the object frame until the record is written, which is in the world.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bidexdata.frames import quat_multiply, quat_rotate
from bidexdata.record import GraspBatch, Scene, Status
from bidexdata.synthesis.attempts import Attempts
from bidexdata.synthesis.config import SynthConfig
from bidexdata.synthesis.forces import (
    ContactForces,
    contact_forces,
    force_scales,
    joint_torques,
    shifted_residual,
)
from bidexdata.synthesis.methods import MethodConfig, Search, method_of
from bidexdata.synthesis.opening import opened
from bidexdata.synthesis.optimise import Optimised
from bidexdata.synthesis.pose import Pose
from bidexdata.synthesis.rows import scene_rows
from bidexdata.synthesis.selection import SelectionConfig, audit, best, judge

if TYPE_CHECKING:
    from bidexdata.hands.model import Hand
    from bidexdata.objects.prepared import PreparedObject
    from bidexdata.simulation.scene import SimScene


class Overlaps(NamedTuple):
    """Deepest overlaps on the hands' own geometry [m], zero or more; NaN where not finite."""

    depth: np.ndarray
    """Hands and object at the pre-grasp, (K,)."""
    among_hands: np.ndarray
    """Within a hand or between hands at the pre-grasp, (K,)."""
    table: np.ndarray
    """Hands and table at the stage where they are deepest in it; 0 without one, (K,)."""


class Staged(NamedTuple):
    """Finished grasps of all scenes, in the order of the starts."""

    optimised: Optimised
    squeeze: Pose
    forces: ContactForces
    shifted: np.ndarray
    """Residual of moved contacts [-], (K,)."""
    force_scale: np.ndarray
    """[N] per unit of force, (K, 2)."""
    overlaps: Overlaps
    """Each (K,)."""
    status: np.ndarray
    """(K,)."""


class Outcome(NamedTuple):
    """What became of all M attempts of a scene; NaN where there is no start or no finite pose."""

    status: np.ndarray
    """(M,)."""
    depth: np.ndarray
    """Pre-grasp penetration [m], (M,)."""
    residual: np.ndarray
    """Coupled zero-load QP residual [-], (M,)."""
    shifted: np.ndarray
    """Residual of moved contacts [-], (M,)."""
    selected: np.ndarray
    """One of the best, (M,)."""
    audit: np.ndarray
    """One of those drawn beforehand, (M,)."""


def synthesize(
    obj: PreparedObject,
    hands: tuple[Hand, Hand],
    scenes: Sequence[Scene],
    config: MethodConfig | None = None,
    seed: int = 0,
    *,
    run_fingerprint: str = "",
    grasps: int = 10,
    candidates: int | None = None,
    first_attempt: int = 0,
    device: str = "cpu",
) -> GraspBatch:
    """Make grasps of one object in one or several scenes.

    Args:
        obj: The object.
        hands: Left and right.
        scenes: Of this object; each is independent of the others.
        config: All constants; its class says the method. Our defaults when omitted.
        seed: Of the run; each scene derives its own.
        run_fingerprint: Names the run in the grasps' ids.
        grasps: N, grasps kept per scene.
        candidates: M, attempts per scene; `config.selection.candidates_per_grasp` N when omitted.
        first_attempt: Number of the first attempt, when a run grows.
        device: Warp device of the optimisation.

    Returns:
        The rows that are selected or audited, scene after scene, ordered by attempt; the header
        counts the statuses of all attempts per scene.
    """
    config = config or SynthConfig()
    if any(s.object_id != obj.object_id for s in scenes):
        raise ValueError(f"every scene must be one of {obj.object_id}")
    count = candidates or config.selection.candidates_per_grasp * grasps
    grown = first_attempt > 0
    draw = method_of(config).draw
    attempts = [draw(obj, hands, s, config, seed, count, grown=grown) for s in scenes]
    staged = grasp_attempts(obj, hands, attempts, config, device)
    made = []
    for one, rows in zip(attempts, _rows_per_scene(attempts), strict=True):
        found = outcome(one, staged, rows, grasps, config.selection)
        made.append(
            scene_rows(
                *(hands, one, staged, rows, found, config),
                first_attempt=first_attempt,
                run_fingerprint=run_fingerprint,
            )
        )
    return GraspBatch.concat(made)


def grasp_attempts(
    obj: PreparedObject,
    hands: tuple[Hand, Hand],
    attempts: Sequence[Attempts],
    config: MethodConfig,
    device: str = "cpu",
    *,
    search: Search | None = None,
) -> Staged:
    """Find the poses of all starts, balance the contact forces, and aim the squeeze.

    Args:
        obj: The object.
        hands: Left and right.
        attempts: Of each scene.
        config: All constants; its class says the method.
        device: Warp device.
        search: In place of the method's own.
    """
    method = method_of(config)
    found = (search or method.search)(obj, hands, attempts, config, device=device)
    if config.staging.opened is not None:
        palm, joints = config.staging.opened
        pregrasp = opened(found.grasp, hands, palm=palm, joints=joints)
        found = replace(found, pregrasp=pregrasp)
    forces = contact_forces(found.workspace, config.closure, config.selection.residual_iterations)
    select, staging = config.selection, config.staging
    shifted = shifted_residual(
        found.workspace,
        config.closure,
        config.normal_step,
        shift=select.shift,
        sets=select.shifted_sets,
        iterations=select.shifted_iterations,
    )
    scale = force_scales(
        forces.forces,
        found.normals_in,
        np.concatenate(
            [np.full(len(a.start.size), obj.mass(a.scene.size, staging.density)) for a in attempts]
        ),
        staging.force_floor,
        staging.force_per_weight,
    )
    torques = joint_torques(found.workspace, forces.forces * scale[:, :, None, None])
    target = method.aim(found, torques, hands, config)
    finite = found.pregrasp.finite() & found.grasp.finite() & target.finite()
    stages = (found.pregrasp, found.grasp, target)
    deep = Overlaps(*_depths(obj, hands, attempts, stages, finite))
    status = judge(
        *(finite, found.gaps, deep.depth, select), among_hands=deep.among_hands, table=deep.table
    )
    return Staged(found, target, forces, shifted, scale, deep, status)


def _depths(
    obj: PreparedObject,
    hands: tuple[Hand, Hand],
    attempts: Sequence[Attempts],
    stages: tuple[Pose, Pose, Pose],
    finite: np.ndarray,
) -> np.ndarray:
    """Deepest overlaps of each attempt on the hands' own geometry [m].

    Returns:
        At the pre-grasp hands with the object and among the hands; hands with the table at the
        stage where they are deepest in it, (3, K).
    """
    from bidexdata.simulation.resize import SizedScenes

    depths = np.full((3, len(finite)), np.nan)
    scenes: dict[bool, SizedScenes] = {}
    for one, every in zip(attempts, _rows_per_scene(attempts), strict=True):
        rows = every[finite[every]]
        if len(rows) == 0:
            continue
        on_table = one.scene.setting == "tabletop"
        if on_table not in scenes:
            scenes[on_table] = SizedScenes(hands, obj, table=on_table)
        built = scenes[on_table].at(one.scene.size)
        depths[:, rows] = _overlaps(built, obj, one.scene, stages[0].rows(rows))
        for pose in stages[1:] if on_table else ():
            table = _overlaps(built, obj, one.scene, pose.rows(rows))[2]
            depths[2, rows] = np.maximum(depths[2, rows], table)
    return depths


def _overlaps(built: SimScene, obj: PreparedObject, scene: Scene, pose: Pose) -> np.ndarray:
    """Overlaps of one stage: hands with the object, among the hands, with the table [m], (3, n)."""
    from bidexdata.simulation.distances import pregrasp_penetration

    hands = built.hands
    padded = np.full((len(pose.position), 2, max(len(h.joint_names) for h in hands)), np.nan)
    for h, joints in enumerate(pose.joints):
        padded[:, h, : joints.shape[1]] = joints
    # In the world, where the table is z = 0; a floating object is at the identity there.
    origin, turn = np.array(scene.object_pos), np.array(scene.object_quat_wxyz)
    return np.stack(
        pregrasp_penetration(
            hands,
            obj,
            scene.size,
            origin,
            turn,
            quat_rotate(turn, pose.position) + origin,
            quat_multiply(turn, pose.quat_wxyz),
            padded,
            scene=built,
        )
    )


def _rows_per_scene(attempts: Sequence[Attempts]) -> list[np.ndarray]:
    """Which of the joined starts belong to each scene."""
    ends = np.cumsum([len(a.start.size) for a in attempts])
    starts = np.append(0, ends[:-1])
    return [np.arange(a, b) for a, b in zip(starts, ends, strict=True)]


def outcome(
    one: Attempts, staged: Staged, rows: np.ndarray, grasps: int, config: SelectionConfig
) -> Outcome:
    """Say what became of all M attempts of a scene.

    Args:
        one: The scene's attempts.
        staged: Finished grasps of all scenes.
        rows: Which of those are this scene's, in the order of its attempts with a start.
        grasps: N, grasps kept, and as many drawn for the audit.
        config: Of the selection.
    """
    placed = one.status == Status.OK
    status = one.status.copy()
    status[placed] = staged.status[rows]
    depth, residual, shifted = np.full((3, len(status)), np.nan)
    depth[placed] = staged.overlaps.depth[rows]
    residual[placed] = staged.forces.residual[rows]
    shifted[placed] = staged.shifted[rows]
    selected = best(status, depth, residual, shifted, grasps, config)
    drawn = audit(len(status), grasps, np.random.default_rng([one.seed, 2]))
    return Outcome(status, depth, residual, shifted, selected, drawn)
