"""The whole pipeline on built-in objects with the built-in hand; needs no network."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from bidexdata.errors import NotUsable
from bidexdata.kinds import kind_of
from bidexdata.runs.pack import PackReport, pack_runs
from bidexdata.runs.prepare import prepare_library
from bidexdata.runs.prepare_report import PrepareReport
from bidexdata.runs.render import RenderReport, render
from bidexdata.runs.run import Run
from bidexdata.runs.stage import StageReport, TaskExecution
from bidexdata.runs.synth import SynthRequest, synth_library
from bidexdata.runs.validate import validate_run

SOURCES = "shapes:box,cylinder,bottle,mug,bowl,ellipsoid"
HAND = "capsule"
SIZES_MM = (300, 500)
GRASPS = 8
NAME, VERSION = "bidexdata-demo", "1.0.0"
PROTOCOL = "paper-1"
SHOWN = 12
"""Grasps on the contact sheet."""


@dataclass(frozen=True, slots=True)
class Demo:
    """What the pipeline is to make, and where."""

    out: Path
    execution: TaskExecution
    grasps: int = GRASPS
    sources: str = SOURCES
    sizes_mm: tuple[int, ...] = SIZES_MM

    @property
    def library(self) -> Path:
        """The prepared objects."""
        return self.out / "library"

    @property
    def run(self) -> Path:
        """Grasps and their verdicts."""
        return self.out / "run"

    @property
    def release(self) -> Path:
        """The packed data set."""
        return self.out / "release"

    @property
    def sheet(self) -> Path:
        """The contact sheet."""
        return self.out / "contact_sheet.png"


class Stage(NamedTuple):
    """One step of the pipeline."""

    name: str
    sentence: str
    """What a person reads before it starts."""
    work: Callable[[Demo], Any]


@dataclass(frozen=True, slots=True)
class DemoReport:
    """Where everything is, and the figures of the release."""

    out: Path
    sheet: Path
    objects: int
    figures: dict[str, Any]
    seconds: dict[str, float]
    """Wall seconds per stage."""


def run_demo(
    out: Path,
    *,
    execution: TaskExecution | None = None,
    grasps: int = GRASPS,
    sources: str = SOURCES,
    sizes_mm: tuple[int, ...] = SIZES_MM,
    say: Callable[[str], None] = lambda _: None,
) -> DemoReport:
    """Make `library`, `run`, `release` and `contact_sheet.png` in `out`; finished parts stay.

    The release and the sheet are written anew each time.

    Args:
        out: Folder of the demo.
        execution: Where and how the stages run.
        grasps: Kept per object and size.
        sources: Objects.
        sizes_mm: Sizes.
        say: Takes a line before each stage.

    Raises:
        NotUsable: `out` itself is a library, a run or a release.
    """
    if kind_of(out) != "nothing":
        raise NotUsable(f"{out} is a {kind_of(out)}; choose another --out for the demo")
    demo = Demo(out, execution or TaskExecution(), grasps, sources, sizes_mm)
    made, seconds = {}, {}
    for stage in stages_of(demo):
        say(stage.sentence)
        start = time.monotonic()
        made[stage.name] = stage.work(demo)
        seconds[stage.name] = round(time.monotonic() - start, 2)
    objects, figures = made["prepare"].prepared, dict(made["pack"].figures)
    return DemoReport(out, demo.sheet, objects, figures, seconds)


def stages_of(demo: Demo) -> tuple[Stage, ...]:
    """The pipeline in its order."""
    per_scene = f"{demo.grasps} grasps per object and size with the hand {HAND!r}"
    return (
        Stage("prepare", f"prepare {demo.sources}", _prepare),
        Stage("synth", f"synthesise {per_scene}", _synth),
        Stage("validate", f"validate by protocol {PROTOCOL}", _validate),
        Stage("pack", "pack a release", _pack_anew),
        Stage("render", "draw a contact sheet", _render),
    )


def _prepare(demo: Demo) -> PrepareReport:
    how = demo.execution
    return prepare_library(
        [demo.sources], demo.library, executor=how.executor, workers=how.workers, quiet=how.quiet
    )


def _synth(demo: Demo) -> StageReport:
    from bidexdata.synthesis.presets import load_preset

    request = SynthRequest(
        config=load_preset("default"), hand=HAND, sizes_mm=demo.sizes_mm, grasps=demo.grasps
    )
    return synth_library(demo.library, demo.run, request, execution=demo.execution)


def _validate(demo: Demo) -> dict[str, StageReport]:
    from bidexdata.validation.protocols import load_protocol

    return validate_run(Run.open(demo.run), load_protocol(PROTOCOL), execution=demo.execution)


def _pack_anew(demo: Demo) -> PackReport:
    # Only what this function wrote before is replaced: a folder with our demo's manifest.
    from bidexdata.formats.release import Release

    old = demo.release
    if old.is_dir() and any(old.iterdir()) and Release.open(old).name == NAME:
        shutil.rmtree(old)
    return pack_runs([demo.run], old, name=NAME, version=VERSION, quiet=demo.execution.quiet)


def _render(demo: Demo) -> RenderReport:
    return render(demo.release, demo.sheet, count=SHOWN, quiet=demo.execution.quiet)
