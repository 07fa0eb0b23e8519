"""Runs that are made for a rig: which one, and what its arms can take of an object.

What the stage `arms` and the synthesis have in common of it stands here too.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from functools import lru_cache, partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bidexdata.config import from_plain, to_plain
from bidexdata.devices import start_warp
from bidexdata.errors import ConfigConflict
from bidexdata.runs.arm_folder import (
    folder_name,
    known_spheres,
    portable_spec,
    resolve_spec,
    rig_name,
)
from bidexdata.runs.run import Run, open_unchanged
from bidexdata.runs.spec import RunRig, RunSpec
from bidexdata.runs.weights import weight_of_run

if TYPE_CHECKING:
    from bidexdata.arms.arm_scene import SizedArmScenes
    from bidexdata.arms.config import ArmConfig
    from bidexdata.arms.reach import Reach
    from bidexdata.arms.robot import Robot
    from bidexdata.hands.model import Hand
    from bidexdata.objects.library import Library
    from bidexdata.objects.prepared import Solid

_KERNELS = (
    "bidexdata.arms.chain_kernels",
    "bidexdata.arms.ik_kernels",
    "bidexdata.arms.sphere_kernels",
    "bidexdata.arms.clearance_kernels",
)


def rig_of_run(
    rig: str | Path,
    hands: tuple[Hand, ...],
    out: Path,
    library: Library,
    spec: RunSpec,
    config: Mapping[str, Any] | None = None,
) -> RunRig:
    """Say which arms a run's grasps are made for.

    Args:
        rig: A name, or the path of a rig's spec.
        hands: Left and right.
        out: Folder of the run.
        library: Its objects.
        spec: What the run is otherwise.
        config: By which reach is judged, as a run that goes on has it; the defaults when omitted.

    Raises:
        UnknownName: There is no such rig.
        NotUsable: Its models cannot be had, or it cannot carry the hands and half of the heaviest
            object.
    """
    from bidexdata.arms.config import ArmConfig
    from bidexdata.arms.payload import require_payload
    from bidexdata.arms.registry import load_rig
    from bidexdata.arms.robot import mount_robot

    loaded = load_rig(rig)
    name = folder_name(loaded.spec.name)
    robot = mount_robot(loaded, hands, partial(known_spheres, out, name))
    require_payload(robot, heaviest_planned(library, spec))
    return RunRig(
        name=name,
        rig=portable_spec(str(rig), out),
        digest=robot.digest,
        config=to_plain(ArmConfig()) if config is None else config,
    )


def rig_meant(run: Run) -> str:
    """The rig that is taken where nobody names one: that which the grasps were made for, if any."""
    from bidexdata.arms.registry import DEFAULT_RIG

    return DEFAULT_RIG if run.spec.rig is None else resolve_spec(run.spec.rig.rig, run.path)


def arm_config_of(run: Run, rig: str | Path | None = None) -> ArmConfig:
    """How motions are searched where nobody says: of the run's own rig as when it was made.

    Args:
        run: The run.
        rig: The rig that is asked for; see `rig_meant` when omitted.
    """
    from bidexdata.arms.config import ArmConfig

    made_for = run.spec.rig
    if made_for is None or rig_name(rig or rig_meant(run)) != made_for.name:
        return ArmConfig()
    return from_plain(ArmConfig, made_for.config)


def robot_of_run(run: Run) -> Robot:
    """Load the rig that a run's grasps are made for, with the run's hands.

    Raises:
        ConfigConflict: The rig, its models or a hand have changed since.
    """
    from bidexdata.arms.registry import load_rig
    from bidexdata.arms.robot import mount_robot

    made_for = run.spec.rig
    assert made_for is not None
    rig = load_rig(resolve_spec(made_for.rig, run.path))
    robot = mount_robot(rig, run.hands(), partial(known_spheres, run.path, made_for.name))
    if robot.digest != made_for.digest:
        change = f"{made_for.digest[:12]!r} -> {robot.digest[:12]!r}"
        raise ConfigConflict(run.path, [f"rig.robot: {change}"])
    return robot


def reach_of_object(run: Run, object_id: str, *, device: str = "cpu") -> Reach | None:
    """What the arms that a run is made for can take of an object; None where there are none."""
    if run.spec.rig is None:
        return None
    return _reach(str(run.path), run.fingerprint, object_id, device)


@lru_cache(maxsize=1)
def _reach(run_path: str, run_fingerprint: str, object_id: str, device: str) -> Reach:
    """Kept while tasks are of the same object."""
    from bidexdata.arms.reach import Reach

    run = open_unchanged(run_path, run_fingerprint)
    assert run.spec.rig is not None
    robot, obj = robot_of_run(run), run.library.load(object_id)
    return Reach(
        robot=robot,
        field=obj.sdf,
        scenes=object_scenes(robot, obj),
        config=arm_config_of(run),
        device=device,
    )


def object_scenes(robot: Robot, solid: Solid) -> SizedArmScenes | None:
    """MuJoCo's scenes of an object with the arms; None, and a warning, where it refuses them."""
    from bidexdata.arms.arm_scene import SizedArmScenes
    from bidexdata.simulation.scene import SceneNotBuilt

    try:
        return SizedArmScenes(robot, solid)
    except SceneNotBuilt as err:
        logging.getLogger(__name__).warning("%s; its arms are checked by spheres alone", err)
        return None


def load_arm_kernels(device: str) -> None:
    """Load the arms' kernels, so that workers find them compiled, and the solver of their paths."""
    import warp as wp

    start_warp()
    for name in _KERNELS:
        wp.load_module(import_module(name), device=device)
    import_module("osqp")


def heaviest_planned(library: Library, spec: RunSpec) -> float:
    """Mass of the heaviest object of a library at a run's largest size [kg].

    At the weight that the run's hands squeeze for; where it does not say, at the density of
    `paper-1`.
    """
    from bidexdata.simulation.settings import SceneSettings

    kind, value = weight_of_run(spec) or ("density", SceneSettings().density)
    if kind == "mass":
        return value
    left_out = set(spec.without_scene)
    volumes = [library.row(i)["volume"] or 0.0 for i in library.object_ids if i not in left_out]
    return value * max(volumes, default=0.0) * (max(spec.sizes_mm) / 1000) ** 3
