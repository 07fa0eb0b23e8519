"""Rows of a release by number: the columns that a batch needs, wherever each of them is kept."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Int

from bidexdata.errors import UnknownName
from bidexdata.formats import hdf5
from bidexdata.formats.tables import ARM_COLUMNS
from bidexdata.loaders.stored import (
    OF_SCENE,
    FloatRows,
    Rows,
    ScalarColumns,
    arm_floats,
    arm_integers,
    float_values,
    integer_rows,
    refuse_arms,
)
from bidexdata.record import FIELDS

_PAGE = 4096
"""Bytes of a page of memory; larger pages are touched more than once, which costs nothing."""


class RowSource:
    """Copies some columns of some rows.

    State: mapped or read columns. Text is kept as Arrow keeps it, and only where it is asked for.
    """

    def __init__(self, scalars: ScalarColumns, names: Sequence[str]):
        """Open columns.

        Args:
            scalars: The scalar columns of the configuration and split.
            names: Columns of grasps, contacts and arms; `size` is there in any release.

        Raises:
            UnknownName: There is no such column.
            NotUsable: The release has no columns of arms.
        """
        refuse_arms(scalars.release, names)
        self._scalars, self._index = scalars, scalars.index
        names = tuple(dict.fromkeys(names))
        self._floats = self._open_floats(names)
        floats = {n for table in self._floats for n in table.names}
        self._sizes = "size" in names and "size" not in floats
        self._of_scene = [n for n in names if n in OF_SCENE]
        rest = [n for n in names if n not in floats and n not in OF_SCENE and n != "size"]
        text = [n for n in rest if n in scalars and scalars.is_text(n)]
        self._text = {n: scalars.arrow(n) for n in text}
        whole = [n for n in rest if n not in text]
        self._flags = {n for n in whole if n in scalars and scalars.is_boolean(n)}
        place = (scalars.release, scalars.configuration, scalars.splits)
        of_arms = [n for n in whole if n in ARM_COLUMNS]
        self._whole: dict[str, Rows] = {
            **integer_rows(*place, [n for n in whole if n not in of_arms]),
            **arm_integers(*place, of_arms),
        }

    def take(
        self, rows: Int[np.ndarray, " n"]
    ) -> tuple[dict[str, np.ndarray], dict[str, list[str]]]:
        """Copy the columns of some rows: arrays, (n, ...), and text."""
        found: dict[str, np.ndarray] = {}
        for table in self._floats:
            found |= table.take(rows)
        for name, whole in self._whole.items():
            values = whole.take(rows)
            found[name] = values > 0 if name in self._flags else values
        if self._sizes:
            found["size"] = (self._index.size_mm[rows] / 1000).astype(np.float32)
        text = {name: column.take(rows).to_pylist() for name, column in self._text.items()}
        for name in self._of_scene:
            if name == "size_mm":
                found[name] = self._index.size_mm.take(rows)
            else:
                text[name] = self._scene_text(name, rows)
        return found, text

    def warm(self) -> int:
        """Read a byte of every page of the mapped arrays; gives the bytes that are mapped."""
        total = 0
        arrays = [a for table in self._floats for a in table.parts]
        for array in [*arrays, *(a for rows in self._whole.values() for a in rows.arrays)]:
            if isinstance(array, np.memmap) and array.size:
                total += array.nbytes
                array.reshape(-1).view(np.uint8)[::_PAGE].max()
        return total

    def _open_floats(self, names: Sequence[str]) -> list[FloatRows]:
        scalars, left = self._scalars, [n for n in names if n not in OF_SCENE]
        place = (scalars.release, scalars.configuration)
        found: list[FloatRows] = []
        own = set(ARM_COLUMNS) if scalars.release.rig else set()
        of_arms = [n for n in left if n in own and FIELDS[n].dtype == "float32"]
        if of_arms:
            opened = [arm_floats(*place, split, of_arms) for split in scalars.splits]
            found.append(FloatRows(opened, of_arms))
            left = [n for n in left if n not in of_arms]
        known = {*own, *(n for n in scalars if not scalars.is_float(n)), *hdf5.INTEGER_LISTS}
        for part in (hdf5.VALUES, hdf5.CONTACTS):
            if all(n in known for n in left):
                break
            opened = [float_values(*place, split, part) for split in scalars.splits]
            known |= set(opened[0].columns)
            mine = [n for n in left if n in opened[0].columns]
            left = [n for n in left if n not in mine]
            if mine:
                found.append(FloatRows(opened, mine))
        known |= {*scalars, "size"}
        for name in left:
            if name not in known:
                raise UnknownName("field", name, sorted(known))
        return found

    def _scene_text(self, name: str, rows: np.ndarray) -> list[str]:
        index: Any = self._index
        if name == "object_id":
            ids: Sequence[str] = self._scalars.release.object_ids
            return [ids[k] for k in index.object_index[rows].tolist()]
        if name == "scene_id":
            return [index.scene_ids[k] for k in index.scene_index[rows].tolist()]
        return ["tabletop" if t else "floating" for t in index.tabletop[rows].tolist()]
