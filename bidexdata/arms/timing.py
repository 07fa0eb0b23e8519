"""When two arms pass the knots of their paths: no joint faster than its share of what it can."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float


def knot_times(
    paths: Sequence[Float[np.ndarray, "*r W _"]],
    velocities: Sequence[Float[np.ndarray, " _"]],
    knots: Sequence[int],
    least: Sequence[float],
    share: float,
) -> Float[np.ndarray, "*r W"]:
    """Give every knot its time, the same for all arms; knots of one phase are evenly spaced.

    Args:
        paths: Joint paths of the arms [rad], W = 1 + sum(knots).
        velocities: Largest speeds of their joints [rad/s].
        knots: Knots of each phase, without the one before it.
        least: Least time of each phase [s].
        share: Share of the largest speed that is used [-].

    Returns:
        Times since the first knot [s].
    """
    need = np.max(
        [
            np.max(np.abs(np.diff(path, axis=-2)) / (share * speed), axis=-1)
            for path, speed in zip(paths, velocities, strict=True)
        ],
        axis=0,
    )
    steps, first = np.zeros((*need.shape[:-1], 1 + sum(knots))), 0
    for count, shortest in zip(knots, least, strict=True):
        slowest = np.max(need[..., first : first + count], axis=-1, initial=shortest / count)
        steps[..., 1 + first : 1 + first + count] = slowest[..., None]
        first += count
    return np.cumsum(steps, axis=-1)
