"""A hand as flat Warp arrays on one device, and the argument lists of its kernels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import warp as wp

from bidexdata.devices import start_warp
from bidexdata.errors import BadConfig
from bidexdata.frames import matrix_from_quat
from bidexdata.hands.kinematics_kernels import HandArrays, hand_backward, hand_forward
from bidexdata.hands.model import Hand
from bidexdata.hands.pairs import body_balls, pair_groups


@dataclass(frozen=True, slots=True, eq=False)
class DeviceHand:
    """One hand on one device. Letters as in `Hand`; all arrays float32 or int32."""

    hand: Hand
    device: str
    arrays: Any
    """`HandArrays`, the first argument of the kernels."""
    free_lower: wp.array
    """Smallest value of each free variable that keeps all its joints in range [rad], (D,)."""
    free_upper: wp.array
    """[rad], (D,)."""
    self_pairs: wp.array
    """Sphere pairs that must stay apart, by pair of bodies, (P, 2) int."""
    pair_groups: wp.array
    """Two hubs, first pair and the one behind the last of each pair of bodies, (G,) vec4i."""
    group_reach: wp.array
    """Distance of the hubs beyond which no pair of the group meets [m], (G,)."""
    ball_hub: wp.array
    """Sphere in the middle of each body's ball, (b,) int."""
    ball_radius: wp.array
    """Radius of the ball that holds the body's spheres [m], (b,)."""

    @property
    def sphere_radius(self) -> wp.array:
        """[m], (K,)."""
        return self.arrays.sphere_radius

    @property
    def free(self) -> int:
        """Number of free variables D."""
        return self.hand.coupling.shape[1]


@dataclass(frozen=True, slots=True, eq=False)
class HandState:
    """Buffers of N grasps of one hand, allocated once and reused by every launch."""

    body_pos: wp.array
    """[m], (N, B) vec3."""
    body_rot: wp.array
    """(N, B) mat33."""
    contact: wp.array
    """Centres of the contact spheres [m], (N, C) vec3."""
    normal: wp.array
    """Outward pad normals, (N, C) vec3."""
    sphere: wp.array
    """Centres of the collision spheres [m], (N, K) vec3."""
    contact_grad: wp.array
    """(N, C) vec3."""
    normal_grad: wp.array
    """(N, C) vec3."""
    sphere_grad: wp.array
    """(N, K) vec3."""
    gradient: wp.array
    """Base translation, base rotation, free variables, (N, 6 + D) float."""
    scratch: tuple[wp.array, wp.array]
    """Sums per body, two of (N, B) vec3."""


@lru_cache(maxsize=8)
def device_hand(hand: Hand, device: str = "cpu") -> DeviceHand:
    """Copy a hand to a device, once: no kernel writes to it.

    Raises:
        BadConfig: A joint follows more than one free variable.
    """
    start_warp()
    if np.any((hand.coupling != 0).sum(axis=1) != 1):
        raise BadConfig(f"hand {hand.name}: each joint must follow exactly one free variable")
    driver = np.argmax(hand.coupling != 0, axis=1)
    ratio = hand.coupling[np.arange(len(driver)), driver]
    arrays = HandArrays()
    fields = {
        "body_parent": (hand.body_parent, int),
        "body_pos": (hand.body_pos, wp.vec3),
        "body_rot": (matrix_from_quat(hand.body_quat_wxyz), wp.mat33),
        "body_joint": (hand.body_joint, int),
        "joint_axis": (hand.joint_axis, wp.vec3),
        "joint_free": (driver, int),
        "joint_ratio": (ratio, float),
        "contact_body": (hand.contact_body, int),
        "contact_pos": (hand.contact_pos, wp.vec3),
        "contact_normal": (hand.contact_normal, wp.vec3),
        "sphere_body": (hand.sphere_body, int),
        "sphere_pos": (hand.sphere_pos, wp.vec3),
        "sphere_radius": (hand.sphere_radius, float),
    }
    for name, (values, dtype) in fields.items():
        setattr(arrays, name, _array(values, dtype, device))
    lower, upper = free_limits(hand)
    groups, balls = pair_groups(hand), body_balls(hand)
    return DeviceHand(
        hand=hand,
        device=device,
        arrays=arrays,
        free_lower=_array(lower, float, device),
        free_upper=_array(upper, float, device),
        self_pairs=_array(groups.pairs, int, device),
        pair_groups=_array(np.hstack([groups.hubs, groups.ends]), wp.vec4i, device),
        group_reach=_array(groups.reach, float, device),
        ball_hub=_array(balls.hubs, int, device),
        ball_radius=_array(balls.radius, float, device),
    )


def free_limits(hand: Hand) -> tuple[np.ndarray, np.ndarray]:
    """Range of each free variable that keeps all its joints within their limits [rad], (D,) each."""
    lower = np.full(hand.coupling.shape[1], -np.inf)
    upper = np.full(hand.coupling.shape[1], np.inf)
    for joint, row in enumerate(hand.coupling):
        for free in np.flatnonzero(row):
            ends = np.array([hand.joint_lower[joint], hand.joint_upper[joint]]) / row[free]
            lower[free] = max(lower[free], ends.min())
            upper[free] = min(upper[free], ends.max())
    return lower, upper


def allocate(dev: DeviceHand, grasps: int) -> HandState:
    """Make the buffers for `grasps` grasps."""
    bodies, contacts = len(dev.hand.body_names), len(dev.hand.contact_names)
    spheres = len(dev.hand.sphere_body)

    def vec(count: int) -> wp.array:
        return wp.zeros((grasps, count), dtype=wp.vec3, device=dev.device)

    return HandState(
        body_pos=vec(bodies),
        body_rot=wp.zeros((grasps, bodies), dtype=wp.mat33, device=dev.device),
        contact=vec(contacts),
        normal=vec(contacts),
        sphere=vec(spheres),
        contact_grad=vec(contacts),
        normal_grad=vec(contacts),
        sphere_grad=vec(spheres),
        gradient=wp.zeros((grasps, 6 + dev.free), dtype=float, device=dev.device),
        scratch=(vec(bodies), vec(bodies)),
    )


def forward_arguments(
    dev: DeviceHand, state: HandState, base_pos: wp.array, base_rot: wp.array, free: wp.array
) -> list[Any]:
    """All arguments of `hand_forward`, in order.

    Args:
        dev: The hand.
        state: Buffers; bodies, contacts, normals and spheres are written.
        base_pos: [m], (N,) vec3.
        base_rot: (N,) mat33.
        free: Free variables [rad], (N, D) float.
    """
    out = [state.body_pos, state.body_rot, state.contact, state.normal, state.sphere]
    return [dev.arrays, base_pos, base_rot, free, *out]


def backward_arguments(dev: DeviceHand, state: HandState) -> list[Any]:
    """All arguments of `hand_backward`, in order; it reads the three gradients of `state`."""
    points = [state.body_pos, state.body_rot, state.contact, state.normal, state.sphere]
    gradients = [state.contact_grad, state.normal_grad, state.sphere_grad]
    return [dev.arrays, *points, *gradients, *state.scratch, state.gradient]


def forward(
    dev: DeviceHand, state: HandState, base_pos: wp.array, base_rot: wp.array, free: wp.array
) -> None:
    """Launch `hand_forward`; arguments as in `forward_arguments`."""
    arguments = forward_arguments(dev, state, base_pos, base_rot, free)
    wp.launch(hand_forward, dim=base_pos.shape[0], inputs=arguments, device=dev.device)


def backward(dev: DeviceHand, state: HandState) -> None:
    """Launch `hand_backward`: `state.gradient` from the three gradients at points."""
    count = state.gradient.shape[0]
    wp.launch(hand_backward, dim=count, inputs=backward_arguments(dev, state), device=dev.device)


def _array(values: Any, dtype: Any, device: str) -> wp.array:
    kind = np.int32 if dtype in (int, wp.vec4i) else np.float32
    values = np.ascontiguousarray(values, kind)
    if dtype in (wp.vec3, wp.vec4i, wp.mat33):
        return wp.array(values, dtype=dtype, shape=(len(values),), device=device)
    return wp.array(values, dtype=dtype, device=device)
