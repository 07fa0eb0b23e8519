"""Poses that some model made become a run: tested, shown and packed like any other.

A run of kind `generated` holds rows whose poses a caller gives, of objects of a library or of a
release. It is written at once and never grows.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bidexdata.config import fingerprint, to_plain
from bidexdata.errors import BadConfig, NotUsable
from bidexdata.frames import quat_canonical
from bidexdata.kinds import MANIFEST, expect_kind, kind_of
from bidexdata.record import GraspBatch, Header, Status
from bidexdata.record.batch import empty_columns
from bidexdata.record.fields import SIDES
from bidexdata.record.scene import Setting, scene_parts
from bidexdata.runs.made_with import package_versions
from bidexdata.runs.plan import Task, write_plan
from bidexdata.runs.run import Run
from bidexdata.runs.run_folder import PLAN_FILE, refuse_foreign
from bidexdata.runs.shards import shard_path, write_shard
from bidexdata.runs.spec import RunSpec, portable_hand, relative_to_run, write_spec
from bidexdata.synthesis.attempts import grasp_ids

if TYPE_CHECKING:
    from bidexdata.hands.model import Hand

FOLDER = "generated"
POSES = ("object_pos", "object_quat_wxyz", "hand_pos", "hand_quat_wxyz", "joints")
GIVEN = ("scene_id", *POSES)
"""Columns that a caller gives; `size` may be given too."""
_COLUMNS = (
    *("grasp_id", "scene_id", "object_id", "size_mm", "size", "setting"),
    *("object_pos", "object_quat_wxyz", "sides", "attempt", "source_ref"),
    *("hand_pos", "hand_quat_wxyz", "joints", "selected", "audit", "synth_status"),
)
_SLACK = 1e-3
"""How far a joint may be out of its range and be set to its end [rad]. Ours: float32 and clamps."""


def write_generated(
    out: str | Path,
    rows: GraspBatch | Mapping[str, np.ndarray],
    *,
    source: str | Path,
    hand: str = "shadow",
    about: Mapping[str, Any] | None = None,
    seed: int = 0,
) -> Run:
    """Write poses as a run; what `Run.create` does.

    Args:
        out: The run's folder; must not exist, or be empty but for a library of its own.
        rows: The columns `GIVEN`, in any order of scenes; other columns are left out.
        source: Library or release that holds the objects.
        hand: Name of the hand, or LEFT,RIGHT.
        about: Plain data of what made the poses; part of the run's identity.
        seed: Seed that they were drawn with.

    Raises:
        BadConfig: A column is missing, has the wrong shape, or a pose is not finite.
        NotUsable: `out` holds something, or scenes of several settings are mixed.
        PathNotFound: There is no library or release at `source`.
        UnknownName: There is no such hand or object.
    """
    from bidexdata.hands import load_hands

    out, source = Path(out), Path(source)
    of_release = expect_kind(source, "library", "release") == "release"
    if kind_of(out) == "run":
        raise NotUsable(f"{out} is a run already; a generated run is written once: choose another")
    refuse_foreign(out, FOLDER, *_inside(out, source))
    hands = load_hands(hand)
    given = _checked(rows, hands)
    parts = [scene_parts(scene) for scene in given["scene_id"].tolist()]
    settings = {p.setting for p in parts}
    if len(settings) != 1:
        raise NotUsable(f"{out}: a run has scenes of one setting, not of {sorted(settings)}")
    _check_objects(source, {p.object_id for p in parts}, of_release=of_release)
    spec = RunSpec(
        kind="generated",
        config={
            "about": to_plain(about or {}),
            "objects": "release" if of_release else "library",
            "rows": _hash_of(given),
        },
        hand=portable_hand(hand, out),
        hands=tuple(h.header() for h in hands),
        sizes_mm=tuple(sorted({p.size_mm for p in parts})),
        setting=parts[0].setting,
        source=relative_to_run(source, out),
        source_fingerprint=_fingerprint_of(source, of_release=of_release),
        seed=seed,
        versions=package_versions(),
    )
    run = Run(out, spec)
    batch = _batch(given, hands, run)
    tasks = []
    for object_id in sorted({p.object_id for p in parts}):
        mine = batch.select(batch["object_id"] == object_id)
        scenes = tuple(dict.fromkeys(mine["scene_id"].tolist()))
        task = Task(fingerprint([object_id, scenes, 0]), object_id, scenes, 0)
        path = shard_path(run.stage_folder("rows"), task.task_id)
        write_shard(path, mine.to_arrow(), run.fingerprint)
        tasks.append(task)
    write_plan(out / PLAN_FILE, tasks)
    write_spec(out, spec)  # last: a killed start starts again
    return run


def _inside(out: Path, source: Path) -> tuple[str, ...]:
    """Name of the run's own folder that holds the objects, where they lie in the run."""
    try:
        return source.resolve().relative_to(out.resolve()).parts[:1]
    except ValueError:
        return ()


def _checked(
    rows: GraspBatch | Mapping[str, np.ndarray], hands: Sequence[Hand]
) -> dict[str, np.ndarray]:
    """The given columns with their dtypes, each of N rows."""
    columns = rows.columns if isinstance(rows, GraspBatch) else rows
    missing = [n for n in GIVEN if n not in columns]
    if missing:
        raise BadConfig(f"a generated run needs the column {missing[0]!r}: {', '.join(GIVEN)}")
    given: dict[str, np.ndarray] = {n: np.asarray(columns[n], np.float32) for n in POSES}
    given["scene_id"] = np.asarray(columns["scene_id"], np.str_)
    header = Header(hands=tuple(h.header() for h in hands))
    shapes = {n: v.shape for n, v in empty_columns(header, GIVEN, len(given["scene_id"])).items()}
    for name, shape in shapes.items():
        if given[name].shape != shape:
            raise BadConfig(f"column {name!r} must have shape {shape}, not {given[name].shape}")
    if not len(given["scene_id"]):
        raise BadConfig("a generated run needs at least one row")
    for name in POSES:
        known = np.isfinite(given[name])
        if name == "joints":
            for h, hand in enumerate(hands):
                known[:, h, :, len(hand.joint_names) :] = True  # padding
        if not known.all():
            raise BadConfig(f"column {name!r} holds a number that is not finite")
    if "size" in columns:
        given["size"] = np.asarray(columns["size"], np.float32)
    return given


def _check_objects(source: Path, object_ids: set[str], *, of_release: bool) -> None:
    from bidexdata.errors import UnknownName

    if of_release:
        from bidexdata.formats.release import Release

        release = Release.open(source)
        release.require_shapes()
        known = release.object_ids
    else:
        from bidexdata.objects.library import Library

        known = tuple(Library.open(source).object_ids)
    for object_id in sorted(object_ids - set(known)):
        raise UnknownName("object", object_id, known, f"in {source}")


def _fingerprint_of(source: Path, *, of_release: bool) -> str:
    if of_release:
        from bidexdata.formats.manifest import sha256_of

        return sha256_of(source / MANIFEST)[:16]
    from bidexdata.objects.library import Library

    return Library.open(source).fingerprint


def _hash_of(given: Mapping[str, np.ndarray]) -> str:
    """Hash of the given rows: two runs of one model have other rows, so other ids."""
    digest = hashlib.sha256()
    for name in GIVEN:
        values = given[name]
        text = "\n".join(values.tolist()) if values.dtype.kind == "U" else ""
        digest.update(text.encode() or np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()[:16]


def _batch(given: Mapping[str, np.ndarray], hands: Sequence[Hand], run: Run) -> GraspBatch:
    """Complete rows; those whose joints the hand cannot take have a status and no pose."""
    prints = {"run": run.fingerprint, "objects": run.spec.source_fingerprint}
    header = Header(
        hands=run.spec.hands, fingerprints=prints, version=package_versions()["bidexdata"]
    )
    scenes = given["scene_id"]
    parts = [scene_parts(scene) for scene in scenes.tolist()]
    made = empty_columns(header, _COLUMNS, len(scenes))
    made.update({n: given[n] for n in GIVEN})
    for name in ("object_quat_wxyz", "hand_quat_wxyz"):
        made[name] = quat_canonical(given[name].astype(np.float64)).astype(np.float32)
    made["object_id"] = np.array([p.object_id for p in parts], np.str_)
    made["size_mm"] = np.array([p.size_mm for p in parts], np.int32)
    made["size"] = given.get("size", (made["size_mm"] / 1000).astype(np.float32))
    setting: Setting = run.spec.setting
    made["setting"] = np.full(len(scenes), setting)
    made["sides"][:] = [SIDES.index(h.side) for h in hands]
    made["attempt"] = _count_within(scenes)
    pairs = zip(scenes.tolist(), made["attempt"].tolist(), strict=True)
    made["grasp_id"] = np.array([grasp_ids(run.fingerprint, s, [n])[0] for s, n in pairs], np.str_)
    joints, possible = _within_range(given["joints"], hands)
    made["joints"] = joints
    made["selected"][:], made["audit"][:] = possible, ~possible
    made["synth_status"][:] = np.where(possible, Status.OK, Status.JOINT_RANGE)
    for name in ("hand_pos", "hand_quat_wxyz", "joints"):
        made[name] = np.where(
            possible.reshape(-1, *[1] * (made[name].ndim - 1)), made[name], np.nan
        )
    return GraspBatch(header, made)


def _within_range(
    joints: NDArray[np.float32], hands: Sequence[Hand]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    out, possible = joints.copy(), np.ones(len(joints), bool)
    for h, hand in enumerate(hands):
        low, high = hand.joint_lower.astype(np.float32), hand.joint_upper.astype(np.float32)
        count = len(hand.joint_names)
        # Beyond the grasp, the targets of the squeeze may lie out of range, as synthesis has them.
        held = joints[:, h, :2, :count]
        possible &= ((held >= low - _SLACK) & (held <= high + _SLACK)).all(axis=(1, 2))
        out[:, h, :2, :count] = np.clip(held, low, high)
    return out, possible


def _count_within(names: np.ndarray) -> NDArray[np.int32]:
    """For each name how many equal ones come before it."""
    seen: dict[str, int] = {}
    counts = np.zeros(len(names), np.int32)
    for i, name in enumerate(names.tolist()):
        counts[i] = seen.get(name, 0)
        seen[name] = counts[i] + 1
    return counts
