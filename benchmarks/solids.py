"""How exact grids and rest poses are: `python -m benchmarks.solids LIBRARY`.

Grids: distances read from the stored grid against exact ones at points within 3 % of the diagonal
of the surface. Rest poses: probabilities estimated in several ways against 1200 drops in random
orientations, by total variation (half the sum of the absolute differences). Likeness: difference of
the descriptors of an object and of a turned, newly sampled copy, and of different objects. About 15 s of a core
an object, most of it for the reference.
"""

from __future__ import annotations

import argparse
import time
import zlib
from typing import Any

import numpy as np

from bidexdata import Library
from bidexdata.frames import matrix_from_quat, random_quat
from bidexdata.objects.config import RestConfig, SurfaceConfig
from bidexdata.objects.distance_field import signed_distance
from bidexdata.objects.drops import Body, drop, spread_directions
from bidexdata.objects.prepared import PreparedObject
from bidexdata.objects.rest import carrying_facets, rest_poses
from bidexdata.objects.sdf import exact_distances
from bidexdata.objects.surface import sample_surface, surface_points
from bidexdata.objects.traits import descriptor, unlikeness

NEAR = 0.03
"""Of the diagonal."""
REFERENCE = 1200
"""Drops; their own error of sampling is 0.03 in the mean over the 24 objects of the docs."""
CONFIG = RestConfig()


def grid_error(obj: PreparedObject, count: int = 20_000) -> dict[str, float]:
    """Errors in per cent of the diagonal, and the size of the grid."""
    rng = np.random.default_rng(0)
    points, _ = sample_surface(obj.solid, count, rng)
    step = rng.standard_normal((count, 3))
    points += rng.uniform(0, NEAR, (count, 1)) * step / np.linalg.norm(step, axis=1)[:, None]
    exact = exact_distances(obj.solid, obj.pieces, points)
    read, _ = signed_distance(obj.sdf, 1.0, points)
    error = 100 * np.abs(read - exact)
    wrong = ((read < 0) != (exact < 0)) & (np.abs(exact) > 0.0025)
    return {
        "p99_percent": float(np.percentile(error, 99)),
        "max_percent": float(error.max()),
        "wrong_signs": int(wrong.sum()),
        "cells_on_diagonal": 1 / obj.sdf.cell,
        "megabytes": len(zlib.compress(obj.sdf.values.tobytes(), 4)) / 1e6,
    }


def rest_error(obj: PreparedObject) -> dict[str, float]:
    """Total variation of estimates, and processor seconds of the one in use."""
    body = Body(obj.hull, obj.volume, obj.inertia)
    start = time.process_time()
    rest_poses(body, CONFIG)
    seconds = time.process_time() - start
    facets = carrying_facets(body.hull, CONFIG)
    if not len(facets.normals):
        return {"seconds": seconds}

    def counts(directions: Any) -> Any:
        settings = {"height": CONFIG.drop_height, "angle": CONFIG.flat, "seconds": CONFIG.seconds}
        downs = drop(body, directions, facets.normals, **settings).downs
        return np.bincount(np.argmax(downs @ facets.normals.T, axis=1), minlength=len(hull))

    def scattered(count: int, seed: int) -> Any:
        drawn = np.random.default_rng(seed).standard_normal((count, 3))
        return drawn / np.linalg.norm(drawn, axis=1, keepdims=True)

    hull = facets.shares
    reference = counts(scattered(REFERENCE, 1)) / REFERENCE

    def away(estimate: Any) -> float:
        return float(np.abs(estimate - reference).sum() / 2)

    made = {"120 random": counts(scattered(120, 2))}
    for drops in (48, 120, 240):
        made[f"{drops} even"] = counts(spread_directions(drops, np.random.default_rng(0)))
    row = {"seconds": seconds, "hull alone": away(hull)}
    for name, found in made.items():
        for prior in (0, 12, 48):
            estimate = (found + prior * hull) / (found.sum() + prior)
            row[f"{name}, prior {prior}"] = away(estimate)
    return row


def likeness(obj: PreparedObject) -> tuple[Any, float]:
    """The descriptor, and how far that of a turned and newly sampled copy is from it."""
    rng = np.random.default_rng(3)
    turned = obj.solid._replace(vertices=obj.solid.vertices @ matrix_from_quat(random_quat(rng)).T)
    points, _ = surface_points(turned, SurfaceConfig(seed=5))
    own = descriptor(obj.surface_points, obj.solid)
    return own, float(unlikeness(own, descriptor(points, turned)[None])[0])


def main(path: str) -> None:
    """Print one line per object, the means, and how alike the objects are."""
    library = Library.open(path)
    grids, rests, shapes = [], [], []
    for object_id in library.object_ids:
        obj = library.load(object_id)
        grids.append(grid_error(obj))
        rests.append(rest_error(obj))
        shapes.append(likeness(obj))
        line = {**grids[-1], "rest_seconds": rests[-1]["seconds"]}
        print(object_id, ", ".join(f"{k} {v:.3g}" for k, v in line.items()), flush=True)
    for rows in (grids, rests):
        for key in max(rows, key=len):
            values = [row[key] for row in rows if key in row]
            print(f"{key:>24}  mean {np.mean(values):.3g}  max {np.max(values):.3g}")
    known = np.array([own for own, _ in shapes])
    apart = [unlikeness(own, np.delete(known, k, 0)).min() for k, own in enumerate(known)]
    print(f"{'descriptors of copies':>24}  max {max(away for _, away in shapes):.3g}")
    print(f"{'of different objects':>24}  min {np.min(apart):.3g}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("library")
    main(parser.parse_args().library)
