"""The rows of the paper's tables as runs: what each switches, in keys of `synth --set`.

The ablation takes the preset `paper` apart: its last row is the preset, and each row above it lacks
one part more. So two rows differ in the keys that are named here and in nothing else, but for the
paper's baseline, which is another method.
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


NO_REGIONS = (Change("regions.score", "random"), Change("regions.gap", 0.0))
"""Pairs of regions by lot, whatever their distance: random sampling."""
NO_R = (*NO_REGIONS, Change("optimise.energy.region", 0.0))
"""Without region initialisation: the same, and nothing that keeps contacts near their regions."""
NO_DC = (
    Change("optimise.closure.groups", "coupled"),
    Change("optimise.closure.weight_coupled", 1000.0),
)
"""Without decoupled force closure: one Q over the contacts of both hands, of the same weight."""
NO_PS = (Change("staging.opened", [0.01, 0.1]),)
"""Without pre-grasp strategies: what the paper does with grasps that have no pre-grasp."""


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

    @property
    def tests(self) -> tuple[str, ...]:
        """Tests of the protocol that its grasps are put to."""
        return ("f", "l") if self.setting == "tabletop" else ("f",)

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

    def command(self, hand: str, sizes_mm: Sequence[int], grasps: int, seed: int) -> str:
        """The command that makes such a run."""
        sizes = ",".join(f"{mm / 1000:g}" for mm in sizes_mm)
        words = ["bidexdata", "synth", "LIBRARY", "--out", "RUN", "--hand", hand, "--sizes", sizes]
        words += ["--grasps", str(grasps), "--setting", self.setting]
        words += ["--seed", str(seed)] if seed else []
        words += ["--method", self.method] if self.method != DEFAULT_METHOD else []
        words += ["--preset", self.preset] if self.preset != "default" else []
        for assignment in assignments(self.changes):
            words += ["--set", assignment]
        return shlex.join(words)


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
        says="the same on a table",
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
        name="ablation_bodex",
        title="Baseline",
        says='"a straightforward extension of BODex" to two hands: BODex\'s method on our kernels '
        "(docs/baselines.md), with the pre-grasp and squeeze that BODex has",
        setting="tabletop",
        method="bodex",
    ),
    Row(
        name="ablation_none",
        title="without R, Dc, Ps",
        says="no row of the paper: its optimisation with all three parts off, as Baseline differs "
        "from +R in more than R",
        setting="tabletop",
        preset="paper",
        changes=(*NO_R, *NO_DC, *NO_PS),
    ),
    Row(
        name="ablation_r",
        title="+R",
        says="with region initialisation: pairs of regions by the force score, and the region term",
        setting="tabletop",
        preset="paper",
        changes=(*NO_DC, *NO_PS),
    ),
    Row(
        name="ablation_r_dc",
        title="+R+Dc",
        says="with decoupled force closure: Q of each hand alone in place of one over both",
        setting="tabletop",
        preset="paper",
        changes=NO_PS,
    ),
    Row(
        name="ablation_r_dc_ps",
        title="+R+Dc+Ps",
        says="with pre-grasp strategies: the pre-grasp optimised at 1 cm, the squeeze 2 G - G_pre; "
        "this is the preset `paper` as it is",
        setting="tabletop",
        preset="paper",
    ),
)
TABLE_2 = ("bimangrasp", "ours_floating", "ours_tabletop")
"""Rows of the comparison, in the paper's order."""
TABLE_3 = (
    *("ablation_bodex", "ablation_none", "ablation_r", "ablation_r_dc", "ablation_r_dc_ps"),
    "ours_tabletop",
)
"""Rows of the ablation, the paper's in its order; what is ours last."""


def assignments(changes: Sequence[Change]) -> list[str]:
    """Changes as `--set` takes them: `KEY=VALUE`."""
    return [
        f"{c.key}={c.value if isinstance(c.value, str) else json.dumps(c.value)}" for c in changes
    ]
