"""Presets: named configurations, each a list of departures from the defaults with a reason.

The defaults are what measures best. `paper` is the literal paper: `_PAPER` sets what the
paper has otherwise or has not, `PAPER_GIVEN` names the defaults that are the paper's own values,
`PAPER_OPEN` what stands in where the paper leaves a constant open, and `PAPER_IDLE` what has no
effect once the rest is set. Together they name every field of `SynthConfig`. "Measurements, n" is
docs/measurements.md, section n: found beside the default weights, not beside the paper's.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from bidexdata.config import from_plain, merge, to_plain
from bidexdata.errors import UnknownName
from bidexdata.synthesis.config import SynthConfig
from bidexdata.synthesis.selection import KEEP_EVERYTHING
from bidexdata.synthesis.staging import PLAIN_SQUEEZE


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


class Kept(NamedTuple):
    """A field that the preset `paper` leaves at its default, and why."""

    key: str
    """Dotted; a part of the configuration stands for all its fields."""
    source: str


def _changes_to(part: str, config: Any, **reasons: str) -> tuple[Change, ...]:
    """Changes of a part of the configuration to the values of another, with a reason each."""
    return tuple(Change(f"{part}.{n}", getattr(config, n), why) for n, why in reasons.items())


_PAPER = (
    Change(
        "regions.score",
        "force",
        "4.2: s = min over t_j of max over k of t_j . w_k; the maximum exact, not TDG's estimate",
    ),
    Change("regions.same_side", -2.0, "4.2: all points within the radius, either sheet"),
    Change("regions.wide", 10.0, "appendix B: pairs are dropped by the gap alone"),
    Change("regions.depth", 10.0, "appendix B: pairs are dropped by the gap alone"),
    Change("regions.facing", -2.0, "appendix B: pairs are dropped by the gap alone"),
    Change("regions.least_accessible", 2, "every region is accessible; the least value"),
    Change("regions.diversity", 0.0, "4.2: the best pairs, however alike"),
    Change("placement.contacts", ("fingertips",), "limitations: contacts at the fingertips alone"),
    Change("placement.over", "palm", "4.2: the palm at the closest point of the dilated hull"),
    Change("placement.roll", 0.0, "appendix B: fingers as close as possible to a given direction"),
    Change("placement.tilt", 0.0, "4.2: orientation aligned with the surface normal"),
    Change("placement.shift", 0.0, "4.2: the palm at the closest point"),
    Change("placement.repeats", "region", "4.2: initial poses are sampled within the regions"),
    Change("regions.sets", 1, "4.2: N contacts are drawn once"),
    Change(
        "regions.sides",
        "preferred",
        "open in the paper; ours, as appendix B prefers a direction for each hand",
    ),
    Change("placement.flat", 0.005, "appendix B: flat when V < 0.005"),
    Change("placement.table_fingers", "preferred", "appendix B: the direction is given per hand"),
    Change("optimise.closure.groups", "decoupled", "4.3: Q of each hand alone"),
    Change("optimise.closure.disturbances", "forces", "3: six forces along +-x, +-y, +-z"),
    Change(
        "optimise.closure.qp.cone_sides", 8, "appendix A: cones are discretised; 8 sides as BODex"
    ),
    Change("optimise.closure.shift", 0.0, "4.3: forces act where the fingers touch"),
    Change("optimise.closure.weight_decoupled", 1000.0, "6.2: w_QP"),
    Change("optimise.energy.distance", 100.0, "6.2: w_dis"),
    Change("optimise.energy.region", 50.0, "6.2: w_region"),
    Change(
        "optimise.energy.region_distance",
        "points",
        "appendix B: d_i = min over r in R of |c_iw - r|",
    ),
    Change(
        "optimise.energy.region_threshold",
        0.01,
        "open in the paper; ours, an eighth of the radius (measurements, 23)",
    ),
    Change("optimise.energy.pad", 0.0, "the paper has no such term"),
    *_changes_to(
        *("staging", PLAIN_SQUEEZE),
        extrapolate="4.4: 2 G - G_pre, base included; BODex moves joints alone",
        base_lead="4.4: the squeeze knows no weld",
        force_floor="4.4: the squeeze is 2 G - G_pre and nothing else",
        force_per_weight="4.4: the squeeze knows no weight",
    ),
    *_changes_to(
        *("selection", KEEP_EVERYTHING),
        candidates_per_grasp="the paper keeps what it makes",
        start_depth="no attempt is dropped before the simulation",
        hands_depth="no attempt is dropped before the simulation",
        table_depth="no attempt is dropped before the simulation",
        clear_depth="no attempt is preferred for its depth",
        largest_residual="no attempt is dropped before the simulation",
        apart="no attempt is preferred for being unlike others",
        contacts_needed="no attempt is dropped before the simulation",
    ),
)

PAPER_GIVEN = (
    Kept("regions.anchors", "4.2: K_a = 200"),
    Kept("regions.radius", "4.2: 8 cm"),
    Kept(
        "regions.points",
        "4.2: k = 256; above 0.4 m some of them repeat, unless the library is denser "
        "(`prepare --set surface.points=24000`)",
    ),
    Kept("regions.contacts", "4.2: N = 5"),
    Kept("regions.gap", "appendix B: tau_2 = 5 cm"),
    Kept("regions.kept", "4.2: K_r = 40"),
    Kept("placement.pairs", "4.2: all K_r pairs"),
    Kept("placement.table_contacts", "limitations: contacts at the fingertips alone"),
    Kept("placement.left_direction", "appendix B: (1, -1, -1)"),
    Kept("placement.right_direction", "appendix B: (1, 1, -1)"),
    Kept("optimise.closure.qp.cap", "appendix A: normal forces up to 1"),
    Kept("staging.density", "6.1: 2.5 kg/m^3"),
    Kept("staging.opened", "4.4: the pre-grasp is synthesised, not made of the grasp"),
)

PAPER_OPEN = (
    Kept("optimise.closure.qp.mu", "measurements, 3 (0.1 to 0.6 differ by 3 points)"),
    Kept("optimise.closure.qp.beta", "BODex, k_lower 0.2"),
    Kept("optimise.closure.qp.gamma", "BODex, sum of five normal forces at least 1"),
    Kept("optimise.closure.torque_length", "measurements, 4; BODex has half the diagonal"),
    Kept("optimise.closure.least_torque_length", "measurements, 4"),
    Kept("optimise.closure.iterations", "measurements, 3; the paper has a QP solver"),
    Kept("optimise.closure.start_iterations", "measurements, 3"),
    Kept(
        "optimise.energy.penetration",
        "no weight in the paper; measurements, 3, beside w_QP = 10 and not adapted to 1000; BODex "
        "has cuRobo's cost, 100",
    ),
    Kept(
        "optimise.energy.self_penetration",
        "no weight in the paper; measurements, 4, not adapted to w_QP = 1000; BODex 100",
    ),
    Kept("optimise.energy.object_margin", "measurements, 15"),
    Kept(
        "optimise.energy.contact_margin",
        "ours, that of the other spheres; BODex lets contact spheres 2 mm in (measurements, 23)",
    ),
    Kept("optimise.energy.table_margin", "ours, that of the object"),
    Kept("optimise.energy.self_margin", "BODex, activation 2 mm"),
    Kept("optimise.energy.inter_margin", "measurements, 4"),
    Kept("optimise.energy.normal_step", "measurements, 4; BODex 10 to 20 mm"),
    Kept("optimise.adam", "measurements, 4; BODex has normalised gradients, 500 steps"),
    # The paper has one objective (4.3) and does not say how the pre-grasp of 4.4 comes into it.
    Kept(
        "optimise.approach",
        "measurements, 4; alone has Q, E_dis and E_region at once, as BODex until 60 % of the steps; E_dis "
        "aims at 1 cm there, as BODex's, and at the surface in 4.3 (measurements, 23)",
    ),
    Kept(
        "optimise.pregrasp",
        "measurements, 4; no Q and E_region but frozen contact points, as BODex from 60 %; distance "
        "1 cm is the paper's",
    ),
    Kept(
        "optimise.grasp",
        "measurements, 4, with 70 steps for 20 (ours: closer fingers); the same points, as BODex "
        "from 80 %",
    ),
    Kept("regions.force_friction", "measurements, 4"),
    Kept("placement.standoff", "measurements, 4; BODex dilates by 10 cm"),
    Kept("placement.clearance", "measurements, 4, the margin between hands"),
    Kept("placement.table_raise", "ours: the paper does not say how starts clear a table"),
    Kept("regions.table_reach", "ours: the paper does not say what a table makes inaccessible"),
    Kept("regions.table_fingertip", "ours: the paper does not say what a table makes inaccessible"),
    Kept("placement.draws", "ours: draws before an attempt counts as not placeable"),
)

PAPER_IDLE = (
    Kept("regions.reranked", "of the torque score, which is off"),
    Kept("regions.iterations", "of the torque score, which is off"),
    Kept("regions.disturbances", "of the torque score, which is off"),
    Kept("regions.refined", "of the torque score, which is off"),
    Kept("regions.qp", "of the torque score, which is off"),
    Kept("placement.table_roll", "of fingers down, which is off"),
    Kept("optimise.closure.weight_coupled", "of the coupled group, which is off"),
    Kept("optimise.closure.turns", "of a shift that is zero"),
    Kept("optimise.energy.pad_cosine", "of the pad term, which is off"),
    Kept("staging.stiffness", "of the joint torques, which are off"),
    Kept("staging.mass", "of the joint torques, which are off"),
    Kept("staging.largest_offset", "of the joint torques, which are off"),
    Kept("selection.residual_iterations", "of a residual that only stands in the record"),
    Kept("selection.contact_tolerance", "of a check that is off"),
    Kept("selection.shift", "of an order that keeps everything"),
    Kept("selection.weight", "of an order that keeps everything"),
    Kept("selection.shifted_sets", "of an order that keeps everything"),
    Kept("selection.shifted_iterations", "of an order that keeps everything"),
    Kept("selection.settling.aside", "of an order that keeps everything"),
    Kept("selection.settling.friction", "of an order that keeps everything"),
    Kept("selection.settling.closing_moves", "of an order that keeps everything"),
    Kept("selection.settling.pressing_moves", "of an order that keeps everything"),
    Kept("selection.settling.waiting_moves", "of an order that keeps everything"),
    Kept("selection.settling.repeats", "of an order that keeps everything"),
    Kept("selection.settling.stride", "of an order that keeps everything"),
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


def source_of(key: str) -> str:
    """Say where the default of a key is from; empty where only the field's own text does."""
    kept = (k for k in (*PAPER_GIVEN, *PAPER_OPEN) if key == k.key or key.startswith(f"{k.key}."))
    return next((k.source for k in kept), "")


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
