"""Every object of a library dropped on a table in MuJoCo: `python -m benchmarks.drops LIBRARY`.

At 0.5 m, from 2 cm above the table, in three random orientations, all pieces as geoms of their own
and the contacts of `paper-1`. An object has settled when it hardly moves after 6 s, which rolling
ones may not, and has not sunk in.
"""

from __future__ import annotations

import sys

import mujoco
import numpy as np

from bidexdata.frames import matrix_from_quat, random_quat
from bidexdata.objects.library import Library
from bidexdata.objects.prepared import Solid
from bidexdata.simulation.scene import SimScene, build_scene
from bidexdata.simulation.settings import SceneSettings
from bidexdata.simulation.state import object_pose, object_speed, set_pose

SIZE, ABOVE, SECONDS, DROPS = 0.5, 0.02, 6.0, 3
SLOW, TURNING = 0.01, 0.1
"""An object below these speeds has settled [m/s], [rad/s]."""
SUNK = 0.005
"""No vertex lies deeper in the table than this [m]."""


def lowest(solid: Solid, quat: np.ndarray) -> float:
    """Height of the lowest vertex above the object's origin [m]."""
    corners = np.concatenate([piece.vertices for piece in solid.pieces]) * SIZE
    return float((corners @ matrix_from_quat(quat)[2]).min())


def drop(scene: SimScene, solid: Solid, quat: np.ndarray) -> tuple[float, float, float]:
    """Speed [m/s], rate of turning [rad/s] and depth of the lowest vertex [m] at the end."""
    none = np.zeros((0, 3))
    place = np.array([0.0, 0.0, ABOVE - lowest(solid, quat)])
    set_pose(scene, place, quat, none, np.zeros((0, 4)), np.zeros((0, 0)))
    scene.model.opt.gravity[2] = -9.8
    mujoco.mj_step(scene.model, scene.data, round(SECONDS / scene.model.opt.timestep))
    pos, turned = object_pose(scene)
    return *object_speed(scene), -float(pos[2] + lowest(solid, turned))


def ends_of(solid: Solid) -> np.ndarray:
    """Speed, rate of turning and depth at the end of every drop, (DROPS, 3)."""
    scene = build_scene((), solid, SIZE, SceneSettings(), table=True)
    rng = np.random.default_rng(0)
    return np.array([drop(scene, solid, random_quat(rng, ())) for _ in range(DROPS)])


def settled(ends: np.ndarray) -> np.ndarray:
    """Which drops have come to rest and not sunk in, (DROPS,)."""
    return (ends[:, 0] < SLOW) & (ends[:, 1] < TURNING) & (ends[:, 2] < SUNK)


def main(path: str) -> int:
    """Print what has not settled, and counts."""
    library, bad = Library.open(path), 0
    for object_id in library.object_ids:
        ends = ends_of(library.load_solid(object_id))
        still = settled(ends)
        if not still.all():
            bad += 1
            said = "; ".join(f"{v:.3f} m/s {w:.2f} rad/s {d * 1e3:.1f} mm deep" for v, w, d in ends)
            print(f"{object_id}: {int(still.sum())} of {DROPS} settled: {said}", flush=True)
    print(f"{len(library.object_ids) - bad} of {len(library.object_ids)} objects settled always")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
