import sys
from pathlib import Path

import pytest

from bidexdata.hands import load_hands

sys.path.insert(0, str(Path(__file__).parents[1] / "pictures"))


@pytest.fixture(scope="session")
def hands():
    """The built-in hands: they need no download."""
    return load_hands("capsule")
