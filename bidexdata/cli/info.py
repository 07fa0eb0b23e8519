"""`bidexdata info`: what a folder is, how far it is, and its figures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from bidexdata.cli import options
from bidexdata.cli.arm_figures import arm_lines
from bidexdata.cli.figures import attempt_lines, energy_lines, figure_lines
from bidexdata.cli.groups import group_lines
from bidexdata.cli.report import counts_text, finish, no_grasp_text, no_scene_text, validate_again
from bidexdata.synthesis.method_names import DEFAULT_METHOD
from bidexdata.wording import counted


def info(
    path: Annotated[Path, typer.Argument(metavar="PATH", help="A library, a run or a release.")],
    by: Annotated[
        str | None,
        typer.Option(
            help="object, size, setting, hand or status: a table of every metric's mean per group instead."
        ),
    ] = None,
    protocol: Annotated[
        str | None,
        typer.Option(
            help="Whose figures; when left out a release's default, and all that a run has."
        ),
    ] = None,
    rig: options.RigName = None,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Say what a folder is and what its figures are.

    Unselected rate = successes / N over the audit rows of each scene (N grasps asked for), every
    other status a failure. Selected rate = successes / selected rows, printed with the kept share
    = selected / (N x scenes). Intervals are 95 %. --by groups the selected rows, --by status all tested
    rows, selected and audit, and counts every arm_status of a run whose arms are solved.

    An imported run has the key files too: read, failed, left_out (grasps), failures (file, reason).

    --json keys: kind, path and, for a library: fingerprint, inputs, objects, hulls, by_status,
    failures (source_name, status, reason), warnings (source_name, warning); a run: fingerprint,
    hand, method, preset, changed (keys that --set changed), setting, rest_poses, without_scene (objects that no scene could be made of),
    without_grasp (scenes that no grasp was kept of), sizes_mm, grasps, candidates, seed, objects,
    tasks, rig (whose arms the figures of test a are), rigs (all that have solutions), arms (of that rig, where
    it has solutions: per all, selected and audit rows: n with a grasp, reachable, by_status, by_size), made_for (the rig of synth --rig), done (per stage), made_with (per stage: a list of tasks, device, device_name and package
    versions), unfinished (protocols whose validation was started and gave no verdict), figures, protocols; a release: name, version, schema_version, default_protocol,
    tests, splits, hands, rig (empty without arms), protocol (whose figures), figures. With --by also: by, groups (per protocol, test and group: rows, objects, selected,
    metrics).
    """
    from bidexdata.runs.info import describe

    data = describe(path, by, protocol, rig)
    lines = _LINES[data["kind"]](data)
    if by is not None:
        lines = [lines[0], *group_lines(data)]
    finish(data, lines, as_json=as_json, quiet=quiet)


def _start(data: dict[str, Any]) -> str:
    """What the configuration of a run started from."""
    if data["method"] in ("", DEFAULT_METHOD):
        return f"preset {data['preset'] or '-'}"
    return f"method {data['method']}"


def _library_lines(data: dict[str, Any]) -> list[str]:
    lines = [
        f"{data['path']}: library of {counted(data['objects'], 'object')} "
        f"from {counted(data['inputs'], 'input')} "
        f"({counts_text(data['by_status'])}; {data['hulls']} replaced by the hull)",
        f"fingerprint {data['fingerprint']}",
    ]
    lines += [f"{f['source_name']}: {f['reason']}" for f in data["failures"]]
    return lines + [f"{w['source_name']}: warning: {w['warning']}" for w in data["warnings"]]


def _run_lines(data: dict[str, Any]) -> list[str]:
    asked = (
        f"{counted(data['grasps'] or 0, 'grasp')} of {counted(data['candidates'] or 0, 'attempt')} "
        "per scene"
    )
    if data["grasps"] is None:
        asked = "grasps as they came"
    poses = f" in {counted(data['rest_poses'], 'rest pose')}" if data["rest_poses"] else ""
    sizes = ", ".join(f"{mm / 1000:g}" for mm in data["sizes_mm"])
    lines = [
        f"{data['path']}: run of hand {data['hand']}, {_start(data)}, "
        f"{data['setting']}{poses}, sizes {sizes or '-'} m, {asked}, seed {data['seed']}",
        f"fingerprint {data['fingerprint']}",
    ]
    if data["made_for"]:
        lines.append(f"made for the arms of {data['made_for']}")
    if data["changed"]:
        lines.append(f"set: {' '.join(data['changed'])}")
    if "files" in data:
        files = data["files"]
        lines.append(
            f"imported from {counted(files['read'], 'file')}; not usable: "
            f"{counted(files['failed'], 'file')} and {counted(files['left_out'], 'grasp')}"
        )
    if data["without_scene"]:
        lines.append(no_scene_text(data["without_scene"]))
    if data["without_grasp"]:
        lines.append(no_grasp_text(data["without_grasp"]))
    for stage, done in data["done"].items():
        lines.append(f"{stage}: {done} of {counted(data['tasks'], 'task')} done")
        lines += [_made_with_line(kind) for kind in data["made_with"][stage]]
    lines += [
        f"validation by {name} was started and no task has a verdict: {data['path']}/logs says why"
        for name in data["unfinished"]
    ]
    lines += arm_lines(data["rig"], [r for r in data["rigs"] if r != data["rig"]], data["arms"])
    sizes = data["figures"]["by_size"]
    diagnosis = [*attempt_lines(sizes), *energy_lines(sizes)]
    if not data["protocols"]:
        return lines + figure_lines(data["figures"]) + diagnosis
    for protocol, figures in data["protocols"].items():
        rig = data["rig"] if len(data["rigs"]) > 1 else ""
        again = validate_again(data["path"], protocol, rig)
        tested = f"{figures['tested_rows']} of {counted(figures['n'], 'row')}"
        partly = f"partly validated: {tested}; run {again} again"
        lines += figure_lines(figures, protocol, partly, rig=data["rig"])
        if figures["untested_objects"]:
            lines.append(
                f"not tested completely by {protocol}: "
                f"{counted(figures['untested_objects'], 'object')} (tested: {tested}), "
                "which the rates leave out"
            )
    return lines + diagnosis


def _made_with_line(kind: dict[str, Any]) -> str:
    """`  12 tasks on cpu (name of the processor) with bidexdata 0.1.0, mujoco 3.3.0, ...`."""
    versions = dict(kind)
    tasks, device = versions.pop("tasks"), versions.pop("device", "")
    name = versions.pop("device_name", "")
    if not device:
        return f"  {counted(tasks, 'task')} on a device that the shards do not name"
    packages = ", ".join(f"{package} {number}" for package, number in versions.items())
    return f"  {counted(tasks, 'task')} on {device} ({name}) with {packages}"


def _release_lines(data: dict[str, Any]) -> list[str]:
    splits = ", ".join(f"{n} in {name}" for name, n in data["splits"].items())
    lines = [
        f"{data['path']}: release {data['name']} {data['version']} "
        f"(schema {data['schema_version']}), objects: {splits}; hands {', '.join(data['hands'])}"
        f"{data['rig'] and '; arms of '}{data['rig']}"
    ]
    return lines + figure_lines(data["figures"], data["protocol"], rig=data["rig"])


_LINES = {"library": _library_lines, "run": _run_lines, "release": _release_lines}
