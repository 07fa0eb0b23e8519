"""HandModel: a hand as a differentiable torch module, built on pytorch-kinematics.

For training losses and users' own optimisation. The production kernels are in
`kinematics_kernels.py`; both agree with MuJoCo (tests/hands/test_kinematics.py).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from bidexdata.hands.model import Hand
from bidexdata.hands.urdf import hand_urdf

if TYPE_CHECKING:
    import numpy as np


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

    Dtype and device follow the inputs.
    """

    def __init__(self, hand: Hand):
        super().__init__()
        import pytorch_kinematics

        self.hand = hand
        chain: Any = pytorch_kinematics.build_chain_from_urdf(hand_urdf(hand))
        self._chain = chain.to(dtype=torch.float64)
        names = list(chain.get_joint_parameter_names())
        # One column per joint of the chain, taken from our order.
        self._order = [hand.joint_names.index(name) for name in names]

    def forward(
        self,
        pos: Float[Tensor, "*b 3"],
        quat_wxyz: Float[Tensor, "*b 4"],
        joints: Float[Tensor, "*b J"],
    ) -> HandPose:
        """Place the hand.

        Args:
            pos: Origin of the hand frame [m].
            quat_wxyz: Its orientation; need not have unit length.
            joints: Joint angles in the order of `hand.joint_names` [rad].
        """
        batch = joints.shape[:-1]
        local = self._body_transforms(joints.reshape(-1, joints.shape[-1]))
        local = local.reshape(*batch, *local.shape[1:])
        base = rotation_matrix(quat_wxyz)
        body_rot = base[..., None, :, :] @ local[..., :3, :3]
        body_pos = (base[..., None, :, :] @ local[..., :3, 3:]).squeeze(-1) + pos[..., None, :]
        hand = self.hand

        def place(body: np.ndarray, points: np.ndarray) -> Tensor:
            index = torch.as_tensor(body, dtype=torch.long, device=joints.device)
            fixed = torch.as_tensor(points, dtype=joints.dtype, device=joints.device)
            return (body_rot[..., index, :, :] @ fixed[..., None]).squeeze(-1)

        contact_origin = body_pos[..., torch.as_tensor(hand.contact_body.copy()).long(), :]
        sphere_origin = body_pos[..., torch.as_tensor(hand.sphere_body.copy()).long(), :]
        return HandPose(
            body_pos,
            body_rot,
            contact_origin + place(hand.contact_body, hand.contact_pos),
            place(hand.contact_body, hand.contact_normal),
            sphere_origin + place(hand.sphere_body, hand.sphere_pos),
        )

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
