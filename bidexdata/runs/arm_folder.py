"""What lies in a run's folder `arms`: per rig `rig.json` and shards of arm solutions.

A run may have solutions of several rigs beside each other. Verdicts of tests with arms lie in folders
that name the rig: `validate/<protocol>/a-<rig>`.
"""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import BadZipFile

import numpy as np

from bidexdata.config import differing_keys, fingerprint, from_plain, to_plain
from bidexdata.errors import (
    BadConfig,
    BidexError,
    ConfigConflict,
    Contradiction,
    NotUsable,
    PathNotFound,
)
from bidexdata.record.fields import SIDES
from bidexdata.runs.shards import write_atomically, write_text
from bidexdata.runs.spec import relative_to_run

if TYPE_CHECKING:
    from bidexdata.arms.arm_spheres import ArmSpheres
    from bidexdata.arms.robot import Robot

ARMS = "arms"
RIG_FILE = "rig.json"
SPHERES_FILE = "spheres.npz"
_SPEC_ENDINGS = (".yaml", ".yml")


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmsRecord:
    """The contents of rig.json: what the solutions in the folder were made with."""

    name: str
    """Of the rig, and of the folder."""
    rig: str
    """What `--rig` was: a name, or the path of a spec relative to the run."""
    digest: str
    """Of the robot: the rig, its models and both hands."""
    spec: Mapping[str, Any]
    """Plain data of the rig's spec."""
    config: Mapping[str, Any]
    """Plain data of the `ArmConfig`."""
    joint_names: Mapping[str, tuple[str, ...]]
    """Per side, the arm's joints and the wrist's."""
    run: str
    """Fingerprint of the run."""
    versions: Mapping[str, str] = field(default_factory=dict)
    """Of the packages that started the stage; information only."""

    @property
    def fingerprint(self) -> str:
        """Mark of the shards: run, robot and configuration."""
        return fingerprint([self.run, self.digest, to_plain(self.config)])

    def identity(self) -> dict[str, Any]:
        """What may never change among the solutions of one folder."""
        return {"spec": self.spec, "config": self.config, "robot": self.digest, "run": self.run}


def arms_folder(run: Path, rig: str) -> Path:
    """Folder of the solutions of one rig."""
    return run / ARMS / rig


def rigs_in(run: Path) -> tuple[str, ...]:
    """Names of the rigs that a run has solutions of, sorted."""
    return tuple(sorted(p.parent.name for p in (run / ARMS).glob(f"*/{RIG_FILE}")))


def chosen_rig(run: Path, preferred: str = "") -> str:
    """Say whose arms are meant in a run where nobody names a rig; empty where it has none.

    Args:
        run: The run's folder.
        preferred: The rig that it was made for.

    Raises:
        NotUsable: There are several and no saying which is meant.
    """
    rigs = rigs_in(run)
    if len(rigs) < 2:
        return next(iter(rigs), "")
    from bidexdata.arms.registry import DEFAULT_RIG

    for name in (preferred, DEFAULT_RIG):
        if name in rigs:
            return name
    raise NotUsable(
        f"{run} has arm solutions of several rigs; say which with --rig: {', '.join(rigs)}"
    )


def resolve_spec(name: str, run: Path) -> str:
    """Give what run.json or rig.json calls a hand or a rig as it can be loaded from here."""
    return str((run / name).resolve()) if name.endswith(_SPEC_ENDINGS) else name


def portable_spec(name: str, run: Path) -> str:
    """The reverse of `resolve_spec`: paths become relative to the run."""
    return relative_to_run(Path(name), run) if name.endswith(_SPEC_ENDINGS) else name


def rig_name(rig: str | Path) -> str:
    """Name of a rig that is given by its name or by the path of its spec.

    Raises:
        UnknownName: There is no such file.
        BadConfig: The file is no spec.
    """
    if not str(rig).endswith(_SPEC_ENDINGS):
        return str(rig)
    from bidexdata.arms.registry import rig_spec

    return rig_spec(rig).name


def arms_hint(run: Path, rig: str | Path) -> str:
    """How to get a run the solutions of a rig; empty where there is no such rig."""
    from bidexdata.arms.registry import rig_names

    if not str(rig).endswith(_SPEC_ENDINGS) and str(rig) not in rig_names():
        return "" if rigs_in(run) else f"`bidexdata arms {run}` makes arm solutions"
    return f"`bidexdata arms {run} --rig {rig}` makes arm solutions"


def folder_name(rig: str) -> str:
    """The rig's name, which becomes that of folders.

    Raises:
        BadConfig: It cannot be one.
    """
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]*", rig):
        raise BadConfig(
            f"RigSpec.name: {rig!r} is to be the name of a folder: use letters, digits, _ . and -"
        )
    return rig


def verdict_folder_name(test: str, rig: str) -> str:
    """Name of the folder of a test's verdicts; tests with arms name the rig."""
    return f"{test}-{rig}" if rig else test


def split_folder_name(name: str) -> tuple[str, str]:
    """Test and rig of a folder of verdicts; the rig is empty for tests without arms."""
    test, _, rig = name.partition("-")
    return test, rig


def read_record(run: Path, rig: str) -> ArmsRecord:
    """Read rig.json.

    Raises:
        PathNotFound: The run has no solutions of this rig.
        Contradiction: The file is damaged.
    """
    path = arms_folder(run, rig) / RIG_FILE
    if not path.is_file():
        raise PathNotFound(path, f"arm solutions; `bidexdata arms {run}` makes them")
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        stated = data["fingerprint"]
        known = {f.name for f in dataclasses.fields(ArmsRecord)}
        record = from_plain(ArmsRecord, {k: v for k, v in data.items() if k in known}, "")
    except (ValueError, KeyError, TypeError, BidexError) as err:
        raise Contradiction(f"{path}: damaged record of arm solutions ({err})") from err
    if record.fingerprint != stated:
        raise Contradiction(f"{path}: its content does not match its fingerprint; was it edited?")
    return record


def store_record(run: Path, record: ArmsRecord) -> None:
    """Write rig.json, or check that the one there says the same.

    Raises:
        ConfigConflict: The folder has solutions of other arms, hands or settings; names the keys.
    """
    path = arms_folder(run, record.name) / RIG_FILE
    if not path.is_file():
        data = {**to_plain(record), "fingerprint": record.fingerprint}
        write_text(path, json.dumps(data, indent=1, sort_keys=True) + "\n")
        return
    known = read_record(run, record.name)
    differing = differing_keys(known.identity(), to_plain(record.identity()))
    if differing:
        said = [text for text in differing if not text.startswith("robot")]
        raise ConfigConflict(
            path.parent,
            said or ["robot: files of the arms or the hands"],
            _advice(run, record.name),
        )


def store_spheres(run: Path, rig: str, robot: Robot) -> None:
    """Write the spheres of a robot's arms beside rig.json, so that workers need not fit them."""
    from bidexdata.arms.arm_spheres import spheres_as_arrays

    path = arms_folder(run, rig) / SPHERES_FILE
    if path.is_file():
        return
    arrays: dict[str, Any] = {
        f"{arm.side}_{name}": values
        for arm in robot.arms
        for name, values in spheres_as_arrays(arm.spheres).items()
    }

    def write(temporary: Path) -> None:
        with temporary.open("wb") as file:
            np.savez(file, digest=np.array(robot.digest), **arrays)

    write_atomically(path, write)


def known_spheres(run: Path, rig: str, digest: str) -> tuple[ArmSpheres, ArmSpheres] | None:
    """Read what `store_spheres` wrote for the robot with this digest; None where it did not."""
    from bidexdata.arms.arm_spheres import spheres_from_arrays

    try:
        with np.load(arms_folder(run, rig) / SPHERES_FILE, allow_pickle=False) as file:
            if str(file["digest"]) != digest:
                return None
            found = dict(file)
        of_side = [
            {n.removeprefix(f"{side}_"): v for n, v in found.items() if n.startswith(f"{side}_")}
            for side in SIDES
        ]
        left, right = map(spheres_from_arrays, of_side)
    except (OSError, ValueError, KeyError, BadZipFile):
        return None
    return left, right


def check_robot(run: Path, record: ArmsRecord, robot: Robot) -> None:
    """Refuse to use a robot that is not the one the solutions were made with.

    Raises:
        ConfigConflict: The rig, its models or the hands have changed.
    """
    if robot.digest != record.digest:
        change = f"{record.digest[:12]!r} -> {robot.digest[:12]!r}"
        spec: Sequence[str] = differing_keys(record.spec, to_plain(robot.rig.spec))
        keys = [f"spec.{text}" for text in spec] or [f"robot: {change}"]
        raise ConfigConflict(arms_folder(run, record.name), keys, _advice(run, record.name))


def _advice(run: Path, rig: str) -> str:
    """What to do where solutions of a rig were made with other arms or settings than now."""
    folders = [arms_folder(run, rig), *sorted(run.glob(f"validate/*/?-{rig}"))]
    named = ", ".join(map(str, folders))
    return (
        "Use the same rig and settings as before, or give `--rig` a YAML file with another `name` to have "
        f"both side by side, or remove {named} to solve anew"
    )
