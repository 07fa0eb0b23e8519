"""The baseline `bimangrasp`: MALA annealing of two hands with contacts anywhere on the fingers.

Energies and schedule are those of BimanGrasp's released code; kinematics, distance field and
collision spheres are ours. `docs/baselines.md` says what its description leaves open.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from bidexdata.devices import start_warp
from bidexdata.frames import matrix_from_quat
from bidexdata.synthesis.attempts import Attempts, gather_starts
from bidexdata.synthesis.baselines.annealing import Annealing, allocate_annealing, anneal
from bidexdata.synthesis.baselines.candidates import (
    contact_candidates,
    joined,
    surface_points,
    with_contacts,
)
from bidexdata.synthesis.opening import opened
from bidexdata.synthesis.optimise import Optimised, found_at, read_pose
from bidexdata.synthesis.optimise_config import EnergyConfig, OptimiseConfig
from bidexdata.synthesis.pose import Pose
from bidexdata.synthesis.staging import Press, squeeze
from bidexdata.synthesis.workspace import Start, allocate

if TYPE_CHECKING:
    from bidexdata.hands.model import Hand
    from bidexdata.objects.prepared import PreparedObject
    from bidexdata.synthesis.baselines.bimangrasp_config import BimanGraspConfig


def search(
    obj: PreparedObject,
    hands: tuple[Hand, Hand],
    attempts: Sequence[Attempts],
    config: BimanGraspConfig,
    *,
    device: str = "cpu",
) -> Optimised:
    """Anneal all starts, and put the record's contacts, the fingertips, where they ended.

    Args:
        obj: The object.
        hands: Left and right.
        attempts: Of one or several scenes; the attempts of a scene share their step lengths.
        config: Of the method.
        device: Warp device.
    """
    start = gather_starts(attempts)
    state = prepared(obj, hands, attempts, config, device)
    anneal(state, config)
    grasp = read_pose(state.ws, hands)
    return _recorded(obj, hands, start, grasp, config, device)


def prepared(
    obj: PreparedObject,
    hands: tuple[Hand, Hand],
    attempts: Sequence[Attempts],
    config: BimanGraspConfig,
    device: str,
) -> Annealing:
    """Put starts on the device, with candidates and surface points in place of the pads."""
    start_warp()
    start = gather_starts(attempts)
    on_hands = [contact_candidates(hand, config.energy.candidates) for hand in hands]
    counts = (len(on_hands[0].body), len(on_hands[1].body))
    body = surface_points(hands[1], config.energy.hand_points)
    touching = (
        with_contacts(hands[0], on_hands[0]),
        with_contacts(hands[1], joined([on_hands[1], body])),
    )
    ws = allocate(obj, touching, start, np.ones(len(start.size)), device)
    points = obj.surface_points[: config.energy.object_points]
    return allocate_annealing(ws, points, start.size, counts, scene_ends(attempts), seeds(attempts))


def scene_ends(attempts: Sequence[Attempts]) -> np.ndarray:
    """Where each scene's starts begin, and the end of the last, (scenes + 1,)."""
    return np.append(0, np.cumsum([len(a.start.size) for a in attempts])).astype(np.int32)


def seeds(attempts: Sequence[Attempts]) -> np.ndarray:
    """Seed of each start, apart by more than the streams that it has, (N,) int32."""
    found = []
    for one in attempts:
        for number in range(len(one.start.size)):
            digest = hashlib.sha256(f"{one.seed}\n{number}".encode()).digest()
            found.append((int.from_bytes(digest[:4], "big") >> 5) * 4)
    return np.array(found, np.int32).reshape(-1)


def aim(found: Optimised, press: Press, hands: Sequence[Hand], config: BimanGraspConfig) -> Pose:
    """The squeeze: as far beyond the grasp as the pre-grasp is before it."""
    return squeeze(found.pregrasp, found.grasp, press, hands, config.staging)


def _recorded(
    obj: PreparedObject,
    hands: tuple[Hand, Hand],
    start: Start,
    grasp: Pose,
    config: BimanGraspConfig,
    device: str,
) -> Optimised:
    """Contacts and energies of the fingertips at the grasp, as every method's rows have them."""
    closure = config.closure
    lengths = closure.torque_lengths(obj.longest_side * start.size)
    ended = Start(
        size=start.size,
        position=grasp.position,
        rotation=matrix_from_quat(grasp.quat_wxyz),
        joints=grasp.joints,
        regions=start.regions,
        plane=start.plane,
    )
    ws = allocate(obj, hands, ended, lengths, device)
    energy = EnergyConfig(normal_step=config.normal_step)
    stages = config.stages
    pregrasp = opened(
        *(grasp, hands),
        palm=stages.palm,
        joints=stages.joints,
        least_closing=stages.least_closing,
    )
    return found_at(ws, hands, pregrasp, OptimiseConfig(closure=closure, energy=energy))
