"""docs/library.md is fresh, and says what the files of prepared objects hold."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest

from bidexdata.objects import library_page
from bidexdata.objects.library import COLUMNS
from bidexdata.objects.library_page import ARRAYS, KEYS, PROVENANCE
from bidexdata.objects.prepare import prepare_object
from bidexdata.objects.prepared import PreparedObject
from bidexdata.objects.sources import resolve_sources
from bidexdata.objects.storage import object_files

ROOT = Path(__file__).resolve().parents[2]
ELSEWHERE = {"mass_properties", "nominal_volume", "source_radius", "source_normalisation"}
"""Keys of imports and of given pieces only."""


def test_the_page_in_the_checkout_is_fresh():
    page = ROOT / library_page.PAGE
    assert page.read_text(encoding="utf-8") == library_page.page(), (
        "run `python -m bidexdata.objects.library_page`"
    )


def test_every_column_of_the_index_is_on_the_page():
    for name, kind, text in COLUMNS:
        assert f"| `{name}` | `{kind}` | {text} |" in library_page.page()


def test_an_object_has_the_keys_of_the_page(prepared: dict[str, PreparedObject]):
    for obj in prepared.values():
        document = json.loads(object_files(obj, {"any": 1})["object.json"])
        assert set(document) == {name for name, *_ in KEYS}
        assert set(document["provenance"]) == {name for name, *_ in PROVENANCE} - ELSEWHERE
        poses = len(document["rest_heights"])
        for name, shape, _ in KEYS:
            if name.startswith("rest_") or name == "inertia":
                wanted = tuple(poses if n == "K" else int(n) for n in shape.split(" x "))
                assert np.shape(document[name]) == wanted


def test_given_pieces_have_the_keys_of_the_page(shared: Path, small):
    folder = shared / "peers" / "dexgraspbench" / "objects"
    (item, *_) = resolve_sources([f"bodex:{folder}"])
    known = set(prepare_object(item, small).provenance)
    assert known <= {name for name, *_ in PROVENANCE}
    assert {"source_radius", "source_normalisation"} <= known


@pytest.mark.parametrize("file", ["pieces.npz", "geometry.npz"])
def test_an_object_has_the_arrays_of_the_page(prepared: dict[str, PreparedObject], file: str):
    rows = {row[1].split("_00")[0]: row for row in ARRAYS if row[0] == file}
    for obj in prepared.values():
        archive = np.load(io.BytesIO(object_files(obj)[file]))
        found = {name.rstrip("0123456789").rstrip("_"): archive[name] for name in archive.files}
        assert set(found) == set(rows)
        for name, array in found.items():
            _, _, dtype, shape, _ = rows[name]
            axes = shape.split()
            assert array.dtype == dtype
            assert array.ndim == len(axes)
            fixed = [(n, int(a)) for n, a in zip(array.shape, axes, strict=True) if a.isdigit()]
            assert all(n == a for n, a in fixed)


def test_the_page_is_written_where_it_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    library_page.main()
    assert (tmp_path / library_page.PAGE).read_text(encoding="utf-8") == library_page.page()
