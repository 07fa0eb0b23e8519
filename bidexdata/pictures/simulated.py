"""Pictures of a simulated state: every body where the simulator has it, not where a row says.

A replay of a test is a list of `SimulatedPose`, one camera for all of them, and one
`simulation_frames`; `video.save_video` makes a file of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.frames import matrix_from_quat
from bidexdata.hands.model import Hand
from bidexdata.objects.prepared import Solid
from bidexdata.pictures.camera import Camera, framed
from bidexdata.pictures.drawing import Surface, bodies_part, solid_parts, table_part
from bidexdata.pictures.raycast import RayScene
from bidexdata.pictures.scene import Part
from bidexdata.pictures.sheet import Caption, captioned
from bidexdata.pictures.views import choose_views, subject_points

if TYPE_CHECKING:
    from bidexdata.simulation.scene import SimScene

FloatArray = NDArray[np.float64]
Pixels = NDArray[np.uint8]

WIDTH = 480
"""Width of a picture of a simulation [pixels]."""
_POINTS_PER_POSE = 500  # enough to place a camera


class SimulatedPose(NamedTuple):
    """World poses of all bodies of a scene at one moment, as MuJoCo's `xpos` and `xquat`."""

    object_pos: FloatArray
    """Origin of the object frame [m], (3,)."""
    object_quat_wxyz: FloatArray
    """(4,)."""
    body_pos: tuple[FloatArray, ...]
    """Origins of each hand's bodies in the hand's order [m], (B, 3) per hand."""
    body_quat_wxyz: tuple[FloatArray, ...]
    """(B, 4) per hand."""
    arm_joints: FloatArray = np.zeros((0, 0))
    """Joint angles of arms that carry the hands, padded with NaN [rad], (H, A); empty without."""


Beside = Callable[[SimulatedPose], list[Part]]
"""Gives what else a picture of one moment shows, such as arms."""


def read_simulated_pose(
    scene: SimScene, arm_qpos: Sequence[NDArray[np.intp]] = ()
) -> SimulatedPose:
    """Copy where all bodies are from the scene's state, after any number of steps.

    Positions of bodies are computed from `qpos` first, as every step does before anything else, so
    looking changes nothing that follows.

    Args:
        scene: A scene with an object.
        arm_qpos: Addresses in qpos of the joints of each arm, where the scene has some.
    """
    import mujoco

    from bidexdata.simulation.assembly import OBJECT_BODY, hand_prefix

    model, data = scene.model, scene.data
    mujoco.mj_kinematics(model, data)
    of_hand = [
        [model.body(hand_prefix(i) + name).id for name in hand.body_names]
        for i, hand in enumerate(scene.hands)
    ]
    obj = model.body(OBJECT_BODY).id
    arms = np.full((len(arm_qpos), max((len(a) for a in arm_qpos), default=0)), np.nan)
    for row, address in zip(arms, arm_qpos, strict=True):
        row[: len(address)] = data.qpos[address]
    return SimulatedPose(
        object_pos=np.array(data.xpos[obj], np.float64),
        object_quat_wxyz=np.array(data.xquat[obj], np.float64),
        body_pos=tuple(np.array(data.xpos[ids], np.float64) for ids in of_hand),
        body_quat_wxyz=tuple(np.array(data.xquat[ids], np.float64) for ids in of_hand),
        arm_joints=arms,
    )


def simulation_parts(
    pose: SimulatedPose,
    solid: Solid,
    size: float,
    hands: Sequence[Hand],
    *,
    table: bool = False,
    surface: Surface = "mesh",
    beside: Beside | None = None,
) -> list[Part]:
    """Everything that a picture of one moment shows.

    Args:
        pose: Where the bodies are.
        solid: The object, at unit diagonal.
        size: Its bounding-box diagonal [m].
        hands: In the order of the pose's.
        table: Draw the plane z = 0.
        surface: The object's display mesh, or its convex pieces, each in its own colour.
        beside: What else to show.

    Returns:
        Parts labelled `object`, `left`, `right`, `ground`, and what `beside` gives.
    """
    parts = solid_parts(solid, size, pose.object_pos, pose.object_quat_wxyz, surface=surface)
    for hand, pos, quat in zip(hands, pose.body_pos, pose.body_quat_wxyz, strict=True):
        parts.append(bodies_part(hand, pos, matrix_from_quat(quat)))
    parts += beside(pose) if beside else []
    return [*parts, table_part(size)] if table else parts


def simulation_camera(
    poses: Sequence[SimulatedPose],
    solid: Solid,
    size: float,
    hands: Sequence[Hand],
    *,
    table: bool = False,
    beside: Beside | None = None,
    aspect: float = 4 / 3,
    device: str = "cpu",
) -> Camera:
    """Stand where the hands of the first pose are seen best and everything stays in the picture.

    Args:
        poses: At least one; the first and the extreme ones of a replay are enough.
        solid: The object, at unit diagonal.
        size: Its bounding-box diagonal [m].
        hands: In the order of the poses'.
        table: Whether the plane z = 0 hides what is below it.
        beside: What else is to be in the picture.
        aspect: Width over height of the pictures [-].
        device: A Warp device.
    """
    first = simulation_parts(poses[0], solid, size, hands, table=table, beside=beside)
    direction = choose_views(first, RayScene(first, device))[0]
    points = [subject_points(simulation_parts(p, solid, size, hands, beside=beside)) for p in poses]
    thinned = [p[:: 1 + len(p) // _POINTS_PER_POSE] for p in points]
    # Corners of each moment's box stand in for the points that were left out.
    boxes = [np.stack([p.min(axis=0), p.max(axis=0)]) for p in points]
    return framed(np.concatenate([*thinned, *boxes]), direction, aspect)


def simulation_frames(
    moments: Iterable[tuple[SimulatedPose, Caption]],
    solid: Solid,
    size: float,
    hands: Sequence[Hand],
    camera: Camera,
    *,
    table: bool = False,
    width: int = WIDTH,
    height: int = 360,
    samples: int = 2,
    surface: Surface = "mesh",
    beside: Beside | None = None,
    device: str = "cpu",
) -> Iterator[Pixels]:
    """Draw moments of a simulation one after the other, each with its words under it.

    Two Shadow hands at the default size take a core about 0.25 s, before a table 0.35 s. The scene
    is built for the first moment and moved to the others, so they are of one object and its hands.

    Args:
        moments: Where the bodies are, and words such as the time, the phase and the verdict;
            frames of one video need the same number of lines.
        solid: The object, at unit diagonal.
        size: Its bounding-box diagonal [m].
        hands: In the order of the poses'.
        camera: `simulation_camera` of the same aspect stands well.
        table: Draw the plane z = 0.
        width: Pixels.
        height: Pixels of the picture; the words come below.
        samples: Rays per pixel along each axis where there are edges; 1 is coarse and fast.
        surface: The object's display mesh, or its convex pieces, each in its own colour.
        beside: What else to show, as many parts at every moment.
        device: A Warp device.

    Yields:
        sRGB pixels, (height + lines, width, 3).
    """
    scene: RayScene | None = None
    for pose, caption in moments:
        parts = simulation_parts(
            pose, solid, size, hands, table=table, surface=surface, beside=beside
        )
        if scene is None:
            scene = RayScene(parts, device)
        else:
            scene.move(parts)
        yield captioned(scene.draw(camera, width, height, samples=samples), caption)
