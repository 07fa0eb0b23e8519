"""Analytic qualities of the fingertip contacts at the grasp: Q1, and a QP that OSQP certifies.

Contacts are those of DexGraspBench: the tip body of every finger within 5 mm of the object, all
its contacts averaged to one point and one normal, friction halved. A tip whose normals cancel
is left out. No contact gives no quality.

The signs are unlike: q1 grows with the quality (0 is no force closure, DexGraspBench's q1_metric is
2 - q1), qp_certificate falls.

Source:
    DexGraspBench, `fc_metric` (q1_metric, qp_metric); Q1 after Ferrari and Canny,
    "Planning optimal grasps", 1992, as the distance from the origin to the convex hull of single
    cone edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.errors import MissingExtra
from bidexdata.hands.model import Hand
from bidexdata.simulation.distances import HandContacts
from bidexdata.wrench.contact_model import grasp_matrix

FloatArray = NDArray[np.float64]

TIP_WITHIN = 0.005
"""A tip whose distance is at most this, in or out, has a contact [m] (DexGraspBench)."""
FRICTION_SHARE = 0.5
"""Share of the simulation's friction (DexGraspBench)."""
EDGES = 8
"""Edges of a friction cone in Q1 (DexGraspBench)."""
FORCE = 0.1
"""Size of the six forces of the QP [N] (DexGraspBench)."""
NO_SOLUTION = 1.0
"""Residual where OSQP finds no solution (DexGraspBench)."""
NO_CONTACT = 2.0
"""Residual without any contact (DexGraspBench)."""
ALONG_Y = 0.99
"""Normals closer to the y axis than this cosine take z for their first tangent (DexGraspBench)."""


class AnalyticMetrics(NamedTuple):
    """The analytic columns of one grasp."""

    q1: float
    """Radius of the largest wrench ball, 0 without force closure [-]."""
    qp_certificate: float
    """Mean residual norm over six small forces, 0 when all can be balanced; three of its numbers are
    forces [N], three torques [N m]."""


class TipContacts(NamedTuple):
    """One contact per fingertip near the object, T of them; world frame."""

    points: FloatArray
    """[m], (T, 3)."""
    normals_in: FloatArray
    """Unit normals into the object, (T, 3)."""


def analytic_metrics(
    hands: Sequence[Hand], contacts: HandContacts, friction: tuple[float, float]
) -> AnalyticMetrics:
    """Compute both qualities.

    Args:
        hands: The hands of the contacts.
        contacts: All contacts at the grasp.
        friction: Tangential [-] and torsional [m] friction of the simulation.
    """
    tips = tip_contacts(hands, contacts)
    if len(tips.points) == 0:
        return AnalyticMetrics(0.0, NO_CONTACT)
    slide, spin = (FRICTION_SHARE * f for f in friction)
    return AnalyticMetrics(q1(tips, slide), qp_certificate(tips, slide, spin))


def tip_contacts(hands: Sequence[Hand], contacts: HandContacts) -> TipContacts:
    """Average the contacts of every tip body to one point and one normal."""
    points, normals = [], []
    near = np.abs(contacts.dist) <= TIP_WITHIN
    for number, hand in enumerate(hands):
        for bodies in hand.fingers.values():
            tip = hand.body_names.index(bodies[-1])
            mine = near & (contacts.hand == number) & (contacts.body == tip)
            if not mine.any():
                continue
            normal = contacts.normal_in[mine].mean(axis=0)
            length = float(np.linalg.norm(normal))
            if length < 1e-6:  # opposite sides of a thin wall: no side to press on
                continue
            points.append(contacts.point[mine].mean(axis=0))
            normals.append(normal / length)
    return TipContacts(np.array(points).reshape(-1, 3), np.array(normals).reshape(-1, 3))


def _frames(normals: FloatArray) -> FloatArray:
    """Columns (n, d, n x d), d the y axis made orthogonal to n: edges of a pyramid depend on it."""
    flat = np.abs(normals[:, 1]) > ALONG_Y
    axis = np.where(flat[:, None], np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0]))
    first = axis - np.sum(axis * normals, axis=1, keepdims=True) * normals
    first = first / np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normals, first)
    return np.stack([normals, first, second], axis=-1).astype(np.float64)


def q1(tips: TipContacts, friction: float) -> float:
    """Distance from the origin to the convex hull of all cone edges and the origin.

    Positions are taken from the contacts' centroid in units of their mean distance to it.
    """
    from scipy.spatial import ConvexHull, QhullError

    offset = tips.points - tips.points.mean(axis=0)
    scale = float(np.linalg.norm(offset, axis=1).mean())
    if scale < 1e-9:  # a single contact, or all in one place
        return 0.0
    angle = 2 * np.pi * np.arange(EDGES) / EDGES
    edges = np.stack([np.ones(EDGES), friction * np.sin(angle), friction * np.cos(angle)], axis=1)
    G = grasp_matrix(offset / scale, _frames(tips.normals_in))
    wrenches = np.einsum("cij,ej->cei", G, edges).reshape(-1, 6)
    try:
        hull = ConvexHull(np.concatenate([wrenches, np.zeros((1, 6))]))
    except QhullError:  # all wrenches lie in a subspace: no force closure
        return 0.0
    return float(max(0.0, np.min(-hull.equations[:, -1])))


def qp_certificate(tips: TipContacts, friction: float, spin: float) -> float:
    """Mean residual norm of the wrench balance against six forces along +- x, y, z.

    A contact's wrench is a mix of the edges of two pyramids, tangential and torsional, whose
    strengths sum to at most 1; all strengths together sum to at least 1. Torques are about the
    contacts' centroid, with arms in metres and no scale, so the norm mixes N and N m.

    Raises:
        MissingExtra: OSQP is not installed.
    """
    G = grasp_matrix(tips.points - tips.points.mean(axis=0), _frames(tips.normals_in))
    edges = _soft_edges(G, friction, spin)
    loads = np.concatenate([np.eye(6)[:3], -np.eye(6)[:3]]) * FORCE
    return float(np.mean([_residual(edges, load) for load in loads]))


def _soft_edges(G: FloatArray, friction: float, spin: float) -> FloatArray:
    """Wrenches of the edges of every contact's soft-finger pyramid, (T, 6, 6): edge, row."""
    normal, first, second = G[..., 0], G[..., 1], G[..., 2]
    twist = np.concatenate([np.zeros_like(normal[:, :3]), normal[:, :3]], axis=1)
    sides = (friction * first, friction * second, spin * twist)
    return np.stack([normal + sign * side for side in sides for sign in (1.0, -1.0)], axis=1)


def _residual(edges: FloatArray, load: FloatArray) -> float:
    try:
        import osqp
        from scipy import sparse
    except ImportError as err:
        raise MissingExtra("osqp", "synth") from err
    contacts, per_contact = edges.shape[:2]
    n = contacts * per_contact
    W = edges.reshape(n, 6).T
    rows = sparse.vstack(
        [
            sparse.hstack([sparse.csc_matrix(W), -sparse.identity(6)]),
            sparse.hstack([sparse.identity(n), sparse.csc_matrix((n, 6))]),
            sparse.hstack(
                [
                    sparse.kron(sparse.identity(contacts), np.ones((1, per_contact))),
                    sparse.csc_matrix((contacts, 6)),
                ]
            ),
            sparse.csc_matrix(np.concatenate([np.ones((1, n)), np.zeros((1, 6))], axis=1)),
        ],
        format="csc",
    )
    lower = np.concatenate([-load, np.zeros(n), np.full(contacts, -np.inf), [1.0]])
    upper = np.concatenate([-load, np.full(n, np.inf), np.ones(contacts), [np.inf]])
    solver = osqp.OSQP()
    solver.setup(
        P=sparse.diags([0.0] * n + [2.0] * 6, format="csc"),
        q=np.zeros(n + 6),
        A=rows,
        l=lower,
        u=upper,
        eps_abs=1e-7,
        eps_rel=1e-7,
        max_iter=20_000,
        polishing=True,
        verbose=False,
    )
    found = solver.solve(raise_error=False)
    if not found.info.status.startswith("solved"):
        return NO_SOLUTION
    return float(np.linalg.norm(W @ found.x[:n] + load))
