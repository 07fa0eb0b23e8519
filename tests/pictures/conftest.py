import pytest

from bidexdata.hands import load_hands


@pytest.fixture(scope="session")
def hands():
    """The built-in hands: they need no download."""
    return load_hands("capsule")
