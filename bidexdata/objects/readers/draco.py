"""Triangles that glTF files hold compressed by Draco, through the package of the extra `draco`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bidexdata.objects.failure import PrepareFailure
from bidexdata.record.status import Status

from .content import unreadable

DRACO = "KHR_draco_mesh_compression"


def draco_triangles(
    data: bytes, extension: dict[str, Any]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Decode a primitive: vertices (V, 3) and faces (F, 3).

    Args:
        data: The compressed buffer view.
        extension: The primitive's object of the extension, which names the attribute's id.

    Raises:
        PrepareFailure: The decoder is not installed, or cannot read it.
    """
    try:
        import DracoPy  # type: ignore[import-not-found]
    except ImportError as err:
        raise PrepareFailure(
            Status.UNSUPPORTED,
            "it is compressed by Draco; install the decoder with: pip install 'bidexdata[draco]'",
        ) from err
    try:
        decoded = DracoPy.decode(data)
    except (DracoPy.FileTypeException, ValueError, RuntimeError) as err:
        raise unreadable(f"Draco cannot decode it: {str(err)[:120]}") from err
    faces = getattr(decoded, "faces", None)
    attributes = extension.get("attributes")
    number = attributes.get("POSITION") if isinstance(attributes, dict) else None
    found = [a["data"] for a in decoded.attributes if a["unique_id"] == number]
    if faces is None or not found or found[0].ndim != 2 or found[0].shape[1] != 3:
        raise unreadable("what Draco decoded are no triangles")
    return np.asarray(found[0], np.float64), np.asarray(faces, np.int64).reshape(-1, 3)
