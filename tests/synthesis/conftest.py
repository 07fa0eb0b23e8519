"""What most files make grasps with: the capsule hands and a prepared box. Read only."""

from __future__ import annotations

import pytest


@pytest.fixture(scope="session")
def hands():
    from bidexdata.hands import load_hands

    return load_hands("capsule")


@pytest.fixture(scope="session")
def obj():
    from bidexdata.objects.prepare import prepare_object

    return prepare_object("shapes:box")
