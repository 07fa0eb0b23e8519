"""Train on a release: one epoch of shuffled batches with point clouds.

python examples/01_load_release.py RELEASE
"""

from __future__ import annotations

import sys

from torch.utils.data import DataLoader

from bidexdata import BiDexDataset, Release
from bidexdata.loaders import collate


def main(release: str, batch_size: int = 64, points: int = 1024) -> None:
    """Read one epoch and count what came."""
    tests = Release.open(release).figures["tests"]
    where = f"suc_{next(test for test in 'fla' if test in tests)}"  # not every release has test f
    grasps = BiDexDataset(release, split="train", where=where, points=points)
    if not len(grasps):
        raise SystemExit(f"{release}: no grasp of its split train has {where}; nothing to load")
    loader = DataLoader(grasps, batch_size=batch_size, shuffle=True, collate_fn=collate)
    print(f"{len(grasps)} grasps of {len(grasps.object_ids)} objects, joints {grasps.joint_names}")

    seen, widest = 0, 0.0
    for batch in loader:
        rows = len(batch["joints"])
        assert batch["hand_pos"].shape == (rows, 2, 3, 3)  # (B, hands, stages, xyz) [m]
        assert batch["hand_quat_wxyz"].shape == (rows, 2, 3, 4)
        assert batch["cloud_solid"].shape == (rows, points, 3)
        # Clouds come at the grasp's size, so none is wider than its object's diagonal.
        span = batch["cloud_solid"].amax(1) - batch["cloud_solid"].amin(1)
        diagonal = batch["size"]
        assert (span.norm(dim=-1) <= diagonal * 1.001).all()
        widest = max(widest, float(diagonal.max()))
        seen += rows
    print(f"one epoch: {seen} grasps, the largest object is {widest:.2f} m")

    assert seen == len(grasps)


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        sys.exit(__doc__)
    main(sys.argv[1])
