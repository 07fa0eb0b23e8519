"""What the device arrays of an optimisation say: poses and energies, as numpy arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from bidexdata.frames import quat_from_matrix
from bidexdata.synthesis.pose import Pose

if TYPE_CHECKING:
    from bidexdata.hands.model import Hand
    from bidexdata.synthesis.workspace import Workspace
    from bidexdata.wrench.qp import ContactQP


class Energies(NamedTuple):
    """Unweighted energies of N grasps."""

    distance: Float[np.ndarray, " N"]
    region: Float[np.ndarray, " N"]
    pad: Float[np.ndarray, " N"]
    penetration: Float[np.ndarray, " N"]
    self_penetration: Float[np.ndarray, " N"]
    closure: Float[np.ndarray, " N"]
    """Q over all groups and disturbances of the configuration."""


def read_pose(ws: Workspace, hands: Sequence[Hand]) -> Pose:
    """Copy the hands' poses from the device."""
    joints = []
    for hand, state in zip(hands, ws.hands, strict=True):
        u = state.joints.numpy().astype(np.float64)
        # One product per joint, so that the batch's size cannot change the rounding.
        q = np.sum(u[:, None, :] * hand.coupling[None], axis=2)
        joints.append(np.clip(q, hand.joint_lower, hand.joint_upper))
    rotations = np.stack([s.rotation.numpy() for s in ws.hands], axis=1).astype(np.float64)
    finite = np.all(np.isfinite(rotations), axis=(-1, -2))
    quats = quat_from_matrix(np.where(finite[..., None, None], rotations, np.eye(3)))
    position = np.stack([s.position.numpy() for s in ws.hands], axis=1).astype(np.float64)
    position[~finite] = np.nan
    return Pose(position, quats, (joints[0], joints[1]))


def read_energies(ws: Workspace, qp: ContactQP | None) -> Energies:
    """Copy and sum the energies that the last step wrote; terms that it left out are older.

    Args:
        ws: The optimisation.
        qp: Whose residuals are the closure energy; NaN without one.
    """
    c = ws.contacts
    real = np.zeros((2, c.centres.shape[1] // 2), bool)
    for h, count in enumerate(ws.contacts_per_hand):
        real[h, :count] = True
    places = real.ravel()
    depth = [_per_grasp(s.sphere_energy) for s in ws.hands]
    overlaps = [s.self_energy for s in ws.hands] + [ws.between_energy]
    return Energies(
        distance=_per_grasp(c.distance_energy, places),
        region=_per_grasp(c.region_energy, places),
        pad=_per_grasp(c.pad_energy, places),
        penetration=depth[0] + depth[1],
        self_penetration=np.sum([e.numpy() for e in overlaps], axis=0, dtype=np.float64),
        closure=np.full(ws.count, np.nan) if qp is None else _per_grasp(qp.residual),
    )


def _per_grasp(values: Any, columns: slice | np.ndarray = slice(None)) -> np.ndarray:
    # Contiguous rows are summed alike whatever their number.
    rows = np.ascontiguousarray(values.numpy()[:, columns])
    return np.asarray(np.sum(rows, axis=tuple(range(1, rows.ndim)), dtype=np.float64))
