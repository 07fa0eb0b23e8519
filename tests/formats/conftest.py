import shutil
from pathlib import Path

import pytest
from made_release import made_lifted, made_release


@pytest.fixture(scope="session")
def packed(tmp_path_factory) -> Path:
    """A made release; read only."""
    return made_release(tmp_path_factory.mktemp("packed") / "release")


@pytest.fixture
def copied(packed: Path, tmp_path: Path) -> Path:
    """A made release to damage."""
    return Path(shutil.copytree(packed, tmp_path / "release"))


@pytest.fixture(scope="session")
def lifted(tmp_path_factory) -> Path:
    """A made release with verdicts of test l alone; read only."""
    return made_lifted(tmp_path_factory.mktemp("lifted") / "release")
