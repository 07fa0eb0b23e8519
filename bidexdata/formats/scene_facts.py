"""What the scenes table says of a scene's physics: pose, table, mass and friction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bidexdata.frames import IDENTITY_QUAT
from bidexdata.record import GraspBatch
from bidexdata.record.batch import in_metres
from bidexdata.record.scene import SceneParts

_NAN = float("nan")


@dataclass(frozen=True, slots=True, kw_only=True)
class ScenePhysics:
    """Mass and friction of one object under one protocol."""

    volume: float
    """Volume of the solid at unit diagonal."""
    nominal_volume: float
    """Volume at unit diagonal that a fixed mass belongs to."""
    density: float = _NAN
    """[kg/m^3]."""
    fixed_mass: float | None = None
    """Mass of every object in place of a density [kg]."""
    friction: float = _NAN
    """Tangential friction of every surface [-]."""

    @classmethod
    def of(cls, row: Mapping[str, Any], protocol: Mapping[str, Any] | None) -> ScenePhysics:
        """Put together a row of the objects table and a protocol's settings, None if unknown."""
        scene = (protocol or {}).get("scene", {})
        return cls(
            volume=row["volume"],
            nominal_volume=row["nominal_volume"],
            density=scene.get("density", _NAN),
            fixed_mass=scene.get("mass"),
            friction=scene.get("friction_slide", _NAN),
        )

    def mass(self, size: float) -> float:
        """Mass of the simulated body at bounding-box diagonal `size` [m], in kg."""
        if self.fixed_mass is not None:
            return self.fixed_mass * self.volume / self.nominal_volume
        return self.density * self.volume * size**3


def scene_facts(
    named: SceneParts, rows: GraspBatch, physics: ScenePhysics | None
) -> dict[str, Any]:
    """Columns `table`, pose, `mass` and `friction` of one scene.

    Args:
        named: What its id says.
        rows: The stored rows of the scene; there may be none.
        physics: None where nothing is known.
    """
    pos, quat = _pose(rows, on_table=named.rest_pose >= 0)
    size = in_metres(rows["size"][0]) if len(rows) else named.size_mm / 1000
    return {
        "table": named.rest_pose >= 0,
        "object_pos": pos,
        "object_quat_wxyz": quat,
        "mass": _NAN if physics is None else physics.mass(size),
        "friction": _NAN if physics is None else physics.friction,
    }


def _pose(rows: GraspBatch, *, on_table: bool) -> tuple[list[float], list[float]]:
    columns = [rows["object_pos"], rows["object_quat_wxyz"]]
    if len(rows) and all(np.all(column == column[0]) for column in columns):
        return columns[0][0].tolist(), columns[1][0].tolist()
    if not len(rows) and not on_table:
        return [0.0] * 3, IDENTITY_QUAT.tolist()
    return [_NAN] * 3, [_NAN] * 4
