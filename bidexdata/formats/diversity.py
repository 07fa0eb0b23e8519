"""Diversity D of a set of grasps: how much of their variance one direction explains.

A grasp is one vector: for every hand the position of the hand frame in the object frame [m], its
orientation as a rotation vector [rad] and its joints [rad]. D is the share of the variance along
the first principal component; small is diverse. Metres and radians are mixed, and radians are
larger, so D hardly sees positions: the scale-free D divides every number by its own deviation.
DexGraspBench takes positions of its hand's root, 34 mm below our palm: of its 160 example grasps D
is 0.3433 from there and 0.3437 from the palm.

Source:
    DexGraspBench (PCA of all evaluated grasps, unscaled); BiDexGrasp, appendix D, which states the
    first component, of both hands' vectors together. The scale-free variant is ours.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.frames import quat_conjugate, quat_multiply, quat_rotate, rotation_vector_from_quat
from bidexdata.record import GraspBatch

COLUMNS = ("object_pos", "object_quat_wxyz", "hand_pos", "hand_quat_wxyz", "joints")
_TINY = 1e-12
_UNIT = 1e-3
"""A quaternion whose length is further from 1 is no rotation [-]; verify is stricter."""
GRASP = 1
"""The stage that counts."""


class Diversity(NamedTuple):
    """Shares of variance along the first component, in (0, 1]; NaN below two different grasps."""

    d: float
    scale_free: float


class DiversityTally:
    """Add batches of any size, then read `value()`.

    State: count, sums and sums of products of the vectors; nothing per grasp.
    """

    def __init__(self) -> None:
        self._n = 0
        self._sum = np.zeros(0)
        self._products = np.zeros((0, 0))

    def add(self, batch: GraspBatch, mask: NDArray[np.bool_]) -> None:
        """Count the marked rows whose numbers are all finite and whose rotations are some."""
        whole = finite_vectors(batch)
        if whole is not None:
            self.add_vectors(whole.vectors[mask[whole.rows]])

    def add_vectors(self, vectors: NDArray[np.float64]) -> None:
        """Count grasps by their vectors, all finite, (K, D)."""
        if not len(vectors):
            return
        if self._n == 0:
            size = vectors.shape[1]
            self._sum, self._products = np.zeros(size), np.zeros((size, size))
        self._n += len(vectors)
        self._sum += vectors.sum(axis=0)
        self._products += vectors.T @ vectors

    def value(self) -> Diversity:
        """Give both shares."""
        if self._n < 2:
            return Diversity(np.nan, np.nan)
        mean = self._sum / self._n
        covariance = self._products / self._n - np.outer(mean, mean)
        deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        moving = deviation > 1e-6  # what is the same in all grasps has no direction
        if not moving.any():
            return Diversity(np.nan, np.nan)
        covariance = covariance[np.ix_(moving, moving)]
        scaled = covariance / np.outer(deviation[moving], deviation[moving])
        return Diversity(_first_share(covariance), _first_share(scaled))


class FiniteVectors(NamedTuple):
    """The grasps of a batch that count."""

    rows: NDArray[np.integer]
    """Their rows, (K,)."""
    vectors: NDArray[np.float64]
    """(K, D)."""


def finite_vectors(batch: GraspBatch) -> FiniteVectors | None:
    """Vectors of the rows whose numbers are all finite and whose quaternions are unit ones.

    None where the batch has no poses.
    """
    if any(name not in batch for name in COLUMNS):
        return None
    good = _unit(batch.object_quat_wxyz)
    good &= _unit(batch.hand_quat_wxyz[:, :, GRASP]).all(axis=1)
    rows = np.flatnonzero(good)
    posed = GraspBatch(batch.header, {name: batch[name][rows] for name in COLUMNS})
    vectors = grasp_vectors(posed)
    finite = np.isfinite(vectors).all(axis=1)
    return FiniteVectors(rows[finite], vectors[finite])


def grasp_vectors(batch: GraspBatch) -> NDArray[np.float64]:
    """One vector per grasp at the stage grasp, hands one after the other, (N, D)."""
    back = quat_conjugate(batch["object_quat_wxyz"].astype(np.float64))
    parts = []
    for h, hand in enumerate(batch.header.hands):
        offset = (batch["hand_pos"][:, h, GRASP] - batch["object_pos"]).astype(np.float64)
        turn = quat_multiply(back, batch["hand_quat_wxyz"][:, h, GRASP].astype(np.float64))
        joints = batch["joints"][:, h, GRASP, : len(hand.joint_names)]
        parts += [quat_rotate(back, offset), rotation_vector_from_quat(turn), joints]
    return np.concatenate(parts, axis=1, dtype=np.float64)


def _unit(quat: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Where a quaternion is a rotation as it stands: two short ones have a product of length 0."""
    return np.abs(np.linalg.norm(quat.astype(np.float64), axis=-1) - 1.0) < _UNIT


def _first_share(matrix: NDArray[np.float64]) -> float:
    values = np.linalg.eigvalsh((matrix + matrix.T) / 2)
    return float(values[-1] / max(np.maximum(values, 0.0).sum(), _TINY))
