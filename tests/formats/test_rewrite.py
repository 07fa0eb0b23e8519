"""Releases made of releases: nothing is lost, nothing is there twice, and every law holds."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from made_release import OBJECTS, PER_SCENE, SIZES, made_object, made_release, made_rows
from old_releases import unpacked

from bidexdata.errors import NotUsable, UnknownName
from bidexdata.formats.content_hash import content_hash
from bidexdata.formats.diff import diff_releases
from bidexdata.formats.manifest import write_manifest
from bidexdata.formats.release import Release
from bidexdata.formats.rewrite import Rewriting, rewrite
from bidexdata.formats.rows import RunInfo
from bidexdata.formats.verify import verify_release

SECOND = RunInfo("run", "e" * 16, PER_SCENE, 4 * PER_SCENE, config={"a": 2})


def written(sources, out: Path, how="migrate", **what) -> Release:
    releases = [Release.open(s) for s in sources]
    what = {"name": releases[0].name, "version": "1.1.0", **what}
    rewrite(releases, out, Rewriting(how=how, **what))
    report = verify_release(out, full=True)
    assert report.ok, [c.detail for c in report.checks if not c.ok]
    return Release.open(out)


def stated_too(old, new) -> bool:
    """Whether everything that old figures state stands in the new ones alike."""
    if not isinstance(old, dict):
        return old == new
    return all(key in new and stated_too(value, new[key]) for key, value in old.items())


def only(*ids: str):
    return lambda scene: scene["object_id"] in ids


@pytest.fixture(scope="module")
def halves(packed, tmp_path_factory) -> tuple[Path, Path]:
    """The made release in two: its first object, and the others."""
    folder = tmp_path_factory.mktemp("halves")
    for name, ids in (("a", OBJECTS[:1]), ("b", OBJECTS[1:])):
        written([packed], folder / name, "subset", scenes=only(*ids))
    return folder / "a", folder / "b"


def test_rewriting_a_release_changes_no_table(packed, tmp_path):
    again = written([packed], tmp_path / "again", version="1.0.0")
    release = Release.open(packed)
    assert content_hash(again) == content_hash(release)
    assert again.figures == release.figures
    made = {p.relative_to(packed) for p in packed.rglob("*") if p.is_file()}
    assert made == {p.relative_to(again.path) for p in again.path.rglob("*") if p.is_file()}
    pages = {"DATASET_CARD.md", "README.md", "manifest.json", "manifest.sha256"}
    for name in made:
        same = (packed / name).read_bytes() == (again.path / name).read_bytes()
        assert same == (str(name) not in pages), name


def test_an_old_release_migrates_with_all_its_rows_and_figures(tmp_path):
    path = unpacked("schema-1.2", tmp_path)
    old, new = Release.open(path), written([path], tmp_path / "new")
    assert stated_too(old.figures, new.figures)
    assert (
        new.figures["by_setting"]["floating"]["selected_f"] == new.figures["tests"]["f"]["selected"]
    )
    for configuration in old.configurations:
        mine, theirs = (r.grasps(configuration=configuration) for r in (old, new))
        for name in mine.columns:
            np.testing.assert_array_equal(mine[name], theirs[name], err_msg=name)
    row = new.objects.to_pylist()[0]
    assert row["nominal_volume"] == pytest.approx(row["volume"])  # read from the object's files
    assert "migrated from made 1.0.0" in (new.path / "DATASET_CARD.md").read_text().lower()
    assert diff_releases(old, new).rows.same


def test_rewriting_twice_gives_the_same_bytes(packed, tmp_path):
    for name in ("a", "b"):
        written([packed], tmp_path / name, "split", split_by="size", seed=3)
    for path in (tmp_path / "a").rglob("*"):
        if path.is_file():
            assert (
                path.read_bytes()
                == (tmp_path / "b" / path.relative_to(tmp_path / "a")).read_bytes()
            )


def test_parts_merge_to_the_whole(packed, halves, tmp_path):
    whole = written(halves[::-1], tmp_path / "whole", "merge", version="2.0.0")
    release = Release.open(packed)
    assert whole.figures == release.figures
    assert diff_releases(release, whole).same
    assert whole.runs.num_rows == 1  # the same run in both parts is one run
    assert content_hash(whole) == content_hash(release)


def test_runs_of_one_name_are_told_apart(packed, tmp_path):
    other = made_release(tmp_path / "other", OBJECTS, seed=5, runs=[SECOND])
    whole = written([packed, other], tmp_path / "whole", "merge")
    assert whole.runs.column("run").to_pylist() == ["run", "run-2"]
    assert whole.figures["n"] == 2 * Release.open(packed).figures["n"]
    assert set(whole.scenes.column("runs").to_pylist()) == {2}
    assert set(whole.scenes.column("grasps_wanted").to_pylist()) == {2 * PER_SCENE}
    assert whole.figures["kept"] == 1.0
    names = whole.index("selected", columns=["run", "grasp_id"]).to_pylist()
    theirs = set(Release.open(other).grasps()["grasp_id"].tolist())
    assert {r["run"] for r in names if r["grasp_id"] in theirs} == {"run-2"}
    # Rates over two runs are those of all their rows, whoever joins them.
    packed_together = made_release(
        tmp_path / "together",
        OBJECTS,
        rows_of=lambda i: [made_rows(i), made_rows(i, seed=5, run="run-2")],
        runs=[
            RunInfo("run", "f" * 16, PER_SCENE, 4 * PER_SCENE, config={"a": 1}),
            RunInfo("run-2", "e" * 16, PER_SCENE, 4 * PER_SCENE, config={"a": 2}),
        ],
    )
    assert whole.figures == Release.open(packed_together).figures
    again = written([whole.path], tmp_path / "again")
    assert again.figures == whole.figures


def test_what_cannot_be_one_release_is_named(packed, halves, tmp_path, monkeypatch):
    grasp = Release.open(halves[0]).grasps()["grasp_id"]
    with pytest.raises(NotUsable, match=r"grasp \w{16} of box-aaaaaaaa is there twice") as twice:
        written([packed, halves[0]], tmp_path / "x", "merge")
    assert any(str(g) in str(twice.value) for g in grasp)
    tetra = made_object(OBJECTS[2])
    with monkeypatch.context() as patch:
        patch.setattr("made_release.made_object", lambda i: _named(tetra, i))
        other = made_release(tmp_path / "other", OBJECTS[:1], seed=5, runs=[SECOND])
    with pytest.raises(
        NotUsable, match=f"object {OBJECTS[0]} has another shape in .*other than in"
    ):
        written([packed, other], tmp_path / "x", "merge")
    apart = made_release(tmp_path / "apart", OBJECTS, seed=5, runs=[SECOND], split_by="category")
    with pytest.raises(NotUsable, match=r"split differently.*--split object, category or size"):
        written([packed, apart], tmp_path / "x", "merge")
    written([packed, apart], tmp_path / "anew", "merge", split_by="object")
    strict = made_release(
        tmp_path / "strict", seed=5, runs=[SECOND], protocols={"paper-1": {"scene": {"dt": 1}}}
    )
    loose = made_release(tmp_path / "loose", protocols={"paper-1": {"scene": {"dt": 2}}})
    with pytest.raises(NotUsable, match=r"different protocols called 'paper-1' .scene.dt"):
        written([strict, loose], tmp_path / "x", "merge")
    with pytest.raises(UnknownName, match=r"protocol is called .lift-9."):
        written([apart], tmp_path / "x", "split", protocol="lift-9")
    assert not (tmp_path / "x").exists()


def _named(obj, object_id):
    from dataclasses import replace

    return replace(obj, object_id=object_id)


def test_a_release_of_a_newer_minor_schema_is_not_rewritten(packed, tmp_path):
    newer = Path(shutil.copytree(packed, tmp_path / "newer"))
    head = json.loads((newer / "manifest.json").read_text())
    head.pop("files")
    header = json.dumps({**json.loads(head["header"]), "schema_version": "1.99"})
    write_manifest(newer, {**head, "header": header, "schema_version": "1.99"})
    with pytest.raises(NotUsable, match=r"would lose columns; upgrade it with `pip install -U"):
        written([newer], tmp_path / "x")


@pytest.mark.parametrize("by", ["object", "category", "size"])
def test_a_new_split_moves_rows_and_changes_nothing_else(packed, by, tmp_path):
    new, old = written([packed], tmp_path / by, "split", split_by=by, seed=1), Release.open(packed)
    assert new.figures == old.figures
    found = diff_releases(old, new)
    assert found.rows.same
    assert new.manifest["split"]["by"] == by
    again = written([new.path], tmp_path / "again")
    for split in new.split_names:
        mine, theirs = (r.grasps(split=split)["grasp_id"].tolist() for r in (new, again))
        assert mine == theirs


def test_whole_scenes_keep_their_rates_and_chosen_rows_have_none(packed, halves, tmp_path):
    direct = made_release(tmp_path / "direct", OBJECTS[:1])
    part = Release.open(halves[0])
    assert part.figures == Release.open(direct).figures
    assert part.manifest["derived"]["whole_scenes"]
    release = Release.open(packed)

    def chosen(object_id, rows):
        return np.array(rows.column("suc_f").fill_null(False).to_pylist(), bool)

    won = written([packed], tmp_path / "won", "subset", choose=chosen, where="suc_f")
    ids = {
        str(g)
        for c in release.configurations
        for b in [release.grasps(configuration=c)]
        for g in b["grasp_id"][b["success"]]
    }
    found = [won.grasps(configuration=c)["grasp_id"].tolist() for c in won.configurations]
    assert set(found[0]) | set(found[1]) == ids
    figures = won.figures
    assert figures["tests"]["f"]["selected"]["rate"] == 1.0
    assert figures["tests"]["f"]["unselected"]["n"] == 0
    assert figures["kept"] is None
    assert figures["by_status"] == release.figures["by_status"]  # attempts of whole scenes
    card = " ".join((won.path / "DATASET_CARD.md").read_text().split())
    assert "rows where `suc_f`" in card
    assert "there is no unselected rate and no kept share" in card
    again = written([won.path], tmp_path / "again", "split", split_by="object")
    assert not again.manifest["derived"]["whole_scenes"]
    with pytest.raises(NotUsable, match="no scene is left"):
        written([packed], tmp_path / "x", scenes=only())


def test_objects_without_a_kept_row_and_untested_runs_come_through(tmp_path):
    def rows_of(object_id):
        rows = made_rows(object_id, tested=object_id != OBJECTS[1])
        if object_id == OBJECTS[2]:  # every attempt failed before anything could be kept
            batch = rows.batch.select(np.zeros(len(rows.batch), bool))
            verdicts = {k: {c: v[:0] for c, v in d.items()} for k, d in rows.verdicts.items()}
            return [type(rows)(rows.run, batch, verdicts)]
        return [rows]

    first = Release.open(made_release(tmp_path / "first", rows_of=rows_of))
    again = written([first.path], tmp_path / "again")
    assert again.figures == first.figures
    assert again.figures["tests"]["f"]["unselected"]["n"] == 2 * PER_SCENE * len(SIZES)
    assert diff_releases(first, again).same


def test_a_release_without_meshes_makes_releases_without_meshes(packed, halves, tmp_path):
    bare = made_release(tmp_path / "bare", OBJECTS[:1], licences="ids-only")
    whole = written([bare, halves[1]], tmp_path / "whole", "merge")
    assert not whole.has_shapes
    assert not (whole.path / "objects").exists()
    assert whole.figures == Release.open(packed).figures


def test_clouds_of_a_merged_release_have_the_points_that_all_have(halves, tmp_path):
    few = made_release(tmp_path / "few", OBJECTS[:1], cloud_points=32)
    whole = written([few, halves[1]], tmp_path / "whole", "merge")
    assert whole.cloud().shape == (len(OBJECTS), 32, 3)
    np.testing.assert_array_equal(whole.cloud()[1:], Release.open(halves[1]).cloud()[:, :32])


@pytest.mark.parametrize("form", ["parquet", "hdf5"])
def test_the_form_stays(form, tmp_path):
    first = Release.open(made_release(tmp_path / "first", OBJECTS[:2], form=form))
    again = written([first.path], tmp_path / "again")
    assert again.form == form
    assert diff_releases(first, again).same


def test_diff_finds_what_was_changed(packed, tmp_path):
    ours = Release.open(packed)
    other = Release.open(made_release(tmp_path / "other", OBJECTS[:2], seed=5, version="2.0.0"))
    found = diff_releases(ours, other)
    assert not found.same
    assert found.about["version"] == ("1.0.0", "2.0.0")
    assert (found.objects.only_a, found.objects.only_b, found.objects.both) == (1, 0, 2)
    assert found.rows.both == 0
    assert found.rows.only_a == ours.figures["n"]
    assert found.rows.only_b == other.figures["n"]
    assert found.figures["objects"] == (3, 2)

    def changed(object_id):
        rows = made_rows(object_id)
        pd = rows.verdicts["paper-1", "f"]["pd"].copy()
        joints = rows.batch["joints"].copy()
        if object_id == OBJECTS[0]:
            pd[0] += 1
            joints[1, 0, 0, 0] = np.nextafter(joints[1, 0, 0, 0], np.float32(9))
        verdicts = {k: {**v, "pd": pd} for k, v in rows.verdicts.items()}
        columns = {**rows.batch.columns, "joints": joints}
        return [type(rows)(rows.run, type(rows.batch)(rows.batch.header, columns), verdicts)]

    near = Release.open(made_release(tmp_path / "near", rows_of=changed))
    rows = diff_releases(ours, near).rows
    assert (rows.only_a, rows.only_b, rows.changed) == (0, 0, 2)
    assert rows.by_column == {"joints": 1, "paper-1-f/pd": 1}
    old = diff_releases(Release.open(unpacked("schema-1.2", tmp_path)), ours)
    assert "uri" in old.columns["objects"][1]
