"""Print the figures of a script and save them beside the machine that gave them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.machine import describe_machine

RESULTS = Path(__file__).parent / "results"


def report(name: str, figures: Mapping[str, Any]) -> None:
    """Print a line per figure and write `results/NAME.json`."""
    for key, value in figures.items():
        shown = f"{value:.4g}" if isinstance(value, float) else value
        print(f"{name:>12}  {key}: {shown}", flush=True)
    RESULTS.mkdir(exist_ok=True)
    target = RESULTS / f"{name}.json"
    target.write_text(json.dumps({"machine": describe_machine(), **figures}, indent=2) + "\n")
