"""Ten million grasps: `python -m benchmarks.scale RUN|RELEASE --rows N --objects 6000 --shards 10000 --out DIR`.

Makes a large run of real grasps (`benchmarks.scale_data`) in DIR/run, packs it into DIR/release and
measures, each in a process of its own:

- pack: seconds, processor seconds of the process (rows) and of those it starts (objects), and the peak
  memory of all of them, without pages of files;
- bytes per row of the grasps table;
- open: seconds of `Release.open` and `BiDexDataset(...)`, imports not counted;
- batches: milliseconds of random 256-row batches among the first 100,000 rows and among all, in turn,
  after `BiDexDataset.warm()`, which brings the pages of all rows into memory.

What is there already is not made again, so a measurement may be repeated; `--drop-shards` deletes DIR/run
and DIR/library once the release stands. 1e7 rows take about 50 GB and leave half of that.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from benchmarks.report import report
from benchmarks.scale_data import Source, Wanted, make_run, shards_of

BARS = {
    "pack_seconds": 1200.0,
    "pack_peak_gb": 3.0,
    "grasps_bytes_per_row": 800.0,
    "open_seconds": 2.0,
    "batches_slower": 1.5,
}
"""What the figures must not exceed, at 1e7 rows, 6000 objects and 10,000 shards on two cores."""
BATCH, ROUNDS, FEW = 256, 400, 100_000
_MADE = "made.json"


def main(argv: Sequence[str] | None = None) -> None:
    """Make, pack, measure and report."""
    given = _arguments(argv)
    if given.child:
        print(json.dumps(CHILDREN[given.child](given.out)))
        return
    out: Path = given.out
    out.mkdir(parents=True, exist_ok=True)
    wanted = Wanted(given.rows, given.objects, given.shards or shards_of(given.rows))
    figures: dict[str, Any] = {**wanted._asdict(), "form": given.form}
    if not (out / _MADE).is_file():
        start = time.perf_counter()
        for name in ("run", "library", "release"):
            shutil.rmtree(out / name, ignore_errors=True)
        make_run(Source(given.source, given.protocol), out, wanted, given.workers)
        made = {**wanted._asdict(), "make_seconds": time.perf_counter() - start}
        (out / _MADE).write_text(json.dumps(made))
    if not (out / "release").is_dir():
        (out / "packed.json").write_text(json.dumps(_packed(out, given.form)))
    figures |= json.loads((out / _MADE).read_text())
    figures |= json.loads((out / "packed.json").read_text())
    if given.drop_shards:
        for name in ("run", "library"):
            shutil.rmtree(out / name, ignore_errors=True)
    figures |= _sizes(out / "release")
    for child in ("open", "batches"):
        figures |= _run_child(child, out)
    for name, bar in BARS.items():
        if name in figures and figures[name] > bar:
            print(f"       scale  {name} {figures[name]:.4g} is over its bar of {bar:g}")
    report("scale", figures)


def pack(out: Path) -> dict[str, Any]:
    """Pack the run and say how long it took."""
    from bidexdata.runs.pack import pack_runs

    start = time.perf_counter()
    form = os.environ.get("SCALE_FORM", "both")
    pack_runs([out / "run"], out / "release", name="scale", version="1.0.0", form=form, quiet=True)
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "pack_seconds": time.perf_counter() - start,
        "pack_cpu_seconds_rows": time.process_time(),
        "pack_cpu_seconds_objects": children.ru_utime + children.ru_stime,
    }


def open_all(out: Path) -> dict[str, Any]:
    """Open the release and a data set of its training rows."""
    import h5py  # noqa: F401
    import pyarrow.parquet  # noqa: F401
    import torch  # noqa: F401

    from bidexdata import BiDexDataset, Release

    start = time.perf_counter()
    Release.open(out / "release")
    opened = time.perf_counter() - start
    data = BiDexDataset(out / "release", split="train")
    return {
        "release_open_seconds": opened,
        "open_seconds": time.perf_counter() - start,
        "train_rows": len(data),
    }


def batches(out: Path) -> dict[str, Any]:
    """Gather random batches among few rows and among all, in turn, and compare the medians."""
    from bidexdata import BiDexDataset

    data = BiDexDataset(out / "release", split="train", cloud=None)
    data.warm()
    rng = np.random.default_rng(0)
    ends = {"few": min(FEW, len(data)), "all": len(data)}
    seconds: dict[str, list[float]] = {name: [] for name in ends}
    for _ in range(ROUNDS):
        for name, end in ends.items():
            rows = rng.integers(0, end, BATCH).tolist()
            start = time.perf_counter()
            data.__getitems__(rows)
            seconds[name].append(time.perf_counter() - start)
    few, every = (median(seconds[name][ROUNDS // 4 :]) for name in ends)
    return {
        "batch_ms_few_rows": 1e3 * few,
        "batch_ms_all_rows": 1e3 * every,
        "batches_slower": every / few,
    }


CHILDREN: dict[str, Callable[[Path], dict[str, Any]]] = {
    "pack": pack,
    "open": open_all,
    "batches": batches,
}


def _packed(out: Path, form: str) -> dict[str, Any]:
    return _run_child("pack", out, watch=True, env={"SCALE_FORM": form})


def _run_child(
    name: str, out: Path, *, watch: bool = False, env: dict[str, str] | None = None
) -> dict[str, Any]:
    command = [sys.executable, "-m", "benchmarks.scale", "--child", name, "--out", str(out)]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, env={**os.environ, **(env or {})}
    )
    peak = 0
    while watch and process.poll() is None:
        peak = max(peak, _memory_of(process.pid))
        time.sleep(0.2)
    said, _ = process.communicate()
    if process.returncode:
        raise SystemExit(f"{name} failed with exit code {process.returncode}")
    figures = json.loads(said.strip().splitlines()[-1])
    return {**figures, **({f"{name}_peak_gb": peak / 1e9} if watch else {})}


def _memory_of(pid: int) -> int:
    """Bytes of a process and its descendants, pages of files left out (Linux)."""
    parents: dict[int, list[int]] = {}
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
        except (OSError, ValueError, IndexError):
            continue
        parents.setdefault(parent, []).append(int(entry.name))
    total, todo = 0, [pid]
    while todo:
        one = todo.pop()
        todo += parents.get(one, [])
        try:
            lines = Path(f"/proc/{one}/status").read_text().splitlines()
        except OSError:
            continue
        total += sum(1024 * int(x.split()[1]) for x in lines if x.startswith(("RssAnon", "RssSh")))
    return total


def _sizes(release: Path) -> dict[str, Any]:
    from bidexdata import Release

    rows = Release.open(release).figures["selected_rows"]
    tables = {"grasps": 0, "contacts": 0, "verdicts": 0}
    for name in tables:
        tables[name] = sum(p.stat().st_size for p in (release / name).rglob("*.parquet"))
    whole = sum(p.stat().st_size for p in release.rglob("*") if p.is_file())
    per_row = {f"{name}_bytes_per_row": size / rows for name, size in tables.items() if size}
    return {"release_gb": whole / 1e9, **per_row}


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("source", type=Path, nargs="?", help="a run or release with verdicts")
    parser.add_argument("--rows", type=float, default=1e5)
    parser.add_argument("--objects", type=int, default=200)
    parser.add_argument("--shards", type=int, default=0, help="about a thousand rows each if 0")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--form", default="both", choices=("both", "parquet", "hdf5"))
    parser.add_argument("--protocol", default="paper-1", help="whose verdicts are repeated")
    parser.add_argument("--workers", type=int, default=2, help="processes that make the run")
    parser.add_argument("--drop-shards", action="store_true")
    parser.add_argument("--child", choices=sorted(CHILDREN), help=argparse.SUPPRESS)
    given = parser.parse_args(argv)
    given.rows = int(given.rows)
    if not given.child and given.source is None:
        parser.error("which run or release to take grasps of")
    return given


if __name__ == "__main__":
    main()
