"""Laws of loading arms: columns are those of the release, in every form and through every loader."""

from __future__ import annotations

import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from made_release import made_release
from torch.utils.data import DataLoader

from bidexdata.errors import BadConfig, NotUsable, UnknownName
from bidexdata.formats.release import Release
from bidexdata.formats.tables import ARM_COLUMNS
from bidexdata.loaders import BiDexCases, BiDexDataset, BiDexStream, collate
from bidexdata.record import Status


@pytest.fixture(scope="module", params=["both", "parquet", "hdf5"])
def armed(request, tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("armed") / "release"
    return made_release(root, arms=True, form=request.param)


@pytest.fixture(scope="module")
def in_parquet(tmp_path_factory) -> Path:
    return made_release(tmp_path_factory.mktemp("one") / "release", arms=True, form="parquet")


def same(found, expected: np.ndarray) -> bool:
    values = found.numpy()
    return values.dtype == expected.dtype and np.array_equal(
        values, expected, equal_nan=values.dtype.kind == "f"
    )


@pytest.mark.parametrize("split", ["train", "test", None])
@pytest.mark.parametrize("configuration", ["selected", "audit"])
def test_columns_of_arms_are_those_of_the_release(armed, split, configuration):
    how = {"split": split, "configuration": configuration, "cloud": None}
    data = BiDexDataset(armed, fields=("hand_pos", *ARM_COLUMNS), frame="world", **how)
    release = Release.open(armed)
    rows = release.with_arms(release.grasps(split=split, configuration=configuration))
    whole = data.__getitems__(range(len(data))).stacked
    assert len(data) == len(rows) > 0
    for name in ("hand_pos", *ARM_COLUMNS):
        assert same(whole[name], rows[name]), name
    assert data.rig == "made"
    assert data.arm_joint_names == (("j0", "j1", "lh_W"), ("j0", "j1"))


def test_rows_are_chosen_by_columns_of_arms(armed):
    release = Release.open(armed)
    rows = release.with_arms(release.grasps(split="train"))
    wanted = rows["arm_status"] == Status.OK
    assert 0 < wanted.sum() < len(rows)
    ways = (
        f"arm_status == {int(Status.OK)}",
        {"arm_status": int(Status.OK)},
        lambda columns: columns["arm_status"] == Status.OK,
    )
    for where in ways:
        data = BiDexDataset(armed, where=where, fields=("arm_path", "grasp_id"), cloud=None)
        batch = data.__getitems__(range(len(data))).stacked
        assert batch["grasp_id"] == rows["grasp_id"][wanted].tolist()
        assert same(batch["arm_path"], rows["arm_path"][wanted])
    data = BiDexDataset(armed, where="suc_f and clear_arms > 0.01", cloud=None)
    assert len(data) == int((rows["success"] & (rows["clear_arms"] > 0.01)).sum())


def test_workers_and_cases_give_the_same_columns(in_parquet):
    data = BiDexDataset(in_parquet, fields=("arm_joints", "arm_starts"), cloud=None)
    whole = data.__getitems__(range(len(data))).stacked
    back = pickle.loads(pickle.dumps(data))  # noqa: S301  (what spawn does)
    loader = DataLoader(back, batch_size=5, collate_fn=collate)
    for name in ("arm_joints", "arm_starts"):
        again = torch.cat([batch[name] for batch in loader])
        assert same(again, whole[name].numpy())
    cases = BiDexCases(in_parquet, fields=("arm_joints", "arm_starts"), cloud=None)
    joined = torch.cat([case["arm_joints"] for case in cases])
    assert same(joined, whole["arm_joints"].numpy())


def test_a_stream_reads_the_files_of_arms(in_parquet, tmp_path):
    fields = ("grasp_id", "arm_path", "arm_status", "contact_point")
    how = {"fields": fields, "cloud": None, "where": f"arm_status == {int(Status.OK)}"}
    data = BiDexDataset(in_parquet, **how)
    whole = data.__getitems__(range(len(data))).stacked
    stream = BiDexStream(in_parquet, shuffle=False, batch_size=4, **how)
    batches = list(stream)
    assert [i for batch in batches for i in batch["grasp_id"]] == whole["grasp_id"]
    for name in ("arm_path", "arm_status", "contact_point"):
        assert same(torch.cat([batch[name] for batch in batches]), whole[name].numpy())
    copy = Path(shutil.copytree(in_parquet, tmp_path / "release"))
    shutil.rmtree(copy / "arms")
    with pytest.raises(NotUsable, match=r"arms/made/train-00000\.parquet: not there"):
        BiDexStream(copy, **how)


def test_a_release_without_arms_says_so(floating):
    for loader in (BiDexDataset, BiDexStream):
        for how in ({"fields": ("arm_path",)}, {"where": "arm_status == 0"}):
            with pytest.raises(NotUsable, match=r"has no arm solutions, so no arm_\w+: pack runs"):
                loader(floating, cloud=None, **how)
    assert BiDexDataset(floating, cloud=None).rig == ""
    assert BiDexDataset(floating, cloud=None).arm_joint_names == ()


def test_an_unknown_field_lists_those_of_arms_and_augmentation_leaves_arms_out(in_parquet):
    for loader in (BiDexDataset, BiDexStream):
        with pytest.raises(UnknownName, match=r"did you mean 'arm_path'.*arm_time"):
            loader(in_parquet, fields=("arm_paths",), cloud=None)
        with pytest.raises(BadConfig, match="arms cannot follow: leave out augment or arm_path"):
            loader(in_parquet, fields=("arm_path",), augment=("yaw",))
    moved = BiDexDataset(in_parquet, where="arm_status == 0", augment=("yaw",))
    assert len(moved) > 0


@pytest.mark.parametrize("loader", [BiDexDataset, BiDexCases, BiDexStream])
def test_angles_of_arms_come_with_nothing_of_another_frame(in_parquet, loader):
    mixed = ({"fields": ("arm_path",)}, {"fields": ("hand_pos", "arm_joints"), "cloud": None})
    for how in mixed:
        with pytest.raises(BadConfig, match='add frame="world"'):
            loader(in_parquet, **how)
        assert loader(in_parquet, frame="world", **how) is not None
    # Without either there is nothing to mix, and numbers of a motion have no frame.
    assert loader(in_parquet, fields=("arm_path", "joints"), cloud=None) is not None
    assert loader(in_parquet, fields=("hand_pos", "arm_time", "arm_status")) is not None
