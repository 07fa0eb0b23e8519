"""How soon the viewer shows a release, and what it takes: `python -m benchmarks.viewer RELEASE`.

Starts `bidexdata view RELEASE` as a process of its own and joins it through its socket as a browser
does, but draws nothing. Seconds run from the start of the process until the port answers and until
scene and widgets have come (with the processor's seconds, for machines that others use too), and
from the moment a filter is set until its result has come. Memory is the largest that the process
had resident; its own now, and pages mapped from files, which the system may drop, are said apart.

Bars for ten million rows: the scene within 5 s, memory within 1 GB.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

from benchmarks.machine import describe_machine
from bidexdata import Release
from bidexdata.viewer.server import free_port

SECONDS_BAR, MEMORY_BAR = 5.0, 1e9
LIMIT = 60.0
"""Longest wait for the page [s]."""
FILTER_LIMIT = 20.0
"""Longest wait for what a filter finds [s]."""
FILTERS = (
    ("outcome", "failed"),
    ("reason", None),
    ("size", None),
    ("object has", "7"),
)
"""Widgets and what they are set to, one at a time; None: the last option."""


def measure(release: Path) -> dict[str, Any]:
    """Open the viewer twice, for the second time with counting; seconds and bytes."""
    with tempfile.TemporaryDirectory() as folder:
        # As an installed package has them: modules compiled before.
        plain = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
        environment = {**plain, "PYTHONPYCACHEPREFIX": folder}
        _opened(release, environment)
        return _opened(release, environment)


def _opened(release: Path, environment: dict[str, str]) -> dict[str, Any]:
    opened = Release.open(release)
    figures: dict[str, Any] = {
        "rows": sum(opened.figures[f"{c}_rows"] for c in ("selected", "audit")),
        "objects": len(opened.object_ids),
    }
    port, start = free_port(), time.monotonic()
    command = [sys.executable, "-m", "bidexdata", "view", str(release), "--port", str(port)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, env=environment)
    try:
        _wait_for(port, process)
        figures["seconds_until_the_port_answers"] = time.monotonic() - start
        page = Page(port)
        page.wait_for("of this object")
        figures["seconds_until_the_scene_is_there"] = time.monotonic() - start
        figures["cpu_seconds_until_then"] = _cpu_seconds(process.pid)
        figures["bytes_sent"] = page.bytes
        figures["memory_opened"] = _memory(process.pid)
        figures["seconds_per_filter"] = dict(page.choose(*chosen) for chosen in FILTERS)
        figures["memory_filtered"] = _memory(process.pid)
        page.close()
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(60)
    return figures


class Page:
    """A client of the page that draws nothing."""

    def __init__(self, port: int):
        import msgspec.msgpack
        import viser
        import zstandard
        from websockets.sync.client import connect
        from websockets.typing import Subprotocol

        self._pack, self._decode = msgspec.msgpack.encode, msgspec.msgpack.decode
        self._zstd = zstandard.ZstdDecompressor()
        protocol = Subprotocol(f"viser-v{viser.__version__}")
        self._socket = connect(f"ws://127.0.0.1:{port}", subprotocols=[protocol], max_size=None)
        self.bytes = 0
        self._widgets: dict[str, tuple[str, list[str]]] = {}
        self._send(
            type="ViewerCameraMessage",
            wxyz=(1.0, 0.0, 0.0, 0.0),
            position=(1.0, 1.0, 1.0),
            look_at=(0.0, 0.0, 0.0),
            up_direction=(0.0, 0.0, 1.0),
            **{"fov": 0.6, "near": 0.01, "far": 100.0, "image_height": 800, "image_width": 1200},
        )

    def wait_for(self, words: str, limit: float = LIMIT) -> str:
        """Read messages until a text with some words has come; give the text."""
        end = time.monotonic() + limit
        while time.monotonic() < end:
            for text in self._texts(limit):
                if words in text:
                    return text
        raise TimeoutError(f"waited {limit:.0f} s for {words!r}")

    def choose(self, label: str, option: str | None) -> tuple[str, float | None]:
        """Set a widget, wait for what is then found, and set it back; what was found, and seconds.

        None where the page has nothing new to say: the filter leaves out nothing.
        """
        uuid, options = self._widgets[label]
        value = options[-1] if option is None else option
        before = options[0] if options else ""
        if value == before:
            return f"{label}: nothing to choose from", None
        start = time.monotonic()
        found = self._set(uuid, value)
        seconds = time.monotonic() - start
        if found:
            self._set(uuid, before)
        return f"{label}: {value} -> {found or 'all'}", seconds if found else None

    def _set(self, uuid: str, value: str) -> str:
        self._send(type="GuiUpdateMessage", uuid=uuid, updates={"value": value})
        try:
            return self.wait_for("** object", FILTER_LIMIT).replace("*", "")
        except TimeoutError:
            return ""

    def close(self) -> None:
        """Leave."""
        self._socket.close()

    def _send(self, **message: Any) -> None:
        self._socket.send(self._pack(message))

    def _texts(self, limit: float) -> list[str]:
        data = self._socket.recv(limit)
        assert isinstance(data, bytes)
        self.bytes += len(data)
        size = int.from_bytes(data[8:16], "little")
        found = []
        for message in self._decode(self._zstd.decompress(data[16 : 16 + size]))["messages"]:
            props = message.get("props") or message.get("updates") or {}
            if "label" in props and "uuid" in message:
                options = [str(option) for option in props.get("options") or ()]
                self._widgets[props["label"]] = (message["uuid"], options)
            found += [v for k, v in props.items() if isinstance(v, str) and "label" not in k]
        return found


def _wait_for(port: int, process: subprocess.Popen[bytes]) -> None:
    end = time.monotonic() + LIMIT
    while time.monotonic() < end:
        if process.poll() is not None:
            raise SystemExit(f"bidexdata view ended with code {process.returncode}")
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}") as answer:
                assert answer.status == 200
                return
        except urllib.error.URLError:
            time.sleep(0.02)
    raise TimeoutError(f"waited {LIMIT:.0f} s for the port")


def _cpu_seconds(pid: int) -> float:
    """User and system time of a process: what wall time is where nothing else runs."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _memory(pid: int) -> dict[str, int]:
    """Bytes: the most that was resident, and now those of its own and those mapped from files."""
    text = Path(f"/proc/{pid}/status").read_text()
    kb = {name: int(n) for name, n in re.findall(r"^(\w+):\s+(\d+) kB$", text, re.MULTILINE)}
    return {
        "peak": kb["VmHWM"] * 1024,
        "own": kb["RssAnon"] * 1024,
        "mapped": kb["RssFile"] * 1024,
    }


def main() -> int:
    """Print the figures as JSON; 1 where a bar is missed."""
    parser = argparse.ArgumentParser(description="How soon the viewer shows a release.")
    parser.add_argument("release", type=Path)
    figures = measure(parser.parse_args().release)
    print(json.dumps({"machine": describe_machine(), **figures}, indent=2))
    slow = figures["seconds_until_the_scene_is_there"] > SECONDS_BAR
    return int(slow or figures["memory_filtered"]["peak"] > MEMORY_BAR)


if __name__ == "__main__":
    sys.exit(main())
