"""The whole pipeline on built-in objects with the built-in hand; needs no network."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bidexdata.runs.pack import pack_runs
from bidexdata.runs.run import Run
from bidexdata.runs.stage import Execution
from bidexdata.runs.synth import SynthRequest, synth_library
from bidexdata.runs.validate import validate_run

SOURCES = "shapes:box,cylinder,bottle,mug,bowl,ellipsoid"
HAND = "capsule"
SIZES_MM = (300, 500)
GRASPS = 8
NAME, VERSION = "bidexdata-demo", "1.0.0"
PROTOCOL = "paper-1"


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
    execution: Execution | None = None,
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
    """
    from bidexdata.runs.prepare import prepare_library
    from bidexdata.runs.render import render
    from bidexdata.synthesis.presets import load_preset
    from bidexdata.validation.protocols import load_protocol

    execution = execution or Execution()
    library, run, release = out / "library", out / "run", out / "release"
    sheet = out / "contact_sheet.png"
    seconds: dict[str, float] = {}

    def stage(name: str, text: str, do: Callable[[], Any]) -> Any:
        say(text)
        start = time.monotonic()
        result = do()
        seconds[name] = round(time.monotonic() - start, 2)
        return result

    prepared = stage(
        "prepare",
        f"prepare {sources}",
        lambda: prepare_library(
            [sources],
            library,
            executor=execution.executor,
            workers=execution.workers,
            quiet=execution.quiet,
        ),
    )
    request = SynthRequest(
        config=load_preset("default"), hand=HAND, sizes_mm=sizes_mm, grasps=grasps
    )
    stage(
        "synth",
        f"synthesise {grasps} grasps per object and size with the hand {HAND!r}",
        lambda: synth_library(library, run, request, execution=execution),
    )
    stage(
        "validate",
        f"validate by protocol {PROTOCOL}",
        lambda: validate_run(Run.open(run), load_protocol(PROTOCOL), execution=execution),
    )
    packed = stage("pack", "pack a release", lambda: _pack_anew(run, release, execution.quiet))
    stage(
        "render",
        "draw a contact sheet",
        lambda: render(release, sheet, count=12, quiet=execution.quiet),
    )
    return DemoReport(out, sheet, prepared.prepared, dict(packed.figures), seconds)


def _pack_anew(run: Path, release: Path, quiet: bool) -> Any:
    # Only what this function wrote before is replaced: a folder with our demo's manifest.
    import shutil

    from bidexdata.formats.release import Release

    if release.is_dir() and any(release.iterdir()) and Release.open(release).name == NAME:
        shutil.rmtree(release)
    return pack_runs([run], release, name=NAME, version=VERSION, quiet=quiet)
