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
    from bidexdata.validation.protocols import load_protocol, protocol_from
    from bidexdata.validation.validate import validate_grasps

    hands = open_browsable(release.path).hands()
    name = release.default_protocol
    stored = release.protocol_settings.get(name)
    where = f"{release.path}/manifest.json: protocol {name}"
    protocol = load_protocol(name) if stored is None else protocol_from(stored, where)
    return validate_grasps(batch, solid, hands, protocol, "f")["success"]
