"""The same regressor with PyTorch Lightning: it drives the loader, and ranks share the order.

Needs `pip install lightning`.

python examples/03_train_lightning.py RELEASE
"""

from __future__ import annotations

import logging
import sys
import warnings
from typing import Any

import lightning
import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader

from bidexdata.loaders import BiDexDataset, EpochSampler, collate

GRASP = 1  # the stage: 0 pregrasp, 1 grasp, 2 squeeze


class PalmRegressor(lightning.LightningModule):
    """From cloud and contact points to the position of the last hand's root body [m]."""

    def __init__(self, contacts: int, width: int = 64):
        super().__init__()
        self.point = nn.Sequential(nn.Linear(3, width), nn.ReLU(), nn.Linear(width, width))
        self.head = nn.Sequential(
            nn.Linear(width + 3 * contacts, width), nn.ReLU(), nn.Linear(width, 3)
        )
        self.losses: list[float] = []

    def forward(self, cloud: Tensor, contact_point: Tensor) -> Tensor:
        """Predict (B, 3) from clouds (B, P, 3) and contact points (B, C, 3), all [m]."""
        # A grasp that touches with fewer points has NaN behind them.
        points = contact_point.nan_to_num().flatten(1)
        return self.head(torch.cat([self.point(cloud).amax(dim=1), points], dim=-1))

    def training_step(self, batch: dict[str, Any], _: int) -> Tensor:
        """Mean squared error of a batch."""
        found = self(batch["cloud_solid"], batch["contact_point"][:, -1])
        loss = nn.functional.mse_loss(found, batch["hand_pos"][:, -1, GRASP])
        self.losses.append(loss.item())
        return loss

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """Adam."""
        return torch.optim.Adam(self.parameters(), lr=3e-3)


class Grasps(lightning.LightningDataModule):
    """Rows of a release; each rank gets its share of one global order."""

    def __init__(self, data: BiDexDataset, batch_size: int):
        super().__init__()
        self.data, self.batch_size = data, batch_size

    def train_dataloader(self) -> DataLoader[Any]:
        """Give the loader of this rank."""
        trainer, data = self.trainer, self.data
        assert trainer is not None
        ranks = {"rank": trainer.global_rank, "world_size": trainer.world_size}
        sampler = EpochSampler(len(data), seed=0, **ranks)
        every: Any = data  # has what a data set of torch needs, without being one
        return DataLoader(every, self.batch_size, sampler=sampler, collate_fn=collate)


def main(release: str, epochs: int = 60, batch_size: int = 8, points: int = 256) -> None:
    """Train and see the loss fall."""
    lightning.seed_everything(0, verbose=False)
    logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
    warnings.filterwarnings("ignore", message=".*does not have many workers.*")
    trainer = lightning.Trainer(
        max_epochs=epochs,
        accelerator="cpu",
        devices=1,
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        use_distributed_sampler=False,  # the sampler knows its rank
    )
    data = BiDexDataset(release, fields=("hand_pos", "contact_point"), points=points)
    model = PalmRegressor(contacts=data[0]["contact_point"].shape[1])
    trainer.fit(model, Grasps(data, batch_size))
    per_epoch = torch.tensor(model.losses).reshape(epochs, -1).mean(dim=1)
    print(f"mean loss of the first epoch {per_epoch[0]:.5f}, of the last {per_epoch[-1]:.5f}")
    assert per_epoch[-1] < 0.5 * per_epoch[0]


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        sys.exit(__doc__)
    main(sys.argv[1])
