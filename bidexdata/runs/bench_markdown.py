"""The tables as Markdown: a pure function of the figures in tables.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bidexdata.record.fields import HEADLINE
from bidexdata.runs.bench_paper import DATASETS

Cells = list[str]

LEGEND = (
    "A rate or mean is followed by its 95 % interval over objects and by what was counted: successes "
    "of trials, or numbers behind the mean. *Unselected*: attempts drawn before any filter, failures "
    "of the synthesis included, as the paper's figures are. *Selected*: the grasps that are kept, "
    "without a simulator, out of the attempts. S: attempts per second of one core, without start and "
    "compilation; SGS: S times the unselected success. The paper's speeds are those of one RTX 3090. "
    "PD, SPD, CDC in mm (the paper prints cm). D: share of the variance in one direction, small is "
    "diverse."
)
WITH_ARMS = (
    "SUC-A: test a, the lift with two arms of the rig {rig}, whose motors do not feel gravity; a grasp "
    "that they do not reach without a collision is a failure. *Reachable*: the share that they reach. "
    "Rows on a table are made for these arms: an attempt out of their reach is a failure before it. "
    "Rig, place and planner are ours: the paper names none."
)
WITHOUT_ARMS = "SUC-A was not tested: no rig was named."


def markdown(data: Mapping[str, Any]) -> str:
    """All of `tables.md`; `data` is what tables.json holds."""
    sizes = ", ".join(f"{mm / 1000:g}" for mm in data["sizes_mm"])
    used, there = len(data["library"]["object_ids"]), data["library"]["objects"]
    asked = (
        f"{used} of {there} objects of the library {data['library']['fingerprint']}, sizes {sizes} m, "
        f"{data['grasps']} grasps per scene, hand {data['hand']}, seed {data['seed']}, protocol "
        f"{data['protocol']}."
    )
    arms = WITH_ARMS.format(rig=data["rig"]) if data["rig"] else WITHOUT_ARMS
    parts = [
        ["# The paper's tables on this library", "", asked, "", f"{LEGEND} {arms}"],
        ["## Table 2: comparison", "", *comparison(data)],
        ["## Table 3: ablation of the data synthesis", "", *ablation(data)],
        ["## Region quality: Q1", "", *regions(data)],
        ["## Rows", "", *definitions(data)],
    ]
    return "\n\n".join("\n".join(part) for part in parts) + "\n"


def comparison(data: Mapping[str, Any]) -> list[str]:
    """Table 2: each method unselected, selected, and as the paper has it."""
    head = ["method", "figures", "rows", "SUC-F [%]", "SUC-L [%]", "SUC-A [%]", "reachable [%]"]
    rows: list[Cells] = [[*head, "S [1/s]", "PD [mm]", "SPD [mm]", "CDC [mm]", "D", "kept [%]"]]
    for name in data["table_2"]:
        row = data["rows"][name]
        for kind in ("unselected", "selected"):
            found, first = row[kind], kind == "unselected"
            rows.append(
                [
                    row["title"],
                    kind,
                    str(found["rows"]),
                    *(rate_text(found.get(f"suc_{test}")) for test in "fla"),
                    rate_text(found.get("reachable")),
                    _number(row["s"], 2, count=row["s_attempts"]) if first else "-",
                    *(length_text(found[metric]) for metric in HEADLINE),
                    _number(found["d"], 3),
                    "-" if first else _number(row["kept"], 1, 100.0),
                ]
            )
        for dataset, its in data["paper"]["table_2"][name].items():
            rows.append(
                [
                    row["title"],
                    f"paper, {DATASETS[dataset]}",
                    "",
                    *(_number(its[f"suc_{test}"], 2, 100.0) for test in "fla"),
                    "-",
                    _number(its["s"], 2),
                    *(_number(its[metric], 1, 1000.0) for metric in HEADLINE),
                    _number(its["d"], 3),
                    "-",
                ]
            )
    return table(rows)


def ablation(data: Mapping[str, Any]) -> list[str]:
    """Table 3: each row beside the paper's; SGS is that of test l, as there."""
    head = ["method", "figures", "rows", "SUC-L [%]", "SUC-A [%]", "reachable [%]", "SGS [1/s]"]
    rows: list[Cells] = [[*head, "PD [mm]", "SPD [mm]", "SUC-F [%]", "configuration"]]
    for name in data["table_3"]:
        row = data["rows"][name]
        for kind in ("unselected", "selected"):
            found, first = row[kind], kind == "unselected"
            rows.append(
                [
                    *(row["title"], kind, str(found["rows"])),
                    *(rate_text(found.get(key)) for key in ("suc_l", "suc_a", "reachable")),
                    _number(row["sgs"]["l"], 2) if first else "-",
                    *(length_text(found[metric]) for metric in ("pd", "spd")),
                    rate_text(found["suc_f"]),
                    difference(row) if first else "",
                ]
            )
        its = data["paper"]["table_3"].get(name)
        if its is not None:
            shares = [_number(its[f"suc_{test}"], 1, 100.0) for test in "la"]
            lengths = [_number(its[metric], 1, 1000.0) for metric in ("pd", "spd")]
            paper = [*shares, "-", _number(its["sgs"], 1), *lengths]
            rows.append([row["title"], "paper", "", *paper, "-", ""])
    return table(rows)


def regions(data: Mapping[str, Any]) -> list[str]:
    """Q1 of region pairs: ours, and the paper's two kinds."""
    found = data["regions"]
    text = (
        f"The first {found['pairs_per_scene']} pairs of each of {found['scenes']} scenes, "
        f"{found['contacts_per_region']} contacts in each region, friction {found['friction']:g}."
    )
    papers = [f"paper, {name}" for name in DATASETS.values()]
    rows = [["regions", "what", "pairs", "Q1 [1e-2]", "Q1 above 0 [%]", *papers, "configuration"]]
    for name, kind in found["kinds"].items():
        its = data["paper"]["regions"].get(name, {})
        rows.append(
            [
                name,
                kind["says"],
                str(kind["pairs"]),
                mean_text(kind["q1"], 2, 100.0),
                rate_text(kind["positive"]),
                *(_number(its.get(dataset), 2, 100.0) for dataset in DATASETS),
                difference({**kind, "base": f"preset {kind['preset']}"}),
            ]
        )
    return [text, "", *table(rows)]


def definitions(data: Mapping[str, Any]) -> list[str]:
    """What each row is: folder, command, fingerprint, counts of attempts."""
    lines = []
    for name, row in data["rows"].items():
        ended = ", ".join(f"{n} {label}" for label, n in row["by_status"].items()) or "none"
        lines += [
            f"- **{row['title']}** (`{name}/`, run {row['fingerprint']}): {row['says']}.",
            f"  Configuration: {difference(row)}. Attempts: {row['attempts']} ({ended}) in "
            f"{row['scenes']} scenes of {row['objects']} objects; objects without a scene: "
            f"{row['objects_without_scene']}, not tested completely: {row['objects_untested']}. "
            f"Made on: {_machines(row)}.",
            f"  `{row['command']}`",
        ]
    return lines


def _machines(row: Mapping[str, Any]) -> str:
    names = (kind.get("device_name", "") for kind in row["made_with"].get("synth", ()))
    return ", ".join(sorted({name or "not known" for name in names})) or "-"


def difference(row: Mapping[str, Any]) -> str:
    """What a row starts from, and the keys that it sets."""
    changes = (f"`{key}={value}`" for key, value in row["changes"].items())
    return ", ".join([row["base"], *changes])


def rate_text(rate: Mapping[str, Any] | None) -> str:
    """`91.7 (62.0-98.5; 11/12)` in percent; `-` where nothing was tested."""
    if not rate or not rate["n"]:
        return "-"
    mean, low, high = (f"{100 * rate[key]:.1f}" for key in ("rate", "low", "high"))
    return f"{mean} ({low}-{high}; {rate['k']}/{rate['n']})"


def length_text(mean: Mapping[str, Any] | None) -> str:
    """A mean in millimetres."""
    return mean_text(mean, 2, 1000.0)


def mean_text(mean: Mapping[str, Any] | None, digits: int, scale: float) -> str:
    """`0.12 (0.05-0.20; 12)`; without an interval where there is none, `-` without a mean."""
    if not mean or mean["mean"] is None:
        return "-"
    number = _number(mean["mean"], digits, scale)
    if mean["low"] is None:
        return f"{number} ({mean['n']})"
    low, high = (_number(mean[key], digits, scale) for key in ("low", "high"))
    return f"{number} ({low}-{high}; {mean['n']})"


def table(rows: Sequence[Cells]) -> list[str]:
    """Rows of cells as a Markdown table; the first is its head."""
    lines = ["| " + " | ".join(cells) + " |" for cells in rows]
    return [lines[0], "|" + "---|" * len(rows[0]), *lines[1:]]


def _number(value: float | None, digits: int, scale: float = 1.0, count: int | None = None) -> str:
    if value is None:
        return "-"
    text = f"{scale * value:.{digits}f}"
    return text if count is None else f"{text} ({count})"
