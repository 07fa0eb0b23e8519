"""What a release holds beside rows, objects and hands, and who writes it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from bidexdata.formats.hand_files import write_hand
from bidexdata.formats.object_pass import EachObject, ObjectPass, ObjectRow
from bidexdata.record import HandHeader

if TYPE_CHECKING:
    from bidexdata.hands.model import Hand


@runtime_checkable
class StoredParts(Protocol):
    """Writes objects and hands into a release, wherever they come from."""

    @property
    def hands(self) -> tuple[HandHeader, ...]:
        """The H axis."""
        ...

    @property
    def cloud_points(self) -> int:
        """Points per object and cloud."""
        ...

    def each_object(self, one: ObjectPass, ids: Sequence[str]) -> Iterable[tuple[str, ObjectRow]]:
        """Do the pass for all objects; see `object_pass.EachObject`."""
        ...

    def write_hands(self, root: Path) -> None:
        """Write the files of the hands."""
        ...


class PreparedParts:
    """Objects and hands as runs have them."""

    def __init__(self, hands: Sequence[Hand], each: EachObject, cloud_points: int):
        self._hands, self._each = tuple(hands), each
        self.hands = tuple(hand.header() for hand in hands)
        self.cloud_points = cloud_points

    def each_object(self, one: ObjectPass, ids: Sequence[str]) -> Iterable[tuple[str, ObjectRow]]:
        """Write every object's files and clouds; give their rows."""
        return self._each(one, ids)

    def write_hands(self, root: Path) -> None:
        """Write the files of the hands."""
        for hand in self._hands:
            write_hand(root, hand)
