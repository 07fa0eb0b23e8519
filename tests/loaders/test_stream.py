"""Batches from the Parquet files that are there."""

import pickle
from itertools import islice

import pytest
import torch
from made_release import OBJECTS, made_release, made_rows
from torch.utils.data import DataLoader

from bidexdata.errors import BadConfig, NotUsable, UnknownName
from bidexdata.formats import parquet
from bidexdata.formats.release import Release
from bidexdata.loaders import BiDexCases, BiDexDataset, BiDexStream, Prefetch, expand_clouds

FIELDS = ("grasp_id", "hand_pos", "hand_quat_wxyz", "joints", "contact_point", "contact_index",
          "suc_f", "size", "size_mm", "scene_id")  # fmt: skip
OPTIONS = {"split": None, "fields": FIELDS, "points": 16}


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    """A release whose grasps lie in several files of several row groups."""
    patch = pytest.MonkeyPatch()
    patch.setattr(parquet, "ROW_GROUP", 3)
    patch.setattr(parquet, "ROWS_PER_FILE", 8)
    root = made_release(tmp_path_factory.mktemp("many") / "release", setting="tabletop")
    patch.undo()
    assert len(Release.open(root).table_files("grasps", "selected", "train")) > 1
    return root


def ids(batches):
    return [i for b in batches for i in b["grasp_id"]]


@pytest.mark.parametrize("frame", ["object", "world"])
def test_a_stream_gives_the_items_of_the_dataset(many, frame):
    data = BiDexDataset(many, frame=frame, **OPTIONS)
    items = {item["grasp_id"]: item for item in data}
    stream = BiDexStream(many, batch_size=5, buffer=7, frame=frame, clouds="unique", **OPTIONS)
    seen = []
    for batch in map(expand_clouds, stream):
        for k, grasp_id in enumerate(batch["grasp_id"]):
            seen.append(grasp_id)
            for name, value in items[grasp_id].items():
                found = batch[name][k]
                if isinstance(value, torch.Tensor):
                    assert torch.equal(torch.nan_to_num(found), torch.nan_to_num(value)), name
                else:
                    assert found == value
    assert sorted(seen) == sorted(items)
    assert seen != list(items)


def test_seed_and_epoch_decide_the_order(many):
    stream = BiDexStream(many, batch_size=5, seed=1, **OPTIONS)
    first = ids(stream)
    assert ids(stream) == first
    stream.set_epoch(1)
    assert sorted(ids(stream)) == sorted(first)
    assert ids(stream) != first
    assert ids(BiDexStream(many, batch_size=7, seed=1, **OPTIONS)) == first
    stored = BiDexDataset(many, **OPTIONS)
    plain = BiDexStream(many, shuffle=False, **OPTIONS)
    assert ids(plain) == [item["grasp_id"] for item in stored]


@pytest.mark.parametrize("workers", [1, 2])
def test_workers_and_the_thread_change_nothing(many, workers):
    stream = BiDexStream(many, batch_size=3, buffer=6, **OPTIONS)
    alone = [b["grasp_id"] for b in stream]
    options = {"num_workers": workers, "multiprocessing_context": "fork"}
    loaded = DataLoader(stream, batch_size=None, **options)
    assert [b["grasp_id"] for b in loaded] == alone
    assert len(loaded) == len(alone)
    assert [b["grasp_id"] for b in Prefetch(stream)] == alone
    sent = pickle.loads(pickle.dumps(stream))  # noqa: S301  (what spawn does)
    assert [b["grasp_id"] for b in sent] == alone


@pytest.mark.parametrize("world", [1, 2])
@pytest.mark.parametrize("after", [1, 2, 3])
def test_a_stream_resumes_on_any_number_of_ranks(many, world, after):
    def ranks(count):
        return [BiDexStream(many, batch_size=2, buffer=6, rank=r, world_size=count, **OPTIONS) for r in range(count)]  # fmt: skip

    whole = ids(BiDexStream(many, batch_size=2, buffer=6, **OPTIONS))
    begun = ranks(world)
    had = [i for s in begun for i in ids(islice(iter(s), 3))]
    assert sorted(had) == sorted(whole[: 6 * world])
    state = begun[0].state_dict(3)
    resumed = ranks(after)
    for stream in resumed:
        stream.load_state_dict(state)
    rest = [i for s in resumed for i in ids(s)]
    left = whole[6 * world :]
    assert sorted(rest) == sorted(left[: len(left) // (2 * after) * 2 * after])


def test_rows_of_missing_files_are_left_out_and_said(many, tmp_path, caplog):
    partial = tmp_path / "release"
    partial.mkdir()
    release = Release.open(many)
    kept = release.table_files("grasps", "selected", "train")[0].name
    for path in many.rglob("*"):
        if path.is_file() and path.suffix != ".h5":
            if path.parent.name in ("grasps", "contacts") and path.name != kept:
                continue
            copy = partial / path.relative_to(many)
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes(path.read_bytes())
    stream = BiDexStream(partial, **{**OPTIONS, "split": "train"})
    assert "files of grasps are not there" in caplog.text
    there = parquet.read_table(many / "grasps" / kept).column("grasp_id").to_pylist()
    assert sorted(ids(stream)) == sorted(there)
    (partial / "contacts" / kept).unlink()
    with pytest.raises(NotUsable, match="contacts"):
        ids(BiDexStream(partial, **{**OPTIONS, "split": "train"}))
    few = BiDexStream(partial, split="train", fields=("grasp_id",), cloud=None)
    assert sorted(ids(few)) == sorted(there)
    (partial / "grasps" / kept).unlink()
    with pytest.raises(NotUsable, match="files of grasps is there"):
        BiDexStream(partial, split="train")


def test_where_chooses_the_same_rows_as_in_a_dataset(many):
    where = "suc_f and size_mm == 300"
    data = BiDexDataset(many, where=where, **OPTIONS)
    stream = BiDexStream(many, where=where, batch_size=4, **OPTIONS)
    assert stream.rows == len(data)
    assert sorted(ids(stream)) == sorted(item["grasp_id"] for item in data)
    assert list(BiDexStream(many, where="size_mm > 10000", **OPTIONS)) == []


@pytest.mark.parametrize(
    "where",
    [
        "1 > 2",
        "1 < 2",
        {},
        "joints > 2",
        "sucf",
        {"sizes": 1},
        "size_mm > 'a'",
        "size_mm +",
        "not " * 999 + "suc_f",
    ],
)
def test_where_does_and_says_what_it_does_in_a_dataset(many, where):
    found = []
    for kind in (BiDexDataset, BiDexStream):
        try:
            data = kind(many, where=where, **OPTIONS)
            found.append(data.rows if kind is BiDexStream else len(data))
        except (BadConfig, UnknownName) as err:
            found.append((type(err), str(err)))
    assert found[0] == found[1]


def test_a_split_without_rows_gives_no_batch(tmp_path):
    root = made_release(tmp_path / "r", OBJECTS[:1])
    for where in (None, "suc_f"):
        assert list(BiDexStream(root, split="test", where=where)) == []


def test_the_order_and_the_numbers_of_objects_are_found_once_per_epoch(many, monkeypatch):
    orders, plain = [], BiDexStream._order
    monkeypatch.setattr(BiDexStream, "_order", lambda s: orders.append(s.epoch) or plain(s))
    stream = BiDexStream(many, batch_size=2, buffer=6, **OPTIONS)
    assert len(ids(stream)) > 20
    numbers = stream._numbers
    stream.set_epoch(1)
    assert len(ids(stream)) > 20
    assert orders == [0, 1]
    assert stream._numbers is numbers


@pytest.mark.parametrize("kind", [BiDexDataset, BiDexStream, BiDexCases])
@pytest.mark.parametrize(("option", "word"), [("fields", "joints"), ("augment", "yaw")])
def test_a_text_in_place_of_a_list_is_refused_with_the_list_shown(many, kind, option, word):
    with pytest.raises(BadConfig, match=rf"{option}=\['{word}'\]"):
        kind(many, **{option: word})


@pytest.mark.parametrize(
    ("options", "error", "said"),
    [
        ({"where": lambda c: c}, BadConfig, "no function"),
        ({"fields": ("joint",)}, UnknownName, "did you mean 'joints'"),
        ({"split": "val"}, UnknownName, "train, test"),
        ({"configuration": "all"}, UnknownName, "selected, audit"),
        ({"frame": "palm"}, UnknownName, "object, world"),
        ({"rank": 2}, ValueError, "rank"),
    ],
)
def test_what_a_stream_cannot_do_is_said(many, options, error, said):
    with pytest.raises(error, match=said):
        BiDexStream(many, **options)


def test_rows_that_stand_in_hdf5_alone_are_no_stream(tmp_path):
    rows = {o: made_rows(o) for o in OBJECTS[:1]}
    root = made_release(tmp_path / "r", OBJECTS[:1], form="hdf5", rows_of=lambda o: [rows[o]])
    with pytest.raises(NotUsable, match="BiDexDataset"):
        BiDexStream(root, split=None)
