"""The help of `pack` names every form and every test; the pages name every configuration of the hub."""

from pathlib import Path
from typing import get_args, get_type_hints

import pytest

from bidexdata.cli.pack import pack
from bidexdata.formats.writer import Form
from bidexdata.record.fields import TESTS

PAGE = Path(__file__).parents[2] / "docs" / "releases.md"


@pytest.mark.parametrize(
    ("option", "words"), [("form", get_args(Form)), ("protocol", [f"suc_{t}" for t in TESTS])]
)
def test_the_help_names_all_that_there_is(option, words):
    said = get_type_hints(pack, include_extras=True)[option].__metadata__[0].help
    for word in words:
        assert word in said


def test_the_page_names_every_configuration_of_the_hub():
    (row,) = (
        r for r in PAGE.read_text(encoding="utf-8").split("\n") if r.startswith("| `README.md`")
    )
    for table in ("contacts", "verdicts", "arms"):
        tail = {"contacts": "", "verdicts": "-<protocol>-<test>", "arms": "-<rig>"}[table]
        for name in (f"`{table}{tail}`", f"`{table}_audit{tail}`"):
            assert name in row
