"""How close `BiDexDataset` comes to memory: rows and clouds a second against plain copies.

All figures are of one run on one release of `ROWS` rows, repeated from a small one. Each of `TURNS`
rounds times every reader once, in an order drawn anew and on batches drawn anew for each, so that no
reader finds what the one before it left in the caches; a ratio is the median of the rounds' ratios.
Everything lies in the page cache and its pages were touched before: the figures are those of code
and memory, not of a disk. Batches come as arrays of row numbers. What they are compared with:

- `take`: `np.take` of a `numpy.memmap` of the same rows, all columns;
- `memcpy`: a contiguous `np.copyto` of as many bytes as a batch has (rows and clouds) from an array
  of all clouds into memory that was used before, as the loader's own is, both at cache lines;
- `copies`: `np.take` of the rows and `np.take` of the clouds without their sizes into memory that was
  used before: what numpy needs at least for such a batch, with nothing around it;
- `grouped` batches are those of `ObjectSampler` in groups of 16; all others are random rows;
- data sets of single rows, as peers have them: one row after the other from a contiguous dataset by
  h5py, and one `.npy` file per grasp; both split the row into the same columns, make tensors and
  stack them with PyTorch's collate function. `h5py_stacked` stacks the rows by numpy and makes one
  tensor of all; `h5py_reads` is h5py's reading of rows alone.

Seconds are of the processor, in one thread: machines that do other things spread wall time, and
nothing here waits for a disk.
"""

from __future__ import annotations

import itertools
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import torch

from benchmarks.repeated import SPLIT, repeat_release
from bidexdata.formats.hdf5 import TRAINING_FILE, MappedValues, map_values
from bidexdata.loaders import BiDexDataset, ObjectSampler
from bidexdata.runs.demo import run_demo
from bidexdata.runs.stage import TaskExecution

ROWS = 400_000
OBJECTS = 1_000
SIZES = (256, 1024)
"""Rows of a batch: what a batch costs besides its rows counts less in large ones."""
POINTS = (1024, 2048)
ROWS_OF_A_TURN = 8_192
TURNS = 21
ONE_BY_ONE = 256
"""Rows that the readers of single rows read in a turn."""
GROUP = 16


class Reader(NamedTuple):
    """Something that reads batches, what draws them, and how many rows a turn has."""

    read: Callable[[Any], Any]
    draw: Callable[[], list[Any]]
    rows: int


def measure() -> dict[str, Any]:
    """Time every reader in turns and give rows a second and ratios."""
    with tempfile.TemporaryDirectory() as folder:
        execution = TaskExecution(executor="inline", quiet=True)
        run_demo(Path(folder), execution=execution, sources="shapes:box", sizes_mm=(300,), grasps=4)
        big = repeat_release(Path(folder) / "release", Path(folder) / "big", OBJECTS, ROWS)
        return measure_release(big, Path(folder) / "npy")


def measure_release(root: Path, npy: Path) -> dict[str, Any]:
    """Measure on a release of form HDF5; single files are written to `npy`."""
    torch.set_num_threads(1)
    mapped = map_values(root, "selected", SPLIT)
    assert mapped is not None
    rng = np.random.default_rng(0)
    plain = BiDexDataset(root, cloud=None)
    floats = BiDexDataset(root, cloud=None, fields=tuple(mapped.columns))
    clouds = {n: BiDexDataset(root, points=n) for n in POINTS}
    files = _write_files(npy, mapped.values, rng.integers(0, len(mapped.values), ONE_BY_ONE))
    for data in (plain, floats, *clouds.values()):
        data.warm()
        for low in range(0, len(data), 100_000):  # a row of each object: its cloud is kept then
            data.__getitems__(range(low, min(low + 100_000, len(data)), 100))
    with h5py.File(root / TRAINING_FILE) as file:
        dataset: Any = file[f"selected/{SPLIT}/values"]
        readers: dict[str, Reader] = {}
        for size in SIZES:
            draw = partial(_random_lots, rng, len(plain), size)
            readers |= {
                f"rows_{size}": Reader(plain.__getitems__, draw, ROWS_OF_A_TURN),
                f"floats_{size}": Reader(floats.__getitems__, draw, ROWS_OF_A_TURN),
                f"take_{size}": Reader(
                    partial(np.take, mapped.values, axis=0), draw, ROWS_OF_A_TURN
                ),
            }
            for points, data in clouds.items():
                readers |= _cloud_readers(f"{points}_{size}", data, mapped.values, draw, size)
        one_by_one = partial(_random_lots, rng, len(plain), ONE_BY_ONE, ONE_BY_ONE)
        by_h5py, by_numpy = (
            partial(_one_by_one, read, mapped) for read in (dataset.__getitem__, np.load)
        )
        readers |= {
            "h5py_reads": Reader(
                partial(_one_after_the_other, dataset.__getitem__), one_by_one, ONE_BY_ONE
            ),
            "h5py_stacked": Reader(partial(_stacked, dataset.__getitem__), one_by_one, ONE_BY_ONE),
            "h5py_rows": Reader(by_h5py, one_by_one, ONE_BY_ONE),
            "npy_files": Reader(by_numpy, lambda: [files], ONE_BY_ONE),
        }
        seconds = _in_turns(readers, rng)
    return {
        **{f"{n}_per_second": 1 / statistics.median(s) for n, s in seconds.items()},
        **{f"{a}_to_{b}": _ratio(seconds, a, b) for a, b in _pairs()},
        "stored_rows": len(mapped.values),
        "floats_per_row": mapped.values.shape[1],
        "objects": OBJECTS,
    }


def _pairs() -> Iterator[tuple[str, str]]:
    for size in SIZES:
        yield from ((f"{ours}_{size}", f"take_{size}") for ours in ("rows", "floats"))
        for points in POINTS:
            case = f"{points}_{size}"
            yield from (
                (f"clouds_{case}", f"copies_{case}"),
                (f"clouds_{case}", f"memcpy_{case}"),
                (f"copies_{case}", f"memcpy_{case}"),
                (f"grouped_{case}", f"memcpy_{case}"),
            )
    for theirs in ("h5py_rows", "h5py_stacked", "h5py_reads", "npy_files"):
        yield "floats_256", theirs
        yield "rows_256", theirs
    yield "take_256", "h5py_reads"


def _cloud_readers(
    case: str,
    data: BiDexDataset,
    values: np.ndarray,
    draw: Callable[[], list[np.ndarray]],
    size: int,
) -> dict[str, Reader]:
    stored = data.release.cloud("cloud_solid")[:, : data.options.points]
    flat = _at_line(stored.shape[0], stored[0].size)
    flat[:] = stored.reshape(len(stored), -1)
    out = [_at_line(size, flat.shape[1]) for _ in range(2)]
    copied = size * (flat.shape[1] + values.shape[1])
    room = [_at_line(1, copied)[0] for _ in range(2)]
    for memory in (*out, *room):
        memory[:] = 0
    turns = itertools.count()
    objects = data._index.object_index.astype(np.int64)

    def copies(rows: np.ndarray) -> Any:
        here = out[next(turns) % 2]
        flat.take(objects[rows], 0, here, "clip")
        return here, values.take(rows, 0)

    def memcpy(rows: np.ndarray) -> Any:
        # Another part of the clouds for each batch, so that the source is as cold as a gather's.
        everything, here, done = flat.reshape(-1), room[next(turns) % 2], 0
        low = int(rows[0]) % len(flat) * flat.shape[1]
        while done < copied:  # a batch of more bytes than all clouds begins again at the first
            part = min(copied - done, everything.size - low)
            np.copyto(here[done : done + part], everything[low : low + part])
            done, low = done + part, 0
        return here

    order = ObjectSampler(data.object_rows, GROUP).order()
    grouped = itertools.cycle(order[: len(order) // size * size].reshape(-1, size))
    return {
        f"clouds_{case}": Reader(data.__getitems__, draw, ROWS_OF_A_TURN),
        f"grouped_{case}": Reader(
            data.__getitems__,
            lambda: list(itertools.islice(grouped, ROWS_OF_A_TURN // size)),
            ROWS_OF_A_TURN,
        ),
        f"copies_{case}": Reader(copies, draw, ROWS_OF_A_TURN),
        f"memcpy_{case}": Reader(memcpy, draw, ROWS_OF_A_TURN),
    }


def _random_lots(
    rng: np.random.Generator, count: int, size: int, rows: int = ROWS_OF_A_TURN
) -> list[np.ndarray]:
    return [rng.integers(0, count, size) for _ in range(rows // size)]


def _at_line(rows: int, width: int) -> np.ndarray:
    """Memory that begins where a cache line does."""
    made = np.empty(rows * width + 16, np.float32)
    start = -made.__array_interface__["data"][0] % 64 // 4
    return made[start : start + rows * width].reshape(rows, width)


def _ratio(seconds: dict[str, list[float]], ours: str, theirs: str) -> float:
    """Our rows a second to theirs: the median over the turns."""
    pairs = zip(seconds[ours], seconds[theirs], strict=True)
    return statistics.median(b / a for a, b in pairs)


def _in_turns(readers: dict[str, Reader], rng: np.random.Generator) -> dict[str, list[float]]:
    """Seconds of the processor per row of every reader, in each turn."""
    found: dict[str, list[float]] = {name: [] for name in readers}
    for turn in range(TURNS + 1):
        for name in rng.permutation(list(readers)).tolist():
            reader = readers[name]
            lots = reader.draw()
            start = time.thread_time()
            _each(reader.read, lots)
            if turn:  # the first warms caches
                found[name].append((time.thread_time() - start) / reader.rows)
    return found


def _each(read: Callable[[Any], Any], lots: Any) -> None:
    held = None
    for lot in lots:
        held = read(lot)  # as in a training loop: a batch lives until the next one is there
    del held


def _one_after_the_other(read: Callable[[Any], np.ndarray], lot: np.ndarray) -> None:
    for key in lot.tolist():
        read(key)


def _stacked(read: Callable[[Any], np.ndarray], lot: np.ndarray) -> Any:
    return torch.from_numpy(np.stack([read(key) for key in lot.tolist()]))


def _one_by_one(read: Callable[[Any], np.ndarray], mapped: MappedValues, lot: Any) -> Any:
    """A batch from a data set of single rows."""
    from torch.utils.data import default_collate

    items = []
    for key in lot:
        row = np.asarray(read(key))
        parts = {n: row[place].reshape(shape) for n, (place, shape) in mapped.columns.items()}
        items.append({n: torch.from_numpy(np.asarray(part)) for n, part in parts.items()})
    return default_collate(items)


def _write_files(folder: Path, values: np.ndarray, rows: np.ndarray) -> list[Path]:
    folder.mkdir()
    files = []
    for row in rows.tolist():
        files.append(folder / f"{row:08d}.npy")
        np.save(files[-1], values[row])
    return files
