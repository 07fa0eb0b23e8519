"""Laws of contact frames, grasp matrices and friction cones."""

import numpy as np
import pytest

from bidexdata.frames import matrix_from_quat, random_quat
from bidexdata.wrench.contact_model import (
    cone_violation,
    contact_frames,
    grasp_matrix,
    project_to_cone,
    split_force,
    wrench_of,
)

# Float64 algebra of a few operations.
EXACT = 1e-12

AXES = np.concatenate([np.eye(3), -np.eye(3)])


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def normals(count=50, seed=0):
    drawn = unit(np.random.default_rng(seed).standard_normal((count, 3)))
    diagonals = unit(np.array([[1.0, 1.0, 1.0], [1.0, -1.0, 0.0], [0.0, 0.0, -1.0]]))
    return np.concatenate([drawn, AXES, diagonals])


def test_contact_frames_are_right_handed_and_start_with_the_normal():
    n = normals()
    R = contact_frames(n)
    assert np.allclose(np.swapaxes(R, -1, -2) @ R, np.eye(3), atol=EXACT)
    assert np.array_equal(R[..., 0], n)
    assert np.allclose(np.cross(R[..., 1], R[..., 2]), n, atol=EXACT)


def test_the_grasp_matrix_gives_force_and_torque():
    rng = np.random.default_rng(1)
    n = normals()
    p, f = rng.standard_normal((2, len(n), 3))
    R = contact_frames(n)
    force = np.einsum("cij,cj->ci", R, f)
    w = np.einsum("cij,cj->ci", grasp_matrix(p, R), f)
    assert np.allclose(w[:, :3], force, atol=EXACT)
    assert np.allclose(w[:, 3:], np.cross(p, force), atol=EXACT)
    assert np.allclose(w.sum(axis=0), wrench_of(p, force), atol=1e-11)


def test_power_does_not_depend_on_the_frame():
    rng = np.random.default_rng(2)
    p, f = rng.standard_normal((2, 20, 10, 3))
    velocity, spin = rng.standard_normal((2, 20, 3))
    R, origin = matrix_from_quat(random_quat(rng, (20,))), rng.standard_normal((20, 3))

    def power(p, f, velocity, spin):
        w = wrench_of(p, f)
        return (w[:, :3] * velocity).sum(1) + (w[:, 3:] * spin).sum(1)

    def turn(v):
        return np.einsum("nij,n...j->n...i", R, v)

    # The same rigid motion seen from a frame that is turned and whose origin lies elsewhere.
    moved = turn(p) + origin[:, None]
    spin_there = turn(spin)
    velocity_there = turn(velocity) - np.cross(spin_there, origin)
    here = power(p, f, velocity, spin)
    assert np.allclose(power(moved, turn(f), velocity_there, spin_there), here, atol=1e-11)


@pytest.mark.parametrize("mu", [0.0, 0.1, 0.6, 2.0])
def test_the_projection_is_the_nearest_force_of_the_cone(mu):
    rng = np.random.default_rng(3)
    n = np.repeat(normals(20), 20, axis=0)
    y = 1.5 * rng.standard_normal(n.shape)
    y[::7] = 0.0  # the apex
    y[1::7] = n[1::7] * rng.uniform(-2, 2, (len(n[1::7]), 1))  # along the axis
    f = project_to_cone(y, n, mu=mu)
    assert np.all(cone_violation(f, n, mu=mu) < EXACT)
    assert np.allclose(project_to_cone(f, n, mu=mu), f, atol=EXACT)
    # The variational inequality: no other member of the convex set lies on y's side of f.
    R = contact_frames(n)
    for _ in range(20):
        pressed = rng.uniform(0, 1, len(n))
        angle = rng.uniform(0, 2 * np.pi, len(n))
        slide = mu * pressed * rng.choice([0.0, 0.5, 1.0], len(n))
        local = np.stack([pressed, slide * np.cos(angle), slide * np.sin(angle)], axis=1)
        other = np.einsum("cij,cj->ci", R, local)
        assert np.einsum("ci,ci->c", y - f, other - f).max() < EXACT


def test_splitting_a_force_loses_nothing():
    rng = np.random.default_rng(4)
    n = normals()
    f = rng.standard_normal(n.shape)
    f_n, f_t = split_force(f, n)
    assert np.allclose(f_n[:, None] * n + f_t, f, atol=EXACT)
    assert np.allclose(np.einsum("ci,ci->c", f_t, n), 0.0, atol=EXACT)
