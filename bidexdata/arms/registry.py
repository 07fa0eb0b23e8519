"""Names of rigs, and how a name or a path becomes a `Rig`."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from bidexdata.arms.source import ArmMjcf, load_arm
from bidexdata.arms.spec import RigSpec, read_rig
from bidexdata.config import named_yaml
from bidexdata.errors import BadConfig
from bidexdata.hands.model import Side

_RIGS = Path(__file__).parent / "rigs"

DEFAULT_RIG = "ur10e_post"


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """A rig with the models of its arms, without hands."""

    spec: RigSpec
    left: ArmMjcf
    right: ArmMjcf
    digest: str
    """sha256 over what the spec says and every file of the arms' models."""

    def arm(self, side: Side) -> ArmMjcf:
        """The model of one side."""
        return self.left if side == "left" else self.right


def rig_names() -> tuple[str, ...]:
    """Names of the rigs that come with the package, in alphabetical order."""
    return tuple(sorted(p.stem for p in _RIGS.glob("*.yaml")))


def rig_spec(name: str | Path) -> RigSpec:
    """Read the spec of a named rig or of a YAML file.

    Raises:
        UnknownName: No rig has this name and no file this path.
        BadConfig: The spec is not usable.
    """
    return read_rig(rig_path(str(name)))


def load_rig(name: str | Path) -> Rig:
    """Load a rig by name or by the path of a YAML spec.

    Raises:
        UnknownName: No rig has this name and no file this path.
        PathNotFound: A model is not there.
        BadConfig: The spec is not usable, or a model does not fit it.
        NotUsable: A model cannot be had.
    """
    path = rig_path(str(name))
    return _load(path, path.stat().st_mtime_ns)


def rig_path(name: str) -> Path:
    """Find the YAML file of a named rig, or of a path.

    Raises:
        UnknownName: No rig has this name and no file this path.
    """
    return named_yaml("rig", name, rig_names(), _RIGS)


@lru_cache(maxsize=8)
def _load(path: Path, modified: int) -> Rig:
    spec = read_rig(path)
    try:
        left = load_arm(spec.arm, spec, path.parent, "arm")
        right = left
        if spec.right_arm is not None:
            right = load_arm(spec.right_arm, spec, path.parent, "right_arm")
    except BadConfig as err:
        err.args = (f"rig {path.name}: {err}",)
        raise
    total = hashlib.sha256(f"{spec.content_hash()}{left.digest}{right.digest}".encode())
    return Rig(spec, left, right, total.hexdigest())
