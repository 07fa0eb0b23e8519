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
_TOLERANCE = 4e-6
_RHO = 3e-4
"""OSQP's step size; fixed, so that an answer does not depend on the path before."""
_ROOM = 1e-9


class Smoothed(NamedTuple):
    """Paths after smoothing."""

    path: Float[np.ndarray, "*r W A"]
    """[rad]; the given path where there is no solution."""
    solved: Bool[np.ndarray, "*r"]


class Smoother:
    """Smooths paths of W knots of A joints; what depends on the pins alone is worked out once."""

    def __init__(self, knots: int, joints: int) -> None:
        self._shape = (knots, joints)
        self._problems: dict[bytes, _Problem] = {}

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
        key = pinned.tobytes()
        problem = self._problems.get(key)
        if problem is None:
            problem = self._problems[key] = _Problem(pinned)
        smooth = problem.unbounded(path)
        inside = (smooth >= lower - _ROOM) & (smooth <= upper + _ROOM)
        steps = np.abs(np.diff(smooth, axis=-2)).max(axis=-2, initial=0.0)
        bad = ~inside.all(axis=-2) | (steps > largest_step + _ROOM)
        smooth = np.where(pinned[:, None], path, np.clip(smooth, lower, upper))
        solved = np.ones(path.shape[:-2], bool)
        # Every joint is a problem of its own.
        for *row, joint in np.argwhere(bad).tolist():
            column = (*row, slice(None), joint)
            limits = (lower[joint], upper[joint], largest_step)
            found = problem.bounded(path[column], *limits)
            solved[tuple(row)] &= found is not None
            if found is not None:
                smooth[column] = found
        return Smoothed(np.where(solved[..., None, None], smooth, path), solved)


class _Problem:
    """The least third difference between some pinned knots, of one joint."""

    def __init__(self, pinned: np.ndarray) -> None:
        knots = len(pinned)
        third = np.diff(np.eye(knots), 3, axis=0)
        hessian = third.T @ third + NEAR * np.eye(knots)
        self._free, self._pinned = np.flatnonzero(~pinned), np.flatnonzero(pinned)
        self._hessian = hessian[np.ix_(self._free, self._free)]
        self._across = hessian[np.ix_(self._free, self._pinned)]
        right = np.concatenate([NEAR * np.eye(len(self._free)), -self._across], axis=1)
        self._answer = np.linalg.solve(self._hessian, right)
        self._steps = np.diff(np.eye(knots), axis=0)
        self._solver: Any = None

    def unbounded(self, path: np.ndarray) -> np.ndarray:
        """Solutions without bounds, (*r, W, A)."""
        smooth = path.copy()
        order = np.concatenate([self._free, self._pinned])
        smooth[..., self._free, :] = self._answer @ path[..., order, :]
        return smooth

    def bounded(
        self, path: np.ndarray, lower: float, upper: float, largest_step: float
    ) -> np.ndarray | None:
        """The solution for one joint where a bound is met, by OSQP; none where there is none."""
        known = self._steps[:, self._pinned] @ path[self._pinned]
        touched = np.any(self._steps[:, self._free] != 0, axis=1)
        if np.any(np.abs(known[~touched]) > largest_step):
            return None
        self._solver = self._solver or _set_up(self._hessian, self._steps[touched][:, self._free])
        count, known = len(self._free), known[touched]
        bottom = np.concatenate([np.full(count, lower), -largest_step - known])
        top = np.concatenate([np.full(count, upper), largest_step - known])
        slope = self._across @ path[self._pinned] - NEAR * path[self._free]
        self._solver.update(l=bottom, u=top, q=slope)
        self._solver.warm_start(x=path[self._free], y=np.zeros(len(bottom)))
        found = self._solver.solve(raise_error=False)
        if found.info.status != "solved":
            return None
        smooth = path.copy()
        smooth[self._free] = np.clip(np.asarray(found.x, np.float64), lower, upper)
        return smooth


def roughness(path: Float[np.ndarray, "W A"]) -> float:
    """Sum of the squared third differences of a path [rad^2]."""
    return float(np.sum(np.diff(path, 3, axis=0) ** 2))


def _set_up(hessian: np.ndarray, steps: np.ndarray) -> Any:
    import osqp
    from scipy import sparse

    A = sparse.csc_matrix(np.concatenate([np.eye(len(hessian)), steps]))
    free = np.full(len(hessian) + len(steps), np.inf)
    solver = osqp.OSQP()
    solver.setup(
        sparse.triu(sparse.csc_matrix(hessian), format="csc"),
        *(np.zeros(len(hessian)), A, -free, free),
        verbose=False, polishing=False, eps_abs=_TOLERANCE, eps_rel=_TOLERANCE, max_iter=2000,
        rho=_RHO, adaptive_rho=False,
    )  # fmt: skip
    return solver
