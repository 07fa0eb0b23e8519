"""Run the benchmarks named on the command line, or all: `python -m benchmarks [NAME ...]`."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

from benchmarks.machine import describe_machine
from benchmarks.report import RESULTS, report

SCRIPTS = ("prepare", "regions", "synthesis", "validation", "arms", "real", "loader", "gpu")


def main(names: list[str]) -> int:
    """Measure, print and save one JSON file per script; skip what this machine cannot run."""
    unknown = sorted(set(names) - set(SCRIPTS))
    if unknown:
        print(
            f"no benchmark is called {unknown[0]!r}; known: {', '.join(SCRIPTS)}", file=sys.stderr
        )
        return 2
    print("machine: " + ", ".join(f"{k} {v}" for k, v in describe_machine().items()))
    for name in names or SCRIPTS:
        script = importlib.import_module(f"benchmarks.{name}")
        reason = script.missing() if hasattr(script, "missing") else ""
        if reason:
            print(f"{name:>12}  skipped: {reason}", flush=True)
        else:
            report(name, script.measure())
    print(
        f"saved in {RESULTS.relative_to(Path.cwd()) if RESULTS.is_relative_to(Path.cwd()) else RESULTS}"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
