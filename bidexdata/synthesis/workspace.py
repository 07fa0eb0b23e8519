"""Device arrays of one optimisation: N grasps of one object by two hands.

Everything lives in the object frame. Both hands' contact points lie side by side in arrays of
width M = 2 C (hand h from h C on, padding at the end of the hand with fewer); each hand sees its
part as a view. Spheres differ in number, so they are kept per hand.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float

from bidexdata.devices import start_warp
from bidexdata.hands.device import DeviceHand, HandState, device_hand, free_limits
from bidexdata.objects.distance_field import device_field

if TYPE_CHECKING:
    from bidexdata.hands.model import Hand
    from bidexdata.objects.prepared import PreparedObject

SIDES = 2


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HandWork:
    """One hand of every grasp: its pose, what follows from it, and the step rule's memory."""

    model: DeviceHand
    points: HandState
    """Bodies, points, spheres and the gradients at them; contact arrays are views of the
    `ContactState`'s."""
    position: Any
    """Origin of the hand frame [m], (N,) vec3."""
    rotation: Any
    """Orientation of the hand frame, (N,) mat33."""
    joints: Any
    """Free variables u [rad], (N, D)."""
    measured: Any
    """Where each sphere's distance was last measured, and how far it may move, (N, K) vec4."""
    low: Any
    high: Any
    """Corners of the box around all spheres, (N,) vec3."""
    sphere_energy: Any
    """Squared depths in object and table [m2], (N, K)."""
    self_energy: Any
    """Squared overlaps within the hand [m2], (N,)."""
    first_moment: Any
    """(N, 6 + D)."""
    second_moment: Any
    """(N, 2 + D)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ContactState:
    """The contact points of both hands and the surface under them, width M."""

    hand: Any
    """Hand of each place, (M,) int."""
    radius: Any
    """Contact sphere radii [m], (M,)."""
    regions: Any
    """Points of each hand's region [m], (N, H, k) vec3."""
    centres: Any
    """Contact sphere centres [m], (N, M) vec3."""
    pads: Any
    """Outward pad normals, (N, M) vec3."""
    distance: Any
    """Signed distance of the centres [m], (N, M)."""
    direction: Any
    """Its gradient, (N, M) vec3."""
    points: Any
    """Closest surface points [m], (N, M) vec3."""
    normals_in: Any
    """Inward unit normals there, (N, M) vec3."""
    centre_gradient: Any
    pad_gradient: Any
    point_gradient: Any
    normal_gradient: Any
    """Gradients with respect to centres, pads, points and inward normals, (N, M) vec3."""
    distance_energy: Any
    region_energy: Any
    pad_energy: Any
    """Unweighted energies per contact, (N, M)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Workspace:
    """All arrays of one optimisation."""

    count: int
    device: str
    field: Any
    """`distance_field_kernels.DistanceField`."""
    size: Any
    """Bounding-box diagonal of each grasp's object [m], (N,)."""
    torque_length: Any
    """(N,) [m]."""
    plane: Any
    """Table under each grasp in the object frame (normal, offset); zero where there is none, (N,)
    vec4."""
    has_table: bool
    between_energy: Any
    """Squared overlaps between the hands [m2], (N,)."""
    hands: tuple[HandWork, HandWork]
    contacts: ContactState
    contacts_per_hand: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Start:
    """Where N grasps start, object frame."""

    size: Float[np.ndarray, " N"]
    """Bounding-box diagonal [m]."""
    position: Float[np.ndarray, "N 2 3"]
    """Hand frames [m]."""
    rotation: Float[np.ndarray, "N 2 3 3"]
    joints: tuple[Float[np.ndarray, "N J0"], Float[np.ndarray, "N J1"]]
    """Per hand [rad]."""
    regions: Float[np.ndarray, "N 2 k 3"]
    """Points of each hand's region; one point, the anchor, where distances are to it [m]."""
    plane: Float[np.ndarray, "N 4"]
    """Table in the object frame: normal . x + offset >= 0 above it; zeros without a table."""

    def rows(self, which: Bool[np.ndarray, " N"]) -> Start:
        """Keep some of the starts."""
        return Start(
            size=self.size[which],
            position=self.position[which],
            rotation=self.rotation[which],
            joints=(self.joints[0][which], self.joints[1][which]),
            regions=self.regions[which],
            plane=self.plane[which],
        )


def free_variables(hand: Hand, joints: Float[np.ndarray, "N J"]) -> Float[np.ndarray, "N D"]:
    """Free variables u whose joints are closest to the given ones, within the limits [rad]."""
    # Columns of the coupling do not overlap, so its pseudo-inverse is a weighted mean.
    weights = hand.coupling / np.sum(hand.coupling**2, axis=0)
    u = np.sum(joints[:, :, None] * weights, axis=1)
    return np.clip(u, *free_limits(hand))


def allocate(
    obj: PreparedObject,
    hands: Sequence[Hand],
    start: Start,
    torque_length: Float[np.ndarray, " N"],
    device: str = "cpu",
) -> Workspace:
    """Put a start on the device with room for everything that a step writes."""
    import warp as wp

    start_warp()
    n = len(start.size)
    counts = tuple(len(h.contact_body) for h in hands)
    stride = max(counts)
    width = SIDES * stride

    def zeros(shape: Any, dtype: Any = float) -> Any:
        return wp.zeros(shape, dtype=dtype, device=device)

    def copy(values: Any, dtype: Any = float) -> Any:
        return wp.array(np.ascontiguousarray(values, np.float32), dtype=dtype, device=device)

    radius = np.zeros(width)
    for h, hand in enumerate(hands):
        radius[h * stride : h * stride + counts[h]] = hand.contact_radius
    owner = np.repeat(np.arange(SIDES, dtype=np.int32), stride)
    vectors = {
        name: zeros((n, width), wp.vec3)
        for name in (
            "centres",
            "pads",
            "direction",
            "points",
            "normals_in",
            "centre_gradient",
            "pad_gradient",
            "point_gradient",
            "normal_gradient",
        )
    }
    numbers = {
        name: zeros((n, width))
        for name in ("distance", "distance_energy", "region_energy", "pad_energy")
    }
    contacts = ContactState(
        hand=wp.array(owner, dtype=int, device=device),
        radius=copy(radius),
        regions=copy(start.regions, wp.vec3),
        **vectors,
        **numbers,
    )
    return Workspace(
        count=n,
        device=device,
        field=device_field(obj.sdf, device),
        size=copy(start.size),
        torque_length=copy(torque_length),
        plane=copy(start.plane, wp.vec4),
        has_table=bool(np.any(start.plane)),
        between_energy=zeros(n),
        hands=(
            _hand_work(hands[0], 0, start, contacts, zeros, copy, device),
            _hand_work(hands[1], 1, start, contacts, zeros, copy, device),
        ),
        contacts=contacts,
        contacts_per_hand=(counts[0], counts[1]),
    )


def _hand_work(
    hand: Hand,
    h: int,
    start: Start,
    contacts: ContactState,
    zeros: Callable[..., Any],
    copy: Callable[..., Any],
    device: str,
) -> HandWork:
    import warp as wp

    n, bodies, spheres = len(start.size), len(hand.body_names), len(hand.sphere_body)
    free = hand.coupling.shape[1]
    first = h * contacts.centres.shape[1] // SIDES

    def own(array: Any) -> Any:
        # Warp cannot slice an array without rows.
        return array[:, first : first + len(hand.contact_body)] if n else array

    points = HandState(
        body_pos=zeros((n, bodies), wp.vec3),
        body_rot=zeros((n, bodies), wp.mat33),
        contact=own(contacts.centres),
        normal=own(contacts.pads),
        sphere=zeros((n, spheres), wp.vec3),
        contact_grad=own(contacts.centre_gradient),
        normal_grad=own(contacts.pad_gradient),
        sphere_grad=zeros((n, spheres), wp.vec3),
        gradient=zeros((n, 6 + free)),
        scratch=(zeros((n, bodies), wp.vec3), zeros((n, bodies), wp.vec3)),
    )
    return HandWork(
        model=device_hand(hand, device),
        points=points,
        position=copy(start.position[:, h], wp.vec3),
        rotation=copy(start.rotation[:, h], wp.mat33),
        joints=copy(free_variables(hand, start.joints[h])),
        measured=zeros((n, spheres), wp.vec4),
        low=zeros(n, wp.vec3),
        high=zeros(n, wp.vec3),
        sphere_energy=zeros((n, spheres)),
        self_energy=zeros(n),
        first_moment=zeros((n, 6 + free)),
        second_moment=zeros((n, 2 + free)),
    )
