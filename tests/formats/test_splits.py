import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_release import SIZES, made_release

from bidexdata.errors import NotUsable, UnknownChoice
from bidexdata.formats.release import Release
from bidexdata.formats.splits import ALL, split_objects, split_rows
from bidexdata.formats.verify import verify_release
from bidexdata.objects.sources.item import UNKNOWN

names = st.text("abcdef0123456789-", min_size=1, max_size=12)
libraries = st.dictionaries(names, st.sampled_from("pqrstuvwxyz"), min_size=1, max_size=30)


@given(libraries, st.floats(0.01, 0.99), st.integers(0, 99))
def test_a_split_is_a_partition_that_keeps_shapes_together(shapes, fraction, seed):
    splits = split_objects(shapes, test_fraction=fraction, seed=seed)
    assert set(splits) == set(shapes)
    by_shape = {
        shape: {splits[o] for o in shapes if shapes[o] == shape} for shape in shapes.values()
    }
    assert all(len(where) == 1 for where in by_shape.values())
    if len(by_shape) > 1:
        assert set(splits.values()) == {"train", "test"}
    else:
        assert set(splits.values()) == {"train"}
    assert (
        split_objects(dict(reversed(shapes.items())), test_fraction=fraction, seed=seed) == splits
    )


def test_a_fifth_of_the_objects_is_for_testing():
    shapes = {f"o{i}": str(i) for i in range(1000)}
    splits = split_objects(shapes)
    assert list(splits.values()).count("test") == 200
    assert splits != split_objects(shapes, seed=1)


def test_adding_objects_moves_few():
    shapes = {f"o{i}": str(i) for i in range(1000)}
    before = split_objects(shapes)
    after = split_objects({**shapes, **{f"p{i}": f"p{i}" for i in range(100)}})
    assert sum(before[o] != after[o] for o in shapes) < 30


@pytest.mark.parametrize("fraction", [0.0, 1.0, -0.1])
def test_impossible_shares_are_refused(fraction):
    with pytest.raises(ValueError, match="test_fraction"):
        split_objects({"a": "1"}, test_fraction=fraction)


def rows_of(shapes, categories):
    return [
        {"object_id": o, "shape_sha256": shapes[o], "category": categories[o]}
        for o in sorted(shapes)
    ]


@given(st.data(), st.floats(0.01, 0.99), st.integers(0, 99))
def test_no_category_and_no_shape_is_in_two_splits_by_category(data, fraction, seed):
    shapes = data.draw(libraries)
    words = st.sampled_from(["mug", "bowl", "box", "can", UNKNOWN])
    categories = {o: data.draw(words) for o in shapes}
    rows = rows_of(shapes, categories)
    if len(set(categories.values()) - {UNKNOWN}) < 2:
        with pytest.raises(NotUsable, match="two categories or more"):
            split_rows("category", rows, test_fraction=fraction, seed=seed)
        return
    found = split_rows("category", rows, test_fraction=fraction, seed=seed)
    assert set(found.objects) == set(shapes)
    for key in ("category", "shape_sha256"):
        where = {}
        for row in rows:
            if row[key] != UNKNOWN:
                where.setdefault(row[key], set()).add(found.objects[row["object_id"]])
        assert all(len(splits) == 1 for splits in where.values())
    again = split_rows("category", rows[::-1], test_fraction=fraction, seed=seed)
    assert again.objects == found.objects


def test_an_object_without_a_category_trains_unless_its_shape_tests():
    shapes = {f"o{i}": str(i) for i in range(10)} | {"twin": "0", "alone": "x"}
    categories = {f"o{i}": f"c{i}" for i in range(10)} | dict.fromkeys(("twin", "alone"), UNKNOWN)
    found = split_rows("category", rows_of(shapes, categories)).objects
    assert list(found.values()).count("test") in (2, 3)
    assert found["twin"] == found["o0"]
    assert found["alone"] == "train"


@given(st.sets(st.integers(50, 900), min_size=2), st.floats(0.01, 0.99), st.integers(0, 99))
def test_whole_sizes_train_or_test_by_size(sizes, fraction, seed):
    rows = rows_of({"a": "1", "b": "2"}, {"a": "c", "b": "c"})
    found = split_rows("size", rows, sizes, test_fraction=fraction, seed=seed)
    assert set(found.objects.values()) == {ALL}
    assert set(found.sizes) == sizes
    assert set(found.sizes.values()) == {"train", "test"}
    mm = np.array(sorted(sizes) * 2)
    masks = found.masks("a", mm)
    assert (masks["train"] ^ masks["test"]).all()
    assert set(mm[masks["test"]].tolist()) == {s for s in sizes if found.of("a", s) == "test"}


def test_one_size_cannot_be_split():
    with pytest.raises(NotUsable, match="there is 1 size; --split object"):
        split_rows("size", rows_of({"a": "1"}, {"a": ""}), {300})
    with pytest.raises(UnknownChoice, match="one of object, category, size"):
        split_rows("colour", [])


@pytest.mark.parametrize("by", ["object", "category", "size"])
def test_a_release_keeps_its_rule(by, tmp_path):
    release = Release.open(made_release(tmp_path / "r", split_by=by, sizes_mm=SIZES))
    assert release.manifest["split"]["by"] == by
    ids = {split: release.grasps(split=split)["grasp_id"].tolist() for split in ("train", "test")}
    assert set(ids["train"]).isdisjoint(ids["test"])
    assert len(ids["train"]) + len(ids["test"]) == release.figures["selected_rows"]
    key = {"object": "object_id", "category": "object_id", "size": "size_mm"}[by]
    values = [set(release.grasps(split=s)[key].tolist()) for s in ("train", "test")]
    assert all(values)
    assert values[0].isdisjoint(values[1])
    for split in ("train", "test"):
        objects = set(release.grasps(split=split)["object_id"].tolist())
        assert set(release.splits[split]) == objects
        assert dict(map(tuple, release.manifest["splits"]))[split] == len(objects)
    report = verify_release(release.path, full=True)
    assert report.ok, [c.detail for c in report.checks if not c.ok]
    assert f"By {by}" in (release.path / "DATASET_CARD.md").read_text()
