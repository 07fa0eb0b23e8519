from pathlib import Path

import pytest
from made_release import made_release


@pytest.fixture(scope="session")
def floating(tmp_path_factory) -> Path:
    return made_release(tmp_path_factory.mktemp("floating") / "release")


@pytest.fixture(scope="session")
def tabletop(tmp_path_factory) -> Path:
    return made_release(tmp_path_factory.mktemp("tabletop") / "release", setting="tabletop")
