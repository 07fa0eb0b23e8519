"""Train a small regressor with a plain loop: from cloud and contact points to the palm's position.

Shows a shuffled order that resumes, a prefetch thread and augmentation. The model is small on
purpose: it is the way of the data that counts.

python examples/02_train_loop.py RELEASE
"""

from __future__ import annotations

import sys

import torch
from torch import Tensor, nn

from bidexdata.loaders import BiDexDataset, EpochSampler, ResumableLoader

GRASP = 1  # the stage: 0 pregrasp, 1 grasp, 2 squeeze


class PalmPosition(nn.Module):
    """A PointNet of two layers, and contact points beside it; gives a position (3) [m]."""

    def __init__(self, contacts: int, width: int = 64):
        super().__init__()
        self.point = nn.Sequential(nn.Linear(3, width), nn.ReLU(), nn.Linear(width, width))
        self.head = nn.Sequential(
            nn.Linear(width + 3 * contacts, width), nn.ReLU(), nn.Linear(width, 3)
        )

    def forward(self, cloud: Tensor, contact_point: Tensor) -> Tensor:
        """Predict (B, 3) from clouds (B, P, 3) and contact points (B, C, 3), all [m]."""
        # A grasp that touches with fewer points has NaN behind them.
        points = contact_point.nan_to_num().flatten(1)
        return self.head(torch.cat([self.point(cloud).amax(dim=1), points], dim=-1))


def main(release: str, epochs: int = 60, batch_size: int = 8, points: int = 256) -> None:
    """Train, stop in the middle of an epoch, and go on with what is left of it."""
    torch.random.manual_seed(0)
    data = BiDexDataset(
        release,
        fields=("hand_pos", "hand_quat_wxyz", "contact_point"),
        augment=("yaw",),
        points=points,
    )
    loader = ResumableLoader(data, batch_size, EpochSampler(len(data), seed=0), prefetch=2)
    model = PalmPosition(contacts=data[0]["contact_point"].shape[1])
    optimiser = torch.optim.Adam(model.parameters(), lr=3e-3)
    losses = []
    for epoch in range(epochs):
        data.set_epoch(epoch)  # turns every grasp anew
        total, rows = 0.0, 0
        for batch in loader:
            found = model(batch["cloud_solid"], batch["contact_point"][:, -1])
            loss = nn.functional.mse_loss(found, batch["hand_pos"][:, -1, GRASP])
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            total, rows = total + loss.item() * len(found), rows + len(found)
        losses.append(total / rows)
    print(
        f"{len(data)} grasps; mean loss of the first epoch {losses[0]:.4f}, last {losses[-1]:.4f}"
    )
    assert losses[-1] < 0.5 * losses[0]

    # A checkpoint holds where the data stood, beside the model and the optimiser.
    batches = iter(loader)
    had = len(next(batches)["hand_pos"])
    checkpoint = {"model": model.state_dict(), "data": loader.state_dict()}
    resumed = ResumableLoader(data, batch_size, EpochSampler(len(data)))
    resumed.load_state_dict(checkpoint["data"])
    left = sum(len(batch["hand_pos"]) for batch in resumed)
    print(f"resumed behind the first batch: {left} grasps are left of the epoch")
    assert had + left == (len(data) if had < len(data) else len(data) + had)


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        sys.exit(__doc__)
    main(sys.argv[1])
