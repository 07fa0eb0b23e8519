"""What became of a collection: `python -m benchmarks.collection LIBRARY`.

How many of its inputs are objects, and of these: whether manifold3d takes the stored mesh for a
closed solid, how far the repair moved the surface, how the volume of the pieces (their union, and
their sum) compares with the mesh's, whether MuJoCo takes the pieces, and whether the object settles
when it is dropped on a table (benchmarks/drops.py). Reads the library and changes nothing; 0.15 s of a
core an object.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.drops import DROPS, SIZE, ends_of, settled
from benchmarks.report import report
from bidexdata.objects.closed import as_manifold
from bidexdata.objects.library import Library
from bidexdata.objects.physics import mass_properties
from bidexdata.objects.prepared import Solid
from bidexdata.runs.library_report import read_times
from bidexdata.simulation.scene import SceneNotBuilt

NEAR = (0.01, 0.02)
"""Hausdorff distances that objects are counted under [share of the diagonal]."""
VOLUME = 0.25
"""How far the volume of the pieces may be from the mesh's, as a share of it."""


def figures_of(solid: Solid, row: dict[str, Any]) -> dict[str, Any]:
    """Look at one object of a library.

    Args:
        solid: The object.
        row: Its row in the index.
    """
    mesh = as_manifold(solid.mesh)
    summed = sum(mass_properties(piece).volume for piece in solid.pieces)
    ratio = row["volume_ratio"]
    try:
        still = settled(ends_of(solid))
        refused = ""
    except SceneNotBuilt as err:
        still, refused = np.zeros(DROPS, bool), str(err)
    return {
        "object_id": solid.object_id,
        "watertight": mesh is not None and mesh.volume() > 0,
        "hausdorff": row["hausdorff"],
        "union_to_mesh": ratio,
        # The union's own volume stands between the two: the stored mesh may have fewer faces.
        "sum_to_mesh": None if ratio is None else ratio * summed / solid.volume,
        "mujoco_refuses": refused,
        "settled_drops": int(still.sum()),
    }


def measure(library: Library) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The figures of the whole collection, and those of each object."""
    of_object = [figures_of(library.load_solid(i), library.row(i)) for i in library.object_ids]
    away = np.array([f["hausdorff"] for f in of_object])
    labels = library.index.column("status_label").to_pylist()
    times = [taken.seconds for taken in read_times(library.path).values()]
    figures = {
        "inputs": len(labels),
        "prepared": len(of_object),
        "by_status": {label: labels.count(label) for label in sorted(set(labels))},
        "watertight": sum(f["watertight"] for f in of_object),
        **{f"hausdorff_under_{100 * near:g}_percent": int((away < near).sum()) for near in NEAR},
        **{f"hausdorff_percent_p{q}": _quantile(100 * away, q) for q in (50, 90, 95, 99, 100)},
        **{
            f"{k}_within_25_percent": _near_one(of_object, k)
            for k in ("union_to_mesh", "sum_to_mesh")
        },
        "loads_in_mujoco": sum(not f["mujoco_refuses"] for f in of_object),
        f"settled_in_all_{DROPS}_drops_at_{SIZE:g}_m": _settled(of_object, DROPS),
        "settled_in_some_drop": _settled(of_object, 1),
        "replaced_by_hull": sum(
            library.row(i)["piece_method"] == "hull" for i in library.object_ids
        ),
        "seconds_of_work": sum(times),
        "seconds_of_the_slowest": max(times, default=0.0),
    }
    return figures, of_object


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the figures and save them with those of each object."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("library")
    figures, of_object = measure(Library.open(parser.parse_args(arguments).library))
    report("collection", figures, {**figures, "objects": of_object})
    for f in of_object:
        words = _remarks(f)
        if words:
            print(f"{f['object_id']}: {', '.join(words)}")


def _remarks(figures: dict[str, Any]) -> list[str]:
    """What an object is not counted for."""
    ratio = figures["union_to_mesh"]
    return [
        *([] if figures["watertight"] else ["not watertight"]),
        *([f"{figures['hausdorff']:.2%} off"] if figures["hausdorff"] >= NEAR[-1] else []),
        *([f"pieces {ratio:.2f} times the mesh"] if not _within(ratio) else []),
        *([f"MuJoCo: {figures['mujoco_refuses']}"] if figures["mujoco_refuses"] else []),
        *([f"settled in {n} of {DROPS}"] if (n := figures["settled_drops"]) < DROPS else []),
    ]


def _near_one(of_object: Sequence[dict[str, Any]], key: str) -> int:
    return sum(_within(f[key]) for f in of_object)


def _within(ratio: float | None) -> bool:
    return ratio is not None and abs(ratio - 1) <= VOLUME


def _settled(of_object: Sequence[dict[str, Any]], drops: int) -> int:
    return sum(f["settled_drops"] >= drops for f in of_object)


def _quantile(values: np.ndarray, percent: int) -> float:
    return float(np.percentile(values, percent)) if len(values) else 0.0


if __name__ == "__main__":
    main()
