"""Run the benchmarks named on the command line, or all: `python -m benchmarks [NAME ...]`."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

from benchmarks.machine import describe_machine

SCRIPTS = ("prepare", "regions", "synthesis", "validation", "loader")
RESULTS = Path(__file__).parent / "results"


def main(names: list[str]) -> int:
    """Measure, print and save one JSON file per script."""
    unknown = sorted(set(names) - set(SCRIPTS))
    if unknown:
        print(
            f"no benchmark is called {unknown[0]!r}; known: {', '.join(SCRIPTS)}", file=sys.stderr
        )
        return 2
    RESULTS.mkdir(exist_ok=True)
    machine = describe_machine()
    print("machine: " + ", ".join(f"{k} {v}" for k, v in machine.items()))
    for name in names or SCRIPTS:
        figures = importlib.import_module(f"benchmarks.{name}").measure()
        for key, value in figures.items():
            shown = f"{value:.4g}" if isinstance(value, float) else value
            print(f"{name:>12}  {key}: {shown}", flush=True)
        target = RESULTS / f"{name}.json"
        target.write_text(json.dumps({"machine": machine, **figures}, indent=2) + "\n")
    print(
        f"saved in {RESULTS.relative_to(Path.cwd()) if RESULTS.is_relative_to(Path.cwd()) else RESULTS}"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
