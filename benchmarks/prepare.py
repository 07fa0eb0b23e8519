"""How many objects a minute one worker prepares, built-in shapes of all families."""

from __future__ import annotations

import time
from typing import Any

from bidexdata.config import fingerprint
from bidexdata.objects.config import PrepareConfig
from bidexdata.objects.prepare import prepare_object
from bidexdata.objects.sources import resolve_sources


def measure() -> dict[str, Any]:
    """Prepare one object of every family, in this process, after one for warm-up."""
    config = PrepareConfig()
    items = resolve_sources(["shapes"])
    prepare_object(items[0], config)
    start = time.perf_counter()
    made = [prepare_object(item, config) for item in items]
    seconds = time.perf_counter() - start
    hulls = sum(obj.provenance["piece_method"] == "hull" for obj in made)
    return {
        "objects_per_minute": 60 * len(made) / seconds,
        "objects": len(made),
        "replaced_by_hull": hulls,
        "pieces_mean": sum(len(obj.pieces) for obj in made) / len(made),
        "config": fingerprint(config),
    }
