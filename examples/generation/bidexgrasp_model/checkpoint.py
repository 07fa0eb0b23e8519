"""Checkpoints: everything that training goes on from, and all that sampling needs."""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from bidexgrasp_model.config import BadSetting, Config, from_plain
from bidexgrasp_model.data import ReleaseId
from bidexgrasp_model.model import GenerationModel

FORMAT = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class HandId:
    """The hands that a model moves, left first."""

    names: tuple[str, str]
    joint_names: tuple[tuple[str, ...], tuple[str, ...]]
    lower: tuple[tuple[float, ...], tuple[float, ...]]
    """Limits [rad]."""
    upper: tuple[tuple[float, ...], tuple[float, ...]]

    @property
    def joints(self) -> int:
        """J, of the hand with more."""
        return max(len(names) for names in self.joint_names)

    def within(self, joints: Tensor) -> Tensor:
        """Set joints (..., H, S, J) to their ranges; columns behind a hand's last joint stay."""
        parts = []
        for h, (lower, upper) in enumerate(zip(self.lower, self.upper, strict=True)):
            own, rest = joints[..., h, :, : len(lower)], joints[..., h, :, len(lower) :]
            low, high = own.new_tensor(lower), own.new_tensor(upper)
            parts.append(torch.cat([torch.minimum(torch.maximum(own, low), high), rest], dim=-1))
        return torch.stack(parts, dim=-3)


@dataclass(slots=True, kw_only=True)
class Checkpoint:
    """What one file holds. Statistics of the data are in the weights."""

    config: Config
    release: ReleaseId
    hands: HandId
    setting: str
    """Of the scenes that it was trained on: `tabletop` or `floating`."""
    where: str
    """Which grasps it was trained on."""
    step: int
    seconds: float
    """Of training, all calls together."""
    weights: dict[str, Any]
    average: dict[str, Any]
    """Running mean of the weights, which sampling uses."""
    optimiser: dict[str, Any]
    data: dict[str, Any]
    """Where the order of the cases stood."""

    def save(self, path: Path) -> None:
        """Write it whole or not at all."""
        plain = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        for name in ("config", "release", "hands"):
            plain[name] = dataclasses.asdict(plain[name])
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f".{path.name}.partial")  # one process writes it
        with open(partial, "wb") as stream:
            torch.save({"format": FORMAT, **plain}, stream)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(partial, path)

    @classmethod
    def load(cls, path: Path) -> Checkpoint:
        """Read one.

        Raises:
            BadSetting: There is none, or it is damaged or of another format.
        """
        if path.is_dir():
            path = path / "checkpoint.pt"
        if not path.is_file():
            raise BadSetting(f"{path}: no such checkpoint; `bidexgrasp-model train` makes one")
        try:
            plain = torch.load(path, map_location="cpu", weights_only=True)
            if plain.pop("format") != FORMAT:
                raise BadSetting(f"{path}: written by another version; train again")
            plain["config"] = from_plain(plain["config"])
            plain["release"] = ReleaseId(**plain["release"])
            plain["hands"] = HandId(**plain["hands"])
            return cls(**plain)
        except (RuntimeError, KeyError, TypeError, EOFError, AttributeError) as err:
            raise BadSetting(f"{path}: unreadable checkpoint ({type(err).__name__})") from err

    def model(self) -> GenerationModel:
        """The model with its averaged weights, ready to sample."""
        model = GenerationModel(self.config, self.hands.joints)
        model.load_state_dict(self.average)
        return model.eval()
