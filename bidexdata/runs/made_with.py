"""What a shard was made with: the device, and the packages whose versions decide results.

None of it is part of a run's identity, and a run may be made on several machines. But another
kind of processor, a GPU or another version may round differently, so every shard says its own and
`bidexdata info` tells them apart. Executor, workers and parts change no byte and are not recorded.
"""

from __future__ import annotations

import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from bidexdata import __version__

_PACKAGES = ("mujoco", "numpy", "pyarrow", "scipy", "warp-lang")


def made_with(device: str = "cpu") -> dict[str, str]:
    """Describe this machine and installation as a task on a device sees them.

    Args:
        device: A Warp device.

    Returns:
        `device` (`cpu` or `cuda`: which of several equal GPUs it was decides nothing),
        `device_name`, and the version per package.
    """
    return {**_device(device), **package_versions()}


@cache
def package_versions() -> dict[str, str]:
    """Versions of the packages that decide results; do not change the dict."""
    found = {"bidexdata": __version__}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "unknown"
    return found


@cache
def _device(device: str) -> dict[str, str]:
    if device == "cpu":
        return {"device": "cpu", "device_name": _processor()}
    from bidexdata.devices import start_warp

    start_warp()
    import warp as wp

    found = wp.get_device(device)
    return {"device": found.alias.partition(":")[0], "device_name": found.name}


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name":
                return value.strip()
    return platform.processor() or platform.machine()
