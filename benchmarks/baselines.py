"""Our synthesis beside its peers' on the same scenes: `python -m benchmarks.baselines LIBRARY --out DIR`.

Every N-th object of the library in the order of its ids, at three sizes, five grasps a scene, with
each method's own step counts; then test f of protocol paper-1. Methods take turns object by object,
so that a load on the machine hits all alike, and a second call goes on where the first stopped. The
tables go into docs/baselines.md; the figures are also in DIR/baselines.json.

Speed is attempts (raw grasps, as in the paper) and successes by the time that a core worked for them;
what a call's first task took, which loads or compiles kernels, is left out where there are others.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.machine import describe_machine
from bidexdata import Library, Run
from bidexdata.cli.options import parse_sizes
from bidexdata.errors import BidexError
from bidexdata.formats.figures import Tally
from bidexdata.runs.bench_speed import noted_in, speed_of
from bidexdata.runs.finished import Finished
from bidexdata.runs.pack_rows import rows_of_object
from bidexdata.runs.stage import TaskExecution
from bidexdata.runs.synth import SynthRequest, start_run, synth_library
from bidexdata.runs.validate import validate_run
from bidexdata.synthesis.method_names import METHODS
from bidexdata.synthesis.methods import load_method
from bidexdata.validation import load_protocol

PROTOCOL = "paper-1"


class Asked(NamedTuple):
    """What is compared."""

    library: Path
    out: Path
    every: int
    limit: int | None
    methods: tuple[str, ...]
    sizes_mm: tuple[int, ...]
    grasps: int
    hand: str


def measure(asked: Asked) -> dict[str, Any]:
    """Synthesise and validate what is missing; figures per method."""
    library = Library.open(asked.library)
    numbers = range(0, len(library.object_ids), asked.every)[: asked.limit]
    runs = {name: _run(library, asked, name) for name in asked.methods}
    for done, number in enumerate(numbers, start=1):
        for name, run in runs.items():
            _synthesise(asked, name, run, number)
            _validate(run, number)
        print(f"{done} of {len(numbers)} objects", file=sys.stderr, flush=True)
    ids = [library.object_ids[k] for k in numbers]
    return {
        "machine": describe_machine(),
        "library": library.fingerprint,
        "objects": len(ids),
        "object_ids": ids,
        "sizes_mm": list(asked.sizes_mm),
        "grasps": asked.grasps,
        "hand": asked.hand,
        "protocol": PROTOCOL,
        "methods": {name: figures(Run.open(run.path), ids) for name, run in runs.items()},
    }


def figures(run: Run, ids: Sequence[str]) -> dict[str, Any]:
    """Rates, depth and speed of one method on some objects; the run may hold more."""
    finished, tally = Finished.of(run), Tally()
    for object_id in ids:
        rows = rows_of_object(run, finished, object_id, "", [(PROTOCOL, "f")])
        assert rows is not None
        verdicts = {test: columns for (_, test), columns in rows.verdicts.items()}
        tally.add(rows.batch, verdicts, grasps=run.spec.grasps)
    found = tally.figures()
    rates, speed = found["tests"]["f"], speed_of(run, ids)
    made, success = speed.per_second, rates["unselected"]["rate"]
    return {
        "fingerprint": run.fingerprint,
        "attempts": sum(found["by_status"].values()),
        "unselected": rates["unselected"],
        "selected": rates["selected"],
        "kept": found["kept"],
        "pd": found["pd"],
        "spd": found["spd"],
        "cdc": found["cdc"],
        "by_size": {mm: one["unselected_f"]["rate"] for mm, one in found["by_size"].items()},
        "by_verdict": found["by_verdict"],
        "timed_attempts": speed.attempts,
        "per_cpu_second": made,
        "successes_per_cpu_second": None if made is None else success * made,
    }


def tables(data: dict[str, Any]) -> list[str]:
    """The comparison as Markdown."""
    head = (
        "| method | SUC-F, unselected [%] | SUC-F, selected [%] | kept [%] | PD [mm] | "
        "grasps/CPU s | successes/CPU s | ours over it |"
    )
    lines = [head, "|" + "---|" * 8]
    every = data["methods"]
    ours = every.get(METHODS[0], {})
    for name, one in every.items():
        raw, ratio = (
            _cell(ours[key] / one[key] if ours.get(key) and one[key] else None)
            for key in ("per_cpu_second", "successes_per_cpu_second")
        )
        cells = [
            name,
            _percent(one["unselected"]),
            _percent(one["selected"]),
            f"{100 * one['kept']:.0f}",
            f"{1e3 * one['pd']:.2f}",
            _cell(one["per_cpu_second"]),
            _cell(one["successes_per_cpu_second"]),
            f"{raw} grasps, {ratio} successes",
        ]
        lines.append("| " + " | ".join(cells) + " |")
    sizes = [f"{mm / 1000:g} m" for mm in data["sizes_mm"]]
    lines += ["", f"| SUC-F, unselected [%] | {' | '.join(sizes)} |"]
    lines.append("|" + "---|" * (len(sizes) + 1))
    for name, one in every.items():
        rates = [f"{100 * one['by_size'][str(mm)]:.1f}" for mm in data["sizes_mm"]]
        lines.append(f"| {name} | {' | '.join(rates)} |")
    return lines


def _cell(value: float | None) -> str:
    """A number, or a dash where nothing was timed or nothing passed."""
    return "-" if value is None else f"{value:.2f}"


def _percent(rate: dict[str, Any]) -> str:
    return f"{100 * rate['rate']:.1f} ({100 * rate['low']:.1f}-{100 * rate['high']:.1f})"


def _request(asked: Asked, name: str) -> SynthRequest:
    return SynthRequest(
        config=load_method(name).config(),
        method=name,
        hand=asked.hand,
        sizes_mm=asked.sizes_mm,
        grasps=asked.grasps,
    )


def _run(library: Library, asked: Asked, name: str) -> Run:
    run = start_run(library, asked.out / name, _request(asked, name))
    if [t.object_id for t in run.tasks] != list(library.object_ids):
        sys.exit("the scenes of an object are more than one task; give fewer --grasps or sizes")
    return run


def _one(run: Run, number: int) -> TaskExecution:
    """Task `number` alone, in this process."""
    return TaskExecution(executor="inline", shard=(number, len(run.tasks)), quiet=True)


def _synthesise(asked: Asked, name: str, run: Run, number: int) -> None:
    if run.is_done(run.tasks[number]):
        return
    how, hear = _one(run, number), noted_in(run.path)
    report = synth_library(
        asked.library, run.path, _request(asked, name), execution=how, on_task=hear
    )
    if report.failures:
        sys.exit(f"{run.path}: {report.failures[0].reason}")


def _validate(run: Run, number: int) -> None:
    if not run.is_done(run.tasks[number], PROTOCOL):
        validate_run(run, load_protocol(PROTOCOL), ("f",), execution=_one(run, number))


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare, print the tables and write DIR/baselines.json."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("library", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="folder of the runs; resumed")
    parser.add_argument(
        "--every", type=int, default=6, help="every so many-th object (%(default)s)"
    )
    parser.add_argument("--limit", type=int, help="at most so many of them")
    parser.add_argument("--methods", default=",".join(METHODS), help="%(default)s")
    parser.add_argument("--sizes", default="0.3,0.5,0.8", help="diagonals in metres (%(default)s)")
    parser.add_argument("--grasps", type=int, default=5, help="kept per scene (%(default)s)")
    parser.add_argument("--hand", default="shadow", help="%(default)s")
    given = parser.parse_args(arguments)
    asked = Asked(
        library=given.library,
        out=given.out,
        every=given.every,
        limit=given.limit,
        methods=tuple(given.methods.split(",")),
        sizes_mm=parse_sizes(given.sizes),
        grasps=given.grasps,
        hand=given.hand,
    )
    try:
        data = measure(asked)
    except BidexError as err:
        parser.exit(err.exit_code, f"error: {err}\n")
    (asked.out / "baselines.json").write_text(json.dumps(data, indent=2) + "\n")
    objects = f"{data['objects']} objects x {len(data['sizes_mm'])} sizes x {data['grasps']} grasps"
    print(f"{objects}, hand {data['hand']}, protocol {PROTOCOL}, {data['machine']['cpu']}\n")
    print("\n".join(tables(data)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
