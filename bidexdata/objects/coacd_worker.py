"""Child process of `coacd_process`: one CoACD call under a limit of CPU time.

CoACD cannot be interrupted from inside and ends the process on some inputs, so it never runs in
the process that asks. Input and output are npz archives on standard input and output. It ends with
the process that asks, however that ends.
"""

from __future__ import annotations

import io
import json
import os
import sys
import threading
import time

import numpy as np

_LOOK = 0.5
"""Seconds between looks at whether the parent lives."""


def main() -> None:
    """Read vertices, faces and options; write the vertices `v<k>` of every piece."""
    data = np.load(io.BytesIO(sys.stdin.buffer.read()), allow_pickle=False)
    options = json.loads(str(data["options"]))
    parent = options.pop("parent")
    if os.name == "posix":  # elsewhere a launcher may stand between the two
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    _limit_cpu(options.pop("cpu_seconds"))
    # CoACD writes to standard output; what we send must arrive alone.
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    import coacd

    coacd.set_log_level("off")
    pieces = coacd.run_coacd(coacd.Mesh(data["vertices"], data["faces"]), **options)
    arrays = {f"v{k}": v for k, (v, _) in enumerate(pieces)}
    buffer = io.BytesIO()
    np.savez(buffer, count=len(pieces), **arrays)  # type: ignore[arg-type]
    answer.write(buffer.getvalue())
    answer.close()


def _end_with(parent: int) -> None:
    # A killed parent cannot say goodbye. CoACD holds no lock of Python's while it works.
    while os.getppid() == parent:
        time.sleep(_LOOK)
    os._exit(1)


def _limit_cpu(seconds: int) -> None:
    try:
        import resource
    except ImportError:  # Windows: only the parent's wall-clock limit holds
        return
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


if __name__ == "__main__":
    main()
