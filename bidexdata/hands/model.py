"""Hand: one hand of one side as flat arrays, in the `hand` frame (its root body).

The root body is what a grasp's `hand_pos` and `hand_quat_wxyz` place in the world. Bodies are in
depth-first order with the root first, each with at most one hinge joint, so forward kinematics is
one pass over the arrays.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from bidexdata.record import HandHeader

if TYPE_CHECKING:
    import mujoco

Side = Literal["left", "right"]
Part = Literal["fingertip", "pad", "palm"]
"""What of a hand a contact point is; a pad is any of a finger's links but its tip."""
FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class Hand:
    """Kinematics, contact points, collision spheres and postures of one hand.

    Letters: B bodies, J joints, D degrees of freedom of the optimiser, U actuators, C contact
    points, K collision spheres, P sphere pairs.
    """

    name: str
    side: Side
    spec_hash: str
    """sha256 over the YAML spec and every file that it names."""
    licence: str

    # kinematic tree
    body_names: tuple[str, ...]
    body_parent: IntArray
    """Index of each body's parent; -1 for the root, (B,)."""
    body_pos: FloatArray
    """Origin in the parent's frame at zero joint angle [m], (B, 3)."""
    body_quat_wxyz: FloatArray
    """Orientation in the parent's frame at zero joint angle, (B, 4)."""
    body_joint: IntArray
    """Index of the joint that moves each body; -1 where it is fixed to its parent, (B,)."""
    joint_names: tuple[str, ...]
    joint_axis: FloatArray
    """Unit axes in the frame of the body that the joint moves, through its origin, (J, 3)."""
    joint_lower: FloatArray
    """[rad], (J,)."""
    joint_upper: FloatArray
    """[rad], (J,)."""
    coupling: FloatArray
    """joints = coupling @ u for the D free variables u [rad], (J, D)."""

    # actuation
    actuator_names: tuple[str, ...]
    actuator_moment: FloatArray
    """ctrl = actuator_moment @ joints, (U, J)."""

    # contact
    contact_names: tuple[str, ...]
    contact_body: IntArray
    """Body that carries each contact point, (C,)."""
    contact_pos: FloatArray
    """Centre of the pad's contact sphere in its body's frame [m], (C, 3)."""
    contact_radius: FloatArray
    """Radius of the contact sphere: the pad touches when the centre is this far from the object
    [m], (C,)."""
    contact_normal: FloatArray
    """Outward unit normal of the pad in its body's frame, (C, 3)."""
    contact_finger: tuple[str, ...]
    """Finger of each contact point, a key of `fingers`; empty in the palm."""
    contact_part: tuple[Part, ...]
    """What each contact point is; fingertips come first."""
    fingers: dict[str, tuple[str, ...]]
    """Names of each finger's bodies, base to tip."""

    # collision model for the optimiser
    sphere_body: IntArray
    """The first spheres are the fingertips' contact spheres, in their order, (K,)."""
    sphere_pos: FloatArray
    """In the body's frame [m], (K, 3)."""
    sphere_radius: FloatArray
    """[m], (K,)."""
    self_pairs: IntArray
    """Sphere pairs that must not overlap, (P, 2)."""

    # frames and postures
    T_hand_palm: FloatArray
    """Palm frame in the hand frame: origin on the palm's surface, +z towards the object, +x
    towards the fingertips, (4, 4)."""
    posture_open: FloatArray
    """Joint angles for flat regions [rad], (J,)."""
    posture_curved: FloatArray
    """Joint angles for curved regions [rad], (J,)."""

    make_spec: Callable[[], mujoco.MjSpec] = field(repr=False)
    """Give a fresh `mujoco.MjSpec` of the hand: its root body hangs under the world body without a
    joint, and names carry no side prefix beyond those in `body_names` and `joint_names`."""
    prefix: str = ""
    """What this side's names carry before those of the spec, such as `rh_`."""
    licence_text: str = field(default="", repr=False)
    """The licence as it stands beside the source; empty where the source has no such file. What is
    derived from the source must carry it."""
    make_mounted: Callable[[str], mujoco.MjSpec] | None = field(default=None, repr=False)
    """Give a fresh `mujoco.MjSpec` of the hand cut at a body above its root (named without the
    side's prefix), as an arm carries it: with the wrist joints, their actuators and the forearm."""

    @property
    def fingertips(self) -> int:
        """Number of contact points that are fingertips: as many spheres are their contact spheres."""
        return self.contact_part.count("fingertip")

    @property
    def root_body(self) -> str:
        """Name of the body whose pose the record stores."""
        return self.body_names[0]

    @property
    def plain_body_names(self) -> tuple[str, ...]:
        """Names of the bodies as the spec has them, without the side's prefix, (B,)."""
        return tuple(name.removeprefix(self.prefix) for name in self.body_names)

    def header(self) -> HandHeader:
        """What files carry of this hand."""
        return HandHeader(
            name=self.name,
            side=self.side,
            spec_hash=self.spec_hash,
            joint_names=self.joint_names,
            contact_names=self.contact_names,
            root_body=self.root_body,
        )
