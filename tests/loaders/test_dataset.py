import logging
import pickle

import numpy as np
import pytest
import torch
from batches_alike import EVERYTHING, same_batches
from made_release import OBJECTS, PER_SCENE, SIZES, as_schema_1_0, made_release
from torch.utils.data import DataLoader

from bidexdata import frames
from bidexdata.errors import BadConfig, MissingExtra, PathNotFound, UnknownName
from bidexdata.formats.hdf5 import MappedValues
from bidexdata.formats.release import Release
from bidexdata.loaders import BiDexDataset, EpochSampler, collate
from bidexdata.loaders.stored import FloatRows, Rows

FLOAT32 = 2e-6  # metres and quaternion parts of order 1, converted in float64 and stored in float32


def loaded(data, **options):
    return list(DataLoader(data, batch_size=5, collate_fn=collate, **options))


def test_items_are_the_rows_of_the_release(floating):
    data = BiDexDataset(floating, fields=EVERYTHING, frame="world", cloud=None)
    batch = Release.open(floating).grasps(split="train")
    assert len(data) == len(batch)
    whole = data.__getitems__(range(len(data))).stacked
    for name in EVERYTHING:
        column = batch["success"] if name == "suc_f" else batch[name]
        found = whole[name] if name == "grasp_id" else whole[name].numpy()
        np.testing.assert_array_equal(np.asarray(found), column)
    owners = [data.object_ids[i] for i in whole["object_index"]]
    assert owners == batch["object_id"].tolist()
    one = data[3]
    assert one["joints"].shape == (2, 3, 3)
    assert one["grasp_id"] == batch["grasp_id"][3]
    assert torch.equal(one["hand_pos"], whole["hand_pos"][3])


def test_shapes_and_names_describe_an_item(floating):
    data = BiDexDataset(floating, points=32)
    item = data[0]
    assert set(item) == {
        "hand_pos",
        "hand_quat_wxyz",
        "joints",
        "size_mm",
        "size",
        "object_index",
        "cloud_solid",
    }
    assert item["cloud_solid"].shape == (32, 3)
    assert item["hand_pos"].dtype == torch.float32
    assert data.sides == ("left", "right")
    assert data.joint_names == (("lh_J0", "lh_J1", "lh_J2"), ("rh_J0", "rh_J1"))
    assert torch.isnan(item["joints"][1, :, 2]).all()  # the right hand has two joints


def test_clouds_have_the_size_of_the_scene(floating):
    data = BiDexDataset(floating, points=1024)
    whole = data.__getitems__(range(len(data))).stacked
    release = Release.open(floating)
    for i in range(len(data)):
        object_id = data.object_ids[whole["object_index"][i]]
        unit = release.cloud("cloud_solid", object_id)
        expected = unit * np.float32(whole["size_mm"][i].item() / 1000)
        np.testing.assert_array_equal(whole["cloud_solid"][i].numpy(), expected)


def test_sizes_between_millimetres_scale_the_clouds(tmp_path):
    release = made_release(tmp_path / "r", OBJECTS[:1], sizes=(300,), exact=(0.29973,))
    data = BiDexDataset(release, points=16)
    unit = Release.open(release).cloud("cloud_solid", OBJECTS[0])[:16]
    assert data[0]["size"] == np.float32(0.29973)
    np.testing.assert_array_equal(data[0]["cloud_solid"].numpy(), unit * np.float32(0.29973))


def test_a_release_of_schema_1_0_loads_with_the_sizes_its_millimetres_say(tmp_path):
    new = BiDexDataset(made_release(tmp_path / "r"), points=16)
    expected = new.__getitems__(range(len(new))).stacked
    old = made_release(tmp_path / "old")
    as_schema_1_0(old)
    data = BiDexDataset(old, points=16)
    found = data.__getitems__(range(len(data))).stacked
    assert set(found) == set(expected)
    assert torch.equal(found["size"], expected["size"])
    assert torch.equal(found["cloud_solid"], expected["cloud_solid"])


@pytest.mark.parametrize("room", [0, 10**9])
def test_clouds_are_the_same_kept_at_their_sizes_or_not(floating, monkeypatch, room):
    expected = BiDexDataset(floating, points=64)
    rows = [3, 0, 15, 3, 7]
    first = expected.__getitems__(rows).stacked["cloud_solid"]
    assert torch.equal(expected.__getitems__(rows).stacked["cloud_solid"], first)
    monkeypatch.setattr("bidexdata.loaders.clouds.SCALED_BYTES", room)
    again = BiDexDataset(floating, points=64).__getitems__(rows).stacked["cloud_solid"]
    assert torch.equal(again, first)
    # A batch is the reader's own: nothing that comes later writes to it, or to a view of it.
    again.zero_()
    view, kept = first[1:, :5], first[1:, :5].clone()
    del first
    for start in range(12):
        expected.__getitems__([start, start + 1, 1, 2, 3])
    assert torch.equal(view, kept)


def test_both_frames_describe_the_same_scene(tabletop):
    in_object = BiDexDataset(tabletop, fields=("hand_pos", "hand_quat_wxyz"), points=16)
    in_world = BiDexDataset(tabletop, fields=("hand_pos", "hand_quat_wxyz", "object_pos", "object_quat_wxyz"), frame="world", points=16)  # fmt: skip
    a = in_object.__getitems__(range(len(in_object))).stacked
    b = {k: v.numpy() for k, v in in_world.__getitems__(range(len(in_world))).stacked.items()}
    T_world_object = frames.transform(b["object_pos"], b["object_quat_wxyz"])
    cloud = frames.apply(T_world_object, a["cloud_solid"].numpy())
    np.testing.assert_allclose(cloud, b["cloud_solid"], atol=FLOAT32)
    T_object_hand = frames.transform(a["hand_pos"].numpy(), a["hand_quat_wxyz"].numpy())
    T_world_hand = T_world_object[:, None, None] @ T_object_hand
    pos, quat = frames.pos_quat(T_world_hand)
    np.testing.assert_allclose(pos, b["hand_pos"], atol=FLOAT32)
    overlap = np.abs(np.einsum("...i,...i->...", quat, b["hand_quat_wxyz"]))
    np.testing.assert_allclose(overlap, 1, atol=FLOAT32)
    assert not np.allclose(a["hand_pos"].numpy(), b["hand_pos"])
    assert (a["hand_quat_wxyz"][..., 0] >= 0).all()


def test_floating_scenes_need_no_conversion(floating):
    a, b = (
        BiDexDataset(floating, frame=f).__getitems__([0, 1]).stacked for f in ("object", "world")
    )
    assert all(torch.equal(torch.nan_to_num(a[k]), torch.nan_to_num(b[k])) for k in a)


def test_failed_attempts_stay_nan(tabletop):
    data = BiDexDataset(tabletop, configuration="audit", where="synth_status != 0", cloud=None)
    assert len(data) == len(Release.open(tabletop).splits["train"]) * len(SIZES)
    batch = data.__getitems__(range(len(data))).stacked
    assert torch.isnan(batch["hand_pos"]).all()
    assert torch.isnan(batch["hand_quat_wxyz"]).all()


def test_batches_do_not_depend_on_workers_or_collation(floating):
    data = BiDexDataset(floating, fields=EVERYTHING, points=16)
    alone = loaded(data)
    spawned = loaded(data, num_workers=2, multiprocessing_context="spawn")
    assert same_batches(alone, spawned)
    default = list(DataLoader(data, batch_size=5))
    assert same_batches(alone, default)
    again = loaded(BiDexDataset(floating, fields=EVERYTHING, points=16))
    assert same_batches(alone, again)


def test_parquet_alone_gives_the_same_items(floating, tmp_path):
    bare = made_release(tmp_path / "r", form="parquet")
    assert not (bare / "grasps.h5").exists()
    a, b = (BiDexDataset(p, fields=EVERYTHING, points=16) for p in (floating, bare))
    assert same_batches(loaded(a), loaded(b))


def test_workers_get_paths_not_tables(floating):
    data = BiDexDataset(floating)
    assert len(pickle.dumps(data)) < 20_000
    again = pickle.loads(pickle.dumps(data))  # noqa: S301  (what spawn does)
    assert same_batches([data.__getitems__([0, 2]).stacked], [again.__getitems__([0, 2]).stacked])


def test_selection_is_said_in_repr_and_log(floating, caplog):
    with caplog.at_level(logging.INFO, logger="bidexdata.loaders.dataset"):
        data = BiDexDataset(floating, where="suc_f")
    assert "selected rows only" in repr(data)
    assert "where='suc_f'" in repr(data)
    assert f"{len(data)} of {PER_SCENE * len(SIZES) * 2} grasps" in repr(data)
    assert repr(data) in caplog.text
    assert "audit rows only" in repr(BiDexDataset(floating, configuration="audit"))


@pytest.mark.parametrize("where", [None, "suc_f"])
def test_no_split_is_all_splits_one_after_the_other(floating, where):
    options = {"fields": EVERYTHING, "where": where, "points": 16}
    whole = BiDexDataset(floating, split=None, **options)
    parts = [BiDexDataset(floating, split=s, **options) for s in Release.open(floating).split_names]
    assert len(whole) == sum(len(p) for p in parts)
    assert len(parts) > 1
    rows = [item for part in parts for item in part]
    backwards = list(range(len(whole)))[::-1]
    found = whole.__getitems__(backwards).stacked
    sent = pickle.loads(pickle.dumps(whole))  # noqa: S301  (what spawn does)
    again = sent.__getitems__(backwards).stacked
    for place, row in zip(backwards[::-1], rows, strict=True):
        at = backwards.index(place)
        for name, value in row.items():
            for batch in (found, again):
                if isinstance(value, torch.Tensor):
                    assert torch.equal(
                        torch.nan_to_num(batch[name][at]), torch.nan_to_num(value)
                    ), name
                else:
                    assert batch[name][at] == value


def test_splits_cover_the_release_and_share_no_object(floating):
    train, test = (BiDexDataset(floating, split=s, fields=("grasp_id",)) for s in ("train", "test"))
    seen = [
        set(d.__getitems__(range(len(d))).stacked["object_index"].tolist()) for d in (train, test)
    ]
    assert not seen[0] & seen[1]
    assert len(seen[0] | seen[1]) == len(OBJECTS)
    assert len(train) + len(test) == PER_SCENE * len(OBJECTS) * len(SIZES)


def test_negative_indices_count_from_the_end_and_others_are_refused(floating):
    data = BiDexDataset(floating, fields=("grasp_id",), cloud=None)
    assert data[-1]["grasp_id"] == data[len(data) - 1]["grasp_id"]
    for index in (len(data), -len(data) - 1):
        with pytest.raises(IndexError):
            data[index]
    assert len(data.__getitems__([])) == 0
    rows = data.__getitems__([4, 1, 2])
    assert [r["grasp_id"] for r in rows[1:]] == rows.stacked["grasp_id"][1:]
    with pytest.raises(IndexError):
        rows[3]


def test_an_empty_choice_is_an_empty_dataset_and_is_said(floating, caplog):
    data = BiDexDataset(floating, where="size_mm > 10000")
    assert len(data) == 0
    assert "where='size_mm > 10000' keeps none of" in caplog.text
    assert loaded(data) == []


@pytest.mark.parametrize(
    ("options", "error", "said"),
    [
        ({"split": "val"}, UnknownName, "train, test"),
        ({"fields": ("joint",)}, UnknownName, "did you mean 'joints'"),
        ({"frame": "palm"}, UnknownName, "object, world"),
        ({"cloud": "cloud_hull"}, UnknownName, "cloud_solid"),
        ({"configuration": "all"}, UnknownName, "selected, audit"),
        ({"points": 1025}, BadConfig, "stores 1024 per object"),
        ({"where": "suc_x"}, UnknownName, "did you mean"),
        ({"where": {"sizes": 3}}, UnknownName, "sizes"),
    ],
)
def test_what_is_not_there_is_named(floating, options, error, said):
    with pytest.raises(error, match=said):
        BiDexDataset(floating, **options)


def test_no_release_is_a_path_error(tmp_path):
    with pytest.raises(PathNotFound):
        BiDexDataset(tmp_path)


def test_without_torch_the_pip_line_is_named(floating, monkeypatch):
    monkeypatch.setattr("bidexdata.loaders.options.find_spec", lambda name: None)
    with pytest.raises(MissingExtra, match="pip install"):
        BiDexDataset(floating)


def test_a_sampler_drives_it(floating):
    data = BiDexDataset(floating, fields=("grasp_id",), cloud=None)
    sampler = EpochSampler(len(data), seed=1)
    ids = [
        i for b in DataLoader(data, 4, sampler=sampler, collate_fn=collate) for i in b["grasp_id"]
    ]
    assert ids == [data[i]["grasp_id"] for i in EpochSampler(len(data), seed=1)]
    assert sorted(ids) == sorted(item["grasp_id"] for item in data)


def test_fewer_points_are_the_first_of_the_stored_ones(floating):
    few, many = (BiDexDataset(floating, points=n)[0]["cloud_solid"] for n in (16, 1024))
    assert torch.equal(few, many[:16])


def test_a_test_that_was_never_run_is_named_where_it_is_asked_for(floating, caplog):
    assert len(BiDexDataset(floating, where="suc_l", cloud=None)) == 0
    assert "holds no verdict of test l: no row has suc_l" in caplog.text
    caplog.clear()
    BiDexDataset(floating, where="suc_f", cloud=None)
    assert "holds no verdict" not in caplog.text


def test_untested_rows_can_be_left_out(tmp_path, caplog):
    out = made_release(tmp_path / "r", OBJECTS[:1], tested=False)
    assert not BiDexDataset(out, fields=("suc_f",), cloud=None)[0]["suc_f"]
    assert f"{out} was never tested" in caplog.text
    assert len(BiDexDataset(out, where="suc_f or not suc_f")) == 0
    assert len(BiDexDataset(out)) == PER_SCENE * len(SIZES)


@pytest.mark.parametrize("shift", [0, 1])
@pytest.mark.parametrize("columns", [("a", "b", "c"), ("b",)])
def test_rows_are_gathered_from_arrays_at_any_byte(shift, columns):
    # np.take copies all of an array whose numbers do not lie at multiples of their size.
    values = np.arange(60, dtype=np.float32).reshape(10, 6)
    raw = np.zeros(values.nbytes + shift, np.uint8)
    raw[shift:] = np.frombuffer(values.tobytes(), np.uint8)
    stored = np.ndarray(values.shape, np.float32, raw, shift)
    assert stored.flags.aligned == (shift == 0)
    layout = {"a": (slice(0, 1), ()), "b": (slice(1, 5), (2, 2)), "c": (slice(5, 6), ())}
    rows = FloatRows([MappedValues(stored, layout)], columns)
    found = rows.take(np.array([7, 0, 7]))
    assert set(found) == set(columns)
    for name, column in found.items():
        place, shape = layout[name]
        np.testing.assert_array_equal(column, values[[7, 0, 7], place].reshape(3, *shape))
    whole = Rows([stored])
    np.testing.assert_array_equal(whole.take(np.array([3])), values[[3]])
