"""Words about one attempt: what each stage did to it, why it failed, why it was kept or not.

Numbers are for people: millimetres, degrees. The exact ones stand in `energies.csv` and the shard.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bidexdata.frames import quat_angle
from bidexdata.record import Status
from bidexdata.synthesis.config import SynthConfig
from bidexdata.synthesis.explain import Explanation, Finished, StagePose
from bidexdata.synthesis.selection import touching
from bidexdata.synthesis.trace import TERMS, Trace
from bidexdata.wording import counted

TERM_WORDS = {
    "closure_left": "closure of the left hand",
    "closure_right": "closure of the right hand",
    "closure_coupled": "closure of both hands",
    "distance": "pad distances",
    "region": "way to the regions",
    "pad": "pad angles",
    "penetration": "hands in the object",
    "self_penetration": "hands in themselves",
}


class StageWords(NamedTuple):
    """What one stage did."""

    stage: str
    """`regions`, `start`, `approach`, `pregrasp`, `grasp`, `forces`, `squeeze`, `checks`, `reach`
    (of runs that are made for a rig), `selection` or `audit`."""
    text: str
    passed: bool | None = None
    """Whether the attempt came through; None where the stage decides nothing."""


def stage_words(one: Explanation, config: SynthConfig, grasps: int) -> list[StageWords]:
    """Say of every stage, in order, what it did; stages that were not reached are left out.

    Args:
        one: The attempt.
        config: Of the run.
        grasps: N of the attempt's round.
    """
    said = [_regions(one), *_start(one, config)]
    if one.trace is not None and one.finished is not None:
        at = {m.name: m for m in one.poses}
        said += [
            _approach(one.trace, at, config),
            _pregrasp(one, one.finished, at, config),
            _grasp(one.trace, one.finished, at, config),
            _forces(one, one.finished, config),
            _squeeze(at),
            _checks(one, one.finished, config),
            *_reach(one.finished),
        ]
    return [*said, _selection(one, config, grasps), _audit(one, grasps)]


def _regions(one: Explanation) -> StageWords:
    pairs, placed = one.attempts.pairs, one.attempts.placed
    if placed is None:
        return StageWords("regions", Status.NO_REGION_PAIR.sentence, False)
    k = int(placed.pair_index[one.number])
    distinct = [len(np.unique(points, axis=0)) for points in pairs.points[k]]
    apart = np.linalg.norm(pairs.centres[k, 0] - pairs.centres[k, 1])
    text = (
        f"pair {k + 1} of {len(pairs.score)}, score {pairs.score[k]:.3g} (the best has "
        f"{pairs.score[0]:.3g}); left {distinct[0]} points, right {distinct[1]}, "
        f"centres {_mm(float(apart))} apart"
    )
    return StageWords("regions", text, True)


def _start(one: Explanation, config: SynthConfig) -> list[StageWords]:
    placed = one.attempts.placed
    if placed is None:
        return []
    if not placed.ok[one.number]:
        drawn = counted(config.placement.draws, "draw")
        if not placed.reachable[one.number]:
            text = (
                f"{Status.NOT_REACHABLE.sentence}: in {drawn} the arms could bring the hands to no "
                "start that is clear of the table and the other hand; the last is shown"
            )
            return [StageWords("start", text, False)]
        last = "the hands meet" if placed.above[one.number] else "a hand would reach into the table"
        text = f"{Status.NO_PLACEMENT.sentence}, in {drawn}; in the last, which is shown, {last}"
        return [StageWords("start", text, False)]
    flat = one.attempts.pairs.flatness[placed.pair_index[one.number]] < config.placement.flat
    fingers = ["open" if is_flat else "curved" for is_flat in flat]
    pads = _pads(one.poses[0])
    text = f"left fingers {fingers[0]}, right {fingers[1]}; {pads}"
    return [StageWords("start", text, True)]


def _approach(trace: Trace, at: dict[str, StagePose], config: SynthConfig) -> StageWords:
    text = _descent(trace, "approach")
    if "approach" in at:
        text += f"; {_pads(at['approach'])}, wanted {_mm(config.optimise.approach.distance)}"
    return StageWords("approach", text)


def _pregrasp(
    one: Explanation, done: Finished, at: dict[str, StagePose], config: SynthConfig
) -> StageWords:
    select = config.selection
    overlaps = [
        ("object", one.found.depth[one.number], select.start_depth),
        ("themselves", done.among_hands, select.hands_depth),
    ]
    if one.attempts.scene.setting == "tabletop":
        overlaps.append(("table", done.table, select.table_depth))
    deep = ", ".join(f"{what} {_mm(d)} (limit {_mm(most)})" for what, d, most in overlaps)
    text = _descent(one.trace, "pregrasp") if one.trace else ""
    if "pregrasp" in at:
        text += f"; {_pads(at['pregrasp'])}, wanted {_mm(config.optimise.pregrasp.distance)}"
    if not np.isfinite([d for _, d, _ in overlaps]).all():
        return StageWords("pregrasp", f"{text}; {Status.NOT_FINITE.sentence}", False)
    good = all(d <= most for _, d, most in overlaps)
    return StageWords("pregrasp", f"{text}; hands in {deep}", good)


def _grasp(
    trace: Trace, done: Finished, at: dict[str, StagePose], config: SynthConfig
) -> StageWords:
    select = config.selection
    widest = max(len(gaps) for gaps in done.gaps)
    padded = np.full((1, 2, widest), np.nan)
    for h, gaps in enumerate(done.gaps):
        padded[0, h, : len(gaps)] = gaps
    near = touching(padded, select)[0]
    hands = " and ".join(
        f"{near[h]} of {len(done.gaps[h])} {side}" for h, side in enumerate(("left", "right"))
    )
    text = _descent(trace, "grasp")
    if "grasp" in at:
        text += f"; {_pads(at['grasp'])}, wanted {_mm(config.optimise.grasp.distance)}"
    text += (
        f"; {hands} contacts within {_mm(select.contact_tolerance)} "
        f"({select.contacts_needed} of each hand needed)"
    )
    return StageWords("grasp", text, bool(near.min() >= select.contacts_needed))


def _forces(one: Explanation, done: Finished, config: SynthConfig) -> StageWords:
    residual, shifted = one.found.residual[one.number], one.found.shifted[one.number]
    most, select = config.selection.largest_residual, config.selection
    pressed = [
        float(np.sum(f * n)) * scale
        for f, n, scale in zip(done.forces, done.normals_in, done.force_scale, strict=True)
    ]
    text = (
        f"residual of the wrenches: both hands {residual:.2g} (limit to be kept {most:g}), "
        f"left alone {done.residual_hand[0]:.2g}, right alone {done.residual_hand[1]:.2g}; "
        f"of contacts moved by {_mm(select.shift)} {shifted:.2g}; "
        f"the squeeze presses with {pressed[0]:.2g} N left, {pressed[1]:.2g} N right"
    )
    return StageWords("forces", text, bool(residual <= most))


def _squeeze(at: dict[str, StagePose]) -> StageWords:
    if not {"grasp", "squeeze"} <= set(at):
        return StageWords("squeeze", "aims where the grasp is")
    grasp, target = at["grasp"], at["squeeze"]
    moved = np.linalg.norm(target.position - grasp.position, axis=1)
    turned = np.degrees(quat_angle(target.quat_wxyz, grasp.quat_wxyz))
    bent = [
        np.degrees(np.abs(b - a).max()) for a, b in zip(grasp.joints, target.joints, strict=True)
    ]
    text = (
        f"aims on from the grasp: hands {_mm(moved[0])} and {_mm(moved[1])}, turned "
        f"{turned[0]:.1f} and {turned[1]:.1f} degrees, joints by up to {bent[0]:.0f} and "
        f"{bent[1]:.0f} degrees; {_pads(target)} (inside the object is negative)"
    )
    return StageWords("squeeze", text)


def _checks(one: Explanation, done: Finished, config: SynthConfig) -> StageWords:
    select = config.selection
    measured = {
        Status.PENETRATION_LEFT: (one.found.depth[one.number], select.start_depth),
        Status.SELF_PENETRATION_LEFT: (done.among_hands, select.hands_depth),
        Status.TABLE_PENETRATION: (done.table, select.table_depth),
    }
    failed = [reason for reason in done.reasons if reason is not Status.NOT_REACHABLE]
    if not failed:
        return StageWords("checks", "passed", True)
    said = []
    for reason in failed:
        depth, most = measured.get(reason, (None, 0.0))
        by = "" if depth is None else f" ({_mm(depth)}, limit {_mm(most)})"
        said.append(f"{reason.label}: {reason.sentence}{by}")
    return StageWords("checks", f"failed: {'; '.join(said)}", False)


def _reach(done: Finished) -> list[StageWords]:
    if done.arms is None:
        return []
    if done.arms is Status.OK:
        return [StageWords("reach", "the arms have a motion that takes it", True)]
    text = f"the arms cannot take it: {done.arms.label}: {done.arms.sentence}"
    return [StageWords("reach", text, False)]


def _selection(one: Explanation, config: SynthConfig, grasps: int) -> StageWords:
    found, i, select = one.found, one.number, config.selection
    if one.status is not Status.OK:
        return StageWords("selection", f"not considered: it is {one.status.label}", False)
    if one.rank is None:
        text = (
            f"not considered: the residual of both hands {found.residual[i]:.2g} is over the limit "
            f"{select.largest_residual:g}"
        )
        return StageWords("selection", text, False)
    rank = f"rank {one.rank} of {counted(len(one.order), 'attempt')} that may be kept"
    pressed, touch, turned = (float(figure[i]) for figure in found.settled)
    by = (
        f"when the hands have closed in the quasi-static model (means over four places of the "
        f"object) {touch:.1f} contacts press, without the object those of the weaker hand would go "
        f"on by {_mm(pressed)} in sum, and the object has turned {np.degrees(turned):.1f} "
        f"degrees; with the residual of moved contacts that makes a doubt of {found.doubt[i]:.3g}"
    )
    if found.depth[i] > select.clear_depth:
        clear = int(np.sum(found.depth[one.order] <= select.clear_depth))
        by += (
            f", and its pre-grasp is {1e3 * found.depth[i]:.2f} mm in the object: it comes after the "
            f"{clear} whose pre-grasps are at most {_mm(select.clear_depth)} in it"
        )
    last = one.order[: min(grasps, len(one.order))][-1]
    kept = f"the best {grasps} are kept, the last of them has {found.doubt[last]:.3g}"
    verdict = "kept" if found.selected[i] else "not kept"
    return StageWords("selection", f"{verdict}: {rank}; {by}; {kept}", bool(found.selected[i]))


def _audit(one: Explanation, grasps: int) -> StageWords:
    drawn = "drawn" if one.found.audit[one.number] else "not drawn"
    return StageWords("audit", f"{drawn} among the {grasps} attempts that lots chose beforehand")


def _descent(trace: Trace, phase: str) -> str:
    """Steps of a phase, its weighted energy before and after, and what most of it is at the end."""
    rows = [i for i, name in enumerate(trace.phase) if name == phase]
    if not rows:
        return "no steps"
    total = trace.total()
    weighted = np.nan_to_num(trace.energy[rows[-1]] * trace.weight)
    largest = [k for k in np.argsort(-weighted)[:2] if weighted[k] > 0.005 * total[rows[-1]]]
    parts = ", ".join(f"{TERM_WORDS[TERMS[k]]} {weighted[k]:.2g}" for k in largest)
    most = f" (most of it {parts})" if parts else ""
    return (
        f"{counted(len(rows), 'step')}, weighted energy {total[rows[0]]:.3g} to "
        f"{total[rows[-1]]:.2g}{most}"
    )


def _pads(pose: StagePose) -> str:
    gaps = np.concatenate(pose.gaps)
    if not np.isfinite(gaps).all():
        return "pads nowhere: not finite"
    return f"pads {1e3 * gaps.min():.1f} to {1e3 * gaps.max():.1f} mm from the surface"


def _mm(metres: float) -> str:
    # Of lengths: the depth of what is in nothing is -0.0.
    return f"{abs(metres) * 1e3:.1f}".removesuffix(".0") + " mm"
