"""A chart of numbers over steps on a logarithmic scale, drawn with Pillow."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.pictures.sheet import FAINT, GAP, INK, PAPER, TEXT, TITLE, fitted

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw

Ink = tuple[int, int, int]

GRID = (226, 226, 226)
SHADE = (241, 243, 246)
MOST_DECADES = 7
"""Powers of ten that are shown at most; what is smaller lies on the lower edge."""
_TICKS = [k * 10**p for p in range(6) for k in (1, 2, 5)]  # steps between two numbers
_FINE = 2  # pixels are drawn so much finer, for smooth lines
_LEFT, _LEGEND, _FOOT = 62, 250, 46  # pixels beside and under the plot


class Line(NamedTuple):
    """One row of numbers."""

    name: str
    values: NDArray[np.float64]
    """(T,); NaN where there is none, which leaves a gap."""
    colour: Ink
    width: int = 2


class Band(NamedTuple):
    """A named stretch of steps."""

    name: str
    first: int
    stop: int


class _Plot(NamedTuple):
    """Where the plot lies on the page, and what it spans [pixels of the fine page]."""

    left: int
    top: int
    right: int
    bottom: int
    steps: int
    low: int
    """Power of ten at the lower edge."""
    high: int

    def x(self, step: int) -> float:
        return self.left + (self.right - self.left) * step / max(self.steps - 1, 1)

    def y(self, value: float) -> float:
        power = np.log10(max(value, 10.0**self.low))
        return self.bottom - (self.bottom - self.top) * (power - self.low) / (self.high - self.low)


def log_chart(
    lines: Sequence[Line],
    *,
    title: str,
    footer: str,
    bands: Sequence[Band] = (),
    width: int = 1180,
    height: int = 600,
) -> Image:
    """Draw lines over the numbers of their steps.

    A zero, or what is more than seven powers of ten below the largest number, lies on the lower
    edge. A number that has none beside it is a dot.

    Args:
        lines: Of equal length; the legend names each with its last number.
        title: One line at the top.
        footer: One line at the bottom: what the numbers are.
        bands: Stretches of steps that have a name; lines are cut where one begins.
        width: Pixels.
        height: Pixels.
    """
    from PIL import Image, ImageDraw

    size = (width * _FINE, height * _FINE)
    page = Image.new("RGB", size, PAPER)
    draw = ImageDraw.Draw(page)
    low, high = powers_of_ten(np.concatenate([line.values for line in lines]))
    plot = _Plot(
        left=(GAP + _LEFT) * _FINE,
        top=(3 * GAP + TITLE + TEXT) * _FINE,
        right=(width - _LEGEND - GAP) * _FINE,
        bottom=(height - _FOOT - GAP) * _FINE,
        steps=len(lines[0].values),
        low=low,
        high=high,
    )
    inside = (width - 2 * GAP) * _FINE
    _say(draw, (GAP, GAP), fitted(title, inside // _FINE, TITLE), INK, TITLE)
    _say(draw, (GAP, height - TEXT - GAP), fitted(footer, inside // _FINE, TEXT), FAINT)
    _axes(draw, plot, bands)
    for line in lines:
        _draw_line(draw, plot, line, [band.first for band in bands])
    _legend(draw, plot, lines)
    return page.resize((width, height), Image.Resampling.LANCZOS)


def powers_of_ten(values: NDArray[np.float64]) -> tuple[int, int]:
    """Powers of ten that enclose all positive numbers, at most seven apart.

    >>> powers_of_ten(np.array([0.02, 3.0, 0.0, np.nan])), powers_of_ten(np.array([1e-30, 1.0]))
    ((-2, 1), (-7, 0))
    """
    known = values[np.isfinite(values) & (values > 0)]
    if not len(known):
        return -1, 0
    high = int(np.ceil(np.log10(known.max()) - 1e-9))
    low = int(np.floor(np.log10(known.min())))
    return max(min(low, high - 1), high - MOST_DECADES), high


def _axes(draw: ImageDraw, plot: _Plot, bands: Sequence[Band]) -> None:
    for k, band in enumerate(bands):
        first, last = plot.x(band.first), plot.x(min(band.stop, plot.steps - 1))
        if k % 2 == 0:
            draw.rectangle((first, plot.top, last, plot.bottom), fill=SHADE)
        where = (int(first) // _FINE + 4, plot.top // _FINE - TEXT - 5)
        _say(draw, where, band.name, FAINT)
    for power in range(plot.low, plot.high + 1):
        y = plot.y(10.0**power)
        draw.line((plot.left, y, plot.right, y), fill=GRID, width=_FINE)
        label = f"{10.0**power:g}" if -3 <= power <= 4 else f"1e{power}"
        if power == plot.low:
            label = f"< {label}"
        _say(draw, (GAP, int(y) // _FINE - TEXT // 2 - 1), label, FAINT)
    every = next(n for n in _TICKS if plot.steps <= 12 * n or n == _TICKS[-1])
    for step in range(0, plot.steps, every):
        x = plot.x(step)
        draw.line((x, plot.bottom, x, plot.bottom + 4 * _FINE), fill=FAINT, width=_FINE)
        _say(draw, (int(x) // _FINE - 6, plot.bottom // _FINE + 6), str(step), FAINT)


def _draw_line(draw: ImageDraw, plot: _Plot, line: Line, starts: Sequence[int]) -> None:
    known = np.isfinite(line.values)
    points = [(plot.x(i), plot.y(float(v))) for i, v in enumerate(np.where(known, line.values, 0))]
    for i in np.flatnonzero(known[:-1] & known[1:] & ~np.isin(np.arange(1, len(known)), starts)):
        draw.line((*points[i], *points[i + 1]), fill=line.colour, width=line.width * _FINE)
    beside = np.concatenate([[False], known[:-1]]) | np.concatenate([known[1:], [False]])
    radius = 2 * line.width * _FINE
    for i in np.flatnonzero(known & ~beside):
        x, y = points[i]
        draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=line.colour)


def _legend(draw: ImageDraw, plot: _Plot, lines: Sequence[Line]) -> None:
    x, y = plot.right // _FINE + 2 * GAP, plot.top // _FINE
    for k, line in enumerate(lines):
        at = y + k * (TEXT + 9)
        middle = (at + TEXT // 2 + 1) * _FINE
        draw.line(
            (x * _FINE, middle, (x + 22) * _FINE, middle),
            fill=line.colour,
            width=(line.width + 1) * _FINE,
        )
        last = line.values[-1] if len(line.values) else np.nan
        number = f"  {last:.3g}" if np.isfinite(last) else ""
        _say(draw, (x + 30, at), f"{line.name}{number}", INK)


def _say(draw: ImageDraw, at: tuple[int, int], text: str, colour: Ink, size: int = TEXT) -> None:
    from PIL.ImageFont import load_default

    font: Any = load_default(size * _FINE)
    draw.text((at[0] * _FINE, at[1] * _FINE), text, colour, font)
