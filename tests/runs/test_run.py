"""Laws of starting a run: what a killed start leaves is no obstacle, anything else is."""

from __future__ import annotations

from pathlib import Path

import pytest

from bidexdata.errors import NotUsable
from bidexdata.runs.run_folder import refuse_foreign


@pytest.mark.parametrize("left", [[], [".run.json.host.1.tmp"], ["tasks.parquet"], ["import"]])
def test_what_a_killed_start_leaves_is_no_obstacle(tmp_path: Path, left: list[str]):
    for name in left:
        (tmp_path / name).touch()
    refuse_foreign(tmp_path, "import")
    refuse_foreign(tmp_path / "not-there", "import")


@pytest.mark.parametrize("name", ["thesis.tex", "import", "synth", "index.parquet"])
def test_anything_else_is_refused(tmp_path: Path, name: str):
    (tmp_path / "tasks.parquet").touch()
    (tmp_path / name).touch()
    with pytest.raises(NotUsable, match="is no run"):
        refuse_foreign(tmp_path)
    with pytest.raises(NotUsable, match="is no run"):
        refuse_foreign(tmp_path / name)
