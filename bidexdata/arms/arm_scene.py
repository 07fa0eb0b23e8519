"""ArmScene: the simulated scene of a robot, its hands, one object and the table.

Names, frames and contact numbers are those of scenes of floating hands (`simulation.scene`); what
carries the hands is two servo-controlled arms. Owners of geoms: hands and object as there; `ARM` - i
for arm i with its adapter and the forearm and wrist of its hand; `FIXTURE` for fixtures.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from bidexdata.arms.assembly import arm_prefix, fixture_name
from bidexdata.arms.robot import Robot, robot_spec
from bidexdata.engine_log import engine_warnings_logged
from bidexdata.errors import NotUsable
from bidexdata.objects.prepared import Solid
from bidexdata.simulation.assembly import (
    add_object,
    drop_pictures,
    exclude_bodies,
    hand_prefix,
)
from bidexdata.simulation.resize import COMPILED_SIZE, SizedScenes
from bidexdata.simulation.scene import (
    IntArray,
    SceneNotBuilt,
    SimScene,
    apply_settings,
    index_scene,
    require_few_pieces,
)
from bidexdata.simulation.settings import SceneSettings

if TYPE_CHECKING:
    import mujoco

FloatArray = NDArray[np.float64]

ARM = -2
"""Owner of the geoms of arm i is `ARM` - i."""
FIXTURE = ARM - 2
"""Owner of what stands still beside the arms."""
_FIXTURES_BIT = 2
"""Bit of contacts of arms and hands with fixtures, which nothing else touches."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoSettings:
    """How the arms are held up and driven; their torque limits are the rig's."""

    gravity_compensation: float = 1.0
    """Share of gravity that does not act on arms and hands [-]."""
    arm_gain: float = 1.0
    """Multiple of the stiffness of the model's servos; their damping grows with its root [-]."""
    wrist_gain: float = 1.0
    """The same for wrist joints that belong to the hand [-]."""
    servo_bound: float | None = None
    """Bound on servos by the time step, see `_bound_servos` [-]; None: as in the arm's model."""


@dataclass(frozen=True, slots=True, eq=False)
class ArmScene:
    """A compiled scene with arms; A_i joints of arm i, wrist last."""

    scene: SimScene
    """Hands, object, table; nothing in it carries the hands."""
    robot: Robot
    arm_qpos: tuple[IntArray, IntArray]
    """Addresses in qpos of each arm's joints, in the order of its chain, (A_i,)."""
    arm_qvel: tuple[IntArray, IntArray]
    """Addresses in qvel of the same."""
    arm_actuators: tuple[IntArray, IntArray]
    """Their servos."""


class SizedArmScenes:
    """Scenes of one object at any size, for distances alone; see `simulation.resize`."""

    def __init__(self, robot: Robot, solid: Solid) -> None:
        """Compile the scene, on the table.

        Raises:
            SceneNotBuilt: MuJoCo refuses the scene.
        """
        self._arms = build_arm_scene(robot, solid, COMPILED_SIZE)
        self._sized = SizedScenes(self._arms.scene)

    def at(self, size: float) -> ArmScene:
        """The scene with its object at `size` [m]; the scene given before changes with it."""
        self._sized.at(size)
        return self._arms


def build_arm_scene(
    robot: Robot,
    solid: Solid | None,
    size: float,
    settings: SceneSettings | None = None,
    servos: ServoSettings | None = None,
    *,
    table: bool = True,
) -> ArmScene:
    """Compile the scene of one object-size.

    Args:
        robot: The robot.
        solid: The object; none for the robot alone.
        size: Bounding-box diagonal of the object [m].
        settings: Numbers of the scene; those of `paper-1` when omitted.
        servos: How the arms are driven.
        table: Add the plane z = 0.

    Raises:
        SceneNotBuilt: MuJoCo refuses the scene.
        NotUsable: The settings give every joint of the hands an actuator of its own.
    """
    import mujoco

    settings, servos = settings or SceneSettings(), servos or ServoSettings()
    if settings.actuators != "hand":
        raise NotUsable("hands on arms have their own actuators: use `actuators: hand`")
    if solid is not None:
        require_few_pieces(solid)
    try:
        with engine_warnings_logged():
            spec = _spec(robot, solid, size, settings, servos, table=table)
            model = spec.compile()
    except ValueError as err:
        name = solid.object_id if solid is not None else "no object"
        reason = str(err).splitlines()[0]
        raise SceneNotBuilt(
            f"no scene can be built of rig {robot.rig.spec.name} and {name} at {size:g} m: {reason}"
        ) from err
    data = mujoco.MjData(model)
    scene = index_scene(model, data, settings, robot.hands, solid, size, floating=False)
    apply_settings(scene)
    _own_arms(scene, robot)
    arms = _index_arms(scene, robot)
    _apply_servos(arms, servos)
    return arms


def set_arms(
    arms: ArmScene,
    object_pos: Float[np.ndarray, " 3"],
    object_quat: Float[np.ndarray, " 4"],
    arm_q: Float[np.ndarray, "2 A"],
    joints: Float[np.ndarray, "2 J"],
) -> None:
    """Reset the scene completely, then place the object and the robot at rest, servos included.

    Args:
        arms: The scene; its state is overwritten, warm start of the solver included.
        object_pos: Origin of the object frame [m].
        object_quat: Its orientation.
        arm_q: Joint angles of the arms [rad]; what is behind a shorter chain does not matter.
        joints: Joint angles of the hands [rad], likewise.
    """
    import mujoco

    scene, data = arms.scene, arms.scene.data
    mujoco.mj_resetData(scene.model, data)
    if scene.object_qpos >= 0:
        a = scene.object_qpos
        data.qpos[a : a + 3], data.qpos[a + 3 : a + 7] = object_pos, object_quat
    place_joints(arms, arm_q, joints)
    command_arms(arms, arm_q)
    for i, own in enumerate(scene.joint_qpos):
        data.ctrl[scene.actuators[i]] = scene.controls(i, joints[i, : len(own)])


def place_joints(
    arms: ArmScene, arm_q: Float[np.ndarray, "2 A"], joints: Float[np.ndarray, "2 J"]
) -> None:
    """Put arms and fingers at joint angles [rad], and nothing else; as in `set_arms`."""
    qpos = arms.scene.data.qpos
    for i, address in enumerate(arms.arm_qpos):
        qpos[address] = arm_q[i, : len(address)]
        own = arms.scene.joint_qpos[i]
        qpos[own] = joints[i, : len(own)]


def command_arms(arms: ArmScene, arm_q: Float[np.ndarray, "2 A"]) -> None:
    """Set the targets of the arms' servos [rad]."""
    for i, servos in enumerate(arms.arm_actuators):
        arms.scene.data.ctrl[servos] = arm_q[i, : len(servos)]


def _spec(
    robot: Robot,
    solid: Solid | None,
    size: float,
    settings: SceneSettings,
    servos: ServoSettings,
    *,
    table: bool,
) -> mujoco.MjSpec:
    spec = _spec_of_robot(robot, settings, servos, table).copy()
    if solid is not None:
        add_object(spec, solid, size, settings.density_of(solid, size))
    return spec


@lru_cache(maxsize=4)
def _spec_of_robot(
    robot: Robot, settings: SceneSettings, servos: ServoSettings, table: bool
) -> mujoco.MjSpec:
    """What scenes of all objects have in common; takes longer to make than all the rest."""
    import mujoco

    spec = robot_spec(robot, table=table)
    # Else small robots are dense, and the noslip pass of ours is for sparse models.
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    drop_pictures(spec)
    for index, hand in enumerate(robot.hands):
        exclude_bodies(spec, hand, index, settings)
    carried = tuple(prefix(i) for i in range(2) for prefix in (arm_prefix, hand_prefix))
    for body in spec.bodies:
        if body.name.startswith(carried):
            body.gravcomp = servos.gravity_compensation
            for geom in body.geoms:
                if geom.contype or geom.conaffinity:
                    geom.contype |= _FIXTURES_BIT
    for number in range(len(robot.rig.spec.fixtures)):
        fixture = spec.geom(fixture_name(number))
        fixture.contype, fixture.conaffinity = 0, _FIXTURES_BIT
    return spec


def _own_arms(scene: SimScene, robot: Robot) -> None:
    """Give the geoms of arms and fixtures their owners."""
    model = scene.model
    bodies = [model.body(int(b)).name for b in model.geom_bodyid]
    for i in range(2):
        mine = np.array([name.startswith((arm_prefix(i), hand_prefix(i))) for name in bodies])
        scene.geom_owner[mine & (scene.geom_owner < 0)] = ARM - i
    for number in range(len(robot.rig.spec.fixtures)):
        scene.geom_owner[model.geom(fixture_name(number)).id] = FIXTURE


def _index_arms(scene: SimScene, robot: Robot) -> ArmScene:
    model = scene.model
    servo_of = {int(model.actuator_trnid[u, 0]): u for u in range(model.nu) if _on_joint(model, u)}
    qpos, qvel, servos = [], [], []
    for i, arm in enumerate(robot.arms):
        own = arm.chain.joints - arm.chain.wrist
        joints = [
            int(model.joint((arm_prefix(i) if k < own else hand_prefix(i)) + name).id)
            for k, name in enumerate(arm.chain.joint_names)
        ]
        qpos.append(model.jnt_qposadr[joints].astype(np.intp))
        qvel.append(model.jnt_dofadr[joints].astype(np.intp))
        servos.append(np.array([servo_of[j] for j in joints], np.intp))
    return ArmScene(scene, robot, (qpos[0], qpos[1]), (qvel[0], qvel[1]), (servos[0], servos[1]))


def _on_joint(model: mujoco.MjModel, actuator: int) -> bool:
    import mujoco

    return int(model.actuator_trntype[actuator]) == mujoco.mjtTrn.mjTRN_JOINT


def _apply_servos(arms: ArmScene, servos: ServoSettings) -> None:
    """Multiply the gains of the arms' position servos in the compiled model."""
    model = arms.scene.model
    for arm, actuators in zip(arms.robot.arms, arms.arm_actuators, strict=True):
        gain = np.full(len(actuators), servos.arm_gain)
        gain[len(gain) - arm.chain.wrist :] = servos.wrist_gain
        model.actuator_gainprm[actuators, 0] *= gain
        model.actuator_biasprm[actuators, 1] *= gain
        model.actuator_biasprm[actuators, 2] *= np.sqrt(gain)
    if servos.servo_bound is not None:
        _bound_servos(arms, servos.servo_bound)


def _bound_servos(arms: ArmScene, bound: float) -> None:
    """Weaken the servos of arms whose damping is more than a time step can carry.

    A motor at its torque limit F changes the speed of a joint of inertia I by F dt / I in a step. With
    a damping of at most I / dt the servo answers that with no more than F; with more it drives the
    motor into its other limit, step by step and without end. Stiffness falls with the damping: a
    servo follows a moving target by damping / stiffness late, and joints that are late by unequal
    times leave the path. I is what the motor feels at rest, all other joints free.

    Args:
        arms: The scene, reset; its model is written to.
        bound: Multiple of I / dt [-].
    """
    model = arms.scene.model
    servos = np.concatenate(arms.arm_actuators)
    damping = -model.actuator_biasprm[servos, 2]
    carried = bound * _felt_inertia(arms) / model.opt.timestep
    share = carried / np.maximum(damping, carried)
    model.actuator_gainprm[servos, 0] *= share
    model.actuator_biasprm[servos, 1] *= share
    model.actuator_biasprm[servos, 2] *= share


def _felt_inertia(arms: ArmScene) -> FloatArray:
    """Torque per acceleration of each joint of both arms at rest, 1 / (M^-1)_jj [kg m^2], (A0 + A1,).

    It leaves the scene's data reset.
    """
    import mujoco

    model, data = arms.scene.model, arms.scene.data
    for i, arm in enumerate(arms.robot.arms):
        data.qpos[arms.arm_qpos[i]] = arm.chain.rest
        data.qpos[arms.scene.joint_qpos[i]] = arms.robot.hands[i].posture_open
    mujoco.mj_fwdPosition(model, data)
    dofs = np.concatenate(arms.arm_qvel)
    torques, accelerations = np.eye(model.nv)[dofs], np.zeros((len(dofs), model.nv))
    mujoco.mj_solveM(model, data, accelerations, torques)
    mujoco.mj_resetData(model, data)
    return 1 / accelerations[np.arange(len(dofs)), dofs]
