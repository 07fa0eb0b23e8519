"""Statistics of the float columns: count, mean, deviation, smallest and largest of every component.

Over the selected rows of each split, for normalisation in training: take those of `train`. Numbers
that are not finite (padding, nothing measured) are left out. `statistics.json` of a release holds
them; `read_statistics` gives them as arrays.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.config import canonical_json
from bidexdata.errors import Contradiction
from bidexdata.formats.content_hash import number_bytes

if TYPE_CHECKING:
    import pyarrow as pa

    from bidexdata.formats.release import Release

STATISTICS = "statistics.json"
CONFIGURATION = "selected"
DIGITS = 9
"""Decimal digits that are written: all of a float32, none of the noise of sums."""


class ColumnStatistics(NamedTuple):
    """Of every component of a column, in the column's shape after N, float64."""

    n: NDArray[np.int64]
    """Finite numbers."""
    mean: NDArray[np.float64]
    std: NDArray[np.float64]
    """Square root of the mean squared deviation; NaN where there is no number."""
    min: NDArray[np.float64]
    max: NDArray[np.float64]


class StatisticsTally:
    """Add the rows of one split in order, then read `columns()`.

    State: count, mean, sum of squared deviations and extremes per component.
    """

    def __init__(self) -> None:
        self._sums: dict[str, _Sums] = {}

    def add(self, table: pa.Table) -> None:
        """Add rows; columns that are no floats are passed over."""
        import pyarrow as pa

        for field in table.schema:
            is_list = pa.types.is_fixed_size_list(field.type)
            kind = field.type.value_type if is_list else field.type
            if pa.types.is_float32(kind):
                width = field.type.list_size if is_list else 1
                parts = [number_bytes(chunk) for chunk in table.column(field.name).chunks]
                values = np.concatenate([*parts, np.zeros(0, np.float32)]).reshape(-1, width)
                sums = self._sums.setdefault(field.name, _Sums.none(width))
                self._sums[field.name] = sums.plus(_Sums.of(values))

    def columns(self) -> dict[str, dict[str, list[Any]]]:
        """Plain data per column, components row-major; null where there is no number."""
        return {name: self._sums[name].plain() for name in sorted(self._sums)}


class _Sums(NamedTuple):
    n: NDArray[np.int64]
    mean: NDArray[np.float64]
    squares: NDArray[np.float64]
    """Sum of squared deviations from the mean."""
    low: NDArray[np.float64]
    high: NDArray[np.float64]

    @classmethod
    def none(cls, width: int) -> _Sums:
        zero = np.zeros(width)
        return cls(np.zeros(width, np.int64), zero, zero, zero + np.inf, zero - np.inf)

    @classmethod
    def of(cls, values: NDArray[np.float32]) -> _Sums:
        if not len(values):
            return cls.none(values.shape[1])
        finite = np.isfinite(values)
        n = finite.sum(axis=0)
        wide = np.where(finite, values, 0).astype(np.float64)
        mean = wide.sum(axis=0) / np.maximum(n, 1)
        deviation = np.where(finite, wide - mean, 0)
        squares = (deviation * deviation).sum(axis=0)
        low = np.where(finite, wide, np.inf).min(axis=0)
        high = np.where(finite, wide, -np.inf).max(axis=0)
        return cls(n, mean, squares, low, high)

    def plus(self, other: _Sums) -> _Sums:
        """Join disjoint sets (Chan, Golub and LeVeque)."""
        n = self.n + other.n
        share = other.n / np.maximum(n, 1)
        apart = other.mean - self.mean
        mean = self.mean + apart * share
        squares = self.squares + other.squares + apart**2 * self.n * share
        low, high = np.minimum(self.low, other.low), np.maximum(self.high, other.high)
        return _Sums(n, mean, squares, low, high)

    def plain(self) -> dict[str, list[Any]]:
        std = np.sqrt(self.squares / np.maximum(self.n, 1))
        figures = {"mean": self.mean, "std": std, "min": self.low, "max": self.high}
        return {
            "count": self.n.tolist(),
            **{
                k: [_digits(x, n) for x, n in zip(v.tolist(), self.n.tolist(), strict=True)]
                for k, v in figures.items()
            },
        }


def write_statistics(root: Path, splits: Mapping[str, StatisticsTally]) -> None:
    """Write `statistics.json`."""
    found = {name: tally.columns() for name, tally in splits.items()}
    text = canonical_json({"configuration": CONFIGURATION, "splits": found})
    (root / STATISTICS).write_text(text + "\n", encoding="utf-8")


def read_statistics(release: Release, split: str = "train") -> dict[str, ColumnStatistics]:
    """Statistics of the float columns of grasps and contacts, selected rows of one split.

    Releases of schema 1.2 or before have none: an empty dict.

    Raises:
        Contradiction: The file is damaged.
    """
    path = release.path / STATISTICS
    if not path.is_file():
        return {}
    try:
        columns = json.loads(path.read_text(encoding="utf-8"))["splits"][split]
        return {name: _arrays(release, name, plain) for name, plain in columns.items()}
    except (OSError, ValueError, KeyError, TypeError) as err:
        raise Contradiction(f"{path}: damaged statistics ({err!r})") from err


def _arrays(release: Release, name: str, plain: Mapping[str, list[Any]]) -> ColumnStatistics:
    from bidexdata.formats.tables import column_field

    shape = release.header.shape(column_field(name))
    count = np.array(plain["count"], np.int64).reshape(shape)
    rest = (np.array(plain[k], np.float64).reshape(shape) for k in ("mean", "std", "min", "max"))
    return ColumnStatistics(count, *rest)


def _digits(value: float, n: int) -> float | None:
    return float(f"{value:.{DIGITS}g}") if n else None
