"""Pose: both hands of N grasps at one stage."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bidexdata.frames import matrix_from_quat, quat_multiply


class Pose(NamedTuple):
    """Both hands of N grasps; a grasp that is not finite has NaN positions."""

    position: Float[np.ndarray, "N 2 3"]
    """Origins of the hand frames [m]."""
    quat_wxyz: Float[np.ndarray, "N 2 4"]
    joints: tuple[Float[np.ndarray, "N J0"], Float[np.ndarray, "N J1"]]
    """Per hand [rad]."""

    def finite(self) -> np.ndarray:
        """Which grasps consist of numbers, (N,)."""
        joints = [np.all(np.isfinite(q), axis=1) for q in self.joints]
        position = np.all(np.isfinite(self.position), axis=(1, 2))
        return np.asarray(position & joints[0] & joints[1])

    def moved(self, position: Float[np.ndarray, " 3"], quat_wxyz: Float[np.ndarray, " 4"]) -> Pose:
        """The same poses seen from a frame in which their own frame has the given pose."""
        R = matrix_from_quat(quat_wxyz)
        # A sum per component, so that the batch's size cannot change the rounding.
        turned = np.stack([np.sum(self.position * row, axis=-1) for row in R], axis=-1)
        return Pose(turned + position, quat_multiply(quat_wxyz, self.quat_wxyz), self.joints)

    def rows(self, index: np.ndarray | slice) -> Pose:
        """Some of the grasps."""
        joints = (self.joints[0][index], self.joints[1][index])
        return Pose(self.position[index], self.quat_wxyz[index], joints)
