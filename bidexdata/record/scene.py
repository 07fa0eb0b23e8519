"""Scene: one object at one size in one pose and setting."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from bidexdata.errors import UnknownChoice

Setting = Literal["floating", "tabletop"]


def setting_of(text: str) -> Setting:
    """Read a setting.

    Raises:
        UnknownChoice: There is none of this name.
    """
    for known in get_args(Setting):
        if text == known:
            return known
    raise UnknownChoice("--setting", text, get_args(Setting))


@dataclass(frozen=True, slots=True)
class Scene:
    """Where an object is while it is grasped.

    A floating object has the identity pose. On a table the surface is z = 0 and the object frame's
    origin lies at x = y = 0.
    """

    object_id: str
    size_mm: int
    """Bounding-box diagonal of the simulated solid in the object frame [mm]."""
    setting: Setting = "floating"
    rest_pose: int = -1
    """Number of the object's rest pose on a table; -1 when floating."""
    object_pos: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Origin of the object frame in the world [m]."""
    object_quat_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

    @property
    def size(self) -> float:
        """Bounding-box diagonal [m]."""
        return self.size_mm / 1000

    @property
    def scene_id(self) -> str:
        """`<object_id>/<size_mm>/float` or `<object_id>/<size_mm>/table<k>`."""
        tail = "float" if self.setting == "floating" else f"table{self.rest_pose}"
        return f"{self.object_id}/{self.size_mm}/{tail}"
