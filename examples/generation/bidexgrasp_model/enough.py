"""Check that a release has grasps enough to learn from: the last step of `make dataset-small`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from bidexdata import BiDexDataset, Release


def count(release: Path) -> tuple[int, int]:
    """Selected grasps that passed test l, and the objects that they are of."""
    data = BiDexDataset(release, split=None, where="suc_l", fields=("size_mm",), cloud=None)
    return len(data), len(data.object_rows)


def main() -> None:
    """Print the counts; exit code 6 where they fall short."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("release", type=Path)
    parser.add_argument("--grasps", type=int, default=20_000)
    parser.add_argument("--objects", type=int, default=100)
    asked = parser.parse_args()
    grasps, objects = count(asked.release)
    name = Release.open(asked.release).name
    print(f"{name}: {grasps} selected grasps of {objects} objects passed test l")
    if grasps < asked.grasps or objects < asked.objects:
        print(f"fewer than {asked.grasps} grasps of {asked.objects} objects", file=sys.stderr)
        sys.exit(6)


if __name__ == "__main__":
    main()
