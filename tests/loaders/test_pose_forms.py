"""What an item looks like: rotations, clouds, cases, contacts, types, containers."""

import functools
import pickle
import subprocess
import sys
import types

import numpy as np
import pytest
import torch
from made_release import OBJECTS, PER_SCENE, SIZES, made_release
from torch.utils.data import DataLoader

from bidexdata import frames
from bidexdata.errors import BadConfig, MissingExtra, UnknownName
from bidexdata.formats.tables import ARM_COLUMNS, CONTACT_COLUMNS, GRASP_COLUMNS, GRASP_EXTRAS
from bidexdata.loaders import (
    BiDexCases,
    BiDexDataset,
    GraspItem,
    ObjectSampler,
    collate,
    collate_cases,
    expand_clouds,
    pack_contacts,
)
from bidexdata.record.fields import MEASURED

FLOAT32 = 2e-6
POSES = ("hand_pos", "hand_quat_wxyz", "object_quat_wxyz", "size")


def stacked(data, rows=None):
    return data.__getitems__(range(len(data)) if rows is None else rows).stacked


def equal(a, b):
    return torch.equal(torch.nan_to_num(a), torch.nan_to_num(b))


@pytest.mark.parametrize("frame", ["object", "world"])
def test_rotations_are_the_same_in_every_form(tabletop, frame):
    options = {"fields": POSES, "frame": frame, "cloud": None}
    quat = stacked(BiDexDataset(tabletop, **options))
    xyzw = stacked(BiDexDataset(tabletop, quat_order="xyzw", **options))
    six = stacked(BiDexDataset(tabletop, rotation="6d", **options))
    matrix = stacked(BiDexDataset(tabletop, rotation="matrix", **options))
    for name in ("hand", "object"):
        wxyz = quat[f"{name}_quat_wxyz"]
        assert torch.equal(xyzw[f"{name}_quat_xyzw"], wxyz[..., [1, 2, 3, 0]])
        R = frames.matrix_from_quat(wxyz.numpy())
        np.testing.assert_allclose(matrix[f"{name}_matrix"], R, atol=FLOAT32)
        np.testing.assert_allclose(six[f"{name}_rot6d"][..., :3], R[..., 0], atol=FLOAT32)
        np.testing.assert_allclose(six[f"{name}_rot6d"][..., 3:], R[..., 1], atol=FLOAT32)
    for batch in (xyzw, six, matrix):
        assert not [key for key in batch if key.endswith("_wxyz")]
        assert torch.equal(batch["hand_pos"], quat["hand_pos"])
        assert {v.dtype for k, v in batch.items() if k != "object_index"} == {torch.float32}


@pytest.mark.parametrize("frame", ["object", "world"])
@pytest.mark.parametrize("made", ["floating", "tabletop"])
@pytest.mark.parametrize("augment", [(), ("yaw",)])
def test_unique_clouds_expand_to_those_of_every_grasp(request, made, frame, augment):
    options = {"split": None, "points": 32, "frame": frame, "augment": augment}
    root = request.getfixturevalue(made)
    every = BiDexDataset(root, **options)
    unique = BiDexDataset(root, clouds="unique", **options)
    rows = [5, 0, 1, 5, 20, 2]
    batch = stacked(unique, rows)
    wide = expand_clouds(batch)
    assert wide.keys() == stacked(every, rows).keys()
    for name, values in stacked(every, rows).items():
        assert equal(wide[name], values), name
    assert len(batch["cloud_solid"]) == len(np.unique(batch["point_index"]))
    if made == "floating" and not augment:
        assert len(batch["cloud_solid"]) == 3  # rows 0, 1, 2 and rows 5, 5 are of one scene each
    # Walked row by row it is an item, as PyTorch's own collate wants.
    default = next(iter(DataLoader(unique, batch_size=4)))
    assert equal(default["cloud_solid"], stacked(every, range(4))["cloud_solid"])
    assert expand_clouds(wide).keys() == wide.keys()


def test_grouped_batches_hold_few_clouds(floating):
    data = BiDexDataset(floating, split=None, clouds="unique", points=16, where="size_mm == 300")
    assert data.object_rows.tolist() == [PER_SCENE] * 3
    sampler = ObjectSampler(data.object_rows, PER_SCENE, seed=2)
    for batch in DataLoader(data, PER_SCENE, sampler=sampler, collate_fn=collate):
        assert len(batch["cloud_solid"]) == 1
        assert len(batch["hand_pos"]) == PER_SCENE


def test_cases_are_scenes_with_all_their_grasps(floating):
    where = "not (suc_f and size_mm == 500)"
    fields = ("grasp_id", "scene_id", "hand_pos", "size_mm", "suc_f", "attempt")
    rows = stacked(BiDexDataset(floating, split=None, where=where, fields=fields, points=16))
    cases = BiDexCases(floating, split=None, where=where, fields=fields, points=16)
    assert "scenes of BiDexDataset" in repr(cases)
    whole = [cases[k] for k in range(len(cases))]
    assert [i for case in whole for i in case["grasp_id"]] == rows["grasp_id"]
    assert [case["scene_id"] for case in whole] == list(dict.fromkeys(rows["scene_id"]))
    at = 0
    for case in whole:
        assert case["cloud_solid"].shape == (16, 3)
        assert case["size_mm"].ndim == 0
        assert equal(case["hand_pos"], rows["hand_pos"][at : at + case["grasps"]])
        assert equal(case["cloud_solid"], rows["cloud_solid"][at])
        at += case["grasps"]
    assert equal(cases[-1]["hand_pos"], whole[-1]["hand_pos"])
    for index in (len(cases), -len(cases) - 1):
        with pytest.raises(IndexError):
            cases[index]
    sent = pickle.loads(pickle.dumps(cases))  # noqa: S301  (what spawn does)
    assert equal(sent[1]["cloud_solid"], whole[1]["cloud_solid"])
    with pytest.raises(BadConfig, match="clouds is no option"):
        BiDexCases(floating, clouds="expand")


def test_batches_of_cases_are_packed_or_padded(floating):
    cases = BiDexCases(floating, split=None, where="suc_f", fields=("hand_pos", "attempt", "suc_f", "grasp_id"), points=16)  # fmt: skip
    rows = stacked(cases.grasps)
    counts = [case["grasps"] for case in (cases[k] for k in range(len(cases)))]
    assert len(set(counts)) > 1
    packed = next(iter(DataLoader(cases, len(cases), collate_fn=collate_cases)))
    assert packed["case_offsets"].tolist() == np.cumsum([0, *counts]).tolist()
    assert packed["case_index"].tolist() == np.repeat(np.arange(len(counts)), counts).tolist()
    assert equal(packed["hand_pos"], rows["hand_pos"])
    assert packed["grasp_id"] == rows["grasp_id"]
    padded = collate_cases([cases[k] for k in range(len(cases))], grasps="padded")
    mask = padded["grasp_mask"]
    assert mask.sum(1).tolist() == counts
    for name in ("hand_pos", "attempt", "suc_f"):
        assert equal(padded[name][mask], rows[name])
    assert torch.isnan(padded["hand_pos"][~mask]).all()
    assert (padded["attempt"][~mask] == -1).all()
    assert not padded["suc_f"][~mask].any()
    assert [len(ids) for ids in padded["grasp_id"]] == [max(counts)] * len(counts)
    assert padded["cloud_solid"].shape == (len(counts), 16, 3)
    with pytest.raises(UnknownName, match="padded, packed"):
        collate_cases([cases[0]], grasps="ragged")


def test_packed_contacts_are_the_padded_ones_without_padding(floating):
    data = BiDexDataset(floating, fields=("contact_index", "contact_point", "force_scale"), cloud=None)  # fmt: skip
    padded = stacked(data, [0, 3])
    fn = functools.partial(collate, contacts="packed")
    packed = next(iter(DataLoader(data, sampler=[0, 3], batch_size=2, collate_fn=fn)))
    # Two contacts on the left and three on the right, see made_release.
    assert packed["contact_offsets"].tolist() == [0, 5, 10]
    assert packed["contact_hand"].tolist() == [0, 0, 1, 1, 1] * 2
    for row in range(2):
        low, high = packed["contact_offsets"][row : row + 2]
        mine = padded["contact_index"][row] >= 0
        assert equal(packed["contact_point"][low:high], padded["contact_point"][row][mine])
        assert equal(packed["contact_index"][low:high], padded["contact_index"][row][mine])
    assert equal(packed["force_scale"], padded["force_scale"])
    with pytest.raises(BadConfig, match="'contact_index'"):
        pack_contacts({})
    with pytest.raises(UnknownName, match="padded, packed"):
        collate([], contacts="ragged")


def test_the_type_of_an_item_has_every_column():
    columns = {*GRASP_COLUMNS, *CONTACT_COLUMNS, *ARM_COLUMNS, *MEASURED}
    columns |= {f.name for f in GRASP_EXTRAS}
    made = {"object_index", "cloud_solid", "cloud_mesh", "cloud_normal", "point_index", "mirrored"}
    forms = {
        f"{name}_{form}" for name in ("hand", "object") for form in ("quat_xyzw", "rot6d", "matrix")
    }
    assert set(GraspItem.__annotations__) == columns | made | forms


def test_a_transform_sees_batches(floating):
    def halved(batch):
        return {**batch, "size": batch["size"] / 2}

    data = BiDexDataset(floating, transform=halved, points=16)
    assert equal(stacked(data)["size"] * 2, stacked(BiDexDataset(floating, points=16))["size"])


def test_tensordicts_need_their_package_and_one_leading_axis(floating, monkeypatch):
    monkeypatch.setitem(sys.modules, "tensordict", None)
    with pytest.raises(MissingExtra, match="pip install tensordict"):
        BiDexDataset(floating, as_tensordict=True)
    fake = types.ModuleType("tensordict")
    fake.__spec__ = types.SimpleNamespace()  # all that find_spec asks of a loaded module
    monkeypatch.setitem(sys.modules, "tensordict", fake)
    with pytest.raises(BadConfig, match="one leading axis"):
        BiDexDataset(floating, as_tensordict=True, clouds="unique")


def test_tensordicts_hold_what_dicts_hold(floating):
    pytest.importorskip("tensordict")
    fields = ("hand_pos", "grasp_id")
    plain = BiDexDataset(floating, fields=fields, points=16)
    data = BiDexDataset(floating, fields=fields, points=16, as_tensordict=True)
    batch = next(iter(DataLoader(data, 4, collate_fn=collate)))
    assert batch.batch_size == torch.Size([4])
    expected = stacked(plain, range(4))
    assert equal(batch["hand_pos"], expected["hand_pos"])
    assert batch["grasp_id"] == expected["grasp_id"]
    assert equal(data[2]["cloud_solid"], expected["cloud_solid"][2])
    assert data[2]["grasp_id"] == expected["grasp_id"][2]


@pytest.mark.parametrize(
    ("options", "error", "said"),
    [
        ({"rotation": "euler"}, UnknownName, "quat, 6d, matrix"),
        ({"quat_order": "zyxw"}, UnknownName, "wxyz, xyzw"),
        ({"clouds": "all"}, UnknownName, "expand, unique"),
        ({"augment": ("flip",)}, UnknownName, "yaw, mirror"),
        ({"rotation": "6d", "quat_order": "xyzw"}, BadConfig, "leave one out"),
        ({"points": 0}, BadConfig, "at least one"),
    ],
)
def test_impossible_options_are_named(floating, options, error, said):
    with pytest.raises(error, match=said):
        BiDexDataset(floating, **options)


@pytest.mark.parametrize("form", ["both", "parquet", "hdf5"])
def test_every_form_of_a_release_gives_the_same_items(tmp_path, floating, form):
    every = (*GRASP_COLUMNS, *CONTACT_COLUMNS, *(f.name for f in GRASP_EXTRAS), *MEASURED)
    made = made_release(tmp_path / "r", OBJECTS, form=form)
    a, b = (stacked(BiDexDataset(p, split=None, fields=every, points=16)) for p in (floating, made))
    assert a.keys() == {*every, "object_index", "cloud_solid"} == b.keys()
    for name, values in a.items():
        same = equal(values, b[name]) if isinstance(values, torch.Tensor) else values == b[name]
        assert same, name
    assert len(a["size_mm"]) == PER_SCENE * len(OBJECTS) * len(SIZES)


@pytest.mark.parametrize("form", ["both", "parquet", "hdf5"])
def test_where_reads_columns_of_every_kind_from_every_form(tmp_path, form):
    made = made_release(tmp_path / "r", OBJECTS, form=form)
    data = BiDexDataset(made, split=None, fields=("grasp_id", "object_id", "suc_f", "pd", "attempt", "setting"), cloud=None)  # fmt: skip
    rows = stacked(data)

    def chosen(where):
        return stacked(BiDexDataset(made, split=None, fields=("grasp_id",), cloud=None, where=where))["grasp_id"]  # fmt: skip

    ids = np.array(rows["grasp_id"])
    assert chosen("suc_f") == ids[rows["suc_f"].numpy()].tolist()
    assert chosen("not suc_f and pd < 0.005") == ids[(~rows["suc_f"] & (rows["pd"] < 0.005)).numpy()].tolist()  # fmt: skip
    box = np.array(rows["object_id"]) == OBJECTS[0]
    assert chosen({"object_id": OBJECTS[0]}) == ids[box].tolist()
    assert chosen(f"object_id == '{OBJECTS[0]}' and attempt >= 2") == ids[box & (rows["attempt"] >= 2).numpy()].tolist()  # fmt: skip
    assert chosen("setting == 'tabletop'") == []
    assert chosen({"scene_id": f"{OBJECTS[1]}/500/float"}) == chosen(lambda c: c["scene_id"] == f"{OBJECTS[1]}/500/float")  # fmt: skip
    assert chosen(f"grasp_id in ['{ids[7]}']") == [ids[7]]
    assert chosen({}) == ids.tolist()
    with pytest.raises(UnknownName, match="no column is called 'sizes'"):
        chosen(lambda c: c["sizes"] > 3)


def test_a_function_reads_only_the_columns_it_looks_at(floating):
    seen = {}

    def where(columns):
        seen["columns"] = columns
        return columns["size_mm"] == 300

    assert len(BiDexDataset(floating, split=None, where=where, cloud=None)) == PER_SCENE * 3
    assert {"grasp_id", "suc_f", "pd"} <= set(seen["columns"])
    assert len(seen["columns"]) > 20


NO_ROWS = """
import sys
from bidexdata import BiDexDataset, Release

def refuse(*args, **kwargs):
    raise AssertionError("a row table was read")

Release.index = Release.row_groups = refuse
fields = ("hand_pos", "object_id", "scene_id", "suc_f")
where = "suc_f or object_id == 'x'"
data = BiDexDataset(sys.argv[1], split=None, fields=fields, where=where, points=16)
assert all(item["suc_f"] for item in data)
assert data.warm() > 0
print(len(data))
"""


def test_opening_reads_no_row_table(floating):
    # In a process of its own: the run-time check of types looks into every column.
    argv = [sys.executable, "-c", NO_ROWS, str(floating)]
    done = subprocess.run(argv, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 0
