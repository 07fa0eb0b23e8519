"""Progress on standard error: a bar with rate and ETA on a terminal, plain lines otherwise."""

from __future__ import annotations

import shutil
import sys
import time
from io import TextIOBase
from typing import Any

from bidexdata.wording import counted, duration

PLAIN_INTERVAL = 10.0
"""Seconds between lines where standard error is no terminal."""
BAR_INTERVAL = 0.1
"""Seconds between redraws of the bar."""


class Progress:
    """Counts finished units; use as a context manager.

    `unit` is the word for one, with what is done to it where that helps: `task`, `file read`.

    State: how many of `total` are done; `already` of them were done before this run, which the
    rate and the ETA leave out.
    """

    def __init__(
        self,
        total: int,
        unit: str,
        *,
        quiet: bool = False,
        already: int = 0,
        stream: TextIOBase | None = None,
    ):
        self.total, self.done = total, already
        noun, space, rest = unit.partition(" ")
        self._total_text = counted(total, noun) + space + rest
        self._nouns = noun + "s"
        self._already = already
        self._quiet = quiet
        self._stream: Any = stream or sys.stderr
        self._bar = not quiet and self._stream.isatty()
        self._start = time.monotonic()
        self._shown = 0.0
        self._shown_done = -1
        self._width = 0
        self._note = ""

    def __enter__(self) -> Progress:
        self._start = time.monotonic()
        if self._already and not self._quiet:
            self._line(f"{self._already} of {self._total_text} done before")
        return self

    def __exit__(self, error: object, *_: object) -> None:
        if self._quiet or (error is not None and self.done == self._already):
            return
        if self._bar:
            self._draw()
            self._stream.write("\n")
            self._stream.flush()
        elif self._shown_done != self.done:
            self._line(self.text())

    def advance(self, n: int = 1, note: str = "") -> None:
        """Count n more units; `note` stands behind the figures until the next call."""
        self.done += n
        self._note = note
        if self._quiet:
            return
        now = time.monotonic()
        if now - self._shown < (BAR_INTERVAL if self._bar else PLAIN_INTERVAL):
            return
        self._shown, self._shown_done = now, self.done
        if self._bar:
            self._draw()
        else:
            self._line(self.text())

    def write(self, message: str) -> None:
        """Print a line of its own, above the bar where there is one."""
        if self._quiet:
            return
        if self._bar:
            self._stream.write("\r" + " " * self._width + "\r")
        self._line(message)
        if self._bar:
            self._draw()

    def text(self) -> str:
        """The figures: `12 of 40 objects (30 %), 2.1 objects/s, 13 s left`."""
        share = 100 * self.done / self.total if self.total else 100.0
        parts = [f"{self.done} of {self._total_text} ({share:.0f} %)"]
        fresh, seconds = self.done - self._already, time.monotonic() - self._start
        if fresh > 0 and seconds > 0:
            rate = fresh / seconds
            parts.append(_rate(rate, self._nouns))
            if self.done < self.total:
                parts.append(f"{duration((self.total - self.done) / rate)} left")
            else:
                parts.append(f"in {duration(seconds)}")
        if self._note:
            parts.append(self._note)
        return ", ".join(parts)

    def _draw(self) -> None:
        columns = shutil.get_terminal_size().columns
        text = self.text()
        room = min(24, columns - len(text) - 4)
        if room >= 8:
            filled = round(room * self.done / self.total) if self.total else room
            text = f"[{'#' * filled}{'.' * (room - filled)}] {text}"
        text = text[: max(columns - 1, 1)]
        self._stream.write("\r" + text.ljust(self._width))
        self._stream.flush()
        self._width = len(text)

    def _line(self, text: str) -> None:
        self._stream.write(text + "\n")
        self._stream.flush()


def _rate(per_second: float, unit: str) -> str:
    if per_second >= 1:
        return f"{per_second:.1f} {unit}/s"
    if per_second * 60 >= 1:
        return f"{per_second * 60:.1f} {unit}/min"
    return f"{per_second * 3600:.1f} {unit}/h"
