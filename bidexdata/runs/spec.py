"""RunSpec: what run.json says; what a run is, apart from how far it is."""

from __future__ import annotations

import dataclasses
import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from bidexdata.config import OMIT_NONE, differing_keys, fingerprint, from_plain, to_plain
from bidexdata.errors import BidexError, ConfigConflict, Contradiction, PathNotFound
from bidexdata.kinds import RUN_FILE
from bidexdata.record import HandHeader
from bidexdata.record.batch import SCHEMA_VERSION
from bidexdata.record.scene import Setting
from bidexdata.runs.plan import Round
from bidexdata.runs.shards import write_text
from bidexdata.synthesis.method_names import DEFAULT_METHOD


@dataclass(frozen=True, slots=True, kw_only=True)
class RunRig:
    """The arms that a run's grasps are made for."""

    name: str
    """Of the rig."""
    rig: str
    """What `--rig` was: a name, or the path of a spec relative to the run."""
    digest: str
    """Of the robot: the rig, its models and both hands."""
    config: Mapping[str, Any] = field(default_factory=dict)
    """Plain data of the `ArmConfig` by which reach is judged."""

    def identity(self) -> dict[str, Any]:
        """What may never change: everything but the path."""
        return {"name": self.name, "robot": self.digest, "config": to_plain(self.config)}


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSpec:
    """The contents of run.json."""

    kind: Literal["synth", "import", "release", "generated"] = "synth"
    """Where the rows come from: made here, imported from another format, a release's, or given by
    a caller (`Run.create`)."""
    method: str = ""
    """Of the synthesis; empty in imports, and in runs of earlier versions, whose method is the
    default one."""
    preset: str = ""
    config: Mapping[str, Any] = field(default_factory=dict)
    """Plain data of the method's configuration."""
    hand: str = ""
    """What `--hand` was: one name or LEFT,RIGHT; paths of specs are relative to the run."""
    hands: tuple[HandHeader, ...] = ()
    sizes_mm: tuple[int, ...] = ()
    setting: Setting = "floating"
    rest_poses: int = 0
    """Rest poses per object-size at most, the most probable first; 0 where objects float."""
    without_scene: tuple[str, ...] = ()
    """Objects that no scene could be made of: on a table, those without a rest pose."""
    source: str = ""
    """The library's (or, where the objects are a release's, the release's) path relative to the run."""
    source_fingerprint: str = ""
    seed: int = 0
    rounds: tuple[Round, ...] = ()
    """Empty for imported rows, which have no attempts."""
    versions: Mapping[str, str] = field(default_factory=dict)
    """Of the packages that started the run; information only. Each shard says its own."""
    schema_version: str = SCHEMA_VERSION
    rig: RunRig | None = field(default=None, metadata=OMIT_NONE)
    """Arms that must be able to take the grasps; none as a rule."""

    @property
    def of_release(self) -> bool:
        """Whether the objects are a release's, and not a library's."""
        made = self.kind == "generated" and self.config.get("objects") == "release"
        return self.kind == "release" or made

    @property
    def grasps(self) -> int | None:
        """Grasps kept per scene, all rounds together; None for imported rows."""
        return sum(r.grasps for r in self.rounds) or None

    @property
    def candidates(self) -> int | None:
        """Attempts per scene, all rounds together; None for imported rows."""
        return sum(r.candidates for r in self.rounds) or None

    def identity(self) -> dict[str, Any]:
        """What may never change in a run: everything but rounds, versions and paths."""
        poses = {"rest_poses": self.rest_poses} if self.rest_poses else {}
        # The default method is left out, so that runs keep the fingerprints they had before.
        method = {"method": self.method} if self.method not in ("", DEFAULT_METHOD) else {}
        rig = {} if self.rig is None else {"rig": self.rig.identity()}
        return {
            "kind": self.kind,
            **method,
            "config": to_plain(self.config),
            "hands": {h.side: {"name": h.name, "spec_hash": h.spec_hash} for h in self.hands},
            "sizes_mm": list(self.sizes_mm),
            "setting": self.setting,
            **poses,
            "library": {"fingerprint": self.source_fingerprint},
            "seed": self.seed,
            **rig,
        }

    @property
    def fingerprint(self) -> str:
        """Hash of `identity()`: part of every grasp_id, and carried by every shard."""
        return fingerprint(self.identity())


def grown(folder: Path, old: RunSpec, wanted: RunSpec) -> RunSpec:
    """Join what a run is with what a command asks for; only `--grasps` may grow.

    Args:
        folder: The run, for the message.
        old: The run's spec.
        wanted: The command's, with a single round.

    Returns:
        The old spec, with one more round where more grasps are asked for.

    Raises:
        ConfigConflict: Another configuration, or fewer grasps; names the keys.
    """
    was, asked = old.method or DEFAULT_METHOD, wanted.method or DEFAULT_METHOD
    if was != asked:
        # Methods have configurations of their own, whose keys say nothing about each other.
        raise ConfigConflict(folder, [f"method: {was!r} -> {asked!r}"])
    differing = _readable(differing_keys(old.identity(), wanted.identity()))
    if old.preset and old.preset != wanted.preset:
        # One word says more than the dozens of keys that follow from it.
        own = [text for text in differing if not text.startswith("config.")]
        if len(own) < len(differing):
            differing = [f"preset: {old.preset!r} -> {wanted.preset!r}", *own]
    was, asked = (spec.rig.name if spec.rig else "" for spec in (old, wanted))
    if was != asked:
        differing = [text for text in differing if not text.startswith("rig")]
        differing.append(f"rig: {was!r} -> {asked!r}")
    grasps, candidates = wanted.grasps or 0, wanted.candidates or 0
    had_grasps, had_candidates = old.grasps or 0, old.candidates or 0
    if grasps < had_grasps:
        differing.append(f"grasps: {had_grasps!r} -> {grasps!r} (it may only grow)")
    elif grasps == had_grasps and candidates != had_candidates:
        differing.append(f"candidates: {had_candidates!r} -> {candidates!r}")
    elif grasps > had_grasps and candidates - had_candidates < grasps - had_grasps:
        differing.append(
            f"candidates: {had_candidates!r} -> {candidates!r} (each new grasp needs an attempt)"
        )
    if differing:
        raise ConfigConflict(folder, differing)
    if grasps == had_grasps:
        return old
    extra = Round(grasps - had_grasps, candidates - had_candidates, had_candidates)
    return dataclasses.replace(old, rounds=(*old.rounds, extra))


def _readable(differing: list[str]) -> list[str]:
    """Shorten long values, such as hashes, and name another hand before what follows from it."""
    short = [re.sub(r"'([^']{12})[^']{13,}'", r"'\1…'", text) for text in differing]
    return sorted(short, key=lambda text: re.match(r"hands\.\w+\.name: ", text) is None)


def write_spec(folder: Path, spec: RunSpec) -> None:
    """Write run.json, atomically."""
    data = {**to_plain(spec), "fingerprint": spec.fingerprint}
    write_text(folder / RUN_FILE, json.dumps(data, indent=1, sort_keys=True) + "\n")


def read_spec(folder: Path) -> RunSpec:
    """Read run.json; keys of a newer minor version are ignored.

    Raises:
        PathNotFound: `folder` is no run.
        Contradiction: The file is damaged or its schema is newer.
    """
    path = folder / RUN_FILE
    if not path.is_file():
        raise PathNotFound(path, "a run made by `bidexdata synth`")
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        version = str(data["schema_version"])
        stated = data["fingerprint"]
    except (ValueError, KeyError, TypeError) as err:
        raise Contradiction(f"{path}: not a readable run header ({err})") from err
    if version.split(".", maxsplit=1)[0] != SCHEMA_VERSION.split(".", maxsplit=1)[0]:
        raise Contradiction(
            f"{path}: made with schema {version}, and this version reads {SCHEMA_VERSION}; "
            "upgrade bidexdata to read it"
        )
    known = {f.name for f in dataclasses.fields(RunSpec)}
    try:
        spec = from_plain(RunSpec, {k: v for k, v in data.items() if k in known}, "")
    except BidexError as err:
        raise Contradiction(f"{path}: damaged run header ({err})") from err
    if spec.fingerprint != stated:
        raise Contradiction(f"{path}: its content does not match its fingerprint; was it edited?")
    return spec


def relative_to_run(path: Path, folder: Path) -> str:
    """Path as run.json stores it, so that library and run can move together."""
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()


def portable_hand(hand: str, folder: Path) -> str:
    """What `--hand` was, with paths of specs relative to the run."""
    names = [n.strip() for n in hand.split(",")]
    is_file = [n.endswith((".yaml", ".yml")) for n in names]
    return ",".join(
        relative_to_run(Path(n), folder) if file else n
        for n, file in zip(names, is_file, strict=True)
    )
