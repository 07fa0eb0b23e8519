"""SynthConfig: the configuration of the whole synthesis, one part per stage."""

from __future__ import annotations

from dataclasses import dataclass, field

from bidexdata.synthesis.optimise_config import ClosureConfig, OptimiseConfig
from bidexdata.synthesis.placement import PlacementConfig
from bidexdata.synthesis.regions import RegionConfig
from bidexdata.synthesis.selection import SelectionConfig
from bidexdata.synthesis.staging import StagingConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class SynthConfig:
    """Everything that decides which grasps come out; no path, device, worker count or seed.

    `bidexdata.synthesis.presets` holds named diffs of the defaults.
    """

    regions: RegionConfig = field(default_factory=RegionConfig)
    placement: PlacementConfig = field(default_factory=PlacementConfig)
    optimise: OptimiseConfig = field(default_factory=OptimiseConfig)
    staging: StagingConfig = field(default_factory=StagingConfig)
    selection: SelectionConfig = field(default_factory=SelectionConfig)

    @property
    def steps(self) -> int:
        """Optimiser steps of each attempt."""
        return self.optimise.steps

    @property
    def normal_step(self) -> float:
        """Half width of the differences that give normals [m]."""
        return self.optimise.energy.normal_step

    @property
    def closure(self) -> ClosureConfig:
        """QPs whose residuals stand in the record."""
        return self.optimise.closure
