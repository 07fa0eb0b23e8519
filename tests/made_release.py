"""Small hand-made objects, grasps and releases for tests of formats, loaders, viewer and CLI.

Objects are boxes and a tetrahedron; grasps have random joints inside the limits and random poses,
and contact points that lie exactly where forward kinematics puts the pads, so that every law of
`verify --full` holds. The made hands are unknown to the registry: pass `hands=load_hands("capsule")`
where a viewer or simulator must find them.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from made_arms import led_poses, made_motions, made_rig, with_motions

from bidexdata import frames
from bidexdata.formats import parquet
from bidexdata.formats.hand_files import contact_centres, tree_of
from bidexdata.formats.manifest import write_manifest
from bidexdata.formats.rows import ReleaseRows, RunInfo
from bidexdata.formats.writer import write_release
from bidexdata.hands.model import Hand
from bidexdata.objects.prepared import PreparedObject, SignedDistanceGrid, TriangleMesh
from bidexdata.record import GraspBatch, Header, Status
from bidexdata.record.batch import empty_columns
from bidexdata.record.fields import ADDED_IN, columns_written_by

OBJECTS = ("box-aaaaaaaa", "flat-bbbbbbbb", "tetra-cccccccc")
PAPER_F, PAPER_A = ("paper-1", "f"), ("paper-1", "a")
SIZES = (300, 500)
PER_SCENE = 4
_FACES = np.array(
    [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4], [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]],
    np.int32,
)  # fmt: skip


def made_object(object_id: str) -> PreparedObject:
    if object_id.startswith("tetra"):
        corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]])
        faces = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]], np.int32)
    else:
        half = np.array([1, 0.8, 0.6] if object_id.startswith("box") else [1, 0.9, 0.2])
        corners = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]) * half
        faces = _FACES
    vertices = corners / np.linalg.norm(np.ptp(corners, axis=0))
    # Stored as float32: keep what a reader gets back.
    mesh = TriangleMesh(vertices.astype(np.float32).astype(np.float64), faces)
    v = mesh.vertices[faces]
    volume = float(np.einsum("ni,ni->n", v[:, 0], np.cross(v[:, 1], v[:, 2])).sum() / 6)
    grid = SignedDistanceGrid(np.zeros((2, 2, 2), np.float32), np.zeros(3), 1.0)
    return PreparedObject(
        object_id=object_id,
        mesh=mesh,
        pieces=(mesh,),
        volume=abs(volume),
        inertia=np.eye(3) * 0.01,
        rest_quats_wxyz=np.array([[1.0, 0, 0, 0]]),
        rest_heights=np.array([0.3]),
        rest_probabilities=np.array([1.0]),
        provenance={
            "source": "made",
            "source_name": f"{object_id}.obj",
            "licence": "CC0-1.0" if object_id.startswith("box") else "",
            "author": "nobody",
            "category": object_id.split("-", maxsplit=1)[0],
            "source_sha256": "0" * 64,
        },
        solid=mesh,
        hull=mesh,
        surface_points=mesh.vertices.astype(np.float32),
        surface_normals=np.tile(np.array([0, 0, 1], np.float32), (len(mesh.vertices), 1)),
        sdf=grid,
    )


def made_hand(side: str) -> Hand:
    """A hand of few bodies: 3 joints and 2 contacts on the left, 2 joints and 3 contacts right."""
    left = side == "left"
    bodies = ("palm", "f0", "f1", "f2")[: 4 if left else 3]
    joints = tuple(f"{side[0]}h_J{i}" for i in range(len(bodies) - 1))
    contacts = ("tip", "pad") if left else ("tip", "pad", "palm")
    B, J, C = len(bodies), len(joints), len(contacts)
    names = tuple(f"{side[0]}h_{b}" for b in bodies)
    axes = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0.6, 0.8]])[:J]
    offsets = np.array([[0, 0, 0], [0, 0.02, 0.05], [0, 0, 0.04], [0.01, 0, 0.03]])[:B]
    quats = np.tile([1.0, 0, 0, 0], (B, 1))
    quats[1] = [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]
    lower, upper = np.full(J, -0.3), np.full(J, 1.2)

    def make_spec():
        import mujoco

        spec: Any = mujoco.MjSpec()
        spec.modelname = f"made_{side}"
        spec.compiler.degree = False
        body = spec.worldbody
        for b in range(B):
            body = body.add_body(name=names[b], pos=offsets[b], quat=quats[b])
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0, 0])
            if b:
                limits = (lower[b - 1], upper[b - 1])
                body.add_joint(name=joints[b - 1], axis=axes[b - 1], range=limits)
        return spec

    return Hand(
        name="made",
        side=side,
        spec_hash=hashlib.sha256(side.encode()).hexdigest(),
        licence="Apache-2.0",
        body_names=names,
        body_parent=np.arange(-1, B - 1, dtype=np.int32),
        body_pos=offsets,
        body_quat_wxyz=quats,
        body_joint=np.arange(-1, B - 1, dtype=np.int32),
        joint_names=joints,
        joint_axis=axes,
        joint_lower=lower,
        joint_upper=upper,
        coupling=np.eye(J),
        actuator_names=joints,
        actuator_moment=np.eye(J),
        contact_names=contacts,
        contact_body=np.array([B - 1, 1, 0], np.int32)[:C],
        contact_pos=np.array([[0, 0, 0.01], [0.005, 0, 0], [0, -0.01, 0.02]])[:C],
        contact_radius=np.array([0.008, 0.007, 0.01])[:C],
        contact_normal=np.array([[0, 0, 1.0], [1.0, 0, 0], [0, -1.0, 0]])[:C],
        contact_finger=("finger",) * C,
        contact_part=("fingertip",) * C,
        fingers={"finger": names[1:]},
        sphere_body=np.zeros(1, np.int32),
        sphere_pos=np.zeros((1, 3)),
        sphere_radius=np.array([0.01]),
        self_pairs=np.zeros((0, 2), np.int32),
        T_hand_palm=np.eye(4),
        posture_open=np.zeros(J),
        posture_curved=np.full(J, 0.4),
        make_spec=make_spec,
    )


def made_hands() -> tuple[Hand, Hand]:
    return made_hand("left"), made_hand("right")


def made_rows(
    object_id: str,
    *,
    hands: Sequence[Hand] | None = None,
    sizes=SIZES,
    exact: Sequence[float] | None = None,
    setting: str = "floating",
    run: str = "run",
    seed: int = 0,
    tested: bool = True,
    arms: bool = False,
) -> ReleaseRows:
    """`PER_SCENE` selected and as many audit rows per size (one row is both), with verdicts.

    With `arms` the motions of `made_arms` lead the hands.
    """
    pair = hands or made_hands()
    rng = np.random.default_rng([seed, *object_id.encode()])
    tail = "float" if setting == "floating" else "table0"
    scenes = [f"{object_id}/{mm}/{tail}" for mm in sizes]
    per = 2 * PER_SCENE - 1
    n = per * len(sizes)
    header = Header(
        tuple(h.header() for h in pair),
        {"synth": "f" * 16},
        "0.1.0",
        {scene: {"ok": 3 * PER_SCENE, "no_placement": PER_SCENE} for scene in scenes},
    )
    c = empty_columns(header, columns_written_by("synth"), n)
    c["grasp_id"] = np.array([f"{v:016x}" for v in rng.integers(0, 2**63, n)])
    c["scene_id"] = np.repeat(scenes, per)
    c["object_id"] = np.full(n, object_id)
    c["size_mm"][:] = np.repeat(sizes, per)
    c["size"][:] = np.repeat(exact or [mm / 1000 for mm in sizes], per)
    c["setting"] = np.full(n, setting)
    c["attempt"][:] = np.tile(np.arange(per), len(sizes))
    c["sides"][:] = [("left", "right").index(h.side) for h in pair]
    rank = np.tile(np.arange(per), len(sizes))
    c["selected"][:] = rank < PER_SCENE
    c["audit"][:] = rank >= PER_SCENE - 1
    c["steps"][:], c["seed"][:] = 100, 7
    ok = rank < per - 1  # the last audit row of each scene found no placement
    c["synth_status"][:] = np.where(ok, Status.OK, Status.NO_PLACEMENT)
    motions = made_motions(header, ok, np.random.default_rng(seed)) if arms else {}
    _fill_poses(c, pair, rng, ok, setting, led_poses(motions) if arms else None)
    for name in ("energy_qp", "region_score", "qp_residual", "energy_distance"):
        c[name][ok] = rng.random(ok.sum())
    c["energy_distance"] *= 1e-5  # the pads are made to lie on their points
    batch = GraspBatch(header, c)
    verdicts = {PAPER_F: made_verdicts(batch, rng)} if tested else {}
    if arms:
        batch = with_motions(batch, motions)
        verdicts |= {PAPER_A: made_verdicts(batch, rng)} if tested else {}
    return ReleaseRows(run, batch, verdicts, motions)


def made_verdicts(batch: GraspBatch, rng: np.random.Generator) -> dict[str, np.ndarray]:
    n = len(batch)
    ok = batch["synth_status"] == Status.OK
    v = empty_columns(batch.header, columns_written_by("validate"), n)
    v["success"][:] = ok & (rng.random(n) < 0.8)
    v["verdict_status"][:] = np.where(~ok, Status.NOT_RUN, np.where(v["success"], 0, Status.SLIP))
    for name in ("pd", "spd", "cdc", "contact_distance", "drift_pos", "drift_rot"):
        v[name][ok] = rng.random(ok.sum()) * 0.01
    v["contact_number"][ok] = 8
    return v


def made_release(out: Path, object_ids=OBJECTS, *, runs=None, **options) -> Path:
    """Write a release of made rows; `rows` options go to `made_rows`."""
    rows = {
        k: options.pop(k)
        for k in ("sizes", "exact", "setting", "seed", "tested", "hands", "arms")
        if k in options
    }
    if rows.get("arms"):
        rows.setdefault("setting", "tabletop")
        options = {"rig": made_rig(), "tests": [PAPER_F, PAPER_A], **options}
    options = {"name": "made", "version": "1.0.0", "cloud_points": 1024, **options}
    options.setdefault("rows_of", lambda object_id: [made_rows(object_id, **rows)])
    write_release(
        out,
        object_ids=object_ids,
        load_object=options.pop("load_object", made_object),
        hands=rows.get("hands") or made_hands(),
        runs=runs or [RunInfo("run", "f" * 16, PER_SCENE, 4 * PER_SCENE, config={"a": 1})],
        **{"tests": [PAPER_F], **options},
    )
    return out


def made_lifted(out: Path) -> Path:
    """Write a release of tabletop rows that test l alone judged."""

    def lifted(object_id: str) -> list[ReleaseRows]:
        rows = made_rows(object_id, setting="tabletop")
        return [replace(rows, verdicts={("paper-1", "l"): rows.verdicts[PAPER_F]})]

    return made_release(out, rows_of=lifted, tests=[("paper-1", "l")])


def _fill_poses(c, pair, rng, ok, setting, led=None) -> None:
    n, k = len(ok), int(ok.sum())
    object_quat, object_pos = np.tile(frames.IDENTITY_QUAT, (n, 1)), np.zeros((n, 3))
    if setting == "tabletop":
        object_quat = frames.quat_canonical(frames.random_quat(rng, (n,)))
        object_pos[:, 2] = 0.2
    c["object_quat_wxyz"][:], c["object_pos"][:] = object_quat, object_pos
    c["hand_pos"][ok] = rng.normal(size=(k, len(pair), 3, 3)) * 0.2
    c["hand_quat_wxyz"][ok] = frames.random_quat(rng, (k, len(pair), 3))
    if led is not None:
        rows, c["hand_pos"][led[0]], c["hand_quat_wxyz"][led[0]] = led
        assert ok[rows].all()
    for h, hand in enumerate(pair):
        J, C = len(hand.joint_names), len(hand.contact_names)
        span = hand.joint_upper - hand.joint_lower
        c["joints"][ok, h, :, :J] = hand.joint_lower + span * rng.random((k, 3, J))
        tree = tree_of(hand)
        local = contact_centres(tree, c["joints"][ok, h, 1])
        R = frames.matrix_from_quat(c["hand_quat_wxyz"][ok, h, 1])
        world = local @ np.swapaxes(R, 1, 2) + c["hand_pos"][ok, h, 1].astype(float)[:, None]
        R_world_object = frames.matrix_from_quat(object_quat[ok])
        centre = (world - object_pos[ok][:, None]) @ R_world_object
        normal = rng.normal(size=centre.shape)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        c["contact_index"][ok, h, :C] = np.arange(C)
        c["contact_normal"][ok, h, :C] = normal
        c["contact_point"][ok, h, :C] = centre - hand.contact_radius[:, None] * normal
        c["contact_force"][ok, h, :C] = -normal
        c["force_scale"][ok, h] = 2.0


def as_schema_1_0(root: Path) -> None:
    """Make of a release what version 1.0 of the schema would have written: without the columns that came later."""

    def older(text: str | bytes) -> str:
        return json.dumps({**json.loads(text), "schema_version": "1.0"})

    for path in sorted(root.glob("*/**/*.parquet")):
        table = parquet.read_table(path)
        table = table.drop_columns([n for n in ADDED_IN if n in table.column_names])
        metadata = table.schema.metadata
        metadata[b"bidexdata"] = older(metadata[b"bidexdata"]).encode()
        parquet.write_table(path, table.replace_schema_metadata(metadata))
    for later in (root / "grasps.h5", root / "statistics.json", *root.glob("hands/*/golden.json")):
        later.unlink()
    head = json.loads((root / "manifest.json").read_text())
    files, content = head.pop("files"), head.pop("content_hash")
    assert files
    assert content
    write_manifest(root, {**head, "schema_version": "1.0", "header": older(head["header"])})
