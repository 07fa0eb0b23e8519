"""Chain: the joints from the world to a hand as flat arrays, and its kinematics in float64.

The chain of an arm ends in the record's `hand` frame, the root body of the hand; joints of a wrist
between the arm's flange and the hand come last. All poses are in the world frame. The functions
here are the reference of the kernels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from bidexdata.errors import BadConfig
from bidexdata.frames import matrix_from_quat
from bidexdata.hands.model import FloatArray

if TYPE_CHECKING:
    import mujoco


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """A serial chain of A hinges.

    The frame of a joint is that of the body that it moves, with the origin on the joint's axis.
    """

    joint_names: tuple[str, ...]
    """Arm joints, then wrist joints, (A,)."""
    before_pos: FloatArray
    """Origin of each joint's frame in that of the joint before it at zero angle; of the first in
    the world [m], (A, 3)."""
    before_rot: FloatArray
    """Orientation of the same, (A, 3, 3)."""
    axis: FloatArray
    """Unit axis in the joint's frame, (A, 3)."""
    lower: FloatArray
    """[rad], (A,)."""
    upper: FloatArray
    """[rad], (A,)."""
    rest: FloatArray
    """Posture at rest [rad], (A,)."""
    velocity: FloatArray
    """Largest speed [rad/s], (A,)."""
    torque: FloatArray
    """Largest torque [N m], (A,)."""
    end_pos: FloatArray
    """Origin of the hand frame in the last joint's [m], (3,)."""
    end_rot: FloatArray
    """Its orientation there, (3, 3)."""
    wrist: int
    """How many of the joints, the last ones, belong to the hand."""

    @property
    def joints(self) -> int:
        """Number of joints A."""
        return len(self.joint_names)


def read_chain(
    model: mujoco.MjModel,
    end: str,
    rest: Float[np.ndarray, " A"],
    velocity: Float[np.ndarray, " A"],
    *,
    wrist: int = 0,
) -> Chain:
    """Read the chain from the world to a body of a compiled model.

    Args:
        model: Arm, wrist and hand, standing in the world.
        end: Body that carries the hand frame.
        rest: Posture at rest [rad], in the order of the chain.
        velocity: Largest speeds [rad/s].
        wrist: How many of the joints belong to the hand.

    Raises:
        BadConfig: A joint between is no limited hinge, or their number is another.
    """
    joints, before, T_end = _walk(model, int(model.body(end).id))
    if len(joints) != len(rest):
        names = ", ".join(_plain(model.joint(j).name) for j in joints)
        raise BadConfig(
            f"the chain from the world to {_plain(end)} has {len(joints)} joints ({names}), and "
            f"{len(rest)} are named as the arm's and the wrist's"
        )
    return Chain(
        joint_names=tuple(_plain(model.joint(j).name) for j in joints),
        before_pos=np.array([T[:3, 3] for T in before]),
        before_rot=np.array([T[:3, :3] for T in before]),
        axis=np.array([model.jnt_axis[j] for j in joints], np.float64),
        lower=model.jnt_range[joints, 0].copy(),
        upper=model.jnt_range[joints, 1].copy(),
        rest=np.asarray(rest, np.float64),
        velocity=np.asarray(velocity, np.float64),
        torque=_torques(model, joints),
        end_pos=T_end[:3, 3].copy(),
        end_rot=T_end[:3, :3].copy(),
        wrist=wrist,
    )


def chain_frames(
    chain: Chain, q: Float[np.ndarray, "*b A"]
) -> tuple[Float[np.ndarray, "*b A 3"], Float[np.ndarray, "*b A 3 3"]]:
    """Place the joints' frames in the world.

    Args:
        chain: The chain.
        q: Joint angles [rad].

    Returns:
        Origins [m] and rotations.
    """
    q = np.asarray(q, np.float64)
    pos = np.zeros((*q.shape, 3))
    rot = np.zeros((*q.shape, 3, 3))
    at, turned = np.zeros((*q.shape[:-1], 3)), np.broadcast_to(np.eye(3), (*q.shape[:-1], 3, 3))
    for j in range(chain.joints):
        at = at + turned @ chain.before_pos[j]
        turned = turned @ chain.before_rot[j] @ _turn(chain.axis[j], q[..., j])
        pos[..., j, :], rot[..., j, :, :] = at, turned
    return pos, rot


def chain_forward(
    chain: Chain, q: Float[np.ndarray, "*b A"]
) -> tuple[Float[np.ndarray, "*b 3"], Float[np.ndarray, "*b 3 3"]]:
    """Place the hand frame in the world.

    Args:
        chain: The chain.
        q: Joint angles [rad].

    Returns:
        Position [m] and rotation.
    """
    pos, rot = chain_frames(chain, q)
    last = rot[..., -1, :, :]
    return pos[..., -1, :] + last @ chain.end_pos, last @ chain.end_rot


def chain_jacobian(chain: Chain, q: Float[np.ndarray, "*b A"]) -> Float[np.ndarray, "*b 6 A"]:
    """Velocity of the hand frame per joint speed, in the world frame, at the hand's origin.

    Args:
        chain: The chain.
        q: Joint angles [rad].

    Returns:
        Rows: linear velocity [m/rad], then angular velocity [-].
    """
    pos, rot = chain_frames(chain, q)
    axis = np.einsum("...jik,jk->...ji", rot, chain.axis)
    end = pos[..., -1, :] + rot[..., -1, :, :] @ chain.end_pos
    linear = np.cross(axis, end[..., None, :] - pos)
    return np.swapaxes(np.concatenate([linear, axis], axis=-1), -1, -2)


def _walk(model: mujoco.MjModel, body: int) -> tuple[list[int], list[FloatArray], FloatArray]:
    """Joints from the world to a body, the fixed transforms before each, and that behind the last."""
    import mujoco

    bodies = []
    while body > 0:
        bodies.append(body)
        body = int(model.body_parentid[body])
    joints, before, T = [], [], np.eye(4)
    for b in reversed(bodies):
        T = T @ _rigid(matrix_from_quat(model.body_quat[b]), model.body_pos[b])
        if model.body_jntnum[b] > 1:
            raise BadConfig(
                f"body {_plain(model.body(b).name)!r} of the arm has more than one joint"
            )
        if model.body_jntnum[b]:
            j = int(model.body_jntadr[b])
            if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_HINGE or not model.jnt_limited[j]:
                raise BadConfig(f"joint {_plain(model.joint(j).name)!r} is no hinge with limits")
            shift = _rigid(np.eye(3), model.jnt_pos[j])
            joints.append(j)
            before.append(T @ shift)
            T = _rigid(np.eye(3), -model.jnt_pos[j])
    return joints, before, T


def _rigid(R: FloatArray, p: FloatArray) -> FloatArray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return T


def _plain(name: str) -> str:
    return name.rpartition("/")[2]


def _torques(model: mujoco.MjModel, joints: list[int]) -> FloatArray:
    """Largest force that an actuator of each joint gives [N m]; infinite without a limit."""
    import mujoco

    torque = np.full(len(joints), np.inf)
    for u in range(model.nu):
        on_joint = model.actuator_trntype[u] == mujoco.mjtTrn.mjTRN_JOINT
        if on_joint and model.actuator_trnid[u, 0] in joints and model.actuator_forcelimited[u]:
            torque[joints.index(model.actuator_trnid[u, 0])] = model.actuator_forcerange[u].max()
    return torque


def _turn(axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Rotation matrices about a unit axis (Rodrigues), (*b, 3, 3)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    s, c = np.sin(angle)[..., None, None], np.cos(angle)[..., None, None]
    return np.eye(3) + s * cross + (1 - c) * (cross @ cross)
