"""`bidexdata synth --explain`: how one grasp came about, or why it did not."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path

import typer

from bidexdata.cli import options
from bidexdata.cli.report import command, finish


def refuse_settings(given: Mapping[str, bool]) -> None:
    """Refuse settings of a new run: those of the run that is explained decide."""
    named = options.given_names(given)
    if named:
        raise typer.BadParameter(
            f"--explain repeats a grasp with its run's own settings: leave out {named}"
        )


def explain(
    library: Path, run: Path, grasp_id: str, device: str, *, as_json: bool, quiet: bool
) -> None:
    """Make one attempt again, write its pictures and numbers, and say what became of it."""
    from bidexdata.runs.explain import explain_grasp
    from bidexdata.runs.explain_page import headline
    from bidexdata.runs.explain_words import StageWords

    started = time.perf_counter()
    report = explain_grasp(library, run, grasp_id, device=device)
    seconds = time.perf_counter() - started
    told = [*report.said, *(StageWords("verdict", v.text) for v in report.verdicts)]
    widest = max(len(s.stage) for s in told)
    lines = [
        *headline(report),
        *(f"{s.stage:{widest}}  {s.text}" for s in told),
        f"{', '.join(str(path) for path in report.files)} in {seconds:.1f} s",
    ]
    data = {**report.as_dict(), "seconds": round(seconds, 3)}
    following = ""
    if report.stored and report.as_dict()["status"] == "ok":
        following = command("validate", run, "--replay", report.grasp_id, "--video", "grasp.mp4")
    finish(data, lines, following=following, as_json=as_json, quiet=quiet)
