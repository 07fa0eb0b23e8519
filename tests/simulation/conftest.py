from __future__ import annotations

import pytest


@pytest.fixture(scope="session")
def hands():
    from bidexdata.hands import load_hands

    return load_hands("capsule")
