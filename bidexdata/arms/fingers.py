"""Where the fingers are while the arms move: the one schedule of searching, checking, showing, exporting.

They stay at the pre-grasp until the arms close, go to the grasp while they do, on to the squeeze while
they squeeze, and stay there in the lift.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from bidexdata.record.fields import KEY_FRAMES

PREGRASP = KEY_FRAMES.index("pregrasp")
LAST = {"grasp": 1.0, "squeeze": 2.0}
"""How many stages the fingers go on after the pre-grasp, by the last of them."""


def key_places(knots: Sequence[int]) -> Float[np.ndarray, " W"]:
    """Place of each knot among the key frames: 0 at home, 1 at the stand-off, 2.5 half closed.

    Args:
        knots: Of each phase.

    >>> key_places((1, 2, 1, 1, 1)).tolist()
    [0.0, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0]
    """
    ends = np.cumsum([0, *knots])
    return np.interp(np.arange(ends[-1] + 1), ends, np.arange(len(ends)))


def fingers_at(
    joints: Float[np.ndarray, "*w H 3 J"], places: Float[np.ndarray, " W"], last: str = "squeeze"
) -> Float[np.ndarray, "W H J"]:
    """Angles of the fingers at places among the key frames, bit-equal to the stages at these [rad].

    Args:
        joints: At pre-grasp, grasp and squeeze, of all places or of each [rad].
        places: As `key_places` gives them.
        last: `squeeze`, as it is commanded; `grasp` where the object is taken to stop the fingers.
    """
    stage = np.clip(places - PREGRASP, 0.0, LAST[last])[:, None, None]
    closing, pressing = np.minimum(stage, 1.0), np.maximum(stage - 1.0, 0.0)
    pre, at, end = (joints[..., s, :].astype(np.float64) for s in range(3))
    closed = (1.0 - closing) * pre + closing * at
    return (1.0 - pressing) * closed + pressing * end
