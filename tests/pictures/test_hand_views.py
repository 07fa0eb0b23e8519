"""A hand alone: what marks its spec is seen, and a left hand looks like a right one in a mirror."""

from __future__ import annotations

import numpy as np
import pytest

from bidexdata.hands import load_hand
from bidexdata.pictures.hand_views import DIRECTIONS, draw_hand, hand_tiles, hand_view_parts


@pytest.mark.parametrize("shown", ["meshes", "spheres"])
def test_the_left_hand_is_drawn_as_the_mirror_image_of_the_right(shown):
    drawn = []
    for side in ("left", "right"):
        hand = load_hand("capsule", side)
        parts = hand_view_parts(hand, hand.posture_open, shown)
        points = np.concatenate([p.vertices for p in parts if p.label in (side, "contact")])
        drawn.append(points)
    left, right = drawn[0] * [1.0, -1.0, 1.0], drawn[1]
    for take in (np.min, np.max, np.mean):
        np.testing.assert_allclose(take(left, axis=0), take(right, axis=0), atol=1e-3)


def test_every_contact_point_has_a_ball_and_an_arrow_along_its_normal():
    hand = load_hand("capsule", "right")
    parts = hand_view_parts(hand, hand.posture_curved, "spheres")
    labels = [part.label for part in parts]
    assert labels.count("contact") == 2 * len(hand.contact_names)
    assert labels.count("right") == len(hand.sphere_body) - hand.fingertips


def test_contact_points_and_palm_frame_are_seen():
    hand = load_hand("capsule", "left")
    pixels = draw_hand(hand, hand.posture_open, "palm", width=160, height=120).astype(int)
    red, green, blue = pixels[..., 0], pixels[..., 1], pixels[..., 2]
    assert np.sum((red > 120) & (green < 70) & (blue < 70)) > 20
    tiles = hand_tiles(hand)
    assert len(tiles) == 2 * len(DIRECTIONS)
    assert len({tile.pixels.shape for tile in tiles}) == 1
