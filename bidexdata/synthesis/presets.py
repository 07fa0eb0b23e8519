"""Presets: named configurations, each a list of departures from the defaults with a reason.

The defaults are what measures best. `paper` is the literal paper; where the paper leaves a constant
open, `PAPER_OPEN` says what stands in and where it comes from.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from bidexdata.config import from_plain, merge, to_plain
from bidexdata.errors import UnknownName
from bidexdata.synthesis.config import SynthConfig


class Change(NamedTuple):
    """One departure of a preset from the defaults."""

    key: str
    """Dotted, as for `--set`."""
    value: Any
    reason: str


class Preset(NamedTuple):
    """A named configuration."""

    sentence: str
    changes: tuple[Change, ...]


class OpenConstant(NamedTuple):
    """A constant that the paper needs and does not give."""

    key: str
    source: str


_PAPER = (
    Change("regions.score", "force", "4.2: s = min over t_j of max over k of t_j . w_k"),
    Change("regions.wide", 10.0, "appendix B: pairs are dropped by the gap alone"),
    Change("placement.over", "palm", "4.2: the palm at the closest point of the dilated hull"),
    Change("placement.roll", 0.0, "appendix B: fingers as close as possible to a given direction"),
    Change("placement.tilt", 0.0, "4.2: orientation aligned with the surface normal"),
    Change("placement.shift", 0.0, "4.2: the palm at the closest point"),
    Change("placement.flat", 0.005, "appendix B: flat when V < 0.005"),
    Change("optimise.closure.groups", "decoupled", "4.3: Q of each hand alone"),
    Change("optimise.closure.disturbances", "forces", "3: six forces along +-x, +-y, +-z"),
    Change("optimise.closure.weight_decoupled", 1000.0, "6.1: w_QP"),
    Change("optimise.energy.distance", 100.0, "6.1: w_dis"),
    Change("optimise.energy.region", 50.0, "6.1: w_region"),
    Change("optimise.energy.region_distance", "points", "4.3: distance to the nearest of k points"),
    Change("optimise.energy.region_threshold", 0.01, "open in the paper; a eighth of the radius"),
    Change("optimise.energy.pad", 0.0, "the paper has no such term"),
    Change("staging.force_floor", 0.0, "4.4: the squeeze is 2 G - G_pre and nothing else"),
    Change("staging.force_per_weight", 0.0, "4.4: the squeeze knows no weight"),
)

PAPER_OPEN = (
    OpenConstant("optimise.closure.friction", "our measurement (0.1 to 0.6 differ by 3 points)"),
    OpenConstant("optimise.closure.beta", "BODex, k_lower 0.2"),
    OpenConstant("optimise.closure.gamma", "BODex, sum of five normal forces at least 1"),
    OpenConstant("optimise.closure.torque_length", "our measurement; BODex has half the diagonal"),
    OpenConstant("optimise.energy.region_threshold", "ours: a eighth of the region's radius"),
    OpenConstant("optimise.energy.penetration", "our measurement; BODex has cuRobo's cost, 100"),
    OpenConstant("optimise.energy.self_penetration", "our measurement; BODex 100"),
    OpenConstant("optimise.energy.object_margin", "our measurement"),
    OpenConstant("optimise.energy.inter_margin", "our measurement"),
    OpenConstant("optimise.energy.normal_step", "our measurement; BODex 10 to 20 mm"),
    OpenConstant("optimise.adam", "our measurement; BODex has normalised gradients, 500 steps"),
    OpenConstant("optimise.approach", "our measurement; BODex switches at 60 % of the steps"),
    OpenConstant("optimise.pregrasp", "our measurement; distance 1 cm is the paper's"),
    OpenConstant("optimise.grasp", "our measurement; BODex switches at 80 % of the steps"),
    OpenConstant("regions.force_friction", "our measurement"),
    OpenConstant("placement.standoff", "our measurement; BODex dilates by 10 cm"),
    OpenConstant("placement.clearance", "our measurement"),
    OpenConstant("staging.extrapolate", "4.4, base included; BODex squeezes with the joints alone"),
)

_PRESETS = {
    "default": Preset("what measures best on real meshes", ()),
    "paper": Preset("BiDexGrasp to the letter", _PAPER),
}


def preset_names() -> tuple[str, ...]:
    """Names that `load_preset` knows, the default first."""
    return tuple(_PRESETS)


def describe_preset(name: str) -> Preset:
    """Give a preset's sentence and changes.

    Raises:
        UnknownName: No preset has this name.
    """
    if name not in _PRESETS:
        raise UnknownName("preset", name, _PRESETS, "`bidexdata presets` lists them")
    return _PRESETS[name]


def load_preset(name: str) -> SynthConfig:
    """Build the configuration of a preset.

    Raises:
        UnknownName: No preset has this name.
    """
    plain = to_plain(SynthConfig())
    for change in describe_preset(name).changes:
        nested: Any = change.value
        for part in reversed(change.key.split(".")):
            nested = {part: nested}
        plain = merge(plain, nested)
    return from_plain(SynthConfig, plain)
