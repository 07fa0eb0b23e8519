"""Validated grasps a second from a prepared library on: `python -m benchmarks.end_to_end LIBRARY`.

Synthesis of every object at six sizes, the best 5 of 20 attempts, then the test of every stored row,
both by two worker processes. Preparing the objects is not in the time; the start of the processes,
loading or compiling kernels, reading and writing are. A validated grasp is one that passes. Raw ones are audit
rows, drawn before any attempt was looked at; selected ones are the best of each object-size; stored ones
are both. They are made and tested together, so each of the speeds has all of the time.

Rates are over all objects and over the halves of `benchmarks.selection`: constants were tuned on
objects of the half `tune`.
"""

from __future__ import annotations

import argparse
import contextlib
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.report import report
from benchmarks.selection import tuned_on
from benchmarks.throughput import ATTEMPTS, GRASPS, SIZES_MM, WORKERS
from bidexdata import Run
from bidexdata.cli.options import parse_shard, parse_sizes
from bidexdata.config import fingerprint, with_overrides
from bidexdata.errors import BidexError
from bidexdata.formats.figures import Tally, size_text
from bidexdata.record import GraspBatch, Status
from bidexdata.record.rates import Rate, clustered_interval
from bidexdata.runs.finished import Finished
from bidexdata.runs.pack_rows import rows_of_object
from bidexdata.runs.stage import StageReport, TaskExecution
from bidexdata.runs.synth import SynthRequest, synth_library
from bidexdata.runs.validate import validate_run
from bidexdata.synthesis.config import SynthConfig
from bidexdata.validation import load_protocol
from bidexdata.validation.protocols import Protocol

TESTS = {"floating": "f", "tabletop": "l"}
"""The test of each setting."""
KINDS = {"raw": "unselected", "selected": "selected"}
"""Grasps whose speed is given, and what their rate is called."""


class Cost(NamedTuple):
    """What a stage took."""

    seconds: float
    cpu_seconds: float
    """Of the workers' tasks, without the start of the processes."""


def measure(
    library: Path,
    out: Path,
    request: SynthRequest,
    protocol: Protocol,
    shard: tuple[int, int] | None = None,
) -> dict[str, Any]:
    """Synthesise and validate into the new folder `out`; speed and quality.

    Args:
        library: Its folder.
        out: Of the run.
        request: What to synthesise.
        protocol: By whose test grasps are judged.
        shard: Part i of n of the objects, i from 0; None: all.
    """
    execution, test = (
        TaskExecution(workers=WORKERS, shard=shard, quiet=True),
        TESTS[request.setting],
    )
    start = time.perf_counter()
    made = synth_library(library, out, request, execution=execution)
    synth = _cost(made, start)
    run, start = Run.open(out), time.perf_counter()
    tested = validate_run(run, protocol, (test,), execution=execution)[test]
    validate = _cost(tested, start)
    found = quality(run, protocol.name, test)
    return {
        "run": run.fingerprint,
        "library": run.spec.source_fingerprint,
        "protocol": {"name": protocol.name, "fingerprint": fingerprint(protocol), "test": test},
        "setting": request.setting,
        "hand": request.hand,
        "grasps": request.grasps,
        "candidates": request.candidates,
        "workers": WORKERS,
        "attempts": sum(made.by_status.values()),
        "attempts_with_a_grasp": made.by_status.get(Status.OK.label, 0),
        "rows_tested": tested.rows,
        "synth": synth._asdict(),
        "validate": validate._asdict(),
        **speeds(
            {kind: found["rates"]["all"][name]["k"] for kind, name in KINDS.items()}
            | {"stored": found["by_verdict"].get(Status.OK.label, 0)},
            *(synth, validate),
        ),
        **found,
    }


def speeds(passed: Mapping[str, int], *stages: Cost) -> dict[str, float]:
    """Validated grasps per second of the clock and of the processors.

    Args:
        passed: How many grasps pass, by kind: raw, selected, and all that are stored.
        stages: What they took, one after the other.
    """
    seconds, cpu = (sum(column) for column in zip(*stages, strict=True))
    return {
        f"validated_{kind}_per_{per}": count / spent
        for kind, count in passed.items()
        for per, spent in (("second", seconds), ("cpu_second", cpu))
    }


def quality(run: Run, protocol: str, test: str) -> dict[str, Any]:
    """Rates by half and by size, the share of scenes whose selected grasps all pass, and depths."""
    finished = Finished.of(run)
    tallies = {half: Tally((test,)) for half in ("all", "tune", "held_out")}
    clean: list[list[bool]] = []
    for object_id in run.object_ids:
        rows = rows_of_object(run, finished, object_id, "", [(protocol, test)])
        if rows is None:  # of another part of the plan
            continue
        verdict = rows.verdicts[protocol, test]
        for half in ("all", "tune" if tuned_on(object_id) else "held_out"):
            tallies[half].add(rows.batch, {test: verdict}, grasps=run.spec.grasps)
        clean.append(scenes_that_pass(rows.batch, verdict["success"]))
    figures = {half: tally.figures() for half, tally in tallies.items()}
    every = figures["all"]
    return {
        "objects": every["objects"],
        "object_sizes": every["scenes"],
        "rates": {
            half: {name: found["tests"][test][name] for name in KINDS.values()}
            for half, found in figures.items()
        },
        "by_size": {
            size: {name: one[f"{name}_{test}"] for name in KINDS.values()}
            for size, one in every["by_size"].items()
        },
        "all_selected_pass": clustered_interval(
            [sum(scenes) for scenes in clean], [len(scenes) for scenes in clean]
        ).to_dict(),
        **{name: every[name] for name in ("kept", "pd", "spd", "cdc", "by_verdict")},
    }


def scenes_that_pass(rows: GraspBatch, success: np.ndarray) -> list[bool]:
    """Tell of every scene whether all of its selected rows pass; one without any does not.

    Args:
        rows: Of whole scenes; the header tells of those without rows.
        success: The verdict on each row, (N,).
    """
    selected = rows["selected"]
    mine = [selected & (rows["scene_id"] == scene) for scene in sorted(rows.header.counts)]
    return [bool(one.any() and success[one].all()) for one in mine]


def lines(figures: Mapping[str, Any]) -> dict[str, Any]:
    """The figures for a person: plain ones as they are, rates as texts."""
    named = {
        f"{half}, {n}": rate for half, of in figures["rates"].items() for n, rate in of.items()
    }
    for size, of in figures["by_size"].items():
        named |= {f"{size_text(size)}, {name}": rate for name, rate in of.items()}
    named["object-sizes whose selected grasps all pass"] = figures["all_selected_pass"]
    shown = {k: v for k, v in figures.items() if not isinstance(v, dict)}
    for name in ("protocol", "synth", "validate", "by_verdict"):
        shown[name] = ", ".join(
            f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in figures[name].items()
        )
    return shown | {name: str(Rate(**rate)) for name, rate in named.items()}


def _cost(stage: StageReport, start: float) -> Cost:
    seconds = time.perf_counter() - start
    if stage.failures:
        raise SystemExit(f"{len(stage.failures)} tasks failed: {stage.failures[0].reason}")
    return Cost(seconds, stage.cpu_seconds)


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the command line, print the figures and save them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("library", type=Path)
    parser.add_argument("--out", type=Path, help="keep the run in this new folder")
    parser.add_argument("--hand", default="shadow", help="%(default)s")
    parser.add_argument("--sizes", default=",".join(f"{mm / 1000:g}" for mm in SIZES_MM))
    parser.add_argument("--setting", choices=TESTS, default="floating", help="%(default)s")
    parser.add_argument("--rest-poses", type=int, default=None, metavar="N", help="on a table")
    parser.add_argument("--protocol", default="paper-1", help="%(default)s")
    parser.add_argument("--shard", metavar="I/N", help="part I of N of the objects, I from 0")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="of synth")
    given = parser.parse_args(arguments)
    if given.out is not None and given.out.exists():
        parser.error(f"{given.out} is there: what an earlier call did is in no time")
    with contextlib.ExitStack() as stack:
        out = given.out or Path(stack.enter_context(tempfile.TemporaryDirectory())) / "run"
        try:
            request = SynthRequest(
                config=with_overrides(SynthConfig(), given.set),
                hand=given.hand,
                sizes_mm=parse_sizes(given.sizes),
                setting=given.setting,
                rest_poses=given.rest_poses,
                grasps=GRASPS,
                candidates=ATTEMPTS,
            )
            protocol, shard = load_protocol(given.protocol), parse_shard(given.shard)
            figures = measure(given.library, out, request, protocol, shard)
        except BidexError as err:
            parser.exit(err.exit_code, f"error: {err}\n")
    report("end_to_end", lines(figures), whole=figures)


if __name__ == "__main__":
    main()
