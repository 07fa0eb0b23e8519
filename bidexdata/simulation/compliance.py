"""How far a welded hand gives way under a load: the static stiffness of MuJoCo's soft weld.

A weld is a soft constraint: its force is a spring's whose stiffness follows from its solver
parameters and from the inertia of what it holds.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

from bidexdata.simulation.scene import build_scene
from bidexdata.simulation.settings import SceneSettings

if TYPE_CHECKING:
    from bidexdata.hands.model import Hand


class WeldStiffness(NamedTuple):
    """Of one hand's weld, once it is displaced by more than the width of its impedance, 1 mm."""

    shift: float
    """[N/m]."""
    turn: float
    """[N m/rad]."""


@lru_cache(maxsize=32)
def weld_stiffness(hand: Hand) -> WeldStiffness:
    """Stiffness of the weld that carries a hand under `paper-1`.

    Args:
        hand: Any side; two views of one hand are different hands here, so pass the hand itself.

    Source:
        MuJoCo, computation of constraint forces: at rest (1 - d) / d A f = d k r, with k =
        1 / (dmax^2 timeconst^2 dampratio^2) and A the inverse inertia at the constraint; a weld
        measures turns by half of the angle.
    """
    settings = SceneSettings()
    scene = build_scene((hand,), None, 1.0, settings)
    root = int(scene.model.jnt_bodyid[scene.model.dof_jntid[scene.root_qvel[0]]])
    inverse_mass, inverse_inertia = scene.model.body_invweight0[root]
    time, damping = settings.weld_solref
    d = settings.weld_solimp[1]
    rate = d**2 / (1 - d) / (d * time * damping) ** 2
    turn = (0.5 * settings.weld_torque_scale) ** 2 * rate / inverse_inertia
    return WeldStiffness(float(rate / inverse_mass), float(turn))
