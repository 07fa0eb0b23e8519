"""The figures of a run or release as lines for a person."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bidexdata.cli.report import counts_text, percent, table
from bidexdata.wording import counted, share

KEPT_MEANS = "kept = selected grasps / grasps wanted"
LEGEND = (
    f"{KEPT_MEANS}; selected = passed / kept grasps; unselected = passed / attempts drawn before "
    "any filter; object success = scenes with a selected grasp that passed; PD, SPD = deepest overlap hand-object, within and between hands; "
    "CDC = range of finger-object distances; D = share of the grasps' variance in one direction, "
    "small is diverse"
)

_STAGE_HEADS = {
    "regions": "no region pair",
    "placement": "no start",
    "reach": "out of reach",
    "optimisation": "not finite",
    "checks": "fails a check",
    "ok": "ok",
}
_ENERGY_HEADS = {
    "energy_qp": "closure",
    "energy_distance": "distance m2",
    "energy_region": "region m",
    "energy_pad": "pad",
    "energy_penetration": "penetration m2",
    "energy_self": "self m2",
    "qp_residual": "residual",
    "qp_residual_shifted": "of moved contacts",
}


def figure_lines(
    figures: Mapping[str, Any],
    protocol: str = "",
    untested: str = "not validated yet",
    *,
    rig: str = "",
) -> list[str]:
    """Counts, rates over everything, one line per size, and what the words mean.

    Args:
        figures: From `formats.figures`.
        protocol: Whose verdicts they count; empty when nothing is validated.
        untested: What to say where no rate is defined.
        rig: Whose arms tests with arms were run with.
    """
    from bidexdata.formats.figures import rows_text
    from bidexdata.record.fields import TESTS

    lines = [
        f"{rows_text(figures)} of {counted(figures['objects'], 'object')} "
        f"in {counted(figures['scenes'], 'scene')}",
    ]
    if figures["by_status"]:  # nothing is known of the attempts behind imported rows
        lines.append(f"attempts (before any test): {counts_text(figures['by_status'])}")
    ordered = sorted(figures["tests"].items(), key=lambda item: TESTS.index(item[0]))
    tested = {t: v for t, v in ordered if v["selected"]["n"] or v["by_verdict"]}
    for test, found in tested.items():
        rates = f"selected {percent(found['selected'])}"
        if figures["kept"] is not None:
            rates += f" with {share(figures['kept'])} kept"
            rates += f"; unselected {percent(found['unselected'])}"
        if "object_success" in found:  # releases packed before do not state it
            rates += f"; object success {percent(found['object_success'])}"
        lines += [
            f"{named_test(test, protocol, rig)}: {rates}",
            *_verdict_lines(found),
            *_arm_lines(found),
        ]
    if tested:
        lines.append(
            f"means over selected: {_lengths(figures)}; "
            f"D {share(figures['d'])} (scale-free {share(figures['d_scale_free'])}{_of_audit(figures)})"
        )
    else:
        kept = figures["kept"]
        wanted = "" if kept is None else f"kept {share(kept)} of the wanted grasps; "
        lines.append(wanted + untested)
    legend = LEGEND if tested else KEPT_MEANS
    known = figures["kept"] is not None
    apart = figures.get("by_setting", {})  # releases packed before do not state it
    if len(apart) < 2:
        lines += _by_size(figures, list(tested))
    for setting, found in apart.items() if len(apart) > 1 else ():
        lines += _of_setting(setting, found, list(tested))
    return [*lines, *([legend] if known else [])]


def named_test(test: str, protocol: str, rig: str = "") -> str:
    """`test a of paper-1, arms of ur10e_post`; other tests know no arms."""
    from bidexdata.record.fields import WITH_ARMS

    arms = f", arms of {rig}" if rig and test in WITH_ARMS else ""
    return f"test {test} of {protocol}{arms}"


def _verdict_lines(found: Mapping[str, Any]) -> list[str]:
    """Rows per verdict: of the selected ones, where that is stated, and of all that are stored."""
    chosen = found.get("by_verdict_selected")  # of runs
    every = f"verdicts of all {counted(sum(found['by_verdict'].values()), 'row')}: "
    every += counts_text(found["by_verdict"])
    if not chosen or chosen == found["by_verdict"]:
        return [every]
    return [
        f"verdicts of {counted(sum(chosen.values()), 'selected row')}: {counts_text(chosen)}",
        every,
    ]


def _of_setting(setting: str, found: Mapping[str, Any], tests: list[str]) -> list[str]:
    """Counts and means of one setting, and a line per size."""
    from bidexdata.formats.metric_text import metric_text
    from bidexdata.record.fields import HEADLINE

    run = [test for test in tests if found[f"selected_{test}"]["n"]]
    head = f"{setting}: {counted(found['scenes'], 'scene')}, "
    head += f"{counted(found['selected_rows'], 'selected row')}, "
    head += counted(found["audit_rows"], "audit row")
    if found["kept"] is not None:
        head += f"; {share(found['kept'])} kept"
    for test in run:
        head += f"; test {test}: selected {percent(found[f'selected_{test}'])}"
        if found["kept"] is not None:
            head += f", unselected {percent(found[f'unselected_{test}'])}"
    means = {name: {"mean": found[name]} for name in HEADLINE if found[name] is not None}
    text = [f"{name.upper()} {metric_text(name, mean, unit=True)}" for name, mean in means.items()]
    return ["; ".join([head, *text]), *_by_size(found, run)]


def _arm_lines(found: Mapping[str, Any]) -> list[str]:
    """What of a test's loss is the arms'; nothing for tests without arms."""
    if "reachable" not in found:
        return []
    said = []
    for kind in ("selected", "unselected"):
        every, given, lift = (
            found[name][kind] for name in ("reachable", "given_reachable", "lift_given_reachable")
        )
        if every["n"]:
            floating = f" (test l of the same rows: {percent(lift)})" if lift["n"] else ""
            said.append(
                f"{kind}: reachable {percent(every)}; given reachable {percent(given)}{floating}"
            )
    return said


def _of_audit(figures: Mapping[str, Any]) -> str:
    """`, audit rows 31.0 %`; empty where there are none, or a release of before does not say."""
    d = figures.get("d_audit")
    return "" if d is None else f", audit rows {share(d)}"


def attempt_lines(by_size: Mapping[str, Any]) -> list[str]:
    """Where attempts ended, a line per size; none where nothing is known of attempts.

    Args:
        by_size: Per `size_mm` as text, with `by_stage` in each.
    """
    from bidexdata.formats.figures import size_text

    known = {size: found["by_stage"] for size, found in by_size.items() if found.get("by_stage")}
    if not any(sum(stages.values()) for stages in known.values()):
        return []
    heads = {n: t for n, t in _STAGE_HEADS.items() if any(n in stages for stages in known.values())}
    rows = [["size", "attempts", *heads.values()]]
    for size, stages in known.items():
        ended = [str(stages.get(name, 0)) for name in heads]
        rows.append([size_text(size), str(sum(stages.values())), *ended])
    return ["where attempts ended:", *table(rows)]


def energy_lines(by_size: Mapping[str, Any]) -> list[str]:
    """Mean energies of the selected grasps, a line per size; none where rows have none.

    Args:
        by_size: Per `size_mm` as text, with `energies` in each.
    """
    from bidexdata.formats.figures import size_text

    known = {size: found.get("energies", {}) for size, found in by_size.items()}
    if not any(value is not None for means in known.values() for value in means.values()):
        return []
    rows = [["size", *_ENERGY_HEADS.values()]]
    for size, means in known.items():
        numbers = [means.get(name) for name in _ENERGY_HEADS]
        rows.append([size_text(size), *("-" if x is None else f"{x:.2e}" for x in numbers)])
    return ["energies of selected grasps, unweighted means:", *table(rows)]


def _lengths(figures: Mapping[str, Any]) -> str:
    """`PD 0.90 mm (0.81-1.02), SPD ...`; figures of older releases have no intervals."""
    from bidexdata.formats.metric_text import metric_text
    from bidexdata.record.fields import HEADLINE

    every = (test.get("metrics") for test in figures["tests"].values())
    metrics = next(filter(None, every), {})
    return ", ".join(
        f"{name.upper()} {metric_text(name, metrics.get(name, {'mean': figures[name]}), unit=True)}"
        for name in HEADLINE
    )


def _by_size(figures: Mapping[str, Any], tests: list[str]) -> list[str]:
    from bidexdata.formats.figures import size_text

    whole = figures["kept"] is not None  # imported rows have neither kept nor unselected
    head = ["size", *(["kept"] if whole else [])]
    for test in tests:
        head += [f"selected {test}", *([f"unselected {test}"] if whole else [])]
    rows = [head]
    for size, found in figures["by_size"].items():
        row = [size_text(size), *([share(found["kept"])] if whole else [])]
        for test in tests:
            row.append(percent(found[f"selected_{test}"]))
            if whole:
                row.append(percent(found[f"unselected_{test}"]))
        rows.append(row)
    return table(rows)
