"""Can the arms of a robot carry its hands and an object: rated load, and torque at rest."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bidexdata.arms.assembly import arm_spec
from bidexdata.arms.chain import chain_jacobian
from bidexdata.arms.robot import Robot
from bidexdata.errors import NotUsable
from bidexdata.hands.model import Side
from bidexdata.simulation.settings import GRAVITY

HEAVIEST = 0.25
"""Mass of a cube of 0.8 m diagonal at 2.5 kg/m^3, the largest size at the density of `paper-1`
[kg]."""


class CarryFinding(NamedTuple):
    """What one arm has to carry."""

    side: Side
    carried: float
    """Hand, adapter and half of the object [kg]."""
    payload: float
    """Rated load of the arm [kg]."""
    torque_share: float
    """Largest share of a joint's torque that gravity takes, 95 % of the postures at most [-]."""

    @property
    def fits(self) -> bool:
        """The arm may carry this."""
        return self.carried <= self.payload


class TooHeavy(NotUsable):
    """An arm cannot carry a hand with half of an object."""

    def __init__(self, robot: Robot, finding: CarryFinding):
        self.finding = finding
        hand = robot.hands[0 if finding.side == "left" else 1].name
        super().__init__(
            f"the {finding.side} arm of rig {robot.rig.spec.name!r} carries {finding.payload:g} kg, "
            f"and hand {hand} with half of the object weighs {finding.carried:.2f} kg; use a rig "
            "with stronger arms or a lighter hand"
        )


def check_payload(
    robot: Robot,
    object_mass: float = HEAVIEST,
    postures: Float[np.ndarray, "N 2 A"] | None = None,
) -> tuple[CarryFinding, ...]:
    """Weigh what each arm carries.

    Args:
        robot: The robot.
        object_mass: Of the heaviest object [kg]; each arm carries half.
        postures: Where torques are looked at [rad], NaN behind shorter chains; rest when omitted.
    """
    found = []
    for h, arm in enumerate(robot.arms):
        given = arm.chain.rest[None]
        if postures is not None:
            given = postures[:, h, : arm.chain.joints]
        share = _torque_share(robot, h, given, 0.5 * object_mass)
        load = arm.carried + 0.5 * object_mass
        found.append(CarryFinding(arm.side, load, arm.model.spec.payload, share))
    return tuple(found)


def require_payload(robot: Robot, object_mass: float = HEAVIEST) -> None:
    """Refuse hands that the arms cannot carry.

    Raises:
        TooHeavy: Names the arm and both masses.
    """
    for finding in check_payload(robot, object_mass):
        if not finding.fits:
            raise TooHeavy(robot, finding)


def _torque_share(robot: Robot, h: int, q: np.ndarray, mass: float) -> float:
    import mujoco

    arm, hand = robot.arms[h], robot.hands[h]
    model = arm_spec(robot.rig.spec, h, arm.model, hand, arm.mount).compile()
    model.opt.gravity[:] = (0, 0, -GRAVITY)
    data = mujoco.MjData(model)
    names = [model.joint(j).name.rpartition("/")[2] for j in range(model.njnt)]
    joints = [names.index(name) for name in arm.chain.joint_names]
    shares = []
    for angles in q[np.isfinite(q).all(axis=1)]:
        data.qpos[model.jnt_qposadr[joints]] = angles
        mujoco.mj_forward(model, data)
        held = GRAVITY * mass * chain_jacobian(arm.chain, angles)[2]
        torque = np.abs(data.qfrc_bias[model.jnt_dofadr[joints]] + held)
        arms = slice(arm.chain.joints - arm.chain.wrist)
        shares.append(float((torque / arm.chain.torque)[arms].max()))
    return float(np.percentile(shares, 95)) if shares else float("nan")
