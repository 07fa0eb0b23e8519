"""Which of two postures of an arm is the better one: near to rest, with room."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

ROOM_COUNTS = 30.0
"""What a metre of clearance is worth in turns away from rest [rad/m]."""


def posture_cost(
    q: Float[np.ndarray, "*b A"], rest: Float[np.ndarray, " A"], room: Float[np.ndarray, "*b"]
) -> Float[np.ndarray, "*b"]:
    """Largest turn of a joint away from rest, less what the room is worth: what is best is least [rad].

    Args:
        q: Postures [rad].
        rest: The rest posture [rad].
        room: Their clearances, capped where more is no better [m].
    """
    return np.asarray(np.abs(q - rest).max(axis=-1) - ROOM_COUNTS * room)
