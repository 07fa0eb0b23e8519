"""Contact sheets: pictures in a grid, each with a caption, and a line that says what drew them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.errors import BadConfig

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont, ImageFont

Pixels = NDArray[np.uint8]

PAPER = (250, 250, 250)
INK = (35, 38, 42)
FAINT = (110, 114, 120)
GOOD = (24, 128, 72)
BAD = (190, 40, 36)
TEXT = 13
TITLE = 19
GAP = 10
_STEP = TEXT + 4  # pixels from line to line
PICTURE_ENDINGS = (".png", ".jpg", ".jpeg", ".webp")
"""Endings of files of one picture."""
FRAME_MS = 110
"""Time that one picture of an animation stays [ms]."""


class Caption(NamedTuple):
    """Words under a picture."""

    head: str
    lines: tuple[str, ...] = ()
    good: tuple[bool | None, ...] = ()
    """Colours as many of the last lines: passed, failed, or neither."""


class Tile(NamedTuple):
    """One picture of a sheet with its words."""

    pixels: Pixels
    """(h, w, 3)."""
    caption: Caption


def contact_sheet(
    tiles: Sequence[Tile], *, title: str, footer: str, columns: int | None = None
) -> Image:
    """Lay tiles out in rows under a title.

    Args:
        tiles: Pictures of one size.
        title: At the top; a long one is wrapped.
        footer: One line at the bottom: what drew the pictures, and from what.
        columns: Pictures per row; a landscape sheet when omitted.
    """
    from PIL import Image, ImageDraw

    height, width = tiles[0].pixels.shape[:2] if tiles else (0, 320)
    columns = max(
        1, min(columns or default_columns(len(tiles), width / max(height, 1)), max(len(tiles), 1))
    )
    lines = max((len(_rows(t.caption, width)) for t in tiles), default=0)
    cell = height + lines * _STEP + 2 * GAP
    rows = -(-len(tiles) // columns)
    inside = columns * (width + GAP) - GAP
    heads = wrapped(title, inside, TITLE)
    top = 2 * GAP + TITLE + (len(heads) - 1) * (TITLE + GAP // 2)
    size = (inside + 2 * GAP, top + rows * cell + _STEP + 2 * GAP)
    sheet = Image.new("RGB", size, PAPER)
    draw = ImageDraw.Draw(sheet)
    for k, head in enumerate(heads):
        draw.text((GAP, GAP + k * (TITLE + GAP // 2)), head, INK, _font(TITLE))
    for k, tile in enumerate(tiles):
        x = GAP + (k % columns) * (width + GAP)
        y = top + (k // columns) * cell + GAP // 2
        sheet.paste(Image.fromarray(tile.pixels), (x, y))
        _write(draw, tile.caption, x, y + height + 4, width)
    foot = (GAP, size[1] - _STEP - GAP // 2)
    draw.text(foot, fitted(footer, inside, TEXT), FAINT, _font(TEXT))
    return sheet


def captioned(pixels: Pixels, caption: Caption) -> Pixels:
    """One picture with its words below it, (h + lines, w, 3); lines that are too long are wrapped."""
    from PIL import Image, ImageDraw

    height, width = pixels.shape[:2]
    words = len(_rows(caption, width - GAP)) * _STEP + GAP
    page = Image.new("RGB", (width, height + words), PAPER)
    page.paste(Image.fromarray(pixels), (0, 0))
    _write(ImageDraw.Draw(page), caption, GAP // 2, height + 4, width - GAP)
    return np.asarray(page)


def default_columns(count: int, aspect: float) -> int:
    """Pictures per row that make a sheet a little wider than high.

    Args:
        count: Pictures.
        aspect: Width over height of one.
    """
    return max(1, round(float(np.sqrt(1.8 * count / aspect))))


def wrapped(text: str, width: int, size: int = TEXT) -> tuple[str, ...]:
    """Cut a line between words into lines of at most `width` pixels; see `fitted` for longer words."""
    font = _font(size)
    if font.getlength(text) <= width:
        return (text,)
    lines: list[str] = []
    for word in text.split():
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and font.getlength(longer) <= width:
            lines[-1] = longer
        else:
            lines.append(fitted(word, width, size))
    return tuple(lines)


def fitted(text: str, width: int, size: int) -> str:
    """Shorten a line in its middle until it is at most `width` pixels wide."""
    font = _font(size)
    if font.getlength(text) <= width:
        return text
    kept = len(text)
    while kept > 1:
        kept -= 1
        head, tail = (kept + 1) // 2, kept // 2
        short = f"{text[:head]}…{text[len(text) - tail :]}"
        if font.getlength(short) <= width:
            return short
    return "…"


def require_ending(out: Path, endings: Sequence[str], what: str) -> None:
    """Refuse a file whose ending says no format that `what` can be written in.

    Raises:
        BadConfig: It is none of the endings, whatever their case.
    """
    if out.suffix.lower() not in endings:
        raise BadConfig(f"--out {out}: {what} is written as one of {', '.join(endings)}")


def save_picture(image: Image, path: Path) -> None:
    """Write one picture; the file's ending says how. The same picture gives the same bytes.

    A stop on the way leaves no half of one.
    """
    from PIL import Image

    partial = path.with_name(f".{path.name}.part")
    image.save(partial, format=Image.registered_extensions()[path.suffix.lower()])
    partial.replace(path)


def save_animation(frames: Sequence[Image], path: Path) -> None:
    """Write pictures that follow each other as an animated GIF or PNG, repeating for ever."""
    first, rest = frames[0], list(frames[1:])
    if path.suffix.lower() == ".gif":
        from PIL import Image

        # One palette for all frames: colours that jump between frames flicker. This method keeps
        # the small bright marks, which the others merge with their surroundings.
        samples = [frames[0], frames[len(frames) // 2], frames[-1]]
        width, height = first.size
        strip = Image.new("RGB", (width, len(samples) * height))
        for k, frame in enumerate(samples):
            strip.paste(frame, (0, k * height))
        palette = strip.quantize(255, method=Image.Quantize.MAXCOVERAGE)
        indexed = [f.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG) for f in frames]
        first, rest = indexed[0], indexed[1:]
    first.save(path, save_all=True, append_images=rest, duration=FRAME_MS, loop=0)


def _write(draw: ImageDraw, caption: Caption, x: int, y: int, width: int) -> None:
    for number, (line, colour) in enumerate(_rows(caption, width)):
        draw.text((x, y + number * _STEP), line, colour, _font(TEXT))


def _rows(caption: Caption, width: int) -> list[tuple[str, tuple[int, int, int]]]:
    """The lines of a caption as they are drawn, and their colours."""
    plain = 1 + len(caption.lines) - len(caption.good)
    found = []
    for number, line in enumerate((caption.head, *caption.lines)):
        colour = _ink(number, caption.good[number - plain] if number >= plain else None)
        found += [(part, colour) for part in wrapped(line, width)]
    return found


def _ink(number: int, good: bool | None) -> tuple[int, int, int]:
    if good is not None:
        return GOOD if good else BAD
    return INK if number == 0 else FAINT


def _font(size: int) -> FreeTypeFont | ImageFont:
    # Pillow's built-in font, so that a bare machine needs no font files.
    from PIL.ImageFont import load_default

    return load_default(size)
