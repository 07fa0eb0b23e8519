from pathlib import Path

import pytest

from bidexdata.formats import field_table
from bidexdata.formats.tables import GRASP_EXTRAS, OBJECT_FIELDS, RUN_FIELDS, SCENE_FIELDS
from bidexdata.record import FIELDS

ROOT = Path(__file__).resolve().parents[2]


def test_the_page_in_the_checkout_is_fresh():
    page = ROOT / field_table.PAGE
    assert page.read_text(encoding="utf-8") == field_table.page(), (
        "run `python -m bidexdata.formats.field_table`"
    )


@pytest.mark.parametrize(
    "fields", [FIELDS.values(), GRASP_EXTRAS, OBJECT_FIELDS, SCENE_FIELDS, RUN_FIELDS]
)
def test_every_column_is_documented(fields):
    text = field_table.page()
    for field in fields:
        assert f"| `{field.name}` |" in text


def test_the_card_template_at_the_root_is_the_one_that_pack_fills():
    assert (ROOT / "DATASET_CARD.md").resolve() == (
        ROOT / "bidexdata/formats/dataset_card.md"
    ).resolve()


def test_the_page_is_written_where_it_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    field_table.main()
    assert (tmp_path / field_table.PAGE).read_text(encoding="utf-8") == field_table.page()
