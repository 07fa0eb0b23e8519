"""The picture of a release's card: a contact sheet of selected grasps, the same bytes every time."""

from __future__ import annotations

import io
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bidexdata.errors import NotUsable

if TYPE_CHECKING:
    from bidexdata.formats.pages import Picture

SHEET = "pictures/grasps.png"
SHOWN = 12
COLOURS = 128
"""Colours of the file: a card is read on a page, and a quarter of the bytes shows the same."""
_log = logging.getLogger(__name__)


def card_pictures(root: Path, head: Mapping[str, Any]) -> list[Picture]:
    """Draw a contact sheet of a release that is being written; none where that cannot be done.

    It cannot be done where shapes are left out, a hand is not known here, or a package is missing
    that draws: the card is then without a picture, and everything else is as it was.

    Args:
        root: Folder whose tables, shapes and hands are complete.
        head: The head of its manifest.
    """
    from bidexdata.formats.card_words import holds_shapes
    from bidexdata.formats.pages import Picture

    if not holds_shapes(head) or not head["figures"]["selected_rows"]:
        return []
    try:
        png = _sheet(root, head)
    except (NotUsable, ImportError) as err:
        _log.warning("the card has no picture: %s", err)
        return []
    caption = (
        f"Selected grasps of {head['name']}, spread over its objects and sizes, at the grasp stage"
    )
    return [Picture(SHEET, png, caption)] if png else []


def _sheet(root: Path, head: Mapping[str, Any]) -> bytes:
    from PIL import Image

    from bidexdata.formats.release import Release
    from bidexdata.pictures.picture import drawn_by
    from bidexdata.pictures.sheet import contact_sheet
    from bidexdata.record import Header
    from bidexdata.runs.browse_release import ReleaseSource
    from bidexdata.runs.choose import choose_grasps
    from bidexdata.runs.render import grasp_tiles

    # The manifest is written last; this is what will stand in it.
    manifest = {**head, "files": {}}
    release = Release(root, manifest, Header.from_json(head["header"]))
    source = ReleaseSource.of(release)
    chosen = choose_grasps(source, SHOWN)
    if not chosen:
        return b""
    tiles = grasp_tiles(source, chosen)
    sheet = contact_sheet(tiles, title=f"{head['name']} {head['version']}", footer=drawn_by("cpu"))
    file = io.BytesIO()
    flat: Image.Image = sheet.quantize(COLOURS)
    flat.save(file, "PNG", optimize=True)
    return file.getvalue()
