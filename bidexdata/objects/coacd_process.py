"""One CoACD search in a child process under a limit of CPU seconds.

CoACD cannot be interrupted, has no bound of its own, and ends the process on some inputs.
"""

from __future__ import annotations

import io
import json
import logging
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.record.status import Status

from .failure import PrepareFailure
from .prepared import TriangleMesh

_log = logging.getLogger(__name__)

_WALL_SECONDS = 240.0
"""Wall-clock time of a search that waits for its CPU seconds on a busy machine: less than
`limits.wall_seconds`, which holds in worker processes only."""
_OF_THE_MESH = tuple(getattr(signal, name) for name in ("SIGSEGV", "SIGABRT", "SIGFPE"))
"""What CoACD dies of on some meshes, on any machine."""
_OUT_OF_MEMORY = ("bad_alloc", "MemoryError")
"""What C++ and Python say last when there is no more memory."""


class Search(NamedTuple):
    """What a search gave."""

    pieces: list[NDArray[np.float64]]
    """Vertices of each raw piece; none when the search failed."""
    reason: str
    """Why it failed; empty when it did not."""
    out_of_time: bool
    """Whether it failed because its CPU seconds were used up."""


def run_coacd(mesh: TriangleMesh, options: Mapping[str, Any], cpu_seconds: int) -> Search:
    """Search convex pieces of a closed mesh.

    Args:
        mesh: Closed, oriented, finite.
        options: Keyword arguments of `coacd.run_coacd`.
        cpu_seconds: The system ends the search after so many.

    Raises:
        PrepareFailure: The machine is to blame, which must not decide which pieces an object has:
            `timed_out` when it did not even give those CPU seconds, `too_complex` without memory
            for it, `crashed` when somebody else ended the search or it could not start.
    """
    problem = _unsafe(mesh)
    if problem:
        return Search([], problem, False)
    text = json.dumps({**options, "cpu_seconds": cpu_seconds, "parent": os.getpid()})
    buffer = io.BytesIO()
    np.savez(buffer, vertices=mesh.vertices, faces=mesh.faces, options=np.array(text))
    # One thread: the pieces must not depend on the number of cores.
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    try:
        done = subprocess.run(
            [sys.executable, "-m", "bidexdata.objects.coacd_worker"],
            input=buffer.getvalue(),
            capture_output=True,
            timeout=_WALL_SECONDS,
            env=environment,
            check=False,
        )
    except subprocess.TimeoutExpired as err:
        raise PrepareFailure(
            Status.TIMED_OUT,
            f"the decomposition did not get {cpu_seconds} CPU s in {_WALL_SECONDS:g} s",
        ) from err
    if done.returncode != 0:
        said = done.stderr.decode(errors="replace")[-2000:]
        _log.debug("CoACD: %s", said)
        return _failed(done.returncode, said, cpu_seconds)
    answer = np.load(io.BytesIO(done.stdout), allow_pickle=False)
    return Search([answer[f"v{k}"] for k in range(int(answer["count"]))], "", False)


def _failed(code: int, said: str, cpu_seconds: int) -> Search:
    """Tell what the mesh is to blame for from what the machine is.

    Args:
        code: What the process returned; minus the signal that ended it.
        said: The end of its error output.
        cpu_seconds: What it was allowed.

    Raises:
        PrepareFailure: The machine is to blame.
    """
    if any(text in said for text in _OUT_OF_MEMORY):
        raise PrepareFailure(
            Status.TOO_COMPLEX,
            "the decomposition ran out of memory: decimate the mesh or raise limits.memory_gib",
        )
    if code == -signal.SIGXCPU:  # only the limit on CPU seconds sends it
        return Search([], f"used up its {cpu_seconds} CPU s", True)
    if -code in _OF_THE_MESH:
        return Search([], f"died ({signal.Signals(-code).name})", False)
    if code < 0:
        raise PrepareFailure(
            Status.CRASHED, f"the decomposition was ended: {signal.strsignal(-code)}"
        )
    last = said.strip().splitlines()[-1:] or [f"exit code {code}"]
    raise PrepareFailure(Status.CRASHED, f"the decomposition could not run: {last[0][:200]}")


def _unsafe(mesh: TriangleMesh) -> str:
    """Name what would make CoACD abort or hang; empty when the mesh is fit."""
    if len(mesh.faces) < 4:
        return "was given too few faces"
    if not np.all(np.isfinite(mesh.vertices)):
        return "was given vertices that are not finite"
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        return "was given face indices out of range"
    return ""
