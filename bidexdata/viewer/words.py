"""Text for the page: what a grasp is, its scores and its verdict; what an object is."""

from __future__ import annotations

import html
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from bidexdata.objects.prepared import Solid
from bidexdata.pictures.captions import verdicts_words
from bidexdata.record import GraspBatch
from bidexdata.record.fields import OF_TEST
from bidexdata.runs.arm_pictures import arm_words
from bidexdata.wording import counted

if TYPE_CHECKING:
    from bidexdata.viewer.catalog import Found

# column, words, factor, unit
_SCORES = (
    ("qp_residual", "QP residual, both hands", 1.0, ""),
    ("qp_residual_shifted", "the same with moved contacts", 1.0, ""),
    ("settled_pressed", "closed, the weaker hand presses by", 1e3, "mm"),
    ("settled_touching", "closed, contacts that press", 1.0, ""),
    ("settled_turned", "closed, the object has turned", 180 / np.pi, "°"),
    ("energy_qp", "closure energy Q", 1.0, ""),
    ("energy_distance", "E_dis", 1e6, "mm²"),
    ("energy_penetration", "E_pen", 1e6, "mm²"),
    ("energy_self", "E_self", 1e6, "mm²"),
    ("energy_pad", "E_pad", 1.0, ""),
    ("region_score", "region score", 1.0, ""),
    ("pd", "penetration PD", 1e3, "mm"),
    ("spd", "self-penetration SPD", 1e3, "mm"),
    ("cdc", "contact distance consistency CDC", 1e3, "mm"),
    ("drift_pos", "drift under load", 1e3, "mm"),
    ("drift_rot", "turn under load", 180 / np.pi, "°"),
    ("load_margin", "load margin", 1.0, ""),
)
_CLEARANCES = (
    ("clear_table", "the table by"),
    ("clear_object", "the object by"),
    ("clear_arms", "each other by"),
    ("clear_self", "themselves by"),
)
_COLOURS = {True: "#18804a", False: "#be2824", None: "#6e7278"}


def verdict_html(tested: Mapping[str, GraspBatch], row: int) -> str:
    """A coloured line for each test: passed, failed and why, or not tested."""
    return "".join(
        f'<div style="color:{_COLOURS[good]};font-weight:600;font-size:0.9em;padding:0.4em 0.8em">'
        f"{html.escape(words)}</div>"
        for words, good in verdicts_words(tested, row).items()
    )


def scores_markdown(tested: Mapping[str, GraspBatch], row: int) -> str:
    """A table of the numbers that the row has; see `scores`."""
    lines = [f"| {words} | {value} |" for words, value in scores(tested, row)]
    if not lines:
        return "No scores are stored."
    return "\n".join(["| score | value |", "|---|---|", *lines])


def scores(tested: Mapping[str, GraspBatch], row: int) -> list[tuple[str, str]]:
    """Names and values of the numbers that the row has; those without a value are left out.

    What depends on the test is told per test; the rest is that of the first test that has it.
    """
    lines, batch = [], next(iter(tested.values()))
    for name, words, factor, unit in _SCORES:
        values = {
            test: factor * float(rows[name][row])
            for test, rows in tested.items()
            if name in rows and np.isfinite(rows[name][row])
        }
        if name not in OF_TEST or len(tested) == 1:
            lines += [(words, f"{value:.3g} {unit}") for value in [*values.values()][:1]]
        else:
            lines += [(f"{words}, test {t}", f"{v:.3g} {unit}") for t, v in values.items()]
    for side, value in zip(("left", "right"), _residuals(batch, row), strict=False):
        lines.append((f"QP residual, {side} hand", f"{value:.3g}"))
    return lines


def arms_markdown(batch: GraspBatch | None, row: int, why_hidden: str = "") -> str:
    """What the arms came to, how long they take and how close they come to things.

    Args:
        batch: Rows with the columns of arms; None where there are none.
        row: Which.
        why_hidden: Why the arms are not shown though there are some.
    """
    if batch is None:
        return ""
    told, good = arm_words(batch, row)
    lines = [f"arms: {told}"]
    if good:
        gaps = [
            f"{words} {1e3 * float(batch[name][row]):.0f} mm"
            for name, words in _CLEARANCES
            if np.isfinite(batch[name][row])
        ]
        lines += [f"clear of {', '.join(gaps)}"] if gaps else []
        lines.append(f"largest turn from knot to knot {float(batch['arm_step'][row]):.2f} rad")
    if why_hidden:
        lines.append(f"not shown: {why_hidden}")
    return "  \n".join(lines)


def found_markdown(found: Found) -> str:
    """How much a filter lets through."""
    objects = f"**{len(found.object_ids):,}** object{'' if len(found.object_ids) == 1 else 's'}"
    verb = "matches" if len(found.object_ids) == 1 else "match"
    if found.total is None:
        return f"{objects} {verb}."
    grasps = f"**{found.total:,}** grasp{'' if found.total == 1 else 's'}"
    return f"{grasps} of {objects} {'matches' if found.total == 1 else 'match'}."


def identity_markdown(batch: GraspBatch, row: int) -> str:
    """Ids of a grasp and the set it belongs to."""
    sets = [name for name in ("selected", "audit") if name in batch and batch[name][row]]
    lines = [
        f"grasp `{batch['grasp_id'][row]}`",
        f"{batch['size_mm'][row]} mm, {batch['setting'][row]}, attempt {batch['attempt'][row]}",
    ]
    if sets:
        lines.append(", ".join(sets))
    if "source_ref" in batch and str(batch["source_ref"][row]):
        lines.append(f"from `{batch['source_ref'][row]}`")
    return "  \n".join(lines)


def object_markdown(solid: Solid) -> str:
    """Origin and shape of an object."""
    known = solid.provenance
    lines = [f"**{solid.object_id}**"]
    for key in ("source", "licence", "author", "category"):
        if known.get(key):
            lines.append(f"{key}: {known[key]}")
    pieces, faces = len(solid.pieces), len(solid.mesh.faces)
    lines.append(f"{counted(pieces, 'convex piece')}, {counted(faces, 'face')}")
    lines += [f"⚠ {text}" for text in known.get("warnings") or ()]
    return "  \n".join(lines)


def _residuals(batch: GraspBatch, row: int) -> list[float]:
    if "qp_residual_hand" not in batch:
        return []
    return [float(v) for v in batch["qp_residual_hand"][row] if np.isfinite(v)]
