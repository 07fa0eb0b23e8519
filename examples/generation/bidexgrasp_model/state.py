"""The numbers that the diffusion makes: a grasp of both hands relative to their anchors.

Per hand: dt (3), dr as six numbers, the J joints; then for pre-grasp and squeeze each what differs
from the grasp: a shift (3) and a rotation vector (3) in the grasp's hand frame, and J joints. The
paper's model gives one grasp and leaves open how the other stages follow; `bidexdata validate`
needs all three, so they are predicted too (facts, 4: trajectories of three poses, as in DexLearn).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from bidexgrasp_model.anchors import Anchor, to_relative, to_world
from bidexgrasp_model.rotations import (
    matrix_from_six,
    matrix_from_vector,
    six_from_matrix,
    vector_from_matrix,
)

PREGRASP, GRASP, SQUEEZE = 0, 1, 2
_OTHERS = (PREGRASP, SQUEEZE)
_LEAST = (0.005, 0.02, 0.02)
"""Smallest spread that numbers are divided by: lengths [m], rotations [-] and angles [rad]. Ours:
what hardly varies in the data would otherwise count as much as what does."""


class Poses(NamedTuple):
    """Both hands at all stages, in the world."""

    pos: Float[Tensor, "*b H S 3"]
    """[m]."""
    rot: Float[Tensor, "*b H S 3 3"]
    joints: Float[Tensor, "*b H S J"]
    """[rad]."""


class Layout(NamedTuple):
    """Where which numbers stand in a state of D = 9 + J + 2 (6 + J)."""

    joints: int

    @property
    def width(self) -> int:
        """D."""
        return 9 + self.joints + 2 * (6 + self.joints)

    @property
    def groups(self) -> dict[str, slice]:
        """The parts that the parameter loss is taken of separately."""
        end = 9 + self.joints
        return {
            "translation": slice(0, 3),
            "rotation": slice(3, 9),
            "joints": slice(9, end),
            "stages": slice(end, self.width),
        }

    def least(self) -> Float[Tensor, " D"]:
        """Smallest spread of each number."""
        length, turn, angle = _LEAST
        one = [length] * 3 + [turn] * 6 + [angle] * self.joints
        other = [length] * 3 + [turn] * 3 + [angle] * self.joints
        return torch.tensor(one + 2 * other)


def encode(poses: Poses, anchor: Anchor) -> Float[Tensor, "*b H D"]:
    """Give the state of grasps.

    Args:
        poses: Of all stages.
        anchor: Of each hand, (*b, H).
    """
    dt, dr = to_relative(anchor, poses.pos[..., GRASP, :], poses.rot[..., GRASP, :, :])
    parts = [dt, six_from_matrix(dr), poses.joints[..., GRASP, :]]
    grasp = Anchor(poses.pos[..., GRASP, :], poses.rot[..., GRASP, :, :])
    for stage in _OTHERS:
        shift, turn = to_relative(grasp, poses.pos[..., stage, :], poses.rot[..., stage, :, :])
        on = poses.joints[..., stage, :] - poses.joints[..., GRASP, :]
        parts += [shift, vector_from_matrix(turn), on]
    return torch.cat(parts, dim=-1)


def decode(state: Float[Tensor, "*b H D"], anchor: Anchor, layout: Layout) -> Poses:
    """Give the grasps of states; the inverse of `encode`."""
    J = layout.joints
    pos, rot = grasp_pose(state, anchor)
    joints = state[..., 9 : 9 + J]
    stages = {GRASP: (pos, rot, joints)}
    for number, stage in enumerate(_OTHERS):
        rest = state[..., 9 + J + number * (6 + J) :]
        moved = to_world(Anchor(pos, rot), rest[..., :3], matrix_from_vector(rest[..., 3:6]))
        stages[stage] = (*moved, joints + rest[..., 6 : 6 + J])
    ordered = [stages[s] for s in (PREGRASP, GRASP, SQUEEZE)]
    return Poses(
        torch.stack([p for p, _, _ in ordered], dim=-2),
        torch.stack([R for _, R, _ in ordered], dim=-3),
        torch.stack([q for _, _, q in ordered], dim=-2),
    )


def grasp_pose(
    state: Float[Tensor, "*b H D"], anchor: Anchor
) -> tuple[Float[Tensor, "*b H 3"], Float[Tensor, "*b H 3 3"]]:
    """World pose of each wrist at the grasp."""
    return to_world(anchor, state[..., :3], matrix_from_six(state[..., 3:9]))


class Scale(NamedTuple):
    """Mean and spread of states over the training data, (H, D); stored in every checkpoint."""

    mean: Float[Tensor, "H D"]
    std: Float[Tensor, "H D"]

    @classmethod
    def of(cls, states: Float[Tensor, "n H D"], layout: Layout) -> Scale:
        """Measure them."""
        std = states.std(dim=0, correction=0)
        return cls(states.mean(dim=0), torch.maximum(std, layout.least().to(std)))

    def normalised(self, state: Float[Tensor, "*b H D"]) -> Float[Tensor, "*b H D"]:
        """Mean 0 and spread 1."""
        return (state - self.mean) / self.std

    def restored(self, state: Float[Tensor, "*b H D"]) -> Float[Tensor, "*b H D"]:
        """The inverse of `normalised`."""
        return state * self.std + self.mean
