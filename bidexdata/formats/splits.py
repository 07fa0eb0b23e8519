"""Which rows train and which test: by object, by category or by size.

Objects that have the same shape move together, so that no shape is in two splits, unless the split
is by size. The order is a hash of (seed, name): it depends on nothing but the names, and adding
objects moves only those few that lie at the border.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np

from bidexdata.errors import NotUsable, UnknownChoice
from bidexdata.objects.sources.item import UNKNOWN
from bidexdata.wording import counted

SPLITS = ("train", "test")
ALL = "all"
"""Split of an object whose sizes lie in different splits."""
TEST_FRACTION = 0.2
"""Share of objects, categories or sizes to test [-]. Source: the paper splits objects 4:1."""

By = Literal["object", "category", "size"]


@dataclass(frozen=True, slots=True)
class Splitting:
    """Where the rows of each object go, and by which rule."""

    by: str
    objects: Mapping[str, str]
    """object_id -> split, or `ALL` where its sizes decide."""
    sizes: Mapping[int, str] = field(default_factory=dict)
    """size_mm -> split; empty but for a split by size."""
    about: Mapping[str, Any] = field(default_factory=dict)
    """What the manifest says beside `by`: seed and share."""

    def of(self, object_id: str, size_mm: int) -> str:
        """Split of one scene."""
        split = self.objects[object_id]
        return self.sizes[size_mm] if split == ALL else split

    def masks(self, object_id: str, size_mm: np.ndarray) -> dict[str, np.ndarray]:
        """Rows of one object in each split that may hold some, by the sizes of the rows, (N,)."""
        split = self.objects[object_id]
        if split != ALL:
            return {split: np.ones(len(size_mm), bool)}
        where = np.array([self.sizes[int(s)] for s in size_mm], str)
        return {name: where == name for name in SPLITS}

    def counts(self, scenes: Iterable[tuple[str, int]]) -> list[list[Any]]:
        """Objects per split, in the order of `SPLITS`, as the manifest states them.

        Args:
            scenes: object_id and size_mm of every scene.
        """
        found: dict[str, set[str]] = {name: set() for name in SPLITS}
        for object_id, split in self.objects.items():
            if split != ALL:
                found[split].add(object_id)
        for object_id, size_mm in scenes:
            found[self.of(object_id, size_mm)].add(object_id)
        return [[name, len(found[name])] for name in SPLITS]

    def manifest(self) -> dict[str, Any]:
        """What the manifest says of the split."""
        sizes = {str(mm): split for mm, split in sorted(self.sizes.items())}
        return {"by": self.by, **self.about, **({"sizes": sizes} if sizes else {})}


def split_rows(
    by: str,
    objects: Sequence[Mapping[str, Any]],
    sizes: Collection[int] = (),
    *,
    test_fraction: float = TEST_FRACTION,
    seed: int = 0,
) -> Splitting:
    """Split a release by one of three rules.

    Args:
        by: `object`; `category`, where whole categories train or test and objects without one
            train; or `size`, where whole sizes do, so that objects are in both splits.
        objects: Rows of the objects table: object_id, shape_sha256, category.
        sizes: Every `size_mm` that there is; read for a split by size.
        test_fraction: Share of shapes, categories or sizes to test [-].
        seed: Another seed gives another split.

    Raises:
        UnknownChoice: No such rule.
        NotUsable: There are not two categories or sizes to tell apart.
    """
    check_rule(by)
    shapes = {str(row["object_id"]): str(row["shape_sha256"]) for row in objects}
    about = {"seed": seed, "test_fraction": test_fraction}
    if by == "object":
        found = split_objects(shapes, test_fraction=test_fraction, seed=seed)
        return Splitting(by, found, about=about)
    if by == "category":
        categories = {str(row["object_id"]): str(row["category"]) for row in objects}
        return Splitting(by, _by_category(shapes, categories, test_fraction, seed), about=about)
    found = {str(size): size for size in sorted(set(sizes))}
    if len(found) < 2:
        raise NotUsable(
            f"--split size needs two sizes or more, and there is {counted(len(found), 'size')}; "
            "--split object takes any"
        )
    test = _tested(list(found), test_fraction, seed)
    where = {size: "test" if name in test else "train" for name, size in found.items()}
    return Splitting(by, dict.fromkeys(sorted(shapes), ALL), where, about)


def check_rule(by: str) -> None:
    """Refuse a rule that there is not.

    Raises:
        UnknownChoice: No rule is called so.
    """
    if by not in get_args(By):
        raise UnknownChoice("--split", by, get_args(By))


def split_objects(
    shapes: Mapping[str, str], *, test_fraction: float = TEST_FRACTION, seed: int = 0
) -> dict[str, str]:
    """Assign every object to `train` or `test`.

    Args:
        shapes: object_id -> hash of its shape; equal hashes stay in one split.
        test_fraction: Share of shapes to test [-]; at least one shape goes to each split where
            there are two.
        seed: Another seed gives another split.

    Returns:
        object_id -> split name.
    """
    # A group is named by its first object, so that the split does not depend on mesh bytes.
    names: dict[str, str] = {}
    for object_id in sorted(shapes):
        names.setdefault(shapes[object_id], object_id)
    test = _tested(list(names.values()), test_fraction, seed)
    return {o: "test" if names[shapes[o]] in test else "train" for o in sorted(shapes)}


def _by_category(
    shapes: Mapping[str, str], categories: Mapping[str, str], test_fraction: float, seed: int
) -> dict[str, str]:
    known = sorted(set(categories.values()) - {UNKNOWN, ""})
    if len(known) < 2:
        raise NotUsable(
            f"--split category needs objects of two categories or more, and of "
            f"{counted(len(shapes), 'object')} {counted(len(known), 'category', 'categories')} are "
            "stated; a list file's column `category` states them (docs/sources.md)"
        )
    # Categories that share a shape are one group, named by its first.
    group = {name: name for name in known}
    first: dict[str, str] = {}
    for object_id in sorted(shapes):
        name = categories[object_id]
        if name in group:
            other = first.setdefault(shapes[object_id], name)
            low, high = sorted((group[other], group[name]))
            group = {k: low if v == high else v for k, v in group.items()}
    test = _tested(sorted(set(group.values())), test_fraction, seed)
    # An object without a category goes where its shape is, or trains.
    where = {shape: group[name] for shape, name in first.items()}
    return {o: "test" if where.get(shapes[o]) in test else "train" for o in sorted(shapes)}


def _tested(names: Sequence[str], test_fraction: float, seed: int) -> set[str]:
    """The names that test: a share of them, and at least one in each split where there are two."""
    if not 0 < test_fraction < 1:
        raise ValueError(f"test_fraction must lie in (0, 1), not {test_fraction}")
    ordered = sorted(names, key=lambda name: _hash(seed, name))
    wanted = round(test_fraction * len(ordered))
    count = min(max(wanted, 1), len(ordered) - 1) if len(ordered) > 1 else 0
    return set(ordered[:count])


def _hash(seed: int, name: str) -> str:
    return hashlib.sha256(f"{seed}/{name}".encode()).hexdigest()
