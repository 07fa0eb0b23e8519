"""Laws of scene layouts: the poses multiply, the order is the file's, the work grows with the places."""

from __future__ import annotations

import numpy as np
import pytest

from bidexdata.objects.config import LoadConfig
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.readers.scene import Place, placed

COUNT = 3000


class Node(int):
    """A node that counts how often any of them is looked up."""

    looked_up = 0

    def __hash__(self):
        Node.looked_up += 1
        return int(self)


def layout(below: dict[int, list[int]], roots=(0,)) -> list[int]:
    """Leaves are the nodes without an entry."""
    Node.looked_up = 0
    config = LoadConfig(max_instances=2 * COUNT + 2)
    step = np.eye(4)
    step[0, 3] = 1.0
    found = placed(
        [Place(Node(r), np.eye(4)) for r in roots],
        lambda node: [Place(Node(c), step) for c in below[int(node)]],
        lambda node: int(node) not in below,
        config,
    )
    return [int(place.node) for place in found]


@pytest.mark.parametrize(
    ("below", "roots"),
    [
        ({0: [*range(1, COUNT)]} | {k: [COUNT] for k in range(1, COUNT)}, (0,)),  # one wide parent
        ({k: [k + 1] for k in range(COUNT)}, (0,)),  # a chain
        ({0: [1] * COUNT}, (0,)),  # one part placed often
        ({0: [1], 1: [2]}, (0,) * (COUNT // 2)),  # many roots of one tree
    ],
)
def test_each_place_is_looked_at_once(below, roots):
    places = len(layout(below, roots))
    edges = sum(map(len, below.values()))
    assert Node.looked_up < 20 * (edges + len(below) + len(roots) + places)


def test_leaves_come_in_the_order_of_the_file():
    assert layout({0: [1, 2, 1], 1: [3, 4], 2: [4]}) == [3, 4, 4, 3, 4]


@pytest.mark.parametrize("below", [{0: [0]}, {0: [1], 1: [2], 2: [9, 1]}, {0: [2, 1], 1: [0]}])
def test_a_node_that_contains_itself_is_refused(below):
    with pytest.raises(PrepareFailure, match="contains itself"):
        layout(below)
