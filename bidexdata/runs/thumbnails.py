"""A small picture of a prepared object, for the report of a library."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bidexdata.objects.prepared import Solid

THUMBNAIL = "thumbnail.png"
"""Beside an object's files; no part of the object."""
WIDTH, HEIGHT = 160, 120
"""Pixels of each of the two views: the repaired mesh and the convex pieces."""


def thumbnail(solid: Solid) -> bytes:
    """Draw an object's repaired mesh beside its pieces, as a PNG file."""
    from PIL import Image

    from bidexdata.pictures.picture import draw_object

    file = io.BytesIO()
    Image.fromarray(draw_object(solid, width=WIDTH, height=HEIGHT)).quantize(64).save(
        file, "PNG", optimize=True
    )
    return file.getvalue()
