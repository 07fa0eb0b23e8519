"""What docs/format.md says is enough: a reader without this package gets the same numbers."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from made_release import made_hands, made_release
from plain_reader import PlainRelease, rotation

from bidexdata.formats.release import Release
from bidexdata.formats.tables import (
    ARM_COLUMNS,
    CONTACT_COLUMNS,
    GRASP_COLUMNS,
    VERDICT_COLUMNS,
)

PLAIN = Path(__file__).with_name("plain_reader.py")
TOLERANCE = 1e-7
"""float32 poses of a metre or less [m]."""


@pytest.fixture(scope="module", params=["floating", "tabletop"])
def written(request, tmp_path_factory) -> Path:
    return made_release(tmp_path_factory.mktemp("plain") / "release", setting=request.param)


@pytest.fixture(scope="module")
def armed(tmp_path_factory) -> Path:
    return made_release(tmp_path_factory.mktemp("armed") / "release", arms=True)


def test_the_reader_knows_nothing_of_this_package():
    tree = ast.parse(PLAIN.read_text())
    names = [n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
    names += [a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names]
    assert {n.split(".")[0] for n in names} == {"hashlib", "json", "pathlib", "numpy", "pyarrow"}


@pytest.mark.parametrize("configuration", ["selected", "audit"])
def test_it_reads_the_values_that_the_package_reads(written, configuration):
    plain, release = PlainRelease(written), Release.open(written)
    batch = release.grasps(configuration=configuration)
    assert plain.damaged() == []
    tables = {
        n: plain.table(n, configuration) for n in ("grasps", "contacts", "verdicts/paper-1-f")
    }
    assert tables["grasps"]["grasp_id"] == tables["contacts"]["grasp_id"]
    names = (GRASP_COLUMNS, CONTACT_COLUMNS, VERDICT_COLUMNS)
    for table, columns in zip(tables.values(), names, strict=True):
        for name in columns:
            if isinstance(table[name], list):
                values = [False if v is None else v for v in table[name]]
                assert values == batch[name].tolist(), name
            else:
                assert table[name].tobytes() == batch[name].tobytes(), name
                assert table[name].shape == batch[name].shape


def test_it_poses_the_hands_as_the_simulator_does(written):
    import mujoco

    plain = PlainRelease(written)
    rows = plain.table("grasps")
    for h, hand in enumerate(made_hands()):
        model = hand.make_spec().compile()
        data = mujoco.MjData(model)
        tree = plain.tree(h)
        tips = [(tree["body_names"].index(own[-1]), [0, 0, 0]) for own in tree["fingers"].values()]
        for i in np.flatnonzero(rows["synth_status"] == 0):
            pose = rows["hand_pos"][i, h, 1], rows["hand_quat_wxyz"][i, h, 1]
            joints = rows["joints"][i, h, 1, : len(tree["joint_names"])]
            found = plain.points_in_world(tree, tips, joints, *pose)
            data.qpos[:] = joints
            mujoco.mj_kinematics(model, data)
            root = data.body(tree["body_names"][0])
            own = [data.body(tree["body_names"][b]).xpos for b, _ in tips]
            R = root.xmat.reshape(3, 3)
            local = (np.array(own) - root.xpos) @ R
            W = np.zeros(9)
            mujoco.mju_quat2Mat(W, pose[1].astype(float))
            np.testing.assert_allclose(found, local @ W.reshape(3, 3).T + pose[0], atol=TOLERANCE)


def test_it_finds_the_pads_on_the_stored_contact_points(written):
    plain = PlainRelease(written)
    grasps, contacts = plain.table("grasps"), plain.table("contacts")
    for h in range(2):
        tree = plain.tree(h)
        pads = list(zip(tree["contact_body"], tree["contact_pos"], strict=True))
        for i in np.flatnonzero(grasps["synth_status"] == 0):
            pose = grasps["hand_pos"][i, h, 1], grasps["hand_quat_wxyz"][i, h, 1]
            centres = plain.points_in_world(tree, pads, grasps["joints"][i, h, 1], *pose)
            R = rotation(grasps["object_quat_wxyz"][i])
            for slot, pad in enumerate(contacts["contact_index"][i, h]):
                if pad >= 0:
                    point, normal = (
                        contacts[n][i, h, slot] for n in ("contact_point", "contact_normal")
                    )
                    world = R @ (point + tree["contact_radius"][pad] * normal)
                    world += grasps["object_pos"][i]
                    np.testing.assert_allclose(world, centres[pad], atol=10 * TOLERANCE)


def test_scenes_say_where_their_rows_begin(written):
    import pyarrow.parquet as pq

    plain = PlainRelease(written)
    scenes = pq.read_table(written / "scenes.parquet").to_pylist()
    for configuration in ("selected", "audit"):
        ids = plain.table("grasps", configuration)["scene_id"]
        at = 0
        for split, _ in plain.manifest["splits"]:
            for scene in scenes:
                if scene["split"] == split:
                    rows = scene[f"{configuration}_rows"]
                    assert set(ids[at : at + rows]) <= {scene["scene_id"]}
                    at += rows
        assert at == len(ids)


def test_the_training_form_is_mapped_at_its_byte_offset(written):
    batch = Release.open(written).grasps(split="train")
    with h5py.File(written / "grasps.h5") as file:
        for part, names in (("values", ("joints", "size")), ("contacts", ("contact_point",))):
            dataset = file[f"selected/train/{part}"]
            offset, shape = dataset.id.get_offset(), dataset.shape
            layout = json.loads(dataset.attrs["columns"])
            mapped = np.memmap(written / "grasps.h5", "<f4", "r", offset, shape)
            ends = np.cumsum([c["width"] for c in layout])
            for name in names:
                k = [c["name"] for c in layout].index(name)
                values = mapped[:, ends[k] - layout[k]["width"] : ends[k]]
                values = values.reshape(len(mapped), *layout[k]["shape"])
                assert values.tobytes() == batch[name].tobytes()


@pytest.mark.parametrize("configuration", ["selected", "audit"])
def test_it_reads_the_motions_of_arms(armed, configuration):
    plain, release = PlainRelease(armed), Release.open(armed)
    assert plain.manifest["rigs"] == [release.rig]
    rows = release.with_arms(release.grasps(configuration=configuration))
    table = plain.table(f"arms/{release.rig}", configuration)
    assert table["grasp_id"] == rows["grasp_id"].tolist()
    for name in ARM_COLUMNS:
        assert table[name].tobytes() == rows[name].tobytes(), name
        assert table[name].shape == rows[name].shape
    for i in np.flatnonzero(table["arm_status"] == 0):
        frames = plain.key_frames(table["arm_path"][i])
        np.testing.assert_array_equal(frames, table["arm_joints"][i])


def test_it_puts_the_hands_of_arms_where_the_grasps_have_them(armed):
    plain = PlainRelease(armed)
    grasps, arms = plain.table("grasps"), plain.table(f"arms/{plain.arms[0]['rig']}")
    rig = plain.rig()
    assert rig["config"]["path"]["squeeze_palm"] == "moves"
    moving = np.flatnonzero(arms["arm_status"] == 0)
    assert len(moving)
    for h, arm in enumerate(plain.arms):
        chain = rig["chains"][arm["side"]]
        assert chain["joint_names"] == arm["joint_names"]
        assert chain["wrist"] == arm["wrist_joints"]
        for i in moving:
            for s in range(3):
                pos, R = plain.hand_on_arm(chain, arms["arm_joints"][i, h, 2 + s])
                np.testing.assert_allclose(pos, grasps["hand_pos"][i, h, s], atol=TOLERANCE)
                wanted = rotation(grasps["hand_quat_wxyz"][i, h, s])
                np.testing.assert_allclose(R, wanted, atol=10 * TOLERANCE)


def test_motions_of_the_form_hdf5_are_mapped_too(tmp_path):
    root = made_release(tmp_path / "release", arms=True, form="hdf5")
    release = Release.open(root)
    rows = release.with_arms(release.grasps(split="train"))
    with h5py.File(root / "grasps.h5") as file:
        group = file["selected/train/arms/made"]
        layout = json.loads(group["values"].attrs["columns"])
        names = [c["name"] for c in layout]
        low = sum(c["width"] for c in layout[: names.index("arm_path")])
        column = layout[names.index("arm_path")]
        mapped = np.memmap(
            *(root / "grasps.h5", "<f4", "r", group["values"].id.get_offset()),
            shape=group["values"].shape,
        )
        values = mapped[:, low : low + column["width"]].reshape(len(mapped), *column["shape"])
        assert values.tobytes() == rows["arm_path"].tobytes()
        assert group["arm_status"][:].tolist() == rows["arm_status"].tolist()
