"""What a figure was measured on, and the clock that all scripts share."""

from __future__ import annotations

import os
import platform
import statistics
import threading
import time
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

PACKAGES = ("bidexdata", "warp-lang", "mujoco", "torch", "trimesh", "coacd", "numpy", "pyarrow")


def describe_machine() -> dict[str, Any]:
    """CPU, cores, threads, and versions of the packages that do the work.

    Threads are those that this process has by now, of libraries too; a script that starts other
    processes says so in its figures.
    """
    return {
        "cpu": _cpu_model(),
        "cores": os.cpu_count(),
        "threads": _threads(),
        "omp_num_threads": os.environ.get("OMP_NUM_THREADS", "not set"),
        "python": platform.python_version(),
        **{name: _version(name) for name in PACKAGES},
    }


def median_seconds(work: Callable[[], Any], repeats: int = 5) -> float:
    """Median wall seconds of `work` after one uncounted call."""
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:  # run from a source tree, or not needed by the script
        return "not installed"


def _threads() -> int:
    tasks = Path("/proc/self/task")
    return len(list(tasks.iterdir())) if tasks.is_dir() else threading.active_count()


def _cpu_model() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown"
