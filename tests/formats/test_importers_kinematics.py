"""Fingertips after an import are where the source's own model has them, through MuJoCo on their XML."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from bidexdata.formats.importers import load_format
from bidexdata.formats.importers.named_qpos import THEIR_JOINTS
from bidexdata.formats.importers.rows import record_rows
from bidexdata.frames import matrix_from_quat, quat_rotate
from bidexdata.hands import load_hand
from bidexdata.hands.kinematics import forward_kinematics
from bidexdata.objects.prepared import Solid, TriangleMesh
from bidexdata.record import Status

FINGERS = ("ff", "mf", "rf", "lf", "th")
TIP = np.array([0.0, 0.0, 0.02])
"""A point near the fingertip in the frame of a distal link [m], the same in all descriptions."""
SAME_HAND, OTHER_HAND = 1e-5, 2e-3
"""Bounds [m]: the same links and float32; links that differ by up to 1.8 mm, see their READMEs."""
ORIGIN, UNIT = np.array([0.3, -0.2, 0.1]), 2.0
"""Of a made object in the file's frame: the importers must move what they read to it."""


def bare_model(path):
    """MuJoCo's model of a description, without the meshes that are not there."""
    import mujoco

    root = ET.fromstring(path.read_text())
    for parent in list(root.iter()):
        for child in list(parent):
            drawn = child.tag == "geom" and (child.get("mesh") or child.get("type") == "mesh")
            classed = child.tag == "geom" and "visual" in (child.get("class") or "")
            if (
                drawn
                or classed
                or child.tag in ("mesh", "texture", "material", "size", "contact")
                or child.tag in ("sensor", "actuator", "tendon", "equality", "option", "visual")
            ):
                parent.remove(child)
            child.attrib.pop("material", None)
            child.attrib.pop("user", None)
    return mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))


def model_tips(model, root, place, turn, joints):
    """Fingertips in the file's frame, with the body `root` at a pose, by MuJoCo."""
    import mujoco

    data = mujoco.MjData(model)
    for name, value in joints.items():
        data.qpos[model.joint(name).qposadr[0]] = value
    mujoco.mj_kinematics(model, data)
    base = data.body(root)
    back = base.xmat.reshape(3, 3).T
    prefix = re.sub("palm|root", "", root)
    tips = []
    for finger in FINGERS:
        link = data.body(f"{prefix}{finger}distal")
        local = back @ (link.xpos + link.xmat.reshape(3, 3) @ TIP - base.xpos)
        tips.append(turn @ local + place)
    return np.array(tips)


def our_tips(batch, h, hand, stage=1):
    """Fingertips of the rows in the frame of the object's own files, by our kinematics."""
    pos, rot = forward_kinematics(hand, batch["joints"][:, h, stage].astype(float))
    bodies = [hand.plain_body_names.index(f"{f}distal") for f in FINGERS]
    local = pos[:, bodies] + rot[:, bodies] @ TIP
    turn = matrix_from_quat(batch["hand_quat_wxyz"][:, h, stage].astype(float))
    world = np.einsum("nij,nfj->nfi", turn, local) + batch["hand_pos"][:, h, stage][:, None]
    scale = batch["size"].astype(float) / UNIT
    return world + scale[:, None, None] * ORIGIN


def made_solid():
    nothing = np.zeros(0)
    mesh = TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    return Solid(
        object_id="a-00000000",
        mesh=mesh,
        pieces=(mesh,),
        volume=1.0,
        inertia=np.eye(3),
        rest_quats_wxyz=np.zeros((0, 4)),
        rest_heights=nothing,
        rest_probabilities=nothing,
        provenance={"origin_in_file": ORIGIN.tolist(), "unit_in_file": UNIT},
    )


def rows_of(form, grasps, hands):
    return record_rows(
        [("a", grasps)],
        made_solid(),
        hands,
        form,
        setting="floating",
        run_fingerprint="run",
        fingerprints={"run": "run"},
        version="0",
    )


def fixed_xyz(qpos):
    from scipy.spatial.transform import Rotation

    angles = [qpos[n] for n in ("WRJRx", "WRJRy", "WRJRz")]
    return Rotation.from_euler("xyz", angles).as_matrix()  # lower case: about fixed axes


@pytest.fixture(scope="module")
def peers(shared):
    return shared / "peers"


@pytest.fixture(scope="module")
def hands(menagerie):
    return load_hand("shadow", "left"), load_hand("shadow", "right")


def named_tips(model, qpos):
    place = np.array([qpos[n] for n in ("WRJTx", "WRJTy", "WRJTz")])
    joints = {n: qpos[n] for n in THEIR_JOINTS}
    return model_tips(model, "robot0:palm", place, fixed_xyz(qpos), joints)


@pytest.mark.parametrize(
    "name",
    [
        "core-mug-8570d9a8d24cb0acbebd3c0c0c70fb03",
        "ddg-gd_banana_poisson_002",
        "sem-Camera-7bff4fd4dc53de7496dece3f86cb5dd5",
    ],
)
def test_dexgraspnet_fingertips_stay(peers, hands, name):
    form = load_format("dexgraspnet")
    data = (peers / "dexgraspnet" / f"{name}.npy").read_bytes()
    grasps = form.read(data, f"{name}.npy")
    assert not grasps.left_out
    batch = rows_of(form, grasps, (hands[1],))
    model = bare_model(peers / "dexgraspnet" / "hand" / "shadow_hand_wrist_free.xml")
    theirs = np.load(peers / "dexgraspnet" / f"{name}.npy", allow_pickle=True)
    assert len(theirs) == len(batch)
    possible = batch["synth_status"] == Status.OK
    assert 0.75 < possible.mean() < 1
    found = np.array([named_tips(model, theirs[i]["qpos"]) for i in np.flatnonzero(possible)])
    ours = our_tips(batch.select(possible), 0, hands[1])
    assert np.linalg.norm(ours - found, axis=-1).max() < OTHER_HAND


def test_bimangrasp_fingertips_of_both_hands_stay(peers, hands):
    form = load_format("bimangrasp")
    (path,) = (peers / "bimangrasp").glob("*.npy")
    batch = rows_of(form, form.read(path.read_bytes(), path.name), hands)
    theirs = np.load(path, allow_pickle=True)
    possible = batch["synth_status"] == Status.OK
    # Joints of 0 and 6 are off by many turns; four others by 0.02 to 0.7 rad.
    assert np.flatnonzero(possible).tolist() == [4, 5]
    for h, side in enumerate(("left", "right")):
        model = bare_model(peers / "bimangrasp" / "hand" / f"{side}_shadow_hand.xml")
        found = np.array(
            [named_tips(model, theirs[i][f"qpos_{side}"]) for i in np.flatnonzero(possible)]
        )
        ours = our_tips(batch.select(possible), h, hands[h])
        assert np.linalg.norm(ours - found, axis=-1).max() < OTHER_HAND


def test_bimangrasp_fingertips_stay_whatever_our_limits(peers, hands):
    """All eight grasps, by the adapter alone: poses and joints before the range is looked at."""
    form = load_format("bimangrasp")
    (path,) = (peers / "bimangrasp").glob("*.npy")
    grasps = form.read(path.read_bytes(), path.name)
    theirs = np.load(path, allow_pickle=True)
    for h, side in enumerate(("left", "right")):
        model = bare_model(peers / "bimangrasp" / "hand" / f"{side}_shadow_hand.xml")
        order = [form.joint_names[h].index(n) for n in hands[h].joint_names]
        pos, rot = forward_kinematics(hands[h], grasps.joints[h][:, 0][:, order])
        bodies = [hands[h].plain_body_names.index(f"{f}distal") for f in FINGERS]
        local = pos[:, bodies] + rot[:, bodies] @ TIP
        turn = matrix_from_quat(grasps.hand_quat_wxyz[:, h, 0])
        ours = np.einsum("nij,nfj->nfi", turn, local) + grasps.hand_pos[:, h]
        found = np.array([named_tips(model, g[f"qpos_{side}"]) for g in theirs])
        assert np.linalg.norm(ours - found, axis=-1).max() < OTHER_HAND


def test_dexgraspbench_fingertips_stay_at_every_stage(peers, hands):
    form = load_format("dexgraspbench")
    model = bare_model(peers / "dexgraspbench" / "hand" / "right_hand.xml")
    names = form.joint_names[0]
    for file in form.files(peers / "dexgraspbench")[::16]:
        data = (peers / "dexgraspbench" / file).read_bytes()
        batch = rows_of(form, form.read(data, file), (hands[1],))
        content = np.load(peers / "dexgraspbench" / file, allow_pickle=True).item()
        for stage, key in enumerate(("pregrasp_qpos", "grasp_qpos", "squeeze_qpos")):
            qpos = content[key].astype(float)
            quat = qpos[3:7] / np.linalg.norm(qpos[3:7])
            # The root of its hand is the world body of its file, and the palm lies above it.
            root = qpos[:3]
            tips = model_tips(
                model, "rh_palm", np.zeros(3), np.eye(3), dict(zip(names, qpos[7:], strict=True))
            )
            palm = model.body("rh_palm").pos
            found = quat_rotate(quat, tips + palm) + root
            ours = our_tips(batch, 0, hands[1], stage)[0]
            assert np.linalg.norm(ours - found, axis=-1).max() < SAME_HAND


def test_joints_turned_the_other_way_are_seen(peers, hands):
    """The bounds are narrow enough: with any one sense reversed some fingertip is off."""
    from bidexdata.formats.importers.named_qpos import FINGERS as THEIRS
    from bidexdata.formats.importers.named_qpos import RIGHT_SIGNS, palms

    name = "core-mug-8570d9a8d24cb0acbebd3c0c0c70fb03"
    theirs = np.load(peers / "dexgraspnet" / f"{name}.npy", allow_pickle=True)[:60]
    model = bare_model(peers / "dexgraspnet" / "hand" / "shadow_hand_wrist_free.xml")
    found = np.array([named_tips(model, g["qpos"]) for g in theirs])
    hand = hands[1]
    order = [load_format("dexgraspnet").joint_names[0].index(n) for n in hand.joint_names]
    bodies = [hand.plain_body_names.index(f"{f}distal") for f in FINGERS]
    flip = {"+": "-", "-": "+"}
    for finger, count in THEIRS.items():
        for j in range(count):
            sign = RIGHT_SIGNS[finger]
            signs = RIGHT_SIGNS | {finger: sign[:j] + flip[sign[j]] + sign[j + 1 :]}
            read = palms([g["qpos"] for g in theirs], signs)
            pos, rot = forward_kinematics(hand, read.joints[:, order])
            local = pos[:, bodies] + rot[:, bodies] @ TIP
            turn = matrix_from_quat(read.quat_wxyz)
            ours = np.einsum("nij,nfj->nfi", turn, local) + read.pos[:, None]
            assert np.linalg.norm(ours - found, axis=-1).max() > 2 * OTHER_HAND, (finger, j)
