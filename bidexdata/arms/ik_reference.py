"""The algorithm of the kernels in NumPy and float64, one target at a time: what they are tested by."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bidexdata.arms.chain import Chain, chain_forward, chain_jacobian
from bidexdata.arms.inverse_kinematics import IkConfig
from bidexdata.frames import quat_from_matrix, rotation_vector_from_quat

_LARGEST_DAMPING = 10.0
_PULL_FADES = 0.1
_LOOK_EVERY, _STALLED, _NEARLY = 4, 0.95, 0.01


class OneSolution(NamedTuple):
    """Where one start led."""

    q: Float[np.ndarray, " A"]
    """[rad]."""
    error_pos: float
    """[m]."""
    error_rot: float
    """[rad]."""
    iterations: int


def descend_reference(
    chain: Chain,
    pos: Float[np.ndarray, " 3"],
    rot: Float[np.ndarray, "3 3"],
    start: Float[np.ndarray, " A"],
    config: IkConfig,
) -> OneSolution:
    """Lower the error of one target from one start.

    Args:
        chain: The chain.
        pos: Origin of the hand frame in the world [m].
        rot: Its orientation.
        start: Where to begin [rad].
        config: How.
    """
    q, damping, used = start.copy(), config.damping, 0
    error, before = _error(chain, q, pos, rot, config), np.inf
    for number in range(config.iterations):
        off, twist = np.linalg.norm(error[:3]), np.linalg.norm(error[3:]) / config.length
        good = off <= config.tolerance_pos and twist <= config.tolerance_rot
        if good or damping > _LARGEST_DAMPING:
            break
        size = float(np.linalg.norm(error))
        if number and number % _LOOK_EVERY == 0:
            if size > max(_NEARLY, _STALLED * before):
                break
            before = size
        used = number + 1
        pull = config.rest_gain * min(size / _PULL_FADES, 1.0)
        step = _step(chain, q, error, damping, pull, config)
        tried = np.clip(q + step, chain.lower, chain.upper)
        there = _error(chain, tried, pos, rot, config)
        if np.linalg.norm(there) < size:
            q, error, damping = tried, there, max(damping * config.damp_less, 1e-7)
        else:
            damping *= config.damp_more
    twist = float(np.linalg.norm(error[3:])) / config.length
    return OneSolution(q, float(np.linalg.norm(error[:3])), twist, used)


def _step(
    chain: Chain,
    q: np.ndarray,
    error: np.ndarray,
    damping: float,
    pull: float,
    config: IkConfig,
) -> np.ndarray:
    J = chain_jacobian(chain, q)
    J[3:] *= config.length
    slant = J.T @ error
    still = ((q <= chain.lower) & (slant < 0)) | ((q >= chain.upper) & (slant > 0))
    J[:, still] = 0.0
    rest = np.where(still, 0.0, pull * (chain.rest - q))
    step = J.T @ np.linalg.solve(J @ J.T + damping * np.eye(6), error - J @ rest) + rest
    return step * min(1.0, config.largest_step / max(float(np.abs(step).max()), 1e-12))


def _error(
    chain: Chain, q: np.ndarray, pos: np.ndarray, rot: np.ndarray, config: IkConfig
) -> np.ndarray:
    at, turned = chain_forward(chain, q)
    log = rotation_vector_from_quat(quat_from_matrix(rot @ turned.T))
    return np.concatenate([pos - at, config.length * log])
