"""The rig of a release: `rigs/<name>/{rig.json, LICENSE}`.

`rig.json` holds what the arm solutions were made with (the rig's spec, the configuration, the digest
of the robot) and, per side, the serial chain from the world to the hand frame: enough to place the
hands from the stored angles without MuJoCo or the arms' models.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from bidexdata.config import canonical_json
from bidexdata.errors import Contradiction
from bidexdata.record.batch import ArmHeader

if TYPE_CHECKING:
    from bidexdata.arms.robot import Robot

RIGS = "rigs"
_OF_CHAIN = (
    *("joint_names", "before_pos", "before_rot", "axis", "lower", "upper", "velocity"),
    *("end_pos", "end_rot", "wrist"),
)
"""What `rig.json` says of a chain; see `arms.chain.Chain`."""


@dataclass(frozen=True, slots=True)
class ReleaseRig:
    """What a release says of the arms of its rows."""

    arms: tuple[ArmHeader, ...]
    """For the header of its tables, left first."""
    document: Mapping[str, Any]
    """The content of rig.json, plain data."""
    licence_text: str
    """That came with the arms' models."""

    @property
    def name(self) -> str:
        """Of the rig."""
        return self.arms[0].rig


def release_rig(
    robot: Robot, arms: tuple[ArmHeader, ...], spec: Mapping[str, Any], config: Mapping[str, Any]
) -> ReleaseRig:
    """Describe the rig of some arm solutions.

    Args:
        robot: The rig with the hands.
        arms: Headers of the solutions.
        spec: Plain data of the rig's spec.
        config: Plain data of the `ArmConfig`.
    """
    chains = {
        arm.side: {name: _plain(getattr(arm.chain, name)) for name in _OF_CHAIN}
        for arm in robot.arms
    }
    models = {arm.side: {"licence": arm.model.spec.licence, "sha256": arm.model.digest}
              for arm in robot.arms}  # fmt: skip
    document = {
        "name": arms[0].rig,
        "digest": robot.digest,
        "spec": dict(spec),
        "config": dict(config),
        "models": models,
        "chains": chains,
    }
    texts = dict.fromkeys(arm.model.licence_text for arm in robot.arms if arm.model.licence_text)
    return ReleaseRig(arms, document, "\n".join(texts))


def write_rig(root: Path, rig: ReleaseRig) -> None:
    """Write the files of a rig under the release folder `root`."""
    folder = root / RIGS / rig.name
    folder.mkdir(parents=True)
    (folder / "rig.json").write_text(canonical_json(dict(rig.document)) + "\n", encoding="utf-8")
    if rig.licence_text:
        (folder / "LICENSE").write_text(rig.licence_text, encoding="utf-8")


def read_rig_files(root: Path, arms: tuple[ArmHeader, ...]) -> ReleaseRig:
    """Read what `write_rig` wrote.

    Args:
        root: Release folder.
        arms: Of the release's header.

    Raises:
        Contradiction: A file is missing or unreadable.
    """
    folder = root / RIGS / arms[0].rig
    try:
        document = json.loads((folder / "rig.json").read_text(encoding="utf-8"))
        licence = folder / "LICENSE"
        text = licence.read_text(encoding="utf-8") if licence.is_file() else ""
    except (OSError, ValueError) as err:
        raise Contradiction(f"{folder}: unreadable rig ({err})") from err
    return ReleaseRig(arms, document, text)


def hand_poses(
    chain: Mapping[str, Any], q: Float[np.ndarray, "N A"]
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3 3"]]:
    """Origins [m] and axes of the hand frame in the world, from a chain of `rig.json` alone.

    Written here, apart from `arms.chain`, so that checking a release does not lean on the code that
    made it.

    Args:
        chain: Of one side.
        q: Angles of arm and wrist [rad].
    """
    n = len(q)
    pos, rot = np.zeros((n, 3)), np.broadcast_to(np.eye(3), (n, 3, 3))
    for k, axis in enumerate(np.asarray(chain["axis"], np.float64)):
        pos = pos + rot @ np.asarray(chain["before_pos"][k], np.float64)
        rot = rot @ np.asarray(chain["before_rot"][k], np.float64) @ _about(axis, q[:, k])
    return pos + rot @ np.asarray(chain["end_pos"]), rot @ np.asarray(chain["end_rot"])


def _about(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    # Rodrigues' formula, (N, 3, 3).
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.eye(3) + s * cross + (1 - c) * (cross @ cross)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    return list(value) if isinstance(value, tuple) else value
