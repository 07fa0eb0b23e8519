"""From a release with arms to a controller: motions of two arms, sampled, checked and exported.

Motions are joint angles at knots. Here they are chosen by status, checked against the stored grasps with
the chain of `rig.json` alone (no simulator, no model of the arm), sampled at a controller's rate, and
written as ROS messages.

python examples/05_arms.py RELEASE
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import numpy as np

from bidexdata import BiDexDataset
from bidexdata.errors import BidexError
from bidexdata.formats.rig_files import hand_poses, read_rig_files
from bidexdata.record.fields import KEY_FRAMES
from bidexdata.runs.trajectories import export_trajectories

FIELDS = ("grasp_id", "hand_pos", "arm_joints", "arm_path", "arm_time")
GRASP = 1  # the stage: 0 pregrasp, 1 grasp, 2 squeeze
SOLVER = 1.1e-3  # the solver accepts hands 1 mm from where the grasp has them [m]


def main(release: str, rate: float = 100.0, exported: int = 2) -> None:
    """Use the motions of the grasps that the arms can take."""
    every = BiDexDataset(release, split=None, cloud=None)
    data = BiDexDataset(
        release, split=None, where="arm_status == 0", fields=FIELDS, frame="world", cloud=None
    )
    print(f"{len(data)} of {len(every)} grasps have a motion of {data.rig}")
    assert 0 < len(data) <= len(every)

    batch = data.__getitems__(range(len(data))).stacked
    rig = read_rig_files(data.release.path, data.release.header.arms).document
    farthest, fastest = 0.0, 0.0
    for h, side in enumerate(data.sides):
        chain = rig["chains"][side]
        own = len(chain["joint_names"])  # rows are padded to the longer arm
        q = batch["arm_joints"][:, h, KEY_FRAMES.index("grasp"), :own].numpy()
        at, _ = hand_poses(chain, q.astype(np.float64))
        off = np.linalg.norm(at - batch["hand_pos"][:, h, GRASP].numpy(), axis=1)
        farthest = max(farthest, float(off.max()))

        for path, time in zip(
            batch["arm_path"][:, h, :, :own].numpy(), batch["arm_time"].numpy(), strict=True
        ):
            ticks = np.arange(0, time[-1], 1 / rate)
            sampled = np.stack([np.interp(ticks, time, joint) for joint in path.T], axis=1)
            assert (sampled >= np.array(chain["lower"]) - 1e-4).all()
            assert (sampled <= np.array(chain["upper"]) + 1e-4).all()
            speed = np.abs(np.diff(sampled, axis=0)) * rate / np.array(chain["velocity"])
            fastest = max(fastest, float(speed.max()))
    print(f"hands are at most {1e3 * farthest:.2f} mm from their grasps")
    print(f"joints use at most {fastest:.0%} of their speed")
    assert farthest < SOLVER
    assert fastest < 1.001

    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "ros"
        report = export_trajectories(release, out, "ros", limit=exported, quiet=True)
        files = sorted(out.glob("*/*_left_arm.json"))
        message = json.loads(files[0].read_text())
        print(
            f"{report.grasps} motions as trajectory_msgs/JointTrajectory, such as {files[0].name}"
        )
        assert len(files) == report.grasps
        assert tuple(message["joint_names"]) == data.arm_joint_names[0]
        first = list(batch["grasp_id"]).index(files[0].name.split("_")[0])
        end = batch["arm_joints"][first, 0, KEY_FRAMES.index("lift"), : len(message["joint_names"])]
        assert np.allclose(message["points"][-1]["positions"], end, atol=1e-6)


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        sys.exit(__doc__)
    try:
        main(sys.argv[1])
    except BidexError as err:
        sys.exit(f"error: {err}")
