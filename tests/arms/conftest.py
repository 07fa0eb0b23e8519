"""Every law runs on a made-up rig, and on those that come with the package where their models are."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import warp as wp

sys.path.insert(0, str(Path(__file__).parent))

from made_rig import write_rig

from bidexdata.arms.registry import load_rig, rig_names
from bidexdata.arms.robot import Robot, mount_robot
from bidexdata.devices import start_warp
from bidexdata.hands import load_hands

REAL = {"ur10e_post": "shadow", "iiwa14_facing": "shadow", "xarm7_leap": "leap"}
"""Rigs of the package, and a hand that each carries."""


start_warp()


@pytest.fixture(params=[d.alias for d in wp.get_devices()])
def device(request: pytest.FixtureRequest) -> str:
    """Every Warp device of the machine, given by name: nothing may go to the default one instead."""
    return request.param


@pytest.fixture(scope="session")
def made(tmp_path_factory) -> Robot:
    """The made-up rig with capsule hands."""
    return mount_robot(load_rig(write_rig(tmp_path_factory.mktemp("rig"))), load_hands("capsule"))


@pytest.fixture(scope="session", params=["made", "ur10e_post", "iiwa14_facing"])
def robot(request: pytest.FixtureRequest) -> Robot:
    """The made-up rig, and the two that carry the Shadow hand, wrist joints in the chain."""
    if request.param == "made":
        return request.getfixturevalue("made")
    request.getfixturevalue("menagerie")
    return mount_robot(load_rig(request.param), load_hands(REAL[request.param]))


@pytest.fixture
def real_hands() -> dict[str, str]:
    """A hand for each rig of the package."""
    assert set(REAL) == set(rig_names())
    return REAL


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(13)
