"""Q1 and the QP certificate on contacts whose quality is known by hand."""

from __future__ import annotations

import numpy as np
import pytest

from bidexdata.frames import matrix_from_quat, random_quat
from bidexdata.simulation.distances import HandContacts
from bidexdata.validation.analytic import TipContacts, analytic_metrics, q1, qp_certificate

FRAME_TOLERANCE = 0.03  # the eight edges of a cone turn with its tangents


def tips(points):
    points = np.asarray(points, float)
    return TipContacts(points, -points / np.linalg.norm(points, axis=1, keepdims=True))


OCTAHEDRON = tips(0.1 * np.concatenate([np.eye(3), -np.eye(3)]))
OPPOSED = tips([[0.1, 0, 0], [-0.1, 0, 0]])


def test_contacts_all_round_have_force_closure_and_one_side_has_none():
    assert q1(OCTAHEDRON, 0.3) > 0.1
    one_side = TipContacts(OCTAHEDRON.points[:3], np.tile([1.0, 0, 0], (3, 1)))
    assert q1(one_side, 0.3) == 0
    assert q1(TipContacts(np.zeros((1, 3)), np.eye(3)[:1]), 0.3) == 0


def test_friction_never_makes_a_grasp_worse():
    values = [q1(OCTAHEDRON, mu) for mu in (0.1, 0.3, 0.6)]
    assert values == sorted(values)


def test_the_size_of_the_object_does_not_count_for_q1():
    small = TipContacts(OCTAHEDRON.points * 0.1, OCTAHEDRON.normals_in)
    assert q1(small, 0.3) == pytest.approx(q1(OCTAHEDRON, 0.3), rel=1e-9)


def test_a_turned_grasp_has_the_same_qualities():
    rng = np.random.default_rng(0)
    R = matrix_from_quat(random_quat(rng))
    turned = TipContacts(OCTAHEDRON.points @ R.T, OCTAHEDRON.normals_in @ R.T)
    assert q1(turned, 0.3) == pytest.approx(q1(OCTAHEDRON, 0.3), abs=FRAME_TOLERANCE)
    assert qp_certificate(turned, 0.3, 0.01) == pytest.approx(0, abs=1e-5)


def test_without_a_contact_both_have_the_benchmark_s_worst_value():
    nothing = HandContacts(*(np.zeros(0, int),) * 2, np.zeros(0), *(np.zeros((0, 3)),) * 2)
    assert analytic_metrics((), nothing, (0.6, 0.02)) == (0.0, 2.0)


def test_loads_along_the_line_of_two_opposed_contacts_are_balanced():
    assert qp_certificate(OCTAHEDRON, 0.3, 0.01) == pytest.approx(0, abs=1e-5)
    assert qp_certificate(OPPOSED, 0.3, 0.01) == pytest.approx(0, abs=1e-5)


def test_two_contacts_without_friction_leave_the_four_loads_across_unbalanced():
    # strengths 1/2 and more along x balance +-x; +-y and +-z keep 0.1 each
    assert qp_certificate(OPPOSED, 0.0, 0.0) == pytest.approx(4 * 0.1 / 6, abs=1e-5)


def test_a_lone_contact_pushes_with_all_its_strength():
    # it must press with 1: along its own axis against a load of 0.1 the rest is 0.9, and so on
    alone = TipContacts(np.array([[0.1, 0, 0]]), np.array([[-1.0, 0, 0]]))
    expected = (0.9 + 1.1 + 4 * np.hypot(1.0, 0.1)) / 6
    assert qp_certificate(alone, 0.0, 0.0) == pytest.approx(expected, abs=1e-5)
