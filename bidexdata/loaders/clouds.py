"""Point clouds of a batch: stored once per object at unit diagonal, given at each grasp's size."""

from __future__ import annotations

import sys
import threading
import warnings
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bidexdata.errors import BadConfig

if TYPE_CHECKING:
    from bidexdata.formats.release import Release


SCALED_BYTES = 256 * 2**20
"""Memory that clouds at their sizes may take; with more kinds of cloud they are scaled per batch.
Ours: 2,000 objects at eleven sizes with 1,000 points."""


_MOST_BUFFERS = 8
"""More batches than a prefetch thread and a trainer hold at once."""
_LINE = 16
"""Floats of a cache line. Measured (AMD Zen 4): where a cloud and its copy begin at places of their
pages that differ by a few bytes, as those of new arrays do, the copy takes twice as long."""


class CloudRows:
    """The clouds of all objects of a release, mapped from disk where all their points are wanted.

    State: where few enough kinds of cloud (object, size) are known, those that were asked for are
    kept at their size, so that a batch is one plain copy.
    """

    def __init__(self, release: Release, kind: str, points: int):
        """Open a cloud file.

        Raises:
            BadConfig: Fewer points are stored than asked for.
        """
        import torch

        stored = release.cloud(kind)
        if points > stored.shape[1]:
            raise BadConfig(f"points={points}, but the release stores {stored.shape[1]} per object")
        chosen = np.ascontiguousarray(stored[:, :points]).reshape(len(stored), 3 * points)
        with warnings.catch_warnings():
            # A mapped file cannot be written, and nothing here does.
            warnings.simplefilter("ignore", UserWarning)
            self._flat = torch.from_numpy(chosen)
        self.points, self._width = points, 3 * points
        self._kept: _Scaled | None = None
        self._all_filled = False
        self._buffers = _Buffers()

    def keep(self, objects: Int[np.ndarray, " K"], sizes: Float[np.ndarray, " K"]) -> bool:
        """Make room for kinds of cloud at their sizes, if that is not too much memory.

        Args:
            objects: Object of each kind.
            sizes: Its size [m], float32.
        """
        if len(objects) * self._flat.shape[1] * 4 > SCALED_BYTES:
            return False
        self._kept = _Scaled(
            np.asarray(sizes, np.float32),
            np.asarray(objects, np.int64),
            _Buffers().take((len(objects), self._flat.shape[1])),
            np.zeros(len(objects), bool),
        )
        return True

    def at_size(
        self,
        objects: Int[np.ndarray, " n"],
        sizes: Float[np.ndarray, " n"],
        kind: Int[np.ndarray, " n"] | None = None,
    ) -> Float[np.ndarray, "n P 3"]:
        """Clouds of some objects, multiplied by their sizes [m].

        Args:
            objects: Their numbers.
            sizes: [m], float32.
            kind: Number of each among what `keep` was given.
        """
        kept = self._kept
        # Bytes are compared: two calls in place of four, and sizes are no NaN and no negative zero.
        if kept is None or kind is None or kept.sizes.take(kind).tobytes() != sizes.tobytes():
            # A view into rows of many columns is no plain array, which the gather wants.
            return self._scaled(objects, np.ascontiguousarray(sizes)).reshape(-1, self.points, 3)
        if not (self._all_filled or kept.filled.take(kind).all()):
            new = np.unique(kind[~kept.filled[kind]])
            kept.clouds[new] = self._scaled(kept.objects[new], kept.sizes[new])
            kept.filled[new] = True
            self._all_filled = bool(kept.filled.all())
        out = self._buffers.take((len(kind), self._width))
        # Numbers of kinds are in range, and only this mode writes to `out` without a buffer.
        kept.clouds.take(kind, 0, out, "clip")
        return out.reshape(-1, self.points, 3)

    def _scaled(
        self, objects: Int[np.ndarray, " n"], sizes: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "n W"]:
        """Gather and scale in one pass: what an embedding bag of one weighted row each computes."""
        import torch

        found = torch.embedding_bag(
            self._flat,
            torch.from_numpy(objects),
            torch.arange(len(objects)),
            per_sample_weights=torch.from_numpy(sizes),
        )[0]
        return found.numpy()


class _Buffers:
    """Memory of past batches, given out again when nobody holds it or a view of it.

    New memory costs a fault per page, which is about as much as the copy of a batch.
    """

    def __init__(self) -> None:
        self._held = [np.empty(0, np.float32)]
        self._starts = [0]
        self._idle = self._references()[0]
        self._lock = threading.Lock()

    def take(self, shape: tuple[int, int]) -> np.ndarray:
        """An array with any content, which is the caller's until it lets go of it."""
        size = shape[0] * shape[1]
        with self._lock:
            for k, references in enumerate(self._references()):
                if references == self._idle and self._held[k].size == size + _LINE:
                    break
            else:
                made = np.empty(size + _LINE, np.float32)
                self._held = [*self._held[-_MOST_BUFFERS + 1 :], made]
                self._starts = [*self._starts[-_MOST_BUFFERS + 1 :], _first_of_line(made)]
                k = -1
            start = self._starts[k]
            return self._held[k][start : start + size].reshape(shape)

    def _references(self) -> list[int]:
        return [sys.getrefcount(array) for array in self._held]


def _first_of_line(memory: np.ndarray) -> int:
    """Number of the first float that lies where a cache line begins."""
    return -memory.__array_interface__["data"][0] % (4 * _LINE) // 4


class _Scaled(NamedTuple):
    """Kinds of cloud at their sizes, filled when they are first asked for."""

    sizes: np.ndarray
    objects: np.ndarray
    clouds: np.ndarray
    filled: np.ndarray


def distinct(*parts: np.ndarray) -> tuple[Int[np.ndarray, " U"], Int[np.ndarray, " n"]]:
    """Find rows that are equal in all parts, bit by bit.

    Args:
        parts: Arrays with the same leading axis n.

    Returns:
        The first row of each kind, and the number of its kind for each row.
    """
    flat = [np.ascontiguousarray(p.reshape(len(p), -1)).view(np.uint8) for p in parts]
    rows = np.ascontiguousarray(np.concatenate(flat, axis=1))
    records = rows.view(f"V{rows.shape[1]}").reshape(len(rows))
    _, first, index = np.unique(records, return_index=True, return_inverse=True)
    return first, index


def expand_clouds(batch: dict[str, Any]) -> dict[str, Any]:
    """Give each grasp of a batch with `clouds="unique"` its own cloud, as `"expand"` does."""
    if "point_index" not in batch:
        return dict(batch)
    index = batch["point_index"]
    return {
        name: values[index] if name.startswith("cloud_") else values
        for name, values in batch.items()
        if name != "point_index"
    }
