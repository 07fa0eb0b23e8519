"""Chains on a device: the frames of the joints as they are, and the form of the inverse kinematics."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from bidexdata.arms.chain import Chain
from bidexdata.arms.twisted_chain import twisted
from bidexdata.devices import start_warp


@lru_cache(maxsize=16)
def chain_on_device(chain: Chain, device: str) -> Any:
    """Copy a chain to a device, once."""
    start_warp()
    import warp as wp

    from bidexdata.arms.chain_kernels import ChainArrays

    arrays = ChainArrays()
    count = chain.joints
    for name, dtype in (("before_pos", wp.vec3), ("before_rot", wp.mat33), ("axis", wp.vec3)):
        values = np.ascontiguousarray(getattr(chain, name), np.float32)
        setattr(arrays, name, wp.array(values, dtype=dtype, shape=(count,), device=device))
    arrays.end_pos = wp.vec3(*map(float, chain.end_pos))
    arrays.end_rot = wp.mat33(*map(float, chain.end_rot.ravel()))
    arrays.count = count
    return arrays


@lru_cache(maxsize=16)
def twisted_on_device(chain: Chain, device: str) -> Any:
    """Copy a chain to a device in the form of the inverse kinematics, once."""
    start_warp()
    import warp as wp

    from bidexdata.arms.chain_kernels import TwistedArrays

    made, arrays, count = twisted(chain), TwistedArrays(), chain.joints
    for name, column in zip(("first_x", "first_y", "first_z"), made.first_rot.T, strict=True):
        setattr(arrays, name, wp.vec3(*map(float, column)))
    before = np.ascontiguousarray(made.before_pos, np.float32)
    arrays.before_pos = wp.array(before, dtype=wp.vec3, shape=(count,), device=device)
    for name, angles in (("twist", made.twist), ("offset", made.offset)):
        turns = np.stack([np.cos(angles), np.sin(angles)], axis=1).astype(np.float32)
        setattr(arrays, name, wp.array(turns, dtype=wp.vec2, shape=(count,), device=device))
    for name in ("lower", "upper", "rest"):
        setattr(arrays, name, floats_on_device(_inner(chain, name), device))
    arrays.end_pos = wp.vec3(*map(float, made.end_pos))
    arrays.end_rot = wp.mat33(*map(float, made.end_rot.ravel()))
    arrays.count = count
    return arrays


def _inner(chain: Chain, name: str) -> np.ndarray:
    """Limits in float32 that lie within those in float64."""
    values = getattr(chain, name)
    single = values.astype(np.float32)
    if name == "lower":
        return np.where(single < values, np.nextafter(single, np.float32(np.inf)), single)
    if name == "upper":
        return np.where(single > values, np.nextafter(single, np.float32(-np.inf)), single)
    return single


def floats_on_device(values: np.ndarray, device: str) -> Any:
    """Copy numbers to a device, float32."""
    import warp as wp

    return wp.array(np.ascontiguousarray(values, np.float32), dtype=float, device=device)
