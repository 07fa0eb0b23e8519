"""Where the tables of a release lie."""

import re
from pathlib import Path

import pytest
import yaml
from made_release import made_release

import bidexdata
from bidexdata.formats.release import Release
from bidexdata.formats.tables import folder_of


@pytest.mark.parametrize(
    ("table", "configuration", "folder"),
    [
        ("grasps", "selected", "grasps"),
        ("grasps", "audit", "grasps_audit"),
        ("verdicts/paper-1-f", "selected", "verdicts/paper-1-f"),
        ("verdicts/paper-1-f", "audit", "verdicts_audit/paper-1-f"),
        ("arms/two_fr3", "audit", "arms_audit/two_fr3"),
    ],
)
def test_a_table_has_one_folder_per_configuration(table, configuration, folder):
    assert folder_of(table, configuration) == folder


def test_one_function_names_the_folders():
    root = Path(bidexdata.__file__).parent
    twice = [
        path.name
        for path in sorted(root.rglob("*.py"))
        if re.search(r"_\{(self\.)?configuration\}", path.read_text(encoding="utf-8"))
    ]
    assert twice == ["tables.py"]


def test_the_front_matter_names_every_table_by_its_folder(tmp_path):
    root = made_release(tmp_path / "release")
    front = (root / "README.md").read_text(encoding="utf-8").split("---\n")[1]
    found = {
        c["config_name"]: {Path(d["path"]).parent.as_posix() for d in c["data_files"]}
        for c in yaml.safe_load(front)["configs"]
        if isinstance(c["data_files"], list)
    }
    assert found == {
        "selected": {"grasps"},
        "audit": {"grasps_audit"},
        "contacts": {"contacts"},
        "contacts_audit": {"contacts_audit"},
        "verdicts-paper-1-f": {"verdicts/paper-1-f"},
        "verdicts_audit-paper-1-f": {"verdicts_audit/paper-1-f"},
    }
    assert Release.open(root).table_files("grasps", "audit")
