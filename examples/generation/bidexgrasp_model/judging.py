"""Figures of judged grasps: rates and means over all rows and per size, with object intervals."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bidexdata import BiDexDataset, Run, object_interval
from bidexdata.loaders import collate
from bidexgrasp_model.rotations import matrix_from_quat, six_from_matrix
from bidexgrasp_model.state import GRASP

PROTOCOL = "paper-1"
MEANS = ("pd", "spd", "cdc")
_UNIT = 10**9
"""Parts of a metre in which lengths are summed, exactly."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """n judged grasps."""

    scene_id: np.ndarray
    object_id: np.ndarray
    size_mm: np.ndarray
    success: dict[str, np.ndarray]
    """Per test, bool."""
    means: dict[str, np.ndarray]
    """`pd`, `spd`, `cdc` [m], NaN where not measured."""
    vectors: np.ndarray
    """The grasps as numbers, for the diversity, (n, M)."""
    status: dict[str, dict[str, int]] = field(default_factory=dict)
    """Verdicts per test, by their labels."""

    def select(self, mask: np.ndarray) -> Judged:
        """Some of the rows."""
        return Judged(
            scene_id=self.scene_id[mask],
            object_id=self.object_id[mask],
            size_mm=self.size_mm[mask],
            success={t: v[mask] for t, v in self.success.items()},
            means={n: v[mask] for n, v in self.means.items()},
            vectors=self.vectors[mask],
        )


def judged_run(path: Path, tests: tuple[str, ...]) -> Judged:
    """Read a validated run; its metrics are those of the first test."""
    from bidexdata import describe

    run = Run.open(path)
    parts = {test: list(run.batches(PROTOCOL, test)) for test in tests}
    first = parts[tests[0]]

    def column(name: str, test: str = "") -> np.ndarray:
        return np.concatenate([b[name] for b in parts[test or tests[0]]])

    ids = column("scene_id")
    poses = {n: column(n) for n in ("hand_pos", "hand_quat_wxyz", "joints", "object_pos")}
    counts = {t: describe(path)["protocols"][PROTOCOL]["by_verdict"] for t in tests[:1]}
    assert first
    return Judged(
        scene_id=ids,
        object_id=column("object_id"),
        size_mm=column("size_mm"),
        success={t: column("success", t) for t in tests},
        means={n: column(n) for n in MEANS},
        vectors=_vectors(**poses),
        status=counts,
    )


def judged_split(release: Path, split: str, tests: tuple[str, ...]) -> Judged:
    """What the synthesis itself made for a split's objects: its selected, tested rows."""
    names = ("scene_id", "object_id", "size_mm", *(f"suc_{t}" for t in tests), *MEANS)
    poses = ("hand_pos", "hand_quat_wxyz", "joints", "object_pos")
    data = BiDexDataset(
        release,
        split=split,
        where=f"suc_{tests[0]} or not suc_{tests[0]}",
        fields=(*names, *poses),
        frame="world",
        cloud=None,
    )
    rows: dict[str, Any] = collate(data.__getitems__(range(len(data))))
    return Judged(
        scene_id=np.array(rows["scene_id"]),
        object_id=np.array(rows["object_id"]),
        size_mm=rows["size_mm"].numpy(),
        success={t: rows[f"suc_{t}"].numpy().astype(bool) for t in tests},
        means={n: rows[n].numpy() for n in MEANS},
        vectors=_vectors(**{n: rows[n].numpy() for n in poses}),
    )


def figures(judged: Judged) -> dict[str, Any]:
    """Rates with intervals, means with intervals and diversity; of all rows and per size."""
    sizes = sorted(set(judged.size_mm.tolist()))
    found = _figures(judged)
    found["by_size"] = {str(mm): _figures(judged.select(judged.size_mm == mm)) for mm in sizes}
    found["by_verdict"] = judged.status
    return found


def paired(a: Judged, b: Judged, test: str) -> dict[str, Any]:
    """Difference of two systems' success rates on the same scenes, paired by object.

    Both have as many grasps of each scene, so the difference of rates is the mean over grasps of
    differences, and its interval resamples objects.
    """
    objects = sorted(set(a.object_id) & set(b.object_id))
    counts = [int((a.object_id == o).sum()) for o in objects]
    totals = []
    for o, n in zip(objects, counts, strict=True):
        mine, other = (x.success[test][x.object_id == o] for x in (a, b))
        if len(mine) != len(other):
            raise ValueError(f"{o} has {n} and {len(other)} grasps; they cannot be paired")
        totals.append(int(mine.sum()) - int(other.sum()))
    interval = object_interval(totals, counts)
    return {
        "difference": sum(totals) / max(1, sum(counts)),
        "low": interval.low if interval else None,
        "high": interval.high if interval else None,
        "objects": len(objects),
    }


def _figures(judged: Judged) -> dict[str, Any]:
    rates = {f"suc_{t}": _mean(judged.object_id, ok, 1) for t, ok in judged.success.items()}
    means = {}
    for name, values in judged.means.items():
        known = np.isfinite(values)
        means[name] = _mean(judged.object_id[known], values[known], _UNIT)
    return {"n": len(judged.object_id), **rates, **means, "d": diversity(judged.vectors)}


def _mean(object_id: np.ndarray, values: np.ndarray, unit: int) -> dict[str, Any]:
    """A pooled mean with its interval over objects."""
    objects, number = np.unique(object_id, return_inverse=True)
    counts = np.bincount(number, minlength=len(objects)).tolist()
    parts = np.round(np.asarray(values, np.float64) * unit)
    totals = [int(t) for t in np.bincount(number, weights=parts, minlength=len(objects))]
    if not counts:
        return {"n": 0, "mean": None, "low": None, "high": None}
    interval = object_interval(totals, counts, unit=unit)
    low, high = (interval.low, interval.high) if interval else (None, None)
    return {"n": sum(counts), "mean": sum(totals) / unit / sum(counts), "low": low, "high": high}


def diversity(vectors: np.ndarray) -> float | None:
    """Share of the variance along the first principal component; smaller is more diverse.

    Source:
        BiDexGrasp, appendix D.
    """
    known = vectors[np.isfinite(vectors).all(1)]
    if len(known) < 2:
        return None
    spread = np.linalg.svd(known - known.mean(0), compute_uv=False) ** 2
    return float(spread[0] / max(spread.sum(), 1e-300))


def _vectors(
    hand_pos: np.ndarray, hand_quat_wxyz: np.ndarray, joints: np.ndarray, object_pos: np.ndarray
) -> np.ndarray:
    """Wrists relative to the object [m], their first two axes, joints [rad]; of the grasp."""
    import torch

    quat = torch.from_numpy(np.array(hand_quat_wxyz[:, :, GRASP], np.float64))
    axes = six_from_matrix(matrix_from_quat(quat)).numpy()
    wrists = hand_pos[:, :, GRASP] - object_pos[:, None]
    own = joints[:, :, GRASP]
    own = own[..., ~np.isnan(own).all(axis=(0, 1))]
    return np.concatenate([v.reshape(len(v), -1) for v in (wrists, axes, own)], axis=1)
