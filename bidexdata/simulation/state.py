"""Put a pose into a scene, and read the object's pose out of it. World frame, wxyz, SI units."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bidexdata.frames import matrix_from_quat, quat_rotate

from .scene import SimScene

FloatArray = NDArray[np.float64]


def set_pose(
    scene: SimScene,
    object_pos: ArrayLike,
    object_quat: ArrayLike,
    hand_pos: ArrayLike,
    hand_quat: ArrayLike,
    joints: ArrayLike,
) -> None:
    """Reset the scene completely, then place object and hands at rest, targets at the same pose.

    Args:
        scene: The scene; its state is overwritten, warm start of the solver included.
        object_pos: Origin of the object frame [m], (3,).
        object_quat: Orientation of the object frame, (4,).
        hand_pos: Origins of the hand frames [m], (H, 3).
        hand_quat: Orientations of the hand frames, (H, 4).
        joints: Joint angles, padded beyond each hand's own [rad], (H, J).
    """
    import mujoco

    data = scene.data
    mujoco.mj_resetData(scene.model, data)
    if scene.object_qpos >= 0:
        a = scene.object_qpos
        data.qpos[a : a + 3], data.qpos[a + 3 : a + 7] = object_pos, object_quat
    hand_pos, hand_quat = np.asarray(hand_pos, float), np.asarray(hand_quat, float)
    joints = np.asarray(joints, float)
    for i, address in enumerate(scene.root_qpos):
        if scene.settings.base == "weld":
            data.qpos[address : address + 3] = hand_pos[i]
            data.qpos[address + 3 : address + 7] = hand_quat[i]
        else:
            slid = _slid(scene, hand_pos[i], hand_quat[i])
            data.qpos[address : address + 6] = [*slid, *_hinge_angles(hand_quat[i])]
        own = joints[i, : len(scene.joint_qpos[i])]
        data.qpos[scene.joint_qpos[i]] = own
        data.ctrl[scene.actuators[i]] = scene.controls(i, own)
    set_targets(scene, hand_pos, hand_quat)


def saved_state(scene: SimScene) -> FloatArray:
    """Copy all that the next steps depend on: positions, speeds, controls, warm start."""
    import mujoco

    state = np.empty(mujoco.mj_stateSize(scene.model, mujoco.mjtState.mjSTATE_INTEGRATION))
    mujoco.mj_getState(scene.model, scene.data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    return state


def restore_state(scene: SimScene, state: FloatArray) -> None:
    """Go back to a copy from `saved_state`; warnings of the engine since then are forgotten too."""
    import mujoco

    mujoco.mj_setState(scene.model, scene.data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    scene.data.warning.number[:] = 0


def set_targets(scene: SimScene, hand_pos: FloatArray, hand_quat: FloatArray) -> None:
    """Command poses (H, 3) [m] and (H, 4) of the hands' roots."""
    data = scene.data
    if scene.settings.base == "weld":
        data.mocap_pos[scene.mocap] = hand_pos
        data.mocap_quat[scene.mocap] = hand_quat
        return
    for i, address in enumerate(scene.root_qpos):
        angles = _hinge_angles(hand_quat[i])
        # The turn nearest to where the hinges are: a target never asks for a whole turn.
        now = data.qpos[address + 3 : address + 6]
        angles += 2 * np.pi * np.round((now - angles) / (2 * np.pi))
        data.ctrl[scene.base_actuators[i]] = [*_slid(scene, hand_pos[i], hand_quat[i]), *angles]


def _slid(scene: SimScene, hand_pos: FloatArray, hand_quat: FloatArray) -> FloatArray:
    """Where the slides are when a hand is somewhere: hinges turn about the anchor, not the root."""
    anchor = np.asarray(scene.settings.weld_anchor)
    return hand_pos + quat_rotate(hand_quat, anchor) - anchor


def _hinge_angles(quat: FloatArray) -> FloatArray:
    """Angles of hinges about x, y, z in this order of bodies: R = Rx Ry Rz [rad], (3,)."""
    R = matrix_from_quat(quat)
    return np.array(
        [
            np.arctan2(-R[1, 2], R[2, 2]),
            np.arcsin(np.clip(R[0, 2], -1.0, 1.0)),
            np.arctan2(-R[0, 1], R[0, 0]),
        ]
    )


def object_pose(scene: SimScene) -> tuple[FloatArray, FloatArray]:
    """Position (3,) [m] and orientation (4,) of the object frame."""
    a = scene.object_qpos
    qpos = scene.data.qpos
    return qpos[a : a + 3].copy(), qpos[a + 3 : a + 7].copy()


def object_speed(scene: SimScene) -> tuple[float, float]:
    """Linear [m/s] and angular [rad/s] speed of the object at its centre of mass."""
    a = scene.object_qvel
    qvel = scene.data.qvel
    return float(np.linalg.norm(qvel[a : a + 3])), float(np.linalg.norm(qvel[a + 3 : a + 6]))
