"""Bound what a worker process may use: address space for its life, CPU time for one task.

Both are kept by the operating system, so native code that never returns is bound too. Neither
ever touches the caller's own process, nor a worker of Ray: that maps Ray's store into its address
space and serves other tasks after ours.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import time
from collections.abc import Iterator

CPU_SIGNAL = "SIGXCPU"
"""What a worker dies of that used up its CPU time."""


def limit_memory(gib: float) -> None:
    """Bound the address space of a worker process."""
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


def cpu_used() -> tuple[float, float]:
    """CPU seconds so far of this process and of its children that have ended."""
    try:
        import resource
    except ImportError:  # Windows: nobody counts the children
        return time.process_time(), 0.0
    kinds = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    own, children = (sum(resource.getrusage(kind)[:2]) for kind in kinds)
    return own, children


@contextlib.contextmanager
def limited_cpu(seconds: float) -> Iterator[None]:
    """Bound the CPU time of what runs inside; the worker dies of `CPU_SIGNAL` when it is over.

    Child processes that set a bound of their own are not counted.
    """
    try:
        import resource
    except ImportError:  # Windows: only the wall-clock limit holds
        yield
        return
    if multiprocessing.parent_process() is None:
        yield
        return
    before, hard = resource.getrlimit(resource.RLIMIT_CPU)
    used = resource.getrusage(resource.RUSAGE_SELF)
    # The system counts whole seconds from the start of the process.
    until = int(used.ru_utime + used.ru_stime + seconds) + 1
    if hard != resource.RLIM_INFINITY:
        until = min(until, hard)
    resource.setrlimit(resource.RLIMIT_CPU, (until, hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_CPU, (before, hard))
