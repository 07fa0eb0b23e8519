from pathlib import Path

import pytest
from made_release import made_lifted, made_release


@pytest.fixture(scope="session")
def packed(tmp_path_factory) -> Path:
    """A made release; read only."""
    return made_release(tmp_path_factory.mktemp("packed") / "release")


@pytest.fixture(scope="session")
def armed(tmp_path_factory) -> Path:
    """A made release with motions of arms; read only."""
    return made_release(tmp_path_factory.mktemp("armed") / "release", arms=True)


@pytest.fixture(scope="session")
def lifted(tmp_path_factory) -> Path:
    """A made release with verdicts of test l alone; read only."""
    return made_lifted(tmp_path_factory.mktemp("lifted") / "release")
