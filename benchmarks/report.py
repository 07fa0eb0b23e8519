"""Print the figures of a script and save them beside the machine that gave them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.machine import describe_machine

RESULTS = Path(__file__).parent / "results"


def report(name: str, figures: Mapping[str, Any], whole: Mapping[str, Any] | None = None) -> None:
    """Print a line per figure and write `results/NAME.json`: `whole` so far, if that is more."""
    for key, value in figures.items():
        shown = f"{value:.4g}" if isinstance(value, float) else value
        print(f"{name:>12}  {key}: {shown}", flush=True)
    RESULTS.mkdir(exist_ok=True)
    saved = {"machine": describe_machine(), **(whole or figures)}
    (RESULTS / f"{name}.json").write_text(json.dumps(saved, indent=2) + "\n")
