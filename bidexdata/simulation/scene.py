"""SimScene: the compiled scene of one object at one size, and where everything lies in it.

One scene serves all grasps of an object-size: only positions and controls change. A scene belongs
to one caller at a time, because gravity and contact gaps are switched on its model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bidexdata.engine_log import engine_warnings_logged
from bidexdata.errors import NotUsable
from bidexdata.hands.model import Hand
from bidexdata.objects.prepared import Solid

from .assembly import (
    OBJECT_BODY,
    base_names,
    hand_prefix,
    joint_actuator,
    mocap_name,
    scene_spec,
)
from .noslip import NoslipSteps
from .settings import SceneSettings

if TYPE_CHECKING:
    import mujoco

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

MOST_PIECES = 1000
"""Convex pieces of an object; more take minutes to compile and are no decomposition."""
NOBODY = -1
"""Owner of geoms that belong to no hand and no object: the table."""


class SceneNotBuilt(NotUsable):
    """MuJoCo refuses the scene of an object-size (degenerate pieces or mass)."""


@dataclass(frozen=True, slots=True, eq=False)
class SimScene:
    """A compiled scene; H hands, U actuators, J joints, G geoms, F fingers of all hands."""

    model: mujoco.MjModel
    data: mujoco.MjData
    """Scratch state: no function relies on what an earlier one left in it."""
    settings: SceneSettings
    hands: tuple[Hand, ...]
    root_qpos: IntArray
    """Address in qpos of each hand's free joint, or of its first slide, (H,)."""
    root_qvel: IntArray
    """Address in qvel of the same, (H,)."""
    mocap: IntArray
    """Mocap number of each hand; empty where hands are carried on slides, (H,)."""
    base_actuators: IntArray
    """Actuator numbers of the slides and hinges; empty where hands are welded, (H, 6)."""
    joint_qpos: tuple[IntArray, ...]
    """Addresses in qpos of each hand's joints, in the hand's order, H times (J,)."""
    actuators: tuple[IntArray, ...]
    """Actuator numbers of each hand, in the hand's order, H times (U,)."""
    object_qpos: int
    """Address in qpos of the object's free joint; -1 without an object."""
    object_qvel: int
    """Address in qvel of the object's free joint; -1 without an object."""
    object_body: int
    """Number of the object's body; -1 without an object."""
    geom_owner: IntArray
    """0..H-1 hands, H the object, -1 the table, (G,)."""
    geom_body: IntArray
    """Number of the geom's body within its hand; -1 for other geoms, (G,)."""
    geom_finger: IntArray
    """Number of the geom's finger, counted over all hands; -1 for palms and other geoms, (G,)."""
    finger_names: tuple[str, ...]
    """`<hand number>/<finger>`, (F,)."""
    source_origin: FloatArray
    """Origin of the source file's coordinates in the object frame [m], (3,)."""
    object_mass: float
    """Nominal mass of the object [kg]: that of the solid, or the one that the settings name."""
    noslip: NoslipSteps
    """Steps the model with a noslip pass of ours."""

    @property
    def object_owner(self) -> int:
        """The number that stands for the object in `geom_owner`."""
        return len(self.hands)

    def step(self, steps: int, *, plain: bool = False) -> None:
        """Advance the state by a number of steps.

        Args:
            steps: How many.
            plain: Leave all of a step to the engine, which takes longer.
        """
        if not plain and self.noslip.applies():
            self.noslip.step(steps)
            return
        import mujoco

        mujoco.mj_step(self.model, self.data, steps)

    def controls(self, index: int, joints: FloatArray) -> FloatArray:
        """Controls (..., U) of hand number `index` that command joint angles (..., J) [rad]."""
        if self.settings.actuators == "joints":
            return joints
        return joints @ self.hands[index].actuator_moment.T


def build_scene(
    hands: Sequence[Hand],
    solid: Solid | None,
    size: float,
    settings: SceneSettings | None = None,
    *,
    table: bool = False,
) -> SimScene:
    """Compile the scene of one object-size.

    Args:
        hands: Hands in the order of the record's H axis.
        solid: The object; none for a scene of hands alone.
        size: Bounding-box diagonal of the object [m].
        settings: Numbers of the scene; those of `paper-1` when omitted.
        table: Add the plane z = 0.

    Raises:
        SceneNotBuilt: MuJoCo refuses the scene.
    """
    import mujoco

    settings = settings or SceneSettings()
    if solid is not None:
        require_few_pieces(solid)
    try:
        with engine_warnings_logged():
            spec = scene_spec(hands, solid, size, settings, table=table)
            model = spec.compile()
    except ValueError as err:
        name = solid.object_id if solid is not None else "no object"
        reason = str(err).splitlines()[0]
        raise SceneNotBuilt(f"no scene can be built of {name} at {size:g} m: {reason}") from err
    scene = index_scene(model, mujoco.MjData(model), settings, tuple(hands), solid, size)
    apply_settings(scene)
    return scene


def require_few_pieces(solid: Solid) -> None:
    """Refuse an object of so many pieces that compiling takes minutes.

    Raises:
        SceneNotBuilt: It has more than `MOST_PIECES`.
    """
    if len(solid.pieces) > MOST_PIECES:
        raise SceneNotBuilt(
            f"no scene is built of {solid.object_id}: it has {len(solid.pieces)} convex pieces, "
            f"and at most {MOST_PIECES} are simulated"
        )


def index_scene(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    settings: SceneSettings,
    hands: tuple[Hand, ...],
    solid: Solid | None,
    size: float,
    *,
    floating: bool = True,
) -> SimScene:
    """Find hands, object and table in a compiled scene.

    Args:
        model: The scene.
        data: Its state.
        settings: Numbers of the scene.
        hands: Whose names the scene has, each with its prefix.
        solid: The object; none for a scene without.
        size: Its bounding-box diagonal [m].
        floating: The hands float, on welds or slides; else something carries them that is not of
            the scene's business, and the addresses of their roots are left empty.
    """
    welded = settings.base == "weld"
    bases = [base_names(i) for i in range(len(hands) * floating)]
    roots = [
        model.joint(hand_prefix(i) + "root" if welded else bases[i][0]) for i in range(len(bases))
    ]
    every_joint = settings.actuators == "joints"
    joints, actuators, finger_names = [], [], []
    owner = np.full(model.ngeom, NOBODY)
    body_in_hand = np.full(model.ngeom, -1)
    finger = np.full(model.ngeom, -1)
    for i, hand in enumerate(hands):
        prefix = hand_prefix(i)
        joints.append(_ids(model.jnt_qposadr[model.joint(prefix + n).id] for n in hand.joint_names))
        names = [joint_actuator(n) for n in hand.joint_names] if every_joint else None
        actuators.append(_ids(model.actuator(prefix + n).id for n in names or hand.actuator_names))
        finger_of = {b: f for f, bodies in hand.fingers.items() for b in bodies}
        first = len(finger_names)
        order = {f: first + k for k, f in enumerate(hand.fingers)}
        finger_names += [f"{i}/{f}" for f in hand.fingers]
        for number, name in enumerate(hand.body_names):
            geoms = model.geom_bodyid == model.body(prefix + name).id
            owner[geoms], body_in_hand[geoms] = i, number
            finger[geoms] = order[finger_of[name]] if name in finger_of else -1
    has_object = OBJECT_BODY in {model.body(i).name for i in range(model.nbody)}
    if has_object:
        owner[model.geom_bodyid == model.body(OBJECT_BODY).id] = len(hands)
    free = model.joint(OBJECT_BODY) if has_object else None
    return SimScene(
        model=model,
        data=data,
        settings=settings,
        hands=hands,
        root_qpos=_ids(j.qposadr[0] for j in roots),
        root_qvel=_ids(j.dofadr[0] for j in roots),
        mocap=_ids(model.body(mocap_name(i)).mocapid[0] for i in range(len(bases) * welded)),
        base_actuators=_ids(
            model.actuator(n).id for names in bases for n in (() if welded else names)
        ).reshape(-1, 6),
        joint_qpos=tuple(joints),
        actuators=tuple(actuators),
        object_qpos=int(free.qposadr[0]) if free is not None else -1,
        object_qvel=int(free.dofadr[0]) if free is not None else -1,
        object_body=int(model.body(OBJECT_BODY).id) if has_object else -1,
        geom_owner=owner,
        geom_body=body_in_hand,
        geom_finger=finger,
        finger_names=tuple(finger_names),
        source_origin=np.zeros(3) if solid is None else solid.source_origin * size,
        object_mass=settings.mass
        or (0.0 if solid is None else solid.mass(size, settings.density_of(solid, size))),
        noslip=NoslipSteps(model, data),
    )


def _ids(numbers) -> IntArray:  # noqa: ANN001  (any iterable of numpy or Python integers)
    return np.array([int(n) for n in numbers], dtype=np.intp)


def apply_settings(scene: SimScene) -> None:
    """Write the numbers of the settings into the compiled model; actuators of the hands alone.

    On the model and not on the spec: class defaults of an attached hand would win over the
    latter, and `attach` keeps the parent's options whatever the hand's file says.
    """
    import mujoco

    model, s = scene.model, scene.settings
    opt = model.opt
    opt.timestep, opt.impratio = s.timestep, s.impratio
    opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC if s.elliptic else mujoco.mjtCone.mjCONE_PYRAMIDAL
    opt.solver = mujoco.mjtSolver.mjSOL_NEWTON
    opt.iterations, opt.tolerance = s.solver_iterations, s.tolerance
    opt.noslip_iterations = s.noslip_iterations
    opt.gravity[:] = 0.0
    opt.disableflags, opt.enableflags = 0, 0

    model.geom_condim[:] = s.condim
    model.geom_friction[:] = (s.friction_slide, s.friction_spin, s.friction_roll)
    model.geom_margin[:] = 0.0
    model.geom_gap[:] = 0.0
    model.body_margin[:] = 0.0
    model.geom_priority[:] = 0
    model.geom_solmix[:] = 1.0
    of_hand = (scene.geom_owner >= 0) & (scene.geom_owner < len(scene.hands))
    model.geom_solref[of_hand] = s.hand_solref
    model.geom_solimp[of_hand, :3] = s.hand_solimp
    for actuators in scene.actuators:
        kp = model.actuator_gainprm[actuators, 0].copy() if s.actuator_kp is None else s.actuator_kp
        model.actuator_gainprm[actuators] = 0.0
        model.actuator_gainprm[actuators, 0] = kp
        model.actuator_biasprm[actuators] = 0.0
        model.actuator_biasprm[actuators, 1] = -kp
        if s.actuator_force is not None:
            model.actuator_forcelimited[actuators] = 1
            model.actuator_forcerange[actuators] = (-s.actuator_force, s.actuator_force)
        model.actuator_ctrllimited[actuators] = 0
