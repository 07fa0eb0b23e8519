"""What a release holds of each object: its folder, its two clouds and its row of the table.

One object needs no other, so the caller may spread them over processes: an `ObjectPass` is a small
value that can be sent to them, and each fills its own places of the files.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bidexdata.formats import clouds
from bidexdata.formats.object_table import object_row, shape_hash
from bidexdata.objects.library import object_folder
from bidexdata.objects.storage import solid_files

if TYPE_CHECKING:
    from bidexdata.objects.prepared import PreparedObject, Solid, TriangleMesh

NO_CLOUD = -1
"""`cloud_index` of an object in a release without clouds."""
ObjectRow = dict[str, Any]
EachObject = Callable[["ObjectPass", Sequence[str]], Iterable[tuple[str, ObjectRow]]]
"""Does the pass for all objects, in any order and place; gives (object_id, row) pairs."""


@dataclass(frozen=True, slots=True)
class ObjectPass:
    """Where objects go."""

    root: Path
    """The release in the making."""
    points: int
    """Per object and cloud."""
    shapes: bool = True
    """Whether folders and clouds are written; objects have rows alone if not."""

    def begin(self, objects: int) -> None:
        """Make the cloud files, to be filled in by number: (objects, points, 3) float32."""
        if not self.shapes:
            return
        (self.root / "clouds").mkdir()
        for kind in clouds.CLOUDS:
            shape = (objects, self.points, 3)
            np.lib.format.open_memmap(self._cloud(kind), "w+", np.float32, shape).flush()

    def write(self, number: int, obj: Solid, union: TriangleMesh) -> ObjectRow:
        """Write the files and clouds of one object; give its row of the objects table.

        Args:
            number: Of the object, in the order of their ids.
            obj: The object.
            union: Surface of the union of its pieces.
        """
        row = object_row(obj, shape_hash(obj))
        if not self.shapes:
            return {**row, "cloud_index": NO_CLOUD}
        folder = self.root / object_folder(obj.object_id)
        folder.mkdir(parents=True, exist_ok=True)
        for name, data in solid_files(obj).items():  # the whole release is synced once, at its end
            (folder / name).write_bytes(data)
        for kind, mesh in zip(clouds.CLOUDS, (union, obj.mesh), strict=True):
            at = (mesh.vertices, mesh.faces, self.points, f"{obj.object_id}/{kind}")
            self.fill(number, kind, clouds.surface_cloud(*at))
        return row

    def fill(self, number: int, kind: str, cloud: NDArray[np.float32]) -> None:
        """Put a cloud, (points, 3), in its place."""
        array = np.lib.format.open_memmap(self._cloud(kind), "r+")
        array[number] = cloud
        del array

    def _cloud(self, kind: str) -> Path:
        return self.root / "clouds" / f"{kind}.npy"


def one_by_one(load_object: Callable[[str], PreparedObject] | None) -> EachObject:
    """Do the pass here, object after object; None where something else does it."""

    def each(one: ObjectPass, ids: Sequence[str]) -> Iterable[tuple[str, ObjectRow]]:
        assert load_object is not None
        for number, object_id in enumerate(ids):
            obj = load_object(object_id)
            yield object_id, one.write(number, obj, obj.solid)

    return each
