import doctest
from dataclasses import replace

import pytest
from made_release import OBJECTS, made_object, made_release

from bidexdata.errors import UnknownChoice
from bidexdata.formats import licences
from bidexdata.formats.attribution import attribution_text
from bidexdata.formats.licences import (
    NO_CHANGES,
    NON_COMMERCIAL,
    PERMISSIVE,
    POLICIES,
    SHARE_ALIKE,
    SPDX,
    UNKNOWN,
    allows,
    licence_address,
    normal_licence,
)
from bidexdata.formats.object_table import object_row
from bidexdata.formats.release import Release


def test_examples_of_the_page_hold():
    assert doctest.testmod(licences).failed == 0


@pytest.mark.parametrize("spdx", SPDX)
def test_every_identifier_means_itself_in_any_case(spdx):
    for text in (
        spdx,
        spdx.lower(),
        f" {spdx.upper()} ",
        spdx.replace("-", " "),
        f"{spdx} licence",
    ):
        assert normal_licence(text) == spdx
    assert licence_address(spdx).endswith(spdx)


@pytest.mark.parametrize(
    ("text", "spdx"),
    [
        ("CC BY 4.0", "CC-BY-4.0"),
        ("cc-by-4", "CC-BY-4.0"),
        (
            "Creative Commons Attribution-NonCommercial-ShareAlike 4.0 International",
            "CC-BY-NC-SA-4.0",
        ),
        ("Creative Commons Attribution-NoDerivs 3.0", "CC-BY-ND-3.0"),
        ("http://creativecommons.org/publicdomain/zero/1.0/", "CC0-1.0"),
        ("https://creativecommons.org/licenses/by-nc-nd/4.0/legalcode", "CC-BY-NC-ND-4.0"),
        ("CC0", "CC0-1.0"),
        ("CC0 1.0 Universal", "CC0-1.0"),
        ("The MIT License", "MIT"),
        ("Apache License, Version 2.0", "Apache-2.0"),
        ("BSD 3-Clause", "BSD-3-Clause"),
        ("GPL v3", "GPL-3.0-only"),
        ("public domain", "CC-PDDC"),
    ],
)
def test_words_that_people_use_are_understood(text, spdx):
    assert normal_licence(text) == spdx


@pytest.mark.parametrize(
    "text",
    ["", None, "unknown", "by", "CC-BY", "all rights reserved", "MIT or proprietary", "CC-BY-9.0"],
)
def test_what_is_not_one_known_licence_is_unknown(text):
    assert normal_licence(text) == UNKNOWN
    assert licence_address(UNKNOWN) == ""


def test_every_licence_is_of_one_kind():
    kinds = (PERMISSIVE, SHARE_ALIKE, NON_COMMERCIAL, NO_CHANGES)
    assert sum(map(len, kinds)) == len(SPDX) == len(set(SPDX))


def test_a_policy_holds_what_the_narrower_ones_hold_and_unknown_meshes_are_never_given_on():
    for licence in (*SPDX, UNKNOWN, "whatever"):
        held = [allows(licence, policy) for policy in POLICIES]
        assert held == sorted(held)
        assert held[-1]
    assert [allows(UNKNOWN, p) for p in POLICIES] == [False, False, True]
    # Meshes are changed when they are prepared.
    assert [allows("CC-BY-ND-4.0", p) for p in POLICIES] == [False, False, True]
    assert [allows("CC-BY-NC-4.0", p) for p in POLICIES] == [False, True, True]
    assert [allows("CC-BY-SA-4.0", p) for p in POLICIES] == [False, True, True]
    assert all(allows(licence, "permissive") for licence in PERMISSIVE)
    with pytest.raises(UnknownChoice, match="one of permissive, nc-ok, ids-only"):
        allows("MIT", "all")


def test_the_attribution_table_names_every_object(packed):
    text = (packed / "ATTRIBUTION.md").read_text()
    for row in Release.open(packed).objects.to_pylist():
        (line,) = (x for x in text.splitlines() if x.startswith(f"| `{row['object_id']}` |"))
        assert row["source_name"] in line
        assert row["author"] in line
        assert row["licence"] in line
    assert "[CC0-1.0](https://spdx.org/licenses/CC0-1.0)" in text


def test_no_cell_of_the_attribution_table_is_empty():
    nothing = dict.fromkeys(("source_name", "author", "uri"), "") | {"source": " "}
    rows = [
        {"object_id": "a-0", "licence": UNKNOWN, **nothing},
        {"object_id": "b-0", "licence": "MIT", **nothing, "source": "shelf"},
        {"object_id": "c-0", "licence": "MIT", **nothing, "uri": "https://made.example/c"},
    ]
    text = attribution_text("made", "1.0.0", rows, shapes=True)
    cells = [[c.strip() for c in x.split("|")[1:-1]] for x in text.splitlines() if x[:3] == "| `"]
    assert all(all(row) for row in cells)
    assert [row[-1] for row in cells] == [UNKNOWN, "shelf", "https://made.example/c"]
    assert "collection" in text


@pytest.mark.parametrize(
    ("known", "uri"),
    [
        ({"source": "https://made.example/a"}, "https://made.example/a"),
        ({"source": "shelf"}, ""),
        ({"source": "shelf", "uri": "https://made.example/b"}, "https://made.example/b"),
        ({}, ""),
    ],
)
def test_an_object_has_the_address_that_its_source_states(known, uri):
    solid = made_object(OBJECTS[0])
    assert object_row(replace(solid, provenance=known), "0")["uri"] == uri


def test_ids_only_has_hashes_and_no_shape(tmp_path):
    whole = Release.open(made_release(tmp_path / "whole"))
    out = made_release(tmp_path / "ids", licences="ids-only")
    assert not (out / "objects").exists()
    assert not (out / "clouds").exists()
    release = Release.open(out)
    assert not release.has_shapes
    rows = release.objects.to_pylist()
    assert [r["cloud_index"] for r in rows] == [-1] * len(OBJECTS)
    assert [r["shape_sha256"] for r in rows] == whole.objects.column("shape_sha256").to_pylist()
    assert "their meshes are left out" in " ".join((out / "DATASET_CARD.md").read_text().split())
    assert "left out" in (out / "ATTRIBUTION.md").read_text()
