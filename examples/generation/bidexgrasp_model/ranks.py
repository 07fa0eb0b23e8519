"""Processes that train together, started by torchrun; one alone otherwise."""

from __future__ import annotations

import os

import torch
from torch import nn


class Ranks:
    """This process among others: the gradients of all are averaged before every step.

    It is the sum that DistributedDataParallel makes, without its wrapper around the model. With
    one process nothing is done.
    """

    def __init__(self, rank: int = 0, size: int = 1):
        self.rank, self.size = rank, size

    @classmethod
    def from_environment(cls, device: str) -> Ranks:
        """Join the group that torchrun announces, if there is one."""
        size = int(os.environ.get("WORLD_SIZE", "1"))
        if size == 1:
            return cls()
        gpu = device.startswith("cuda")
        if gpu:  # each process its own: "cuda" means this one from here on
            torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")))
        torch.distributed.init_process_group("nccl" if gpu else "gloo")
        return cls(torch.distributed.get_rank(), size)

    @property
    def first(self) -> bool:
        """Whether this process writes files and reports."""
        return self.rank == 0

    def average_gradients(self, model: nn.Module) -> None:
        """Replace every gradient by the mean over the processes."""
        if self.size == 1:
            return
        own = [p for p in model.parameters() if p.requires_grad]
        flat = torch.cat(
            [(torch.zeros_like(p) if p.grad is None else p.grad).reshape(-1) for p in own]
        )
        torch.distributed.all_reduce(flat)
        flat /= self.size
        at = 0
        for p in own:
            p.grad = flat[at : at + p.numel()].reshape(p.shape).clone()
            at += p.numel()

    def agreed(self, seconds: float) -> float:
        """The clock of the first process, so that all end together."""
        if self.size == 1:
            return seconds
        value = torch.tensor([seconds], dtype=torch.float64)
        if torch.distributed.get_backend() == "nccl":
            value = value.cuda()
        torch.distributed.broadcast(value, 0)
        return float(value)

    def close(self) -> None:
        """Leave the group."""
        if self.size > 1:
            torch.distributed.destroy_process_group()
