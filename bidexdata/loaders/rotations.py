"""The forms in which items give rotations: quaternions of either order, six numbers, matrices."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from bidexdata.frames import matrix_from_quat, xyzw_from_wxyz

_ENDING = "_quat_wxyz"


def renamed(name: str, rotation: str, quat_order: str) -> str:
    """Key of a column in the form asked for: `hand_quat_wxyz` is `hand_rot6d`, say."""
    if not name.endswith(_ENDING):
        return name
    ending = {"quat": f"_quat_{quat_order}", "6d": "_rot6d", "matrix": "_matrix"}[rotation]
    return name.removesuffix(_ENDING) + ending


def in_form(
    quat_wxyz: Float[np.ndarray, "*b 4"], rotation: str, quat_order: str
) -> Float[np.ndarray, "*b _"] | Float[np.ndarray, "*b 3 3"]:
    """Give quaternions in another form; NaN stays NaN.

    Args:
        quat_wxyz: Unit quaternions.
        rotation: `quat`; `6d`: the first column of the matrix, then the second (Zhou et al., On the
            Continuity of Rotation Representations in Neural Networks, 2019), (*b, 6); `matrix`:
            (*b, 3, 3).
        quat_order: `wxyz` or `xyzw`.
    """
    if rotation == "quat":
        return quat_wxyz if quat_order == "wxyz" else _float32(xyzw_from_wxyz(quat_wxyz))
    R = matrix_from_quat(quat_wxyz)
    if rotation == "matrix":
        return _float32(R)
    columns = np.swapaxes(R[..., :2], -1, -2)
    return _float32(columns.reshape(*R.shape[:-2], 6))


def _float32(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.float32)
