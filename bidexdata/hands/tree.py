"""The compiled MuJoCo model of a hand as flat arrays: kinematic tree, limits, actuator moment."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bidexdata.errors import BadConfig
from bidexdata.frames import quat_canonical
from bidexdata.hands.model import FloatArray, IntArray

if TYPE_CHECKING:
    import mujoco


class HandTree(NamedTuple):
    """Arrays named and shaped as in `Hand`."""

    body_names: tuple[str, ...]
    body_parent: IntArray
    body_pos: FloatArray
    body_quat_wxyz: FloatArray
    body_joint: IntArray
    joint_names: tuple[str, ...]
    joint_axis: FloatArray
    joint_lower: FloatArray
    joint_upper: FloatArray
    actuator_names: tuple[str, ...]
    actuator_moment: FloatArray


def read_tree(model: mujoco.MjModel) -> HandTree:
    """Read the kinematic tree of a hand whose root hangs under the world body.

    Raises:
        BadConfig: The model has joints that are no limited hinges through their body's origin, or
            more than one joint on a body.
    """
    import mujoco

    names = tuple(model.body(i).name for i in range(1, model.nbody))
    joints = tuple(model.jnt(i).name for i in range(model.njnt))
    for i, name in enumerate(joints):
        if model.jnt_type[i] != mujoco.mjtJoint.mjJNT_HINGE or not model.jnt_limited[i]:
            raise BadConfig(f"joint {name!r} is no hinge with limits; hands need those")
        if np.abs(model.jnt_pos[i]).max() > 1e-9:
            raise BadConfig(f"joint {name!r} does not pass through its body's origin")
    if np.any(model.body_jntnum > 1):
        raise BadConfig(
            f"body {model.body(int(np.argmax(model.body_jntnum))).name!r} has more than one joint"
        )
    if np.sum(model.body_parentid[1:] == 0) != 1:
        raise BadConfig("the hand's model has more than one body under the world")
    if np.any(model.qpos0 != 0):
        raise BadConfig("a joint of the hand has a reference angle other than zero")
    return HandTree(
        body_names=names,
        body_parent=(model.body_parentid[1:] - 1).astype(np.int32),
        body_pos=model.body_pos[1:].copy(),
        body_quat_wxyz=quat_canonical(model.body_quat[1:]),
        body_joint=np.where(model.body_jntnum[1:] > 0, model.body_jntadr[1:], -1).astype(np.int32),
        joint_names=joints,
        joint_axis=model.jnt_axis / np.linalg.norm(model.jnt_axis, axis=1, keepdims=True),
        joint_lower=model.jnt_range[:, 0].copy(),
        joint_upper=model.jnt_range[:, 1].copy(),
        actuator_names=tuple(model.actuator(i).name for i in range(model.nu)),
        actuator_moment=_actuator_moment(model),
    )


def coupling_matrix(joint_names: tuple[str, ...], follows: dict[str, str]) -> FloatArray:
    """Joints = matrix @ u: one free variable per joint that follows no other, (J, D).

    Raises:
        BadConfig: A name is no joint, or a joint follows a follower.
    """
    for follower, leader in follows.items():
        for name in (follower, leader):
            if name not in joint_names:
                raise BadConfig(
                    f"coupled names the joint {name!r}; known: {', '.join(joint_names)}"
                )
        if leader in follows:
            raise BadConfig(f"coupled: {follower!r} follows {leader!r}, which itself follows")
    free = [name for name in joint_names if name not in follows]
    matrix = np.zeros((len(joint_names), len(free)))
    for row, name in enumerate(joint_names):
        matrix[row, free.index(follows.get(name, name))] = 1.0
    return matrix


def _actuator_moment(model: mujoco.MjModel) -> FloatArray:
    """Rows of d(actuator length)/d(qpos) at the zero pose, (U, J)."""
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    moment = np.zeros((model.nu, model.nv))
    for u in range(model.nu):
        entries = data.moment_rowadr[u] + np.arange(data.moment_rownnz[u])
        moment[u, data.moment_colind[entries]] = data.actuator_moment[entries]
    return moment
