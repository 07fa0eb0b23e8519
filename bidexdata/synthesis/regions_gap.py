"""Which anchor pairs may be grasped together: both accessible and their regions far enough apart.

The exact distance between two regions costs k^2 point pairs, so it is measured only for the pairs
that a ranking asks for, and only where the anchors' distance leaves it open.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from bidexdata.devices import start_warp
from bidexdata.synthesis.regions_build import Regions

# Pairs tested at a time when walking down a ranking.
_CHUNK = 1024


class PairFilter:
    """The pairs (a < b) of usable anchors that may be apart far enough, and the exact test."""

    def __init__(
        self,
        regions: Regions,
        usable: Bool[np.ndarray, " A"],
        gap: float,
        wide: float,
        *,
        device: str = "cpu",
    ) -> None:
        """Bound the gap of every pair by its anchors' distance.

        Args:
            regions: All regions.
            usable: Anchors that may be used at all.
            gap: Least distance between the regions' points [m].
            wide: Anchor distance that is accepted whatever the gap [m].
            device: Warp device of the exact test.
        """
        self._regions, self._gap, self._device = regions, gap, device
        anchors = regions.anchor_points
        index = np.flatnonzero(usable)
        a, b = np.triu_indices(len(index), k=1)
        pairs = np.stack([index[a], index[b]], axis=1)
        distance = np.linalg.norm(anchors[pairs[:, 0]] - anchors[pairs[:, 1]], axis=1)
        # Points of a region are nearer to each other than these two bounds say.
        surely = distance - regions.reach[pairs].sum(axis=1) >= gap
        certain = surely | (distance >= wide)
        possible = certain | (distance >= gap)
        self.pairs: Int[np.ndarray, "Q 2"] = pairs[possible]
        """Candidates: the anchors alone do not rule them out."""
        self._certain = certain[possible]

    def first(self, order: Int[np.ndarray, " n"], need: int) -> Int[np.ndarray, " m"]:
        """Walk along `order` (indices of `pairs`) and return the first `need` that are allowed."""
        found: list[np.ndarray] = []
        total = 0
        for start in range(0, len(order), _CHUNK):
            chunk = order[start : start + _CHUNK]
            allowed = self._certain[chunk].copy()
            open_ = np.flatnonzero(~allowed)
            if len(open_):
                unsure = self.pairs[chunk[open_]]
                allowed[open_] = regions_apart(
                    self._regions, unsure, self._gap, device=self._device
                )
            found.append(chunk[allowed])
            total += len(found[-1])
            if total >= need:
                break
        return np.concatenate(found)[:need] if found else np.zeros(0, np.int64)


def regions_apart(
    regions: Regions, pairs: Int[np.ndarray, "Q 2"], gap: float, *, device: str = "cpu"
) -> Bool[np.ndarray, " Q"]:
    """Tell for each pair whether all points of the two regions are at least `gap` apart [m].

    Source:
        BiDexGrasp, appendix B: d(R_a, R_b) >= tau_2.
    """
    import warp as wp

    from bidexdata.synthesis.regions_kernels import regions_apart_kernel

    start_warp()
    if not len(pairs):
        return np.zeros(0, bool)

    def vectors(values: Float[np.ndarray, "*b 3"]) -> wp.array:
        return wp.array(np.asarray(values, np.float32), dtype=wp.vec3, device=device)

    apart = wp.empty(len(pairs), dtype=int, device=device)
    wp.launch(
        regions_apart_kernel,
        dim=len(pairs),
        inputs=[
            vectors(regions.points),
            vectors(regions.anchor_points),
            wp.array(regions.reach.astype(np.float32), dtype=float, device=device),
            wp.array(pairs.astype(np.int32), dtype=int, device=device),
            gap,
        ],
        outputs=[apart],
        device=device,
    )
    return apart.numpy() != 0
