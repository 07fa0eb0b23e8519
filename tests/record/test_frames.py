"""Group laws of rotations and transforms over random samples and an edge list."""

import numpy as np
import pytest

from bidexdata import frames

TOLERANCE = 1e-9  # float64 algebra; half turns lose half the digits in arctan2 at worst
H = np.sqrt(0.5)
EDGES = np.array(
    [
        [1, 0, 0, 0],
        [-1, 0, 0, 0],
        [0, 1, 0, 0],
        [0, 0, 1, 0],
        [0, 0, 0, 1],
        [0, -1, 0, 0],
        [0, 0, 0, -1],
        [H, H, 0, 0],
        [H, 0, -H, 0],
        [0, H, H, 0],
        [0, 0, -H, H],
        [0.5, 0.5, 0.5, 0.5],
        [np.cos(1e-9), np.sin(1e-9), 0, 0],
        [np.sin(1e-9), 0, np.cos(1e-9), 0],
    ]
)
ROTATIONS = np.concatenate([EDGES, frames.random_quat(np.random.default_rng(0), (200,))])


def same_rotation(a, b):
    return np.abs(np.einsum("...i,...i->...", a, b)) > 1 - 1e-12


def test_products_are_associative_and_match_matrices():
    a, b, c = ROTATIONS, np.roll(ROTATIONS, 1, 0), np.roll(ROTATIONS, 5, 0)
    left = frames.quat_multiply(frames.quat_multiply(a, b), c)
    right = frames.quat_multiply(a, frames.quat_multiply(b, c))
    np.testing.assert_allclose(left, right, atol=TOLERANCE)
    np.testing.assert_allclose(
        frames.matrix_from_quat(frames.quat_multiply(a, b)),
        frames.matrix_from_quat(a) @ frames.matrix_from_quat(b),
        atol=TOLERANCE,
    )


def test_matrices_are_rotations_and_give_the_quaternion_back():
    R = frames.matrix_from_quat(ROTATIONS)
    np.testing.assert_allclose(
        R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=TOLERANCE
    )
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=TOLERANCE)
    assert same_rotation(frames.quat_from_matrix(R), ROTATIONS).all()


def test_conjugate_inverts():
    identity = frames.quat_multiply(ROTATIONS, frames.quat_conjugate(ROTATIONS))
    np.testing.assert_allclose(
        identity, np.broadcast_to([1.0, 0, 0, 0], identity.shape), atol=TOLERANCE
    )


def test_rotation_vectors_round_trip_also_at_half_turns():
    v = frames.rotation_vector_from_quat(ROTATIONS)
    assert (np.linalg.norm(v, axis=1) <= np.pi + TOLERANCE).all()
    assert same_rotation(frames.quat_from_rotation_vector(v), ROTATIONS).all()
    half = frames.rotation_vector_from_quat(EDGES[2:5])
    np.testing.assert_allclose(np.linalg.norm(half, axis=1), np.pi, atol=TOLERANCE)


def test_stored_form_is_unique():
    canonical = frames.quat_canonical(ROTATIONS)
    np.testing.assert_array_equal(canonical, frames.quat_canonical(-ROTATIONS))
    np.testing.assert_allclose(canonical, frames.quat_canonical(3.7 * ROTATIONS), atol=1e-15)
    assert (canonical[:, 0] >= -1e-12).all()
    np.testing.assert_array_equal(frames.quat_canonical([0, -1, 0, 0]), [0, 1, 0, 0])
    np.testing.assert_array_equal(frames.quat_canonical([0, 0, -1, 0]), [0, 0, 1, 0])


@pytest.mark.parametrize("q", [[0, 0, 0, 0], [np.nan, 0, 0, 1], [np.inf, 0, 0, 0]])
def test_no_rotation_is_refused(q):
    with pytest.raises(ValueError, match="has no rotation"):
        frames.quat_canonical(q)


def test_angles_do_not_tell_q_from_minus_q():
    np.testing.assert_allclose(frames.quat_angle(ROTATIONS, -ROTATIONS), 0, atol=1e-7)
    turned = frames.quat_multiply(ROTATIONS, [0, 0, 1, 0])
    np.testing.assert_allclose(frames.quat_angle(ROTATIONS, turned), np.pi, atol=1e-7)


def test_slerp_starts_ends_and_keeps_its_pace():
    a, b = ROTATIONS, np.roll(ROTATIONS, 3, 0)
    whole = frames.quat_angle(a, b)
    assert same_rotation(frames.quat_slerp(a, b, np.zeros(len(a))), a).all()
    assert same_rotation(frames.quat_slerp(a, b, np.ones(len(a))), b).all()
    third = frames.quat_slerp(a, b, np.full(len(a), 1 / 3))
    np.testing.assert_allclose(frames.quat_angle(a, third), whole / 3, atol=1e-7)


def test_transforms_invert_and_compose_on_points():
    rng = np.random.default_rng(1)
    T_a_b = frames.transform(rng.normal(size=(len(ROTATIONS), 3)), ROTATIONS)
    T_b_c = np.roll(T_a_b, 2, 0)
    points_c = rng.normal(size=(len(ROTATIONS), 7, 3))
    np.testing.assert_allclose(
        frames.apply(T_a_b @ T_b_c, points_c),
        frames.apply(T_a_b, frames.apply(T_b_c, points_c)),
        atol=TOLERANCE,
    )
    np.testing.assert_allclose(
        frames.apply(frames.invert(T_a_b), frames.apply(T_a_b, points_c)), points_c, atol=TOLERANCE
    )
    pos, quat = frames.pos_quat(T_a_b)
    np.testing.assert_allclose(frames.transform(pos, quat), T_a_b, atol=TOLERANCE)


def test_rotation_agrees_with_the_matrix_and_a_known_case():
    v = np.random.default_rng(2).normal(size=(len(ROTATIONS), 3))
    np.testing.assert_allclose(
        frames.quat_rotate(ROTATIONS, v),
        np.einsum("nij,nj->ni", frames.matrix_from_quat(ROTATIONS), v),
        atol=TOLERANCE,
    )
    # A quarter turn about z takes x to y.
    np.testing.assert_allclose(frames.quat_rotate([H, 0, 0, H], [1, 0, 0]), [0, 1, 0], atol=1e-15)


def test_any_direction_has_a_frame():
    rng = np.random.default_rng(3)
    z = np.concatenate([np.eye(3), -np.eye(3), rng.normal(size=(50, 3))])
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    R = frames.rotation_with_z(z)
    np.testing.assert_allclose(R[:, :, 2], z, atol=TOLERANCE)
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=TOLERANCE)


def test_orders_convert_both_ways():
    np.testing.assert_array_equal(frames.xyzw_from_wxyz([1, 2, 3, 4]), [2, 3, 4, 1])
    np.testing.assert_array_equal(frames.wxyz_from_xyzw(frames.xyzw_from_wxyz(EDGES)), EDGES)


def test_scipy_agrees():
    from scipy.spatial.transform import Rotation

    theirs = Rotation.from_quat(frames.xyzw_from_wxyz(ROTATIONS))
    np.testing.assert_allclose(
        theirs.as_matrix(), frames.matrix_from_quat(ROTATIONS), atol=TOLERANCE
    )


def test_random_rotations_are_uniform():
    # The mean of uniform rotation matrices is zero; 3 standard errors of 20,000 draws.
    R = frames.matrix_from_quat(frames.random_quat(np.random.default_rng(4), (20_000,)))
    assert np.abs(R.mean(axis=0)).max() < 3 * np.sqrt(1 / 3 / 20_000) * 1.2
