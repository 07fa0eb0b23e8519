"""Smooth joint paths: the least third difference between pinned knots, within bounds.

Every joint is a problem of its own with the same matrix. Where no bound is met, which is the rule,
its solution is that of one small linear system for all joints; OSQP solves the others. The problem of
many knots is stiff (its eigenvalues span nine powers of ten), so that OSQP needs about a millisecond
per joint where the linear system needs a tenth of one for all.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

NEAR = 1e-5
"""Weight of the squared way from the given path against that of third differences [-]: slow bends
over more than thirty knots are left as they are, and every problem is well posed."""
_TOLERANCE = 1e-6
_RHO = 1e-4
"""OSQP's step size; fixed, so that an answer does not depend on the path before."""
_ROOM = 1e-9


class Smoothed(NamedTuple):
    """Paths after smoothing."""

    path: Float[np.ndarray, "*r W A"]
    """[rad]; the given path where there is no solution."""
    solved: Bool[np.ndarray, "*r"]


class Smoother:
    """Smooths paths of W knots of A joints; OSQP is set up once, when it is first needed."""

    def __init__(self, knots: int, joints: int) -> None:
        self._shape = (knots, joints)
        third = np.diff(np.eye(knots), 3, axis=0)
        self._hessian = third.T @ third + NEAR * np.eye(knots)
        self._solver: Any = None

    def smooth(
        self,
        path: Float[np.ndarray, "*r W A"],
        pinned: Bool[np.ndarray, " W"],
        lower: Float[np.ndarray, " A"],
        upper: Float[np.ndarray, " A"],
        largest_step: float,
    ) -> Smoothed:
        """Smooth paths between their pinned knots; none depends on the others.

        Args:
            path: The paths [rad].
            pinned: Knots that stay where they are.
            lower: Joint limits [rad].
            upper: [rad].
            largest_step: Largest turn of a joint from knot to knot [rad].

        Returns:
            The paths with the least sum of squared third differences; pinned knots are bit-equal.
        """
        assert path.shape[-2:] == self._shape
        smooth, free = path.copy(), ~pinned
        across = self._hessian[np.ix_(free, pinned)]
        known = NEAR * path[..., free, :] - across @ path[..., pinned, :]
        smooth[..., free, :] = np.linalg.solve(self._hessian[np.ix_(free, free)], known)
        inside = (smooth >= lower - _ROOM) & (smooth <= upper + _ROOM)
        steps = np.abs(np.diff(smooth, axis=-2)).max(axis=-2, initial=0.0)
        bad = ~inside.all(axis=-2) | (steps > largest_step + _ROOM)
        smooth = np.where(free[:, None], np.clip(smooth, lower, upper), path)
        solved = np.ones(path.shape[:-2], bool)
        # Every joint is a problem of its own.
        for *row, joint in np.argwhere(bad).tolist():
            column = (*row, slice(None), joint)
            limits = (lower[joint], upper[joint], largest_step)
            smooth[column], good = self._bounded(path[column], pinned, *limits)
            solved[tuple(row)] &= good
        return Smoothed(np.where(solved[..., None, None], smooth, path), solved)

    def _bounded(
        self,
        path: np.ndarray,
        pinned: np.ndarray,
        lower: float,
        upper: float,
        largest_step: float,
    ) -> tuple[np.ndarray, bool]:
        """The same for one joint where a bound is met, by OSQP."""
        self._solver = self._solver or _set_up(self._hessian)
        turn = np.full(len(path) - 1, largest_step)
        bottom = np.concatenate([np.where(pinned, path, lower), -turn])
        top = np.concatenate([np.where(pinned, path, upper), turn])
        self._solver.update(l=bottom, u=top, q=-NEAR * path)
        self._solver.warm_start(x=path, y=np.zeros(len(bottom)))
        found = self._solver.solve(raise_error=False)
        if found.info.status != "solved":
            return path, False
        return np.where(pinned, path, np.clip(np.asarray(found.x, np.float64), lower, upper)), True


def roughness(path: Float[np.ndarray, "W A"]) -> float:
    """Sum of the squared third differences of a path [rad^2]."""
    return float(np.sum(np.diff(path, 3, axis=0) ** 2))


def _set_up(hessian: np.ndarray) -> Any:
    import osqp
    from scipy import sparse

    knots = len(hessian)
    steps = sparse.csc_matrix(np.diff(np.eye(knots), axis=0))
    A = sparse.vstack([sparse.eye(knots), steps], format="csc")
    free = np.full(2 * knots - 1, np.inf)
    solver = osqp.OSQP()
    solver.setup(
        sparse.triu(sparse.csc_matrix(hessian), format="csc"),
        *(np.zeros(knots), A, -free, free),
        verbose=False, polishing=True, eps_abs=_TOLERANCE, eps_rel=_TOLERANCE, max_iter=4000,
        rho=_RHO, adaptive_rho=False,
    )  # fmt: skip
    return solver
