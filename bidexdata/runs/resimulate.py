"""Judge rows of a release again, for `verify --full`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from bidexdata.formats.release import Release
    from bidexdata.objects.prepared import Solid
    from bidexdata.record import GraspBatch


def resimulate(release: Release, batch: GraspBatch, solid: Solid) -> np.ndarray:
    """Run test f of the release's default protocol on rows of one object; success, (N,)."""
    from bidexdata.runs.browse import open_browsable
    from bidexdata.validation.protocols import load_protocol
    from bidexdata.validation.validate import validate_grasps

    hands = open_browsable(release.path).hands()
    protocol = load_protocol(release.default_protocol)
    return validate_grasps(batch, solid, hands, protocol, "f")["success"]
