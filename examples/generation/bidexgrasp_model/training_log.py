"""The log of a training: a CSV file of means, and a line for the person who waits."""

from __future__ import annotations

import csv
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

COLUMNS = (
    *("step", "epoch", "seconds", "rate", "loss", "single_view", "bi_view"),
    *("para_translation", "para_rotation", "para_joints", "para_stages"),
    *("chamfer", "self_pen", "obj_pen", "spf"),
)
EVERY = 20
"""Steps whose mean makes a row."""


class TrainingLog:
    """Writes means over `EVERY` steps; rows behind the step that a resumed run starts at go."""

    def __init__(
        self,
        path: Path,
        step: int,
        *,
        quiet: bool = False,
        report: Callable[[str], None] | None = None,
    ):
        """Open it for a run that stands at `step`."""
        path.parent.mkdir(parents=True, exist_ok=True)
        kept = _rows_until(path, step)
        self._stream = path.open("w", newline="", encoding="utf-8")
        self._writer = csv.writer(self._stream)
        self._writer.writerow(COLUMNS)
        self._writer.writerows(kept)
        self._stream.flush()
        self._sums: dict[str, list[float]] = {}
        self._quiet, self._report = quiet, report
        self._shown = 0.0

    def add(
        self, step: int, epoch: int, seconds: float, done: float, terms: Mapping[str, float]
    ) -> None:
        """Take the values of one step."""
        for name, value in terms.items():
            self._sums.setdefault(name, []).append(value)
        if step % EVERY == 0:
            means = {n: sum(v) / len(v) for n, v in self._sums.items() if v}
            row = {"step": step, "epoch": epoch, "seconds": f"{seconds:.1f}"}
            row |= {n: f"{v:.6g}" for n, v in means.items()}
            self._writer.writerow([row.get(n, "") for n in COLUMNS])
            self._stream.flush()
            self._say(step, seconds, done, means)
            self._sums = {}

    def close(self) -> None:
        """End the line and the file."""
        self._stream.close()
        if not self._quiet and sys.stderr.isatty():
            sys.stderr.write("\n")

    def _say(self, step: int, seconds: float, done: float, means: Mapping[str, float]) -> None:
        terminal = sys.stderr.isatty()
        if self._quiet or time.monotonic() - self._shown < (1 if terminal else 30):
            return
        self._shown = time.monotonic()
        left = seconds * (1 - done) / done if done > 0 else 0.0
        text = f"step {step} ({done:.0%}), loss {means['loss']:.3f}, {left / 60:.0f} min left"
        if self._report is not None:
            self._report(text)
        elif terminal:
            bar = "#" * int(30 * done)
            sys.stderr.write(f"\r[{bar:<30}] {text}   ")
            sys.stderr.flush()
        else:
            sys.stderr.write(text + "\n")


def _rows_until(path: Path, step: int) -> list[list[str]]:
    if not path.is_file() or not step:
        return []
    with path.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.reader(stream))[1:]
    return [row for row in rows if row and row[0].isdigit() and int(row[0]) <= step]
