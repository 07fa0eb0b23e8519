"""Scenes whose nodes may be placed many times: counted first, then laid out without recursion."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.objects.config import LoadConfig

from .content import check_instances, unreadable


class Place(NamedTuple):
    """A node and where it stands."""

    node: Any
    T: NDArray[np.float64]
    """Pose in the frame of its parent, or of the world once it is laid out, (4, 4)."""


def placed(
    roots: Sequence[Place],
    children: Callable[[Any], Iterable[Place]],
    is_leaf: Callable[[Any], bool],
    config: LoadConfig,
) -> list[Place]:
    """Lay out a scene: every leaf with its pose in the world, in the order of the file.

    Args:
        roots: Where to begin.
        children: What a node holds; asked once per node.
        is_leaf: Whether a node is what is placed, and has no children.
        config: Bound on the number of places.

    Raises:
        PrepareFailure: A node contains itself, or there are more places than the bound.
    """
    below: dict[Any, list[Place]] = {}
    count: dict[Any, int] = {}
    total = sum(_places(root.node, children, is_leaf, below, count) for root in roots)
    check_instances(total, config)
    found: list[Place] = []
    waiting = list(reversed(roots))
    while waiting:
        node, T = waiting.pop()
        if is_leaf(node):
            found.append(Place(node, T))
            continue
        waiting += [Place(p.node, T @ p.T) for p in reversed(below[node])]
    return found


def _places(
    root: Any,
    children: Callable[[Any], Iterable[Place]],
    is_leaf: Callable[[Any], bool],
    below: dict[Any, list[Place]],
    count: dict[Any, int],
) -> int:
    """Nodes that the layout would visit below a root, however often each is placed.

    Fills in `below` and `count` for every node that is reached; each place is looked at once.
    """
    open_: dict[Any, Iterator[Place]] = {}
    """Nodes from the root to where the search is, with the places not looked at yet."""

    def enter(node: Any) -> None:
        below[node] = [] if is_leaf(node) else list(children(node))
        open_[node] = iter(below[node])

    if root not in count:
        enter(root)
    while open_:
        node, rest = next(reversed(open_.items()))
        child = next((p.node for p in rest if p.node not in count), None)
        if child is None:
            count[node] = 1 + sum(count[p.node] for p in below[node])
            open_.popitem()
        elif child in open_:
            raise unreadable("a node of its scene contains itself")
        else:
            enter(child)
    return count[root]
