"""Synthesis of two-handed grasps of one object: the stages in their order.

The object may appear in several scenes (sizes, rest poses); their grasps are optimised together.
Poses are in the object frame until the record is written, which is in the world.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from bidexdata.hands.contact_sets import ContactSet, contact_view, set_numbers
from bidexdata.objects.distance_field import device_field
from bidexdata.record import GraspBatch, Scene, Status
from bidexdata.synthesis.attempts import Attempts, rows_per_scene
from bidexdata.synthesis.config import SynthConfig
from bidexdata.synthesis.forces import (
    ContactForces,
    base_give,
    contact_forces,
    force_scales,
    joint_torques,
    shifted_residual,
    wanted_press,
    weight_share,
)
from bidexdata.synthesis.methods import MethodConfig, Search, method_of
from bidexdata.synthesis.opening import opened, within_limits
from bidexdata.synthesis.optimise import Optimised
from bidexdata.synthesis.overlaps import deepest_overlaps
from bidexdata.synthesis.reaching import arm_statuses
from bidexdata.synthesis.results import GraspContacts, Made, Outcome, Staged
from bidexdata.synthesis.rows import scene_rows
from bidexdata.synthesis.selection import SelectionConfig, audit, best, doubts, judge
from bidexdata.synthesis.settling import Settled, settled
from bidexdata.synthesis.staging import Press

if TYPE_CHECKING:
    from bidexdata.arms.reach import Reach
    from bidexdata.hands.model import Hand
    from bidexdata.objects.prepared import PreparedObject


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
    reach: Reach | None = None,
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
        device: Warp device; palms are placed on the CPU.
        reach: Arms that the grasps are made for: starts that they cannot take are drawn anew, and
            grasps that they cannot take have the status NOT_REACHABLE.

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
    attempts = [
        draw(obj, hands, s, config, seed, count, grown=grown, device=device, reach=reach)
        for s in scenes
    ]
    staged = grasp_attempts(obj, hands, attempts, config, device, reach=reach)
    made = []
    for one, rows in zip(attempts, rows_per_scene(attempts), strict=True):
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
    searches: Mapping[ContactSet, Search] | None = None,
    reach: Reach | None = None,
) -> Staged:
    """Find the poses of all starts, balance the contact forces, and aim the squeeze.

    Args:
        obj: The object.
        hands: Left and right.
        attempts: Of each scene.
        config: All constants; its class says the method.
        device: Warp device.
        searches: In place of the method's own, for attempts of some contact sets.
        reach: Arms that must be able to take the grasps.
    """
    names = np.array([name for one in attempts for name in one.start_sets], str)
    method, own = method_of(config), searches or {}
    parts, places = [], []
    # Without any start one empty part says how wide the arrays are.
    for name in get_args(ContactSet) if len(names) else get_args(ContactSet)[:1]:
        rows = np.flatnonzero(names == name)
        if len(names) and not len(rows):
            continue
        some = [one.of_set(name) for one in attempts]
        search = own.get(name, method.search)
        parts.append(_grasp_set(obj, hands, name, some, config, device, search))
        places.append(rows)
    made: Made = parts[0] if len(parts) == 1 else _scattered(parts, places)
    stages = made.stages
    finite = np.logical_and.reduce([pose.finite() for pose in stages])
    deep = deepest_overlaps(obj, hands, attempts, stages, finite)
    status = judge(
        *(finite, made.contacts.gaps, deep.depth, config.selection),
        among_hands=deep.among_hands,
        table=deep.table,
    )
    size = np.concatenate([one.start.size for one in attempts])
    field, model = device_field(obj.sdf, device), config.selection.settling
    rest = settled(field, hands, stages, size, model, device)
    if reach is None:
        return Staged(made, rest, deep, status)
    arms = arm_statuses(reach, attempts, stages, np.equal(status, Status.OK))
    beyond = (status == Status.OK) & (arms != Status.OK)
    return Staged(made, rest, deep, np.where(beyond, np.int8(Status.NOT_REACHABLE), status), arms)


def _grasp_set(
    obj: PreparedObject,
    hands: tuple[Hand, Hand],
    name: ContactSet,
    attempts: Sequence[Attempts],
    config: MethodConfig,
    device: str,
    search: Search,
) -> Made:
    """Finish attempts that all touch with the same contact set."""
    from bidexdata.simulation.compliance import weld_stiffness

    views = (contact_view(hands[0], name), contact_view(hands[1], name))
    method = method_of(config)
    found = search(obj, views, attempts, config, device=device)
    if config.staging.opened is not None:
        palm, joints = config.staging.opened
        found = replace(found, pregrasp=opened(found.grasp, views, palm=palm, joints=joints))
    forces = contact_forces(found.workspace, config.closure, config.selection.residual_iterations)
    select, staging = config.selection, config.staging
    masses = [staging.mass or obj.mass(a.scene.size, staging.density) for a in attempts]
    mass = np.repeat(masses, [len(a.start.size) for a in attempts])
    wanted = wanted_press(mass, staging.force_floor, staging.force_per_weight)
    shifted = shifted_residual(
        found.workspace,
        config.closure,
        config.normal_step,
        select.weight * weight_share(mass, wanted),
        shift=select.shift,
        sets=select.shifted_sets,
        iterations=select.shifted_iterations,
    )
    scale = force_scales(forces.forces, found.normals_in, wanted)
    pressing = forces.forces * scale[:, :, None, None]
    press = Press(
        joint_torques(found.workspace, pressing),
        base_give(
            found.points, pressing, found.grasp.position, [weld_stiffness(hand) for hand in hands]
        ),
    )
    target = method.aim(found, press, views, config)
    return Made(
        *(within_limits(found.pregrasp, hands), found.grasp, target, found.energies),
        _widened(hands, name, found, forces),
        *(forces.residual, forces.residual_hand, shifted, scale),
    )


def _widened(
    hands: Sequence[Hand], name: ContactSet, found: Optimised, forces: ContactForces
) -> GraspContacts:
    """Give the contacts of a set room for all contact points of the hands."""
    most = max(len(hand.contact_names) for hand in hands)
    number = np.full((len(found.gaps), 2, most), -1, np.int16)
    for h, hand in enumerate(hands):
        numbers = set_numbers(hand, name)
        number[:, h, : len(numbers)] = numbers

    def wide(values: np.ndarray) -> np.ndarray:
        made = np.full((*number.shape, *values.shape[3:]), np.nan)
        made[:, :, : values.shape[2]] = values
        made[number < 0] = np.nan
        return made

    every = (found.points, found.normals_in, found.gaps, forces.forces)
    return GraspContacts(number, *(wide(values) for values in every))


def _scattered(parts: Sequence[Any], places: Sequence[np.ndarray]) -> Any:
    """Put the rows of each part at their places; parts are trees of tuples of arrays."""
    first = parts[0]
    if isinstance(first, tuple):
        made = [_scattered(fields, places) for fields in zip(*parts, strict=True)]
        return tuple(made) if type(first) is tuple else type(first)(*made)
    whole = np.empty((sum(len(rows) for rows in places), *first.shape[1:]), first.dtype)
    for part, rows in zip(parts, places, strict=True):
        whole[rows] = part
    return whole


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
    rest = np.full((3, len(status)), np.nan)
    depth[placed] = staged.overlaps.depth[rows]
    residual[placed] = staged.made.residual[rows]
    shifted[placed] = staged.made.shifted[rows]
    rest[:, placed] = np.stack(staged.settled)[:, rows]
    found = Settled(*rest)
    doubt = doubts(shifted, found)
    places = np.full((len(status), 2, 3), np.nan)
    places[placed] = staged.made.grasp.position[rows]
    selected = best(status, depth, residual, doubt, places, grasps, config)
    drawn = audit(len(status), grasps, np.random.default_rng([one.seed, 2]))
    return Outcome(status, depth, residual, shifted, found, doubt, places, selected, drawn)
