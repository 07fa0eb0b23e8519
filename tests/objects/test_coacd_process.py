"""Laws of a search in a process of its own: only the mesh decides which rung it ends on."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bidexdata.objects import coacd_process
from bidexdata.objects.coacd_process import run_coacd
from bidexdata.objects.config import ConvexConfig, LimitsConfig
from bidexdata.objects.failure import PrepareFailure
from bidexdata.record.status import Status


@pytest.fixture
def search(tmp_path: Path, monkeypatch, box):
    """A search whose process is a shell script."""

    def run(script: str):
        fake = tmp_path / "python"
        fake.write_text(f"#!/bin/sh\n{script}\n")
        fake.chmod(0o755)
        monkeypatch.setattr(sys, "executable", str(fake))
        return run_coacd(box, {}, 1)

    return run


@pytest.mark.parametrize("name", ["SEGV", "ABRT", "FPE"])
def test_a_mesh_on_which_coacd_dies_goes_to_the_next_rung(search, name):
    found = search(f"kill -{name} $$")
    assert (found.pieces, found.reason, found.out_of_time) == ([], f"died (SIG{name})", False)


def test_the_limit_on_cpu_seconds_leads_to_the_cheaper_search(search):
    found = search("kill -XCPU $$")
    assert (found.reason, found.out_of_time) == ("used up its 1 CPU s", True)


@pytest.mark.parametrize(
    ("script", "status", "reason"),
    [
        ("kill -KILL $$", Status.CRASHED, "Killed"),
        ("kill -TERM $$", Status.CRASHED, "Terminated"),
        ('echo "what():  std::bad_alloc" >&2; kill -ABRT $$', Status.TOO_COMPLEX, "memory_gib"),
        ("echo MemoryError >&2; exit 1", Status.TOO_COMPLEX, "memory_gib"),
        ("echo \"No module named 'coacd'\" >&2; exit 1", Status.CRASHED, "No module named 'coacd'"),
        ("exit 3", Status.CRASHED, "exit code 3"),
    ],
)
def test_what_the_machine_is_to_blame_for_gives_no_object(search, script, status, reason):
    with pytest.raises(PrepareFailure) as caught:
        search(script)
    assert caught.value.status == status
    assert reason in caught.value.reason


def test_a_search_that_gets_no_cpu_time_is_timed_out(search, monkeypatch):
    monkeypatch.setattr(coacd_process, "_WALL_SECONDS", 0.2)
    with pytest.raises(PrepareFailure) as caught:
        search("exec sleep 60")
    assert caught.value.status == Status.TIMED_OUT


def test_a_search_ends_before_its_worker_is_ended_and_has_time_for_its_cpu_seconds():
    wall = coacd_process._WALL_SECONDS
    assert 3 * ConvexConfig().cpu_seconds < wall < LimitsConfig().wall_seconds


SLOW = """
import manifold3d, numpy as np
from bidexdata.objects.closed import as_mesh
from bidexdata.objects.coacd_process import run_coacd
turn = np.arange(96) * 2 * np.pi / 96
profile = np.column_stack([0.3 + 0.1 * np.cos(turn), 0.1 * np.sin(turn)])
ring = as_mesh(manifold3d.Manifold.revolve(manifold3d.CrossSection([profile]), 256))
run_coacd(ring, {"threshold": 0.01, "resolution": 20000, "preprocess_mode": "off"}, 60)
"""


def children(pid: int) -> list[int]:
    return [int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def waited(condition, seconds: float) -> bool:
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.05)
    return condition()


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="processes are looked up in /proc")
def test_a_search_ends_with_the_process_that_asked_for_it():
    asker = subprocess.Popen([sys.executable, "-c", SLOW])
    try:
        assert waited(lambda: bool(children(asker.pid)), 60)
        (child,) = children(asker.pid)
        # Well into the search: the mesh is sent and CoACD at work.
        assert waited(lambda: "lib_coacd" in maps(child), 60)
        os.kill(asker.pid, signal.SIGKILL)
        asker.wait()
        assert waited(lambda: not runs(child), 5)
    finally:
        asker.kill()


def maps(pid: int) -> str:
    return Path(f"/proc/{pid}/maps").read_text()
