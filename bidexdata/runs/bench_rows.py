"""The rows of the paper's tables as runs: what each switches, in keys of `synth --set`.

The ablation takes two configurations apart, the preset `paper` and our defaults: a chain's last row is
the whole, and each row above it lacks one part more. So neighbours differ in the keys that are named
here and in nothing else, but for the paper's baseline, which is another method.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from bidexdata.config import with_overrides
from bidexdata.record.scene import Setting
from bidexdata.synthesis.method_names import DEFAULT_METHOD

if TYPE_CHECKING:
    from bidexdata.synthesis.methods import MethodConfig


class Change(NamedTuple):
    """One key of a configuration that a row sets."""

    key: str
    """Dotted, as for `--set`."""
    value: Any


class Parts(NamedTuple):
    """The keys that switch the parts of the paper's ablation off, for one preset."""

    regions: tuple[Change, ...]
    """R, region initialisation."""
    decoupled: tuple[Change, ...]
    """Dc, decoupled force closure."""
    pregrasp: tuple[Change, ...]
    """Ps, pre-grasp strategies."""


NO_REGIONS = (Change("regions.score", "random"), Change("regions.gap", 0.0))
"""Pairs of regions by lot, whatever their distance: random sampling."""
_NO_R = (*NO_REGIONS, Change("optimise.energy.region", 0.0))
"""The same, and nothing that keeps contacts near their regions."""
_COUPLED = Change("optimise.closure.groups", "coupled")
"""One Q over the contacts of both hands."""
_OPENED = Change("staging.opened", [0.01, 0.1])
"""What the paper does with grasps that have no pre-grasp."""
WITHOUT = {
    "paper": Parts(
        _NO_R,
        (_COUPLED, Change("optimise.closure.weight_coupled", 1000.0)),  # that of the decoupled one
        (_OPENED,),
    ),
    "default": Parts(
        _NO_R,
        (_COUPLED,),
        (
            *(_OPENED, Change("staging.extrapolate", 1.0)),
            *(Change("staging.force_floor", 0.0), Change("staging.force_per_weight", 0.0)),
        ),
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One row of a table: a run of its own."""

    name: str
    """Of its folder."""
    title: str
    """In the tables."""
    says: str
    """What the row is, and where that is our reading of the paper."""
    setting: Setting
    method: str = DEFAULT_METHOD
    preset: str = "default"
    changes: tuple[Change, ...] = ()
    """What differs from the preset or the method's defaults."""

    def tests(self, rig: str = "") -> tuple[str, ...]:
        """Tests of the protocol that its grasps are put to; with arms where a rig is named."""
        if self.setting == "floating":
            return ("f",)
        return ("f", "l", "a") if rig else ("f", "l")

    @property
    def base(self) -> str:
        """What the changes are changes of."""
        if self.method != DEFAULT_METHOD:
            return f"method {self.method}"
        return f"preset {self.preset}"

    def config(self) -> MethodConfig:
        """The configuration of the run."""
        from bidexdata.synthesis.methods import load_method
        from bidexdata.synthesis.presets import load_preset

        method = load_method(self.method)
        base = load_preset(self.preset) if self.method == DEFAULT_METHOD else method.config()
        return with_overrides(base, assignments(self.changes))

    def command(
        self, hand: str, sizes_mm: Sequence[int], grasps: int, seed: int, rig: str = ""
    ) -> str:
        """The command that makes such a run."""
        sizes = ",".join(f"{mm / 1000:g}" for mm in sizes_mm)
        words = ["bidexdata", "synth", "LIBRARY", "--out", "RUN", "--hand", hand, "--sizes", sizes]
        words += ["--grasps", str(grasps), "--setting", self.setting]
        words += ["--rig", rig] if rig else []
        words += ["--seed", str(seed)] if seed else []
        words += ["--method", self.method] if self.method != DEFAULT_METHOD else []
        words += ["--preset", self.preset] if self.preset != "default" else []
        for assignment in assignments(self.changes):
            words += ["--set", assignment]
        return shlex.join(words)


def _ablation(name: str, title: str, preset: str) -> tuple[Row, ...]:
    """The rows of a preset that lack all three parts, two, and one."""
    off = WITHOUT[preset]
    rows = (
        ("none", "none", "R, Dc and Ps off", (*off.regions, *off.decoupled, *off.pregrasp)),
        ("r", "+R", "Dc and Ps off", (*off.decoupled, *off.pregrasp)),
        ("r_dc", "+R+Dc", "Ps off", off.pregrasp),
    )
    return tuple(
        Row(
            name=f"{name}_{end}",
            title=f"{title}{part}",
            says=f"the preset {preset!r} with {says}",
            setting="tabletop",
            preset=preset,
            changes=changes,
        )
        for end, part, says, changes in rows
    )


ROWS = (
    Row(
        name="ours_floating",
        title="Ours (Float)",
        says="the defaults of `synth`, which are not the literal paper",
        setting="floating",
    ),
    Row(
        name="ours_tabletop",
        title="Ours (TableTop)",
        says="the same on a table: in the ablation ours with R, Dc and Ps",
        setting="tabletop",
    ),
    Row(
        name="bimangrasp",
        title="BimanGrasp",
        says="BimanGrasp's method on our kernels (docs/baselines.md), with the paper's pre-grasp and "
        "squeeze for it",
        setting="floating",
        method="bimangrasp",
    ),
    Row(
        name="bodex",
        title="Baseline",
        says='"a straightforward extension of BODex" to two hands: BODex\'s method on our kernels '
        "(docs/baselines.md), with the pre-grasp and squeeze that BODex has",
        setting="tabletop",
        method="bodex",
    ),
    *_ablation("paper", "", "paper"),
    Row(
        name="paper_r_dc_ps",
        title="+R+Dc+Ps",
        says="the preset 'paper' as it is",
        setting="tabletop",
        preset="paper",
    ),
    *_ablation("ours", "Ours: ", "default"),
)
TABLE_2 = ("bimangrasp", "ours_floating", "ours_tabletop")
"""Rows of the comparison, in the paper's order."""
PAPER_CHAIN = ("paper_none", "paper_r", "paper_r_dc", "paper_r_dc_ps")
OURS_CHAIN = ("ours_none", "ours_r", "ours_r_dc", "ours_tabletop")
"""Each row has one part more than the one before."""
TABLE_3 = ("bodex", *PAPER_CHAIN, *OURS_CHAIN)
"""Rows of the ablation: the paper's in its order, and ours."""


def assignments(changes: Sequence[Change]) -> list[str]:
    """Changes as `--set` takes them: `KEY=VALUE`."""
    return [
        f"{c.key}={c.value if isinstance(c.value, str) else json.dumps(c.value)}" for c in changes
    ]
