"""Rows: the record's columns of one scene's attempts, in the world."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bidexdata import __version__
from bidexdata.config import fingerprint
from bidexdata.record import GraspBatch, Header, Scene, Status
from bidexdata.record.batch import empty_columns
from bidexdata.record.fields import columns_written_by
from bidexdata.synthesis.attempts import Attempts, grasp_ids
from bidexdata.synthesis.reaching import world_place, world_stages

if TYPE_CHECKING:
    from bidexdata.hands.model import Hand
    from bidexdata.synthesis.methods import MethodConfig
    from bidexdata.synthesis.results import Outcome, Staged


def scene_rows(
    hands: tuple[Hand, Hand],
    attempts: Attempts,
    staged: Staged,
    rows: np.ndarray,
    found: Outcome,
    config: MethodConfig,
    *,
    first_attempt: int,
    run_fingerprint: str,
) -> GraspBatch:
    """Write the selected and audited attempts of a scene, ordered by attempt.

    Args:
        hands: Left and right.
        attempts: The scene's M attempts.
        staged: Finished grasps of all scenes.
        rows: Which of those are this scene's, in the order of its attempts with a start.
        found: What became of each attempt.
        config: Gives the number of optimiser steps and the header's fingerprint.
        first_attempt: Number of the first attempt.
        run_fingerprint: Names the run in the ids.
    """
    status, selected, audit = found.status, found.selected, found.audit
    header = Header(
        hands=tuple(h.header() for h in hands),
        fingerprints={"synth": fingerprint(config)},
        version=__version__,
        counts={attempts.scene.scene_id: _count(status)},
    )
    kept = np.flatnonzero(selected | audit)
    made = empty_columns(header, columns_written_by("synth"), len(kept))
    _identify(made, attempts, kept, run_fingerprint, first_attempt)
    made["synth_status"] = status[kept].astype(np.int8)
    made["selected"], made["audit"] = selected[kept], audit[kept]
    made["region_id"] = attempts.region_id[kept].astype(np.int16)
    made["region_score"] = attempts.region_score[kept].astype(np.float32)
    # Rows of failed attempts keep their fill values.
    place = np.full(len(status), -1)
    place[attempts.status == Status.OK] = rows
    at = np.flatnonzero(status[kept] == Status.OK)
    _pose(made, attempts.scene, staged, at, place[kept[at]])
    _figures(made, staged, at, place[kept[at]])
    made["steps"][at] = config.steps
    return GraspBatch(header, made)


def _identify(
    made: dict[str, np.ndarray],
    attempts: Attempts,
    kept: np.ndarray,
    run_fingerprint: str,
    first_attempt: int,
) -> None:
    scene, n = attempts.scene, len(kept)
    numbers = kept + first_attempt
    made["grasp_id"] = np.array(grasp_ids(run_fingerprint, scene.scene_id, numbers.tolist()), str)
    made["scene_id"] = np.full(n, scene.scene_id)
    made["object_id"] = np.full(n, scene.object_id)
    made["size_mm"] = np.full(n, scene.size_mm, np.int32)
    made["size"] = np.full(n, scene.size, np.float32)
    made["setting"] = np.full(n, scene.setting)
    pos, quat = world_place(scene)
    made["object_pos"], made["object_quat_wxyz"] = np.tile(pos, (n, 1)), np.tile(quat, (n, 1))
    made["sides"] = np.tile(np.array([0, 1], np.int8), (n, 1))
    made["attempt"] = numbers.astype(np.int32)
    made["seed"] = np.full(n, attempts.seed, np.int64)


def _pose(
    made: dict[str, np.ndarray], scene: Scene, staged: Staged, at: np.ndarray, rows: np.ndarray
) -> None:
    world = world_stages(scene, staged.made.stages, rows)
    for name, values in world._asdict().items():
        made[name][at] = values


def _figures(made: dict[str, np.ndarray], staged: Staged, at: np.ndarray, rows: np.ndarray) -> None:
    energies, contacts = staged.made.energies, staged.made.contacts
    for name, values in {
        "energy_qp": energies.closure,
        "energy_distance": energies.distance,
        "energy_region": energies.region,
        "energy_penetration": energies.penetration,
        "energy_self": energies.self_penetration,
        "energy_pad": energies.pad,
        "qp_residual": staged.made.residual,
        "qp_residual_shifted": staged.made.shifted,
        "settled_pressed": staged.settled.pressed,
        "settled_touching": staged.settled.touching,
        "settled_turned": staged.settled.turned,
        "qp_residual_hand": staged.made.residual_hand,
        "force_scale": staged.made.force_scale,
        "contact_index": contacts.number,
        "contact_point": contacts.points,
        "contact_normal": -contacts.normals_in,
        "contact_force": contacts.forces,
    }.items():
        made[name][at] = values[rows]


def _count(status: np.ndarray) -> dict[str, int]:
    values, counts = np.unique(status, return_counts=True)
    return {Status(v).label: int(c) for v, c in zip(values, counts, strict=True)}
