"""Every law runs for every hand and side; those of Menagerie skip without a local copy."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from bidexdata.hands import Hand, load_hand

HANDS = [(name, side) for name in ("capsule", "shadow") for side in ("left", "right")]


@pytest.fixture(params=HANDS, ids=lambda p: f"{p[0]}-{p[1]}")
def hand(request: pytest.FixtureRequest) -> Hand:
    name, side = request.param
    if name == "shadow":
        request.getfixturevalue("menagerie")
    return load_hand(name, side)


@pytest.fixture(params=["capsule", "shadow"])
def hands(request: pytest.FixtureRequest) -> tuple[Hand, Hand]:
    """Left and right of one kind."""
    if request.param == "shadow":
        request.getfixturevalue("menagerie")
    return load_hand(request.param, "left"), load_hand(request.param, "right")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(8)


@pytest.fixture
def edge_joints(rng: np.random.Generator) -> Callable[[Hand, int], np.ndarray]:
    """A function that gives random joint vectors, then zero, both limits and the two postures."""
    return lambda hand, count: _edge_joints(hand, rng, count)


def _edge_joints(hand: Hand, rng: np.random.Generator, count: int) -> np.ndarray:
    random = rng.uniform(hand.joint_lower, hand.joint_upper, (count, len(hand.joint_names)))
    edges = [0 * hand.joint_lower, hand.joint_lower, hand.joint_upper]
    return np.concatenate([random, edges, [hand.posture_open, hand.posture_curved]])
