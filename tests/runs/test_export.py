"""Laws of an export: what is exported and imported again is the same grasp on the same object."""

from __future__ import annotations

import csv
import json
import pickletools
from pathlib import Path

import numpy as np
import pytest
from made_dexgraspbench import made_dexgraspbench
from made_named_qpos import made_named

from bidexdata.cli import main as cli
from bidexdata.errors import NotUsable, UnknownName
from bidexdata.formats.exporters.dexgraspbench import TWO_HANDED, check_hands
from bidexdata.formats.importers.dummy_arms import ARM_BASE, ARM_JOINTS, arm_pose, arm_values
from bidexdata.formats.release import Release
from bidexdata.frames import matrix_from_quat, quat_angle, quat_multiply, random_quat
from bidexdata.hands import load_hands
from bidexdata.objects.config import PrepareConfig, SdfConfig, SurfaceConfig
from bidexdata.runs import import_objects
from bidexdata.runs.export import export_release
from bidexdata.runs.import_ import ImportRequest, import_run
from bidexdata.runs.pack import pack_runs
from bidexdata.runs.run import Run
from bidexdata.runs.stage import TaskExecution

HERE = TaskExecution(executor="inline", quiet=True)
CLOSE = 2e-7  # float32 of lengths below 1 m and of angles, twice rounded
STAGES = ("pregrasp_qpos", "grasp_qpos", "squeeze_qpos")


@pytest.fixture(scope="module", autouse=True)
def coarse():
    small = PrepareConfig(surface=SurfaceConfig(points=100), sdf=SdfConfig(cells=12))
    patch = pytest.MonkeyPatch()
    patch.setattr(import_objects, "PrepareConfig", lambda: small)
    yield
    patch.undo()


def released(root: Path, form: str, source: Path) -> Path:
    request = ImportRequest(format=form, path=source, hand="capsule")
    import_run(request, root / "run", execution=HERE)
    return pack_runs(
        [root / "run"], root / "release", name="peer", version="1.0.0", quiet=True
    ).path


@pytest.fixture(scope="module")
def one_handed(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("one")
    made_dexgraspbench(root / "source")
    index = root / "source" / "objects" / "INDEX.csv"
    index.write_text("file,licence,author\nbrick,CC0-1.0,me\nTwo_Boxes,MIT,\n")
    return released(root, "dexgraspbench", root / "source")


@pytest.fixture(scope="module")
def two_handed(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("two")
    source = made_named(root / "source", "bimangrasp")
    (source / "meshdata" / "INDEX.csv").write_text("file,licence\nbrick,MIT\nTwo_Boxes,MIT\n")
    return released(root, "bimangrasp", source)


def again(out: Path, form: str, run: Path) -> dict[str, dict[str, np.ndarray]]:
    """Rows of an export after importing it, by the id they had; hands relative to its files."""
    import_run(ImportRequest(format=form, path=out, hand="capsule"), run, execution=HERE)
    rows = {}
    for batch in (opened := Run.open(run)).batches():
        known = opened.load_solid(str(batch["object_id"][0])).provenance
        scale = batch["size"].astype(float) / known["unit_in_file"]
        shift = scale[:, None] * np.array(known["origin_in_file"])
        for i, ref in enumerate(batch["source_ref"].tolist()):
            rows[Path(ref).stem] = {
                "hand_pos": batch["hand_pos"][i] + shift[i],
                **{n: batch[n][i] for n in ("hand_quat_wxyz", "joints", "size", "size_mm")},
            }
    return rows


@pytest.mark.parametrize("kind", ["dexgraspbench", "bimandexgraspbench"])
def test_exported_and_imported_again_a_grasp_is_the_same(kind, one_handed, two_handed, tmp_path):
    path = one_handed if kind == "dexgraspbench" else two_handed
    report = export_release(path, tmp_path / "out", quiet=True)
    rows = Release.open(path).grasps()
    assert report.grasps == len(rows) > 0
    assert report.skipped == {}
    found = again(tmp_path / "out", kind, tmp_path / "run")
    assert set(found) == set(rows["grasp_id"].tolist())
    for i, grasp_id in enumerate(rows["grasp_id"].tolist()):
        back = found[grasp_id]
        np.testing.assert_allclose(back["hand_pos"], rows["hand_pos"][i], atol=CLOSE)
        turned = quat_angle(
            back["hand_quat_wxyz"].astype(float), rows["hand_quat_wxyz"][i].astype(float)
        )
        assert turned.max() < 2 * CLOSE
        np.testing.assert_array_equal(back["joints"], rows["joints"][i])
        assert back["size"] == pytest.approx(rows["size"][i], rel=1e-6)
        assert back["size_mm"] == rows["size_mm"][i]


def test_files_hold_what_the_benchmark_reads_and_only_plain_values(one_handed, tmp_path):
    out = tmp_path / "out"
    export_release(one_handed, out, quiet=True)
    release = Release.open(one_handed)
    files = sorted((out / "graspdata").rglob("*.npy"))
    assert len(files) == len(release.grasps())
    for file in files:
        data = file.read_bytes()
        asked = {a for o, a, _ in pickletools.genops(data[128:]) if o.name == "GLOBAL"}
        # The names of numpy 1, which numpy 2 knows too.
        assert asked == {"numpy.core.multiarray _reconstruct", "numpy ndarray", "numpy dtype"}
        content = np.load(file, allow_pickle=True).item()
        assert set(content) == {*STAGES, "obj_pose", "obj_scale", "obj_path"}
        assert all(content[s].shape == (29,) and content[s].dtype == np.float32 for s in STAGES)
        assert content["obj_pose"].tolist() == [0, 0, 0, 1, 0, 0, 0]
        # What the benchmark computes the density from, and where it looks for pieces.
        folder = out / content["obj_path"]
        info = json.loads((folder / "info" / "simplified.json").read_text())
        volume = info["mass"] / (info["density"] * info["scale"] ** 3)
        solid = release.load_solid(folder.name)
        assert volume == pytest.approx(8 * solid.nominal_volume)
        pieces = sorted((folder / "urdf" / "meshes").glob("*.obj"))
        assert len(pieces) == len(solid.pieces)
        corners = np.concatenate([_vertices(p) for p in pieces])
        assert np.linalg.norm(np.ptp(corners, axis=0)) == pytest.approx(2, abs=1e-6)
        assert 2 * content["obj_scale"] == pytest.approx(solid_size(release, file.stem))
    with open(out / "objects" / "INDEX.csv", newline="") as stream:
        listed = {row["file"]: row for row in csv.DictReader(stream)}
    assert {r["licence"] for r in listed.values()} == {"CC0-1.0", "MIT"}


def _vertices(path: Path) -> np.ndarray:
    lines = path.read_text().splitlines()
    return np.array([[float(x) for x in line.split()[1:]] for line in lines if line[0] == "v"])


def solid_size(release: Release, grasp_id: str) -> float:
    rows = release.grasps()
    return float(rows["size"][rows["grasp_id"] == grasp_id][0])


def test_the_urdf_fixes_every_piece_to_another(one_handed, tmp_path):
    import xml.etree.ElementTree as ET

    export_release(one_handed, tmp_path / "out", quiet=True)
    for file in (tmp_path / "out" / "objects").glob("*/urdf/coacd.urdf"):
        robot = ET.parse(file).getroot()
        links = {link.get("name") for link in robot.iter("link")}
        children = [j.find("child").get("link") for j in robot.iter("joint")]
        assert len(set(children)) == len(links) - 1
        for mesh in robot.iter("mesh"):
            assert (file.parent / mesh.get("filename")).is_file()


def test_two_handed_files_name_their_numbers(two_handed, tmp_path):
    export_release(two_handed, tmp_path / "out", quiet=True)
    (first, *_) = (tmp_path / "out" / "graspdata").rglob("*.npy")
    content = np.load(first, allow_pickle=True).item()
    assert content["joint_names"] == list(TWO_HANDED)
    assert len(set(TWO_HANDED)) == 56
    assert all(content[s].shape == (56,) for s in STAGES)


def arms_model():
    """Two frames on slides and hinges, as the fork's description has them."""
    import mujoco

    bodies = []
    for side, (x, y, z) in ARM_BASE.items():
        kinds = [("slide", k) for k in range(3)] + [("hinge", k) for k in range(3)]
        open_, close = [f'<body pos="{x} {y} {z}"><geom size="0.01"/>'], ["</body>"]
        for name, (kind, axis) in zip(ARM_JOINTS[side], kinds, strict=True):
            turned = " ".join("1" if k == axis else "0" for k in range(3))
            open_.append(f'<body name="{side}{name}"><geom size="0.01"/>')
            open_.append(f'<joint name="{name}" type="{kind}" axis="{turned}"/>')
            close.append("</body>")
        bodies.append("".join(open_ + close))
    text = f"<mujoco><worldbody>{''.join(bodies)}</worldbody></mujoco>"
    return mujoco.MjModel.from_xml_string(text)


def test_slides_and_hinges_put_hands_where_they_are():
    import mujoco

    assert ARM_BASE["right"].tolist() == [0, -0.1, 0]
    assert ARM_BASE["left"].tolist() == [0, 0.1, 0]
    model = arms_model()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    quarter = np.array([np.sqrt(0.5), 0, np.sqrt(0.5), 0])  # the hinges' singular turn
    quats = np.concatenate([random_quat(rng, (20,)), [[1.0, 0, 0, 0], quarter, [0, 1.0, 0, 0]]])
    quats = np.stack([quats, quats, quats], axis=1)
    root = rng.normal(size=(*quats.shape[:2], 3))
    for side in ("left", "right"):
        values = arm_values(root, quats, side)
        back = arm_pose(values, side)
        np.testing.assert_allclose(back[0], root, atol=1e-12)
        assert quat_angle(back[1], quats).max() < 1e-7
        for n in range(len(quats)):
            for name, value in zip(ARM_JOINTS[side], values[n, 0], strict=True):
                data.qpos[model.joint(name).qposadr[0]] = value
            mujoco.mj_kinematics(model, data)
            hand = data.body(side + ARM_JOINTS[side][-1])
            np.testing.assert_allclose(hand.xpos, root[n, 0], atol=1e-12)
            turn = matrix_from_quat(quats[n, 0])
            np.testing.assert_allclose(hand.xmat.reshape(3, 3), turn, atol=1e-12)


def test_hinges_change_little_from_stage_to_stage():
    rng = np.random.default_rng(1)
    for quat in [*random_quat(rng, (200,)), np.array([0.0, 1.0, 0, 0]), np.array([0, 0, 0, 1.0])]:
        small = [np.array([1.0, *(0.004 * rng.normal(size=3))]) for _ in range(2)]
        turned = [quat_multiply(s / np.linalg.norm(s), quat) for s in small]
        stages = np.array([[turned[0], quat, turned[1]]])
        hinges = arm_values(np.zeros((1, 3, 3)), stages, "right")[0, :, 3:]
        beta = abs(np.cos(hinges[1, 1]))
        if beta > 0.2:  # near the singular turn two hinges do each other's work
            assert np.abs(np.diff(hinges, axis=0)).max() < 0.2


def test_hands_that_the_benchmark_has_not_are_refused():
    left, right = (h.header() for h in load_hands("capsule"))
    check_hands([right])
    check_hands([left, right])
    for hands in ([left], [right, left], []):
        with pytest.raises(NotUsable, match="takes the right Shadow hand, or both"):
            check_hands(hands)


def test_an_export_is_whole_or_not_there(one_handed, tmp_path, monkeypatch):
    from bidexdata.formats.exporters import dexgraspbench

    with pytest.raises(UnknownName, match="known: dexgraspbench"):
        export_release(one_handed, tmp_path / "out", format="obj", quiet=True)
    with pytest.raises(UnknownName, match="split"):
        export_release(one_handed, tmp_path / "out", split="no", quiet=True)

    def failing(*_):
        raise OSError("no space left")

    with monkeypatch.context() as patch:
        patch.setattr(dexgraspbench, "obj_text", failing)
        with pytest.raises(OSError, match="no space"):
            export_release(one_handed, tmp_path / "out", quiet=True)
    assert list(tmp_path.iterdir()) == []
    export_release(one_handed, tmp_path / "out", limit=3, quiet=True)
    assert len(list((tmp_path / "out").rglob("*.npy"))) == 3
    with pytest.raises(NotUsable, match="is there already"):
        export_release(one_handed, tmp_path / "out", quiet=True)


def test_the_command_says_what_it_wrote_and_what_comes_next(two_handed, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["export", str(two_handed), "--format", "dexgraspbench", "--out", str(out)]
    assert cli.run([*words, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["n"] == len(Release.open(two_handed).grasps())
    assert data["hands"] == ["left", "right"]
    assert data["next"] == f"bidexdata import bimandexgraspbench {out} --out RUN"
    documented = cli.COMMANDS["export"].__doc__ or ""
    assert all(key in documented for key in set(data) - {"next"})
    assert cli.run(words) == 3
    assert "is there already" in capsys.readouterr().err


def test_objects_without_meshes_cannot_be_exported(one_handed, tmp_path):
    import shutil

    copy = Path(shutil.copytree(one_handed, tmp_path / "release"))
    for file in (copy / "objects").rglob("mesh.glb"):
        file.unlink()
    with pytest.raises(NotUsable, match="has no meshes of"):
        export_release(copy, tmp_path / "out", quiet=True)
