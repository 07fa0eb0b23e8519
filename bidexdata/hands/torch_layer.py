"""HandModel: a hand as a differentiable torch module, built on pytorch-kinematics.

For training losses and users' own optimisation. The production kernels are in
`kinematics_kernels.py`; both agree with MuJoCo (tests/hands/test_kinematics.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bidexdata.errors import MissingExtra, UnknownName
from bidexdata.hands.model import Hand
from bidexdata.hands.sphere_surface import sphere_surface
from bidexdata.hands.tree_file import hand_of_release
from bidexdata.hands.urdf import hand_urdf

try:
    import torch
    from torch import Tensor
except ModuleNotFoundError as err:
    raise MissingExtra("torch", "synth") from err

SURFACE_POINTS = 512
"""Points on a hand's surface unless asked otherwise: about 1 cm apart on a Shadow hand."""


class HandPose(NamedTuple):
    """What a posed hand looks like, in the frame of the base pose."""

    body_pos: Float[Tensor, "*b B 3"]
    """Origins of the bodies [m]."""
    body_rot: Float[Tensor, "*b B 3 3"]
    """Orientations of the bodies."""
    contact_point: Float[Tensor, "*b C 3"]
    """Centres of the contact spheres [m]."""
    contact_normal: Float[Tensor, "*b C 3"]
    """Outward unit normals of the pads."""
    sphere_pos: Float[Tensor, "*b K 3"]
    """Centres of the collision spheres [m]."""


class HandModel(torch.nn.Module):
    """Forward kinematics of one hand, batched and differentiable in pose and joints.

    `forward` places the bodies; `link_poses`, `keypoints` and `surface_points` read links, named
    points and a sampled surface from what it gives. Dtype and device follow the inputs.
    """

    def __init__(self, hand: Hand, *, surface_points: int = SURFACE_POINTS):
        """Build the kinematic chain.

        Args:
            hand: The hand: `load_hand(NAME, SIDE)`, or use `from_release`.
            surface_points: Points that `surface_points` gives.

        Raises:
            MissingExtra: pytorch-kinematics is not installed.
        """
        super().__init__()
        if find_spec("pytorch_kinematics") is None:
            raise MissingExtra("pytorch-kinematics", "synth")
        import pytorch_kinematics

        self.hand = hand
        chain: Any = pytorch_kinematics.build_chain_from_urdf(hand_urdf(hand))
        self._chain = chain.to(dtype=torch.float64)
        names = list(chain.get_joint_parameter_names())
        # One column per joint of the chain, taken from our order.
        self._order = [hand.joint_names.index(name) for name in names]
        body, points, normals = sphere_surface(hand, surface_points)
        count = len(hand.body_names)
        self._contacts = _Fixed(count, hand.contact_body, hand.contact_pos)
        self._pads = _Fixed(count, hand.contact_body, hand.contact_normal, turns_only=True)
        self._spheres = _Fixed(count, hand.sphere_body, hand.sphere_pos)
        self._surface = _Fixed(count, body, points)
        self._normals = _Fixed(count, body, normals, turns_only=True)

    @classmethod
    def from_release(
        cls, release: Any, side: str = "right", *, surface_points: int = SURFACE_POINTS
    ) -> HandModel:
        """Build the hand that a release was made with, from its `tree.json`: no mesh is needed.

        Args:
            release: `Release`, or the path of its folder.
            side: `left` or `right`.
            surface_points: As above.

        Raises:
            PathNotFound: The release has no hand of this side.
            Contradiction: `tree.json` does not describe a hand.
            MissingExtra: pytorch-kinematics is not installed.
        """
        root = Path(getattr(release, "path", release))
        return cls(hand_of_release(root, side), surface_points=surface_points)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Order of the joints."""
        return self.hand.joint_names

    @property
    def keypoint_names(self) -> tuple[str, ...]:
        """What `keypoints` knows: contact points, then bodies (their origins)."""
        bodies = [n for n in self.hand.body_names if n not in self.hand.contact_names]
        return (*self.hand.contact_names, *bodies)

    def forward(
        self,
        pos: Float[Tensor, "*b 3"],
        quat_wxyz: Float[Tensor, "*b 4"],
        joints: Float[Tensor, "*b _"],
    ) -> HandPose:
        """Place the hand.

        Args:
            pos: Origin of the hand frame [m].
            quat_wxyz: Its orientation; need not have unit length.
            joints: Joint angles in the order of `joint_names` [rad], (*b, J). Columns behind the
                last joint, with which rows of a data set are padded, are left out.

        Raises:
            ValueError: There are fewer angles than joints.
        """
        count = len(self.hand.joint_names)
        if joints.shape[-1] < count:
            raise ValueError(f"this hand has {count} joints, and {joints.shape[-1]} are given")
        joints = joints[..., :count]
        batch = joints.shape[:-1]
        local = self._body_transforms(joints.reshape(-1, count))
        local = local.reshape(*batch, *local.shape[1:])
        frames = _turned(rotation_matrix(quat_wxyz), local[..., :3, :])
        bodies = (frames[..., 3] + pos[..., None, :], frames[..., :3])
        fixed = (self._contacts, self._pads, self._spheres)
        return HandPose(*bodies, *(points.placed(*bodies) for points in fixed))

    def link_poses(
        self, pose: HandPose, names: Sequence[str] | None = None
    ) -> Float[Tensor, "*b L 4 4"]:
        """Poses of links as matrices.

        Args:
            pose: What `forward` gave.
            names: Bodies; all in the order of `hand.body_names` when omitted.

        Raises:
            UnknownName: The hand has no such body.
        """
        known = self.hand.body_names
        wanted = list(range(len(known))) if names is None else [_number(n, known) for n in names]
        top = torch.cat([pose.body_rot, pose.body_pos[..., None]], dim=-1)[..., wanted, :, :]
        bottom = top.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(*top.shape[:-2], 1, 4)
        return torch.cat([top, bottom], dim=-2)

    def keypoints(self, pose: HandPose, names: Sequence[str]) -> Float[Tensor, "*b n 3"]:
        """Named points [m]: contact points (the centres of their spheres) or origins of bodies.

        Raises:
            UnknownName: The hand has no such point.
        """
        every = torch.cat([pose.contact_point, pose.body_pos], dim=-2)
        known = (*self.hand.contact_names, *self.hand.body_names)
        return every[..., [_number(n, known) for n in names], :]

    def surface_points(self, pose: HandPose) -> Float[Tensor, "*b P 3"]:
        """Points on the surface of the hand's collision spheres [m], spread by area.

        They are outside all other spheres of their body.
        """
        return self._surface.placed(pose.body_pos, pose.body_rot)

    def surface_normals(self, pose: HandPose) -> Float[Tensor, "*b P 3"]:
        """Outward unit normals at `surface_points`."""
        return self._normals.placed(pose.body_pos, pose.body_rot)

    def _body_transforms(self, joints: Float[Tensor, "n J"]) -> Float[Tensor, "n B 4 4"]:
        if (self._chain.dtype, torch.device(self._chain.device)) != (joints.dtype, joints.device):
            self._chain = self._chain.to(dtype=joints.dtype, device=joints.device)
        placed = self._chain.forward_kinematics(joints[:, self._order])
        count = len(joints)
        poses = [placed[name].get_matrix().expand(count, 4, 4) for name in self.hand.body_names]
        return torch.stack(poses, dim=1)


def rotation_matrix(quat_wxyz: Float[Tensor, "*b 4"]) -> Float[Tensor, "*b 3 3"]:
    """Rotation matrices of quaternions wxyz of any length but zero."""
    w, x, y, z = torch.nn.functional.normalize(quat_wxyz, dim=-1).unbind(-1)
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], dim=-1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], dim=-1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], dim=-1),
    ]
    return torch.stack(rows, dim=-2)


def _turned(
    base: Float[Tensor, "*b 3 3"], frames: Float[Tensor, "*b B 3 4"]
) -> Float[Tensor, "*b B 3 4"]:
    """Turn frames, all of a hand by one product."""
    rows = frames.transpose(-3, -2).flatten(-2)
    return (base @ rows).unflatten(-1, (-1, 4)).transpose(-3, -2)


class _Fixed:
    """Points, or directions, that are fixed to bodies.

    A matrix (4 B, P) that is zero but where a point meets its body, so that one product places
    all points of all poses. Taking each point's own body costs several times as much.
    """

    def __init__(
        self,
        bodies: int,
        body: Int[np.ndarray, " P"],
        vectors: Float[np.ndarray, "P 3"],
        *,
        turns_only: bool = False,
    ):
        """Take points in the frames of their bodies; `turns_only` for directions."""
        weight = np.zeros((bodies, 4, len(body)))
        last = 0.0 if turns_only else 1.0
        weight[body, :3, np.arange(len(body))] = vectors
        weight[body, 3, np.arange(len(body))] = last
        self._weight = torch.from_numpy(weight.reshape(4 * bodies, -1))

    def placed(
        self, body_pos: Float[Tensor, "*b B 3"], body_rot: Float[Tensor, "*b B 3 3"]
    ) -> Float[Tensor, "*b P 3"]:
        """Where they are, bodies being there."""
        if (self._weight.dtype, self._weight.device) != (body_pos.dtype, body_pos.device):
            self._weight = self._weight.to(body_pos)
        frames = torch.cat([body_rot, body_pos[..., None]], dim=-1)
        rows = frames.transpose(-3, -2).flatten(-2)
        return (rows @ self._weight).transpose(-1, -2)


def _number(name: str, known: Sequence[str]) -> int:
    if name not in known:
        raise UnknownName("point of the hand", name, known)
    return known.index(name)
