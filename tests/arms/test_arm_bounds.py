"""The benchmark of motions' bounds measures what it says."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.arm_bounds import palm_errors
from bidexdata.arms.chain import chain_forward
from bidexdata.frames import matrix_from_quat, quat_from_matrix
from bidexdata.record.fields import KEY_FRAMES


@pytest.mark.parametrize("side", [0, 1])
def test_a_palm_that_is_moved_and_turned_is_off_by_that(made, side):
    chain, T = made.arms[side].chain, made.hands[side].T_hand_palm
    rng = np.random.default_rng(3)
    q = chain.lower + rng.random((4, len(KEY_FRAMES), chain.joints)) * (chain.upper - chain.lower)
    pos, rot = (x[:, 2:5] for x in chain_forward(chain, q))
    angle, shift = 0.01, np.array([3e-4, 0.0, 4e-4])
    turn = matrix_from_quat(np.array([np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0]))
    palm = pos + rot @ T[:3, 3] + shift
    batch = {
        "arm_joints": np.stack([q, q], axis=1),
        "hand_pos": np.stack([palm - rot @ turn @ T[:3, 3]] * 2, axis=1),
        "hand_quat_wxyz": np.stack([quat_from_matrix(rot @ turn)] * 2, axis=1),
    }
    off, twist = palm_errors(made, batch, side)
    np.testing.assert_allclose(off, 5e-4, atol=1e-9)
    np.testing.assert_allclose(twist, angle, atol=1e-7)
