"""Citation, Croissant and column tables say what the tables say, and nothing of the clock."""

import doctest
import hashlib
import json

import pytest
import yaml
from made_release import OBJECTS, PAPER_F, made_release

from bidexdata.errors import BadValue
from bidexdata.formats import citation, columns
from bidexdata.formats.citation import About, citation_text
from bidexdata.formats.columns import release_columns
from bidexdata.formats.parquet import read_schema
from bidexdata.formats.release import Release

ABOUT = About(
    authors=("Curie, Marie", "Radium Institute"), date="2026-01-31", url="https://example.org/x"
)


def test_examples_of_the_pages_hold():
    assert doctest.testmod(citation).failed == 0
    assert doctest.testmod(columns).failed == 0


def test_a_citation_says_what_was_said_and_only_that():
    data = yaml.safe_load(citation_text("grasps", "1.2.3", ABOUT, ["MIT", "CC0-1.0"]))
    assert data["type"] == "dataset"
    assert (data["title"], data["version"]) == ("grasps", "1.2.3")
    assert data["authors"] == ABOUT.creators("grasps")
    assert (data["date-released"], data["url"]) == (ABOUT.date, ABOUT.url)
    assert data["license"] == ["CC0-1.0", "MIT"]
    bare = yaml.safe_load(citation_text("grasps", "1.2.3", About(), ["MIT", "unknown"]))
    assert not {"date-released", "url", "license"} & set(bare)
    assert bare["authors"] == [{"name": "The authors of grasps"}]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"date": "31.1.2026"}, "YYYY-MM-DD"),
        ({"date": "20260131"}, "YYYY-MM-DD"),
        ({"date": "2026-02-30"}, "YYYY-MM-DD"),
        ({"url": "example.org"}, "https://"),
        ({"authors": (" ",)}, "no name"),
    ],
)
def test_what_cannot_be_said_is_refused(wrong, said):
    with pytest.raises(BadValue, match=said):
        About(**wrong)


def test_a_manifest_remembers_who_and_when(tmp_path):
    out = made_release(tmp_path / "r", OBJECTS[:1], about=ABOUT)
    manifest = Release.open(out).manifest
    assert About.of(manifest) == ABOUT
    assert About.of({}) == About()
    assert "date-released: '2026-01-31'" in (out / "CITATION.cff").read_text()


def test_columns_are_those_of_the_files(packed):
    found = release_columns(Release.open(packed).header, [PAPER_F])
    assert set(found) == {
        "grasps", "contacts", "verdicts/paper-1-f", "objects", "scenes", "runs"
    }  # fmt: skip
    for table, listed in found.items():
        name = table if table in ("objects", "scenes", "runs") else f"{table}/train-00000"
        schema = read_schema(packed / f"{name}.parquet")
        assert [c.name for c in listed] == schema.names
        for column in listed:
            said = schema.field(column.name).metadata
            assert column.unit.encode() == said[b"unit"]
            assert column.description.encode() == said[b"description"]
            assert column.width == getattr(schema.field(column.name).type, "list_size", 0)


def test_the_card_lists_every_column_with_unit_and_meaning(packed):
    card = (packed / "DATASET_CARD.md").read_text()
    for listed in release_columns(Release.open(packed).header, [PAPER_F]).values():
        for c in listed:
            cells = (f"`{c.name}`", c.dtype, c.shape, c.unit, c.frame, c.description)
            assert "| " + " | ".join(x.replace("|", "\\|") for x in cells) + " |" in card


def test_croissant_names_every_table_file_by_its_hash_and_every_column(packed):
    data = json.loads((packed / "croissant.json").read_text())
    files = {f["@id"]: f for f in data["distribution"] if f["@type"] == "cr:FileObject"}
    tables = {p.relative_to(packed).as_posix() for p in packed.rglob("*.parquet")}
    assert set(files) == tables
    for name, file in files.items():
        assert file["sha256"] == hashlib.sha256((packed / name).read_bytes()).hexdigest()
    sets = {f["@id"]: f["includes"] for f in data["distribution"] if f["@type"] == "cr:FileSet"}
    for pattern in sets.values():
        assert list(packed.glob(pattern))
    records = {r["name"]: r for r in data["recordSet"]}
    found = release_columns(Release.open(packed).header, [PAPER_F])
    for record, table in (("selected", "grasps"), ("audit", "grasps"), ("objects", "objects")):
        fields = {f["name"]: f for f in records[record]["field"]}
        for column in found[table]:
            field = fields[column.name]
            assert column.description in field["description"]
            assert (f"[{column.unit}]" in field["description"]) == bool(column.unit)
            assert field.get("arrayShape", "0") == str(column.width)
    assert "datePublished" not in data
    assert data["license"] == ["https://spdx.org/licenses/CC0-1.0"]


@pytest.mark.parametrize("form", ["parquet", "hdf5"])
def test_a_release_of_any_form_has_pages_that_name_only_its_files(form, tmp_path):
    out = made_release(tmp_path / "r", OBJECTS[:1], form=form)
    data = json.loads((out / "croissant.json").read_text())
    for file in data["distribution"]:
        assert list(out.glob(file.get("contentUrl") or file["includes"]))
    front = yaml.safe_load((out / "README.md").read_text().split("---\n")[1])
    for config in front["configs"]:
        named = config["data_files"]
        paths = [named] if isinstance(named, str) else [f["path"] for f in named]
        assert all(list(out.glob(p)) for p in paths)


@pytest.mark.slow
def test_mlcroissant_finds_nothing_wrong(packed):
    mlcroissant = pytest.importorskip("mlcroissant")
    data = mlcroissant.Dataset(jsonld=str(packed / "croissant.json"))
    assert not data.metadata.ctx.issues.errors
    assert len(list(data.records("selected"))) == Release.open(packed).figures["selected_rows"]
