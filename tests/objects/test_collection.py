"""The figures of a prepared collection count what they say, and the page names every word of the code."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from mesh_files import mixed_folder

from benchmarks.collection import measure
from bidexdata.objects.library import COLUMNS, Library
from bidexdata.objects.sources.shapes import shape_families
from bidexdata.runs.prepare import prepare_library

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "sources.md").read_text(encoding="utf-8")


def test_the_figures_of_a_collection_count_inputs_bodies_volumes_and_drops(tmp_path, small, box):
    out, folder = tmp_path / "lib", mixed_folder(tmp_path / "meshes", box)
    crude = replace(small, convex=replace(small.convex, max_pieces=1, finer_above=100.0))
    prepare_library([str(folder), "shapes:bowl"], out, crude, executor="inline", quiet=True)
    library = Library.open(out)
    figures, of_object = measure(library)
    assert figures["inputs"] == 6
    assert figures["by_status"] == {"duplicate": 1, "no_faces": 1, "ok": 3, "unreadable": 1}
    assert figures["prepared"] == figures["watertight"] == figures["loads_in_mujoco"] == 3
    assert figures["hausdorff_under_1_percent"] == 3
    # One piece fills the bowl, and a single piece is its own sum and union.
    assert figures["union_to_mesh_within_25_percent"] == 2
    assert figures["sum_to_mesh_within_25_percent"] == 2
    bowl = of_object[-1]
    assert bowl["union_to_mesh"] > 1.25
    assert bowl["sum_to_mesh"] == pytest.approx(bowl["union_to_mesh"], rel=1e-4)
    assert figures["settled_in_some_drop"] == 3


def test_the_page_of_sources_names_every_family_and_way_to_pieces():
    assert f"{len(shape_families())} families" in PAGE
    assert all(f"`{name}`" in PAGE for name in shape_families())
    (methods,) = (text for name, _, text in COLUMNS if name == "piece_method")
    for method in methods.split(" (")[0].replace(" or ", ", ").split(", "):
        assert f"| `{method}` |" in PAGE
