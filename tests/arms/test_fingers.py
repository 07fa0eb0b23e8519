"""The schedule of the fingers: bit-equal to the stages at their key frames, straight between them."""

from __future__ import annotations

import numpy as np
import pytest

from bidexdata.arms.fingers import fingers_at, key_places
from bidexdata.record.fields import KEY_FRAMES

KNOTS = (4, 2, 4, 3, 5)
ENDS = np.cumsum([0, *KNOTS])


def test_knots_that_end_phases_are_at_the_key_frames_and_others_evenly_between():
    places = key_places(KNOTS)
    np.testing.assert_array_equal(places[ENDS], np.arange(len(KEY_FRAMES)))
    for first, last, count in zip(ENDS, ENDS[1:], KNOTS, strict=False):
        np.testing.assert_allclose(np.diff(places[first : last + 1]), 1 / count, atol=1e-12)


@pytest.mark.parametrize("last", ["grasp", "squeeze"])
def test_fingers_wait_close_press_on_and_stay(rng, last):
    joints = rng.normal(size=(2, 3, 5)).astype(np.float32)
    joints[1, :, 4] = np.nan  # padded behind the shorter hand
    found = fingers_at(joints, key_places(KNOTS), last)
    frames = [0, 0, 0, 1, 2, 2] if last == "squeeze" else [0, 0, 0, 1, 1, 1]
    np.testing.assert_array_equal(found[ENDS], joints[:, frames].swapaxes(0, 1))
    half = (joints[:, 0].astype(float) + joints[:, 1]) / 2
    np.testing.assert_allclose(found[ENDS[2] + 2], half, atol=1e-12)
    still = found[: ENDS[2] + 1]
    np.testing.assert_array_equal(still, np.repeat(still[:1], len(still), axis=0))
    end = found[ENDS[4] :]
    np.testing.assert_array_equal(end, np.repeat(end[:1], len(end), axis=0))
