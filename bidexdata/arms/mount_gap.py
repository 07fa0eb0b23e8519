"""How far hands hang off the arms that carry them: a gap that an adapter would have to fill."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bidexdata.arms.assembly import arm_prefix, find_flange
from bidexdata.simulation.assembly import hand_prefix

if TYPE_CHECKING:
    import mujoco

    from bidexdata.arms.robot import Robot

_FAR = 1.0
"""Gaps are not measured beyond this [m]."""


def mount_gaps(robot: Robot, model: mujoco.MjModel) -> tuple[float, float]:
    """Least distance of each hand, with what it is mounted by, from the arm's last link.

    Of all shapes of the models, drawn or colliding; of meshes their hulls. Negative where they overlap.

    Args:
        robot: The robot.
        model: Compiled from `robot_spec`.

    Returns:
        Left and right [m]; infinite where a link or a hand has no shape, or beyond 1 m.
    """
    left, right = (_gap(robot, model, h) for h in range(2))
    return left, right


def _gap(robot: Robot, model: mujoco.MjModel, h: int) -> float:
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    link = model.body(arm_prefix(h) + find_flange(robot.arms[h].model).body).id
    while link and not (model.geom_bodyid == link).any():
        link = int(model.body_parentid[link])
    bodies = [b for b in range(model.nbody) if model.body(b).name.startswith(hand_prefix(h))]
    of_link = np.flatnonzero(model.geom_bodyid == link) if link else []
    of_hand = np.flatnonzero(np.isin(model.geom_bodyid, bodies))
    found = [
        mujoco.mj_geomDistance(model, data, int(a), int(b), _FAR, None)
        for a in of_link
        for b in of_hand
    ]
    least = min(found, default=_FAR)
    return least if least < _FAR else float("inf")
