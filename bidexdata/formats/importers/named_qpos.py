"""Poses of the Shadow hand as DexGraspNet and its descendants write them: numbers by name.

`WRJTx, WRJTy, WRJTz` are the origin of the palm body in the object's frame [m]; `WRJRx, WRJRy,
WRJRz` its orientation as angles about the fixed axes x, y, z in this order, R = Rz Ry Rx [rad];
`robot0:FFJ3` ... `robot0:THJ0` 22 joints [rad], numbered from 0 where ours are from 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from bidexdata.formats.importers.format import BadFile, FloatArray
from bidexdata.frames import quat_multiply

FINGERS = {"FF": 4, "MF": 4, "RF": 4, "LF": 5, "TH": 5}
"""Joints of each finger, in the order of the Shadow hand's description."""
THEIR_JOINTS = tuple(f"robot0:{f}J{n - 1 - i}" for f, n in FINGERS.items() for i in range(n))
RIGHT_SIGNS = {"FF": "-+++", "MF": "-+++", "RF": "++++", "LF": "+++++", "TH": "+++--"}
"""Sense of their right hand's joints in ours, base to tip. Measured: forward kinematics of both
descriptions, each joint moved alone, points near the fingertips; tests/formats repeat it for whole
grasps."""
LEFT_SIGNS = {"FF": "----", "MF": "----", "RF": "+---", "LF": "-+---", "TH": "-----"}
"""The same of BimanGrasp's left hand, its frame turned by half a turn about z."""
_PLACE, _TURN = ("WRJTx", "WRJTy", "WRJTz"), ("WRJRx", "WRJRy", "WRJRz")
FARTHEST = 10.0
"""Farthest place of a hand that is taken for one [m]. Source: ours."""


class Palms(NamedTuple):
    """Palm bodies of N grasps in the object's frame, and the joints in our signs."""

    pos: FloatArray
    """(N, 3) [m]."""
    quat_wxyz: FloatArray
    """Unit, (N, 4)."""
    joints: FloatArray
    """(N, 22) in the order of `our_joints` [rad]."""


def our_joints(prefix: str) -> tuple[str, ...]:
    """Names of our joints in the order of `THEIR_JOINTS`.

    >>> our_joints("rh_")[:5]
    ('rh_FFJ4', 'rh_FFJ3', 'rh_FFJ2', 'rh_FFJ1', 'rh_MFJ4')
    """
    return tuple(f"{prefix}{f}J{n - i}" for f, n in FINGERS.items() for i in range(n))


def reason_against(qpos: Any) -> str:
    """Say why a hand's numbers cannot be used; empty where they can."""
    if not isinstance(qpos, Mapping):
        return "it is not a dictionary of numbers by name"
    for name in (*_PLACE, *_TURN, *THEIR_JOINTS):
        if name not in qpos:
            return f"it has no {name}"
        if number(qpos[name]) is None:
            return f"its {name} is not a finite number"
    if any(abs(float(qpos[name])) > FARTHEST for name in _PLACE):
        return f"its hand is more than {FARTHEST:g} m away"
    return ""


def number(value: Any) -> float | None:
    """A finite number, or None."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.number | np.ndarray):
        return None
    if np.size(value) != 1 or np.asarray(value).dtype.kind not in "fiu":
        return None
    found = float(np.asarray(value).reshape(()))
    return found if np.isfinite(found) else None


def palms(rows: Sequence[Mapping[str, Any]], signs: Mapping[str, str]) -> Palms:
    """Read checked numbers.

    Args:
        rows: Those of one hand, which `reason_against` has nothing against.
        signs: `RIGHT_SIGNS` or `LEFT_SIGNS`.
    """

    def columns(names: Sequence[str]) -> FloatArray:
        values = [[float(np.asarray(row[n]).reshape(())) for n in names] for row in rows]
        return np.array(values, np.float64).reshape(len(rows), len(names))

    sense = np.array([1.0 if s == "+" else -1.0 for s in "".join(signs[f] for f in FINGERS)])
    return Palms(
        columns(_PLACE), quat_from_fixed_xyz(columns(_TURN)), sense * columns(THEIR_JOINTS)
    )


def quat_from_fixed_xyz(angles: FloatArray) -> FloatArray:
    """Turn about the fixed axes x, then y, then z, as quaternions (N, 4).

    >>> quat_from_fixed_xyz(np.array([[np.pi, 0.0, 0.0]])).round(3).tolist()
    [[0.0, 1.0, 0.0, 0.0]]
    """
    whole = np.tile([1.0, 0.0, 0.0, 0.0], (len(angles), 1))
    for axis in range(3):
        one = np.zeros((len(angles), 4))
        one[:, 0], one[:, 1 + axis] = np.cos(angles[:, axis] / 2), np.sin(angles[:, axis] / 2)
        whole = quat_multiply(one, whole)
    return whole


def usable(rows: Sequence[Mapping[str, Any]], keys: Sequence[str]) -> tuple[list[int], list[str]]:
    """Which grasps of a file can be used, and why the others cannot.

    Args:
        rows: The dictionaries of a file; each has `scale` and a hand under each key.
        keys: Of the hands.

    Raises:
        BadFile: Not one can be used.
    """
    kept, left_out = [], []
    for i, row in enumerate(rows):
        scale = number(row.get("scale"))
        reason = "" if scale is not None and scale > 0 else "its scale is no positive number"
        for key in keys if not reason else ():
            found = reason_against(row[key]) if key in row else "there is none"
            reason = reason or (f"{key}: {found}" if found else "")
        if reason:
            left_out.append(f"grasp {i}: {reason}")
        else:
            kept.append(i)
    if not kept:
        raise BadFile(left_out[0] if left_out else "it holds no grasp")
    return kept, left_out
