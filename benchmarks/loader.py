"""How close `BiDexDataset` comes to memory: rows and clouds a second against plain copies.

All figures are of one run on one release of `ROWS` rows, repeated from a small one, and measured in
turns: each of `TURNS` rounds times every reader once on the same random batches, and a ratio is the
median of the rounds' ratios, so that what else the machine does meets both sides. Everything lies in
the page cache and its pages were touched before: the figures are those of code and memory, not of a
disk. What they are compared with:

- rows: `np.take` of a `numpy.memmap` of the same array, all columns;
- clouds: a contiguous `np.copyto` of as many bytes from the same array of clouds into a new array
  (`memcpy`), `np.take` of the same clouds, which copies them without their sizes (`gather`), and the
  same with the rows beside them (`copies`), which is what a batch must copy at least;
- data sets of single rows, as peers have them: one row after the other from a contiguous dataset by
  h5py, and one `.npy` file per grasp; both split the row into the same columns, make tensors and
  stack them with PyTorch's collate function. `h5py_reads` is h5py's reading of rows alone.

Seconds are of the processor, in one thread: machines that do other things spread wall time, and
nothing here waits for a disk.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import torch

from benchmarks.repeated import SPLIT, repeat_release
from bidexdata.formats.hdf5 import TRAINING_FILE, MappedValues, map_values
from bidexdata.loaders import BiDexDataset
from bidexdata.runs.demo import run_demo
from bidexdata.runs.stage import TaskExecution

ROWS = 400_000
OBJECTS = 1_000
BATCH = 256
LARGE = 1024
"""The same rows in fewer batches: what a batch costs besides its rows counts less."""
BATCHES = 100
TURNS = 15
ONE_BY_ONE = 512
"""Rows that the readers of single rows read in a turn."""


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
    values, rows = mapped.values, len(mapped.values)
    rng = np.random.default_rng(0)
    lots = [rng.integers(0, rows, BATCH).tolist() for _ in range(BATCHES)]
    flat_rows = [row for lot in lots for row in lot]
    large = [flat_rows[k : k + LARGE] for k in range(0, len(flat_rows), LARGE)]
    few = rng.integers(0, rows, ONE_BY_ONE).tolist()
    plain = BiDexDataset(root, cloud=None)
    floats = BiDexDataset(root, cloud=None, fields=tuple(mapped.columns))
    clouds = {n: BiDexDataset(root, points=n) for n in (1024, 2048)}
    stored = np.asarray(clouds[1024].release.cloud("cloud_solid"))
    files = _write_files(npy, values, few)
    few_lots, file_lots = (
        [x[k : k + BATCH] for k in range(0, len(x), BATCH)] for x in (few, files)
    )
    with h5py.File(root / TRAINING_FILE) as file:
        dataset: Any = file[f"selected/{SPLIT}/values"]
        readers: dict[str, tuple[Callable[[], None], int]] = {
            "rows": (partial(_each, plain.__getitems__, lots), BATCH * BATCHES),
            "rows_all_floats": (partial(_each, floats.__getitems__, lots), BATCH * BATCHES),
            "take": (partial(_each, partial(np.take, values, axis=0), lots), BATCH * BATCHES),
            "rows_1024": (partial(_each, plain.__getitems__, large), BATCH * BATCHES),
            "take_1024": (partial(_each, partial(np.take, values, axis=0), large), BATCH * BATCHES),
            "h5py_reads": (partial(_each, dataset.__getitem__, few), ONE_BY_ONE),
            "h5py_rows": (
                partial(_each, partial(_one_by_one, dataset.__getitem__, mapped), few_lots),
                ONE_BY_ONE,
            ),
            "npy_files": (
                partial(_each, partial(_one_by_one, np.load, mapped), file_lots),
                ONE_BY_ONE,
            ),
        }
        for points, data in clouds.items():
            flat = np.ascontiguousarray(stored[:, :points]).reshape(len(stored), -1)
            objects = [data.objects_of(lot).tolist() for lot in lots]
            readers |= {
                f"clouds_{points}": (partial(_each, data.__getitems__, lots), BATCH * BATCHES),
                f"memcpy_{points}": (
                    partial(_each, partial(_copy, flat), range(BATCHES)),
                    BATCH * BATCHES,
                ),
                f"copies_{points}": (
                    partial(
                        _each, partial(_copies, values, flat), list(zip(lots, objects, strict=True))
                    ),
                    BATCH * BATCHES,
                ),
                f"gather_{points}": (
                    partial(_each, partial(np.take, flat, axis=0), objects),
                    BATCH * BATCHES,
                ),
            }
        for data in (plain, floats, *clouds.values()):
            data.warm()
        seconds = _in_turns({name: work for name, (work, _) in readers.items()})
    counts = {name: count for name, (_, count) in readers.items()}
    return {
        **{f"{n}_per_second": counts[n] / statistics.median(s) for n, s in seconds.items()},
        "rows_to_take": _ratio(seconds, counts, "rows", "take"),
        "rows_1024_to_take": _ratio(seconds, counts, "rows_1024", "take_1024"),
        "rows_all_floats_to_take": _ratio(seconds, counts, "rows_all_floats", "take"),
        **{
            f"clouds_{points}_to_{other}": _ratio(
                seconds, counts, f"clouds_{points}", f"{other}_{points}"
            )
            for points in clouds
            for other in ("copies", "memcpy", "gather")
        },
        "rows_all_floats_to_h5py_rows": _ratio(seconds, counts, "rows_all_floats", "h5py_rows"),
        "rows_all_floats_to_h5py_reads": _ratio(seconds, counts, "rows_all_floats", "h5py_reads"),
        "rows_all_floats_to_npy_files": _ratio(seconds, counts, "rows_all_floats", "npy_files"),
        "stored_rows": rows,
        "floats_per_row": values.shape[1],
        "batch": BATCH,
        "objects": len(stored),
    }


def _ratio(
    seconds: dict[str, list[float]], counts: dict[str, int], ours: str, theirs: str
) -> float:
    """Our rows a second to theirs: the median over the turns."""
    pairs = zip(seconds[ours], seconds[theirs], strict=True)
    return statistics.median(b / counts[theirs] / (a / counts[ours]) for a, b in pairs)


def _in_turns(readers: dict[str, Callable[[], None]]) -> dict[str, list[float]]:
    found: dict[str, list[float]] = {name: [] for name in readers}
    for turn in range(TURNS + 1):
        for name, work in readers.items():
            start = time.thread_time()
            work()
            if turn:  # the first warms caches
                found[name].append(time.thread_time() - start)
    return found


def _each(read: Callable[[Any], Any], lots: Any) -> None:
    held = None
    for lot in lots:
        held = read(lot)  # as in a training loop: a batch lives until the next one is there
    del held


def _one_by_one(read: Callable[[Any], np.ndarray], mapped: MappedValues, lot: list[Any]) -> Any:
    """A batch from a data set of single rows."""
    from torch.utils.data import default_collate

    items = []
    for key in lot:
        row = np.asarray(read(key))
        parts = {n: row[place].reshape(shape) for n, (place, shape) in mapped.columns.items()}
        items.append({n: torch.from_numpy(np.asarray(part)) for n, part in parts.items()})
    return default_collate(items)


def _copies(
    values: np.ndarray, flat: np.ndarray, lot: tuple[list[int], list[int]]
) -> tuple[np.ndarray, np.ndarray]:
    rows, objects = lot
    return np.take(values, rows, axis=0), np.take(flat, objects, axis=0)


def _copy(flat: np.ndarray, number: int) -> np.ndarray:
    # Another part of the clouds for each batch, so that the source is as cold as a gather's.
    low = number * 97 % max(len(flat) - BATCH, 1)
    source = flat[low : low + BATCH]
    out = np.empty_like(source)
    np.copyto(out, source)
    return out


def _write_files(folder: Path, values: np.ndarray, rows: list[int]) -> list[Path]:
    folder.mkdir()
    files = []
    for row in rows:
        files.append(folder / f"{row:08d}.npy")
        np.save(files[-1], values[row])
    return files
