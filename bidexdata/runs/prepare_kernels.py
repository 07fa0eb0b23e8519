"""Kernels that preparing an object runs on the CPU, loaded before its limit on CPU time begins."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

import numpy as np

from bidexdata.devices import start_warp

_MODULES = ("bidexdata.objects.mesh_queries_kernels", "bidexdata.pictures.raycast_kernels")


@cache
def load_kernels() -> None:
    """Load the kernels; on a machine that never did so Warp compiles them, for tens of CPU seconds."""
    import warp as wp
    from warp.geometry import IsoSurfaceMarchingCubes

    start_warp()
    for name in _MODULES:
        wp.load_module(import_module(name), device="cpu")
    # Warp's own kernels are loaded by their first use.
    field = np.ones((3, 3, 3), np.float32)
    field[1, 1, 1] = -1
    grid: Any = wp.array(field, dtype=wp.float32, device="cpu")
    IsoSurfaceMarchingCubes.extract(grid)
