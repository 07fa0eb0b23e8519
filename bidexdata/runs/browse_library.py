"""Look into a library: objects, no grasps."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from bidexdata.errors import NotUsable
from bidexdata.kinds import Kind
from bidexdata.record import GraspBatch
from bidexdata.record.status import Status
from bidexdata.runs.chosen import refuse_other_rig

if TYPE_CHECKING:
    from bidexdata.arms.robot import Robot
    from bidexdata.hands.model import Hand
    from bidexdata.objects.library import Library
    from bidexdata.objects.prepared import Solid
    from bidexdata.runs.release_rows import ReleaseRowsIndex


class LibrarySource:
    """Objects of a library; there are no grasps."""

    kind: Kind = "library"
    test = protocol = ""
    tests: tuple[str, ...] = ()

    def __init__(self, path: Path, protocol: str | None = None, rig: str | Path | None = None):
        from bidexdata.objects.library import Library

        refuse_other_rig(path, "", rig)
        if protocol is not None:
            raise NotUsable(f"{path} is a library: it has no verdicts of {protocol!r}")
        self.path = path
        self.library: Library = Library.open(path)

    @property
    def object_ids(self) -> tuple[str, ...]:
        """Objects, sorted."""
        return tuple(sorted(self.library.object_ids))

    def categories(self) -> tuple[str, ...]:
        """As the library's index has them."""
        return library_categories(self.library, self.object_ids)

    def load_solid(self, object_id: str) -> Solid:
        """Read one object."""
        return self.library.load_solid(object_id)

    def index(self) -> ReleaseRowsIndex | None:
        """None: there are no rows."""
        return None

    def grasps(self, object_id: str, test: str = "") -> GraspBatch | None:
        """None: a library holds no grasps."""
        return None

    def hands(self) -> tuple[Hand, ...]:
        """No hands."""
        return ()

    @property
    def rig(self) -> str:
        """None."""
        return ""

    def arms(self, object_id: str) -> GraspBatch | None:
        """None: a library holds no grasps."""
        return None

    def robot(self) -> Robot | None:
        """None."""
        return None


def library_categories(library: Library, object_ids: Iterable[str]) -> tuple[str, ...]:
    """Category of each object as a library's index has it; empty where none is known."""
    names = ("object_id", "status", "category")
    rows = zip(*(library.index.column(n).to_pylist() for n in names), strict=True)
    known = {object_id: category for object_id, status, category in rows if status == Status.OK}
    return tuple(known.get(object_id) or "" for object_id in object_ids)
