"""Columns of a byte a row, for all rows of a configuration: statuses, flags and `suc_*`.

Mapped from the training form where there is one, else read from the Parquet tables row group by
row group; either way one byte a row is all that is held.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Int

from bidexdata.formats.hdf5 import map_columns
from bidexdata.formats.release import Release


def byte_column(
    release: Release, configuration: str, name: str, table: str = "grasps"
) -> Int[np.ndarray, " N"]:
    """Read an int8 column of all rows, or of `grasps` a boolean one, splits in the release's order.

    Args:
        release: Opened.
        configuration: `selected` or `audit`.
        name: The column.
        table: `grasps`, or `verdicts/<protocol>-<test>`, which is read and not mapped.

    Returns:
        int8; -1 where a boolean is null.

    Raises:
        Contradiction: A file is damaged.
        UnknownName: The grasps have no such column.
    """
    if table == "grasps":
        parts = [
            map_columns(release.path, configuration, split, [name])[name]
            for split in release.split_names
        ]
    else:
        groups = release.row_groups(table, configuration, None, [name])
        parts = [group.column(name).to_numpy() for group in groups]
    return np.concatenate(parts or [np.zeros(0, np.int8)]).astype(np.int8, copy=False)
