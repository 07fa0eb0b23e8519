"""A loss on the hand itself: pads to their contact points, differentiable through the joints.

`HandModel` poses the hand of a release from its joints, without MuJoCo and the hand's meshes. Here
the joints of stored grasps are disturbed, and descent on the pads' distances brings the pads back.

python examples/04_hand_losses.py RELEASE
"""

from __future__ import annotations

import sys

import torch

from bidexdata.loaders import BiDexDataset, HandModel, collate

FIELDS = (
    "hand_pos",
    "hand_quat_wxyz",
    "joints",
    "contact_point",
    "contact_normal",
    "contact_index",
)
GRASP = 1  # the stage: 0 pregrasp, 1 grasp, 2 squeeze


def main(release: str, grasps: int = 8, steps: int = 60) -> None:
    """Recover the pads of a few grasps of one hand."""
    data = BiDexDataset(release, fields=FIELDS, cloud=None)
    batch = collate(data.__getitems__(range(min(grasps, len(data)))))
    hand = len(data.sides) - 1
    model = HandModel.from_release(data.release, data.sides[hand])
    radius = torch.as_tensor(model.hand.contact_radius, dtype=torch.float32)

    pos, quat = batch["hand_pos"][:, hand, GRASP], batch["hand_quat_wxyz"][:, hand, GRASP]
    # Rows are padded to the hand with the most joints and contact points.
    index = batch["contact_index"][:, hand].long()
    there, index = index >= 0, index.clamp(min=0)
    # Padding is NaN. A mask behind a norm does not keep NaN out of its gradient: pick rows before.
    point, normal = (batch[n][:, hand][there] for n in ("contact_point", "contact_normal"))
    centres = point + radius[index[there]][:, None] * normal

    def gap(joints: torch.Tensor) -> torch.Tensor:
        pads = model(pos, quat, joints).contact_point
        chosen = pads.gather(1, index[..., None].expand(-1, -1, 3))
        return (chosen[there] - centres).norm(dim=-1)

    stored = batch["joints"][:, hand, GRASP, : len(model.joint_names)]
    noise = torch.randn(stored.shape, generator=torch.Generator().manual_seed(0))
    joints = (stored + 0.1 * noise).requires_grad_()
    before = gap(joints).mean().item()
    optimiser = torch.optim.Adam([joints], lr=0.01)
    for _ in range(steps):
        optimiser.zero_grad()
        gap(joints).square().mean().backward()
        optimiser.step()
    after = gap(joints).mean().item()
    tips = model.keypoints(model(pos, quat, stored), model.keypoint_names[:1])
    print(
        f"pads to contact points: disturbed {before * 1e3:.2f} mm, recovered {after * 1e3:.2f} mm"
    )
    print(f"{len(model.joint_names)} joints; first keypoint of each grasp {tuple(tips.shape)}")
    assert after < 0.5 * before


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        sys.exit(__doc__)
    main(sys.argv[1])
