"""Bound the memory of worker processes."""

from __future__ import annotations

import multiprocessing
import os


def limit_memory(gib: float) -> None:
    """Bound the address space of a worker process; never that of the caller's own process."""
    if multiprocessing.parent_process() is None:
        return
    # A CUDA driver reserves far more address space than it uses, and nothing here runs on it.
    os.environ.setdefault("CUDA_VISIBLE_DEVICES", "")
    try:
        import resource
    except ImportError:  # Windows: only the time limit holds
        return
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    wanted = int(gib * 2**30)
    if hard != resource.RLIM_INFINITY:
        wanted = min(wanted, hard)
    resource.setrlimit(resource.RLIMIT_AS, (wanted, hard))
