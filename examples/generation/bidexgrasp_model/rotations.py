"""Rotations in the forms that the model needs: six numbers, matrices, vectors, quaternions."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor


def matrix_from_six(six: Float[Tensor, "*b 6"]) -> Float[Tensor, "*b 3 3"]:
    """Rotation matrix of its first two columns, which need be neither unit nor orthogonal.

    Source:
        Zhou et al. 2019, On the Continuity of Rotation Representations in Neural Networks.
    """
    a, b = six[..., :3], six[..., 3:]
    x = torch.nn.functional.normalize(a, dim=-1, eps=1e-8)
    y = b - (x * b).sum(-1, keepdim=True) * x
    y = torch.nn.functional.normalize(y, dim=-1, eps=1e-8)
    return torch.stack([x, y, torch.linalg.cross(x, y)], dim=-1)


def six_from_matrix(R: Float[Tensor, "*b 3 3"]) -> Float[Tensor, "*b 6"]:
    """First two columns of a rotation matrix, one after the other."""
    return torch.cat([R[..., 0], R[..., 1]], dim=-1)


def matrix_from_vector(vector: Float[Tensor, "*b 3"]) -> Float[Tensor, "*b 3 3"]:
    """Rotation by |vector| about vector (Rodrigues); smooth at zero."""
    angle = vector.norm(dim=-1)[..., None, None]
    K = _cross_matrix(vector)
    sin = torch.sinc(angle / torch.pi)
    half = torch.sinc(angle / (2 * torch.pi))
    eye = torch.eye(3, dtype=vector.dtype, device=vector.device)
    return eye + sin * K + 0.5 * half**2 * (K @ K)


def vector_from_matrix(R: Float[Tensor, "*b 3 3"]) -> Float[Tensor, "*b 3"]:
    """Rotation vector of a matrix, of length at most pi."""
    quat = quat_from_matrix(R)
    w, v = quat[..., :1], quat[..., 1:]
    length = v.norm(dim=-1, keepdim=True)
    angle = 2 * torch.atan2(length, w)
    scale = torch.where(length > 1e-9, angle / length.clamp(min=1e-9), torch.full_like(length, 2.0))
    return scale * v


def quat_from_matrix(R: Float[Tensor, "*b 3 3"]) -> Float[Tensor, "*b 4"]:
    """Unit quaternion wxyz with w >= 0, by the largest of four numerators (Shepperd, 1978)."""
    m = R.reshape(*R.shape[:-2], 9)
    xx, xy, xz, yx, yy, yz, zx, zy, zz = m.unbind(-1)
    rows = torch.stack(
        [
            torch.stack([1 + xx + yy + zz, zy - yz, xz - zx, yx - xy], -1),
            torch.stack([zy - yz, 1 + xx - yy - zz, yx + xy, xz + zx], -1),
            torch.stack([xz - zx, yx + xy, 1 - xx + yy - zz, zy + yz], -1),
            torch.stack([yx - xy, xz + zx, zy + yz, 1 - xx - yy + zz], -1),
        ],
        dim=-2,
    )
    best = torch.diagonal(rows, dim1=-2, dim2=-1).argmax(-1)
    chosen = rows.gather(-2, best[..., None, None].expand(*best.shape, 1, 4)).squeeze(-2)
    quat = torch.nn.functional.normalize(chosen, dim=-1)
    return torch.where(quat[..., :1] < 0, -quat, quat)


def matrix_from_quat(quat_wxyz: Float[Tensor, "*b 4"]) -> Float[Tensor, "*b 3 3"]:
    """Rotation matrix of a quaternion wxyz of any length but zero."""
    w, x, y, z = torch.nn.functional.normalize(quat_wxyz, dim=-1).unbind(-1)
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
    ]
    return torch.stack(rows, dim=-2)


def _cross_matrix(v: Float[Tensor, "*b 3"]) -> Float[Tensor, "*b 3 3"]:
    x, y, z = v.unbind(-1)
    o = torch.zeros_like(x)
    rows = [torch.stack(r, -1) for r in ((o, -z, y), (z, o, -x), (-y, x, o))]
    return torch.stack(rows, dim=-2)
