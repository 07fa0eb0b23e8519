"""Splits by object: which objects train and which test.

Objects that have the same shape move together, so that no shape is in two splits. The order is a
hash of (seed, object_id): it depends on nothing but the names, and adding objects moves only those
few that lie at the border.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

SPLITS = ("train", "test")


def split_objects(
    shapes: Mapping[str, str], *, test_fraction: float = 0.2, seed: int = 0
) -> dict[str, str]:
    """Assign every object to `train` or `test`.

    Args:
        shapes: object_id -> hash of its shape; equal hashes stay in one split.
        test_fraction: Share of shapes to test [-]; at least one shape goes to each split where
            there are two. Source: the paper splits objects 4:1.
        seed: Another seed gives another split.

    Returns:
        object_id -> split name.
    """
    if not 0 < test_fraction < 1:
        raise ValueError(f"test_fraction must lie in (0, 1), not {test_fraction}")
    # A group is named by its first object, so that the split does not depend on mesh bytes.
    names: dict[str, str] = {}
    for object_id in sorted(shapes):
        names.setdefault(shapes[object_id], object_id)
    ordered = sorted(names.values(), key=lambda name: _hash(seed, name))
    wanted = round(test_fraction * len(ordered))
    count = min(max(wanted, 1), len(ordered) - 1) if len(ordered) > 1 else 0
    test = set(ordered[:count])
    return {o: "test" if names[shapes[o]] in test else "train" for o in sorted(shapes)}


def _hash(seed: int, name: str) -> str:
    return hashlib.sha256(f"{seed}/{name}".encode()).hexdigest()
