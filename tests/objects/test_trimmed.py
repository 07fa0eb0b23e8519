"""Laws of trimming: the union stays, the sum shrinks, what is covered in full goes."""

import numpy as np
import pytest

from bidexdata.objects.closed import as_mesh, convex_hull, union
from bidexdata.objects.trimmed import trimmed

# Rounding of booleans on bodies of about unit size.
SAME = 1e-6


def cube(low, high):
    corners = np.stack(np.meshgrid(*np.array([low, high], float).T, indexing="ij"), axis=-1)
    return as_mesh(convex_hull(corners.reshape(-1, 3)))


def whole(pieces):
    return union([convex_hull(piece.vertices) for piece in pieces])


def total(pieces):
    return sum(convex_hull(piece.vertices).volume() for piece in pieces)


def test_two_boxes_that_overlap_share_the_overlap_out():
    """By hand: a layer of 0.1 x 1 x 1 counts twice before and once after."""
    a, b = cube([0, 0, 0], [1.0, 1, 1]), cube([0.9, 0, 0], [1.5, 1, 1])
    found = trimmed([a, b])
    assert total([a, b]) == pytest.approx(1.6)
    assert total(found) == pytest.approx(1.5, abs=SAME)
    assert whole(found).volume() == pytest.approx(1.5, abs=SAME)
    # The larger is trimmed first; then nothing of the smaller is covered.
    np.testing.assert_allclose(found[0].vertices.max(axis=0), [0.9, 1, 1], atol=SAME)
    np.testing.assert_allclose(found[1].vertices.min(axis=0), [0.9, 0, 0], atol=SAME)


def test_what_is_covered_in_full_goes_and_the_order_stays():
    large, inside = cube([0, 0, 0], [1.0, 1, 1]), cube([0.2, 0.2, 0.2], [0.5, 0.5, 0.5])
    far = cube([3, 0, 0], [4.0, 1, 1])
    found = trimmed([inside, far, large])
    assert len(found) == 2
    np.testing.assert_allclose(found[0].vertices.min(axis=0), [3, 0, 0], atol=SAME)
    assert total(found) == pytest.approx(2.0, abs=SAME)


def test_random_bodies_keep_their_union_and_never_grow():
    rng = np.random.default_rng(4)
    for _ in range(30):
        middles = rng.uniform(-0.4, 0.4, (rng.integers(2, 9), 3))
        pieces = [
            as_mesh(convex_hull(m + rng.uniform(-0.3, 0.3, (rng.integers(4, 30), 3))))
            for m in middles
        ]
        found = trimmed(pieces)
        assert whole(found).volume() == pytest.approx(whole(pieces).volume(), rel=1e-5)
        assert total(found) <= total(pieces) + SAME
        planes = [convex_hull(piece.vertices) for piece in pieces]
        # Nothing is added anywhere: every piece lies in the union of the old ones.
        assert sum((convex_hull(p.vertices) - union(planes)).volume() for p in found) < 1e-6


def test_the_hull_of_what_a_boolean_leaves_holds_all_of_it():
    rng = np.random.default_rng(4)
    for _ in range(60):
        middles = rng.uniform(-0.4, 0.4, (4, 3))
        bodies = [convex_hull(m + rng.uniform(-0.3, 0.3, (20, 3))) for m in middles]
        left = bodies[0] - union(bodies[1:])
        if not left.is_empty():
            assert (left - convex_hull(as_mesh(left).vertices)).volume() < SAME
