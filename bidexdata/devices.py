"""Start Warp once, quietly, and say which devices there are.

Warp needs `wp.init()` before torch interoperability and device queries. Its banner, and the notice
of its native library that there is no CUDA driver, would otherwise land among a command's output.
"""

from __future__ import annotations

import os
import sys
import tempfile
from functools import cache

from bidexdata.errors import NotUsable

_NO_DRIVER = b"Could not find or load the NVIDIA CUDA driver"


@cache
def start_warp() -> None:
    """Initialise Warp; a no-op after the first call."""
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    # The native library writes to file descriptor 2 and has no switch for it.
    sys.stderr.flush()
    kept = os.dup(2)
    with tempfile.TemporaryFile() as heard:
        os.dup2(heard.fileno(), 2)
        try:
            wp.init()
        finally:
            os.dup2(kept, 2)
            os.close(kept)
        heard.seek(0)
        for line in heard:
            if _NO_DRIVER not in line:
                os.write(2, line)


def check_device(device: str) -> None:
    """Refuse a device that this machine does not have.

    Raises:
        NotUsable: Names the devices that there are.
    """
    if device == "cpu":
        return
    start_warp()
    import warp as wp

    names = [d.alias for d in wp.get_devices()]
    if device not in names and not (device == "cuda" and len(names) > 1):
        known = ", ".join(names)
        raise NotUsable(f"no device is called {device!r} here; this machine has: {known}")
