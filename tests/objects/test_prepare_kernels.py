"""The limit on CPU time bounds an object, never the kernels that a fresh machine compiles first."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

PREPARED = """
import sys

import manifold3d
import warp as wp

from bidexdata.devices import start_warp
from bidexdata.objects.closed import as_mesh
from bidexdata.objects.prepare import prepare_object
from bidexdata.objects.prepared import TriangleMesh
from bidexdata.runs.prepare_kernels import load_kernels
from bidexdata.runs.thumbnails import thumbnail

start_warp()
if "first" in sys.argv:
    load_kernels()
wp.config.log_level = wp.LOG_INFO  # from here on every load is told
ball = as_mesh(manifold3d.Manifold.sphere(0.3, 24))
dome = ball.faces[ball.vertices[ball.faces].mean(axis=1)[:, 2] > 0.03]
obj = prepare_object(TriangleMesh(ball.vertices, dome))
thumbnail(obj)
print(obj.provenance["repair"])
"""


def told(*arguments: str) -> str:
    return subprocess.run(
        [sys.executable, "-c", PREPARED, *arguments], check=True, capture_output=True, text=True
    ).stdout


@pytest.mark.slow
def test_no_kernel_is_left_to_load_when_the_limit_begins():
    assert told("first") == "remesh_shell\n"
    assert "load on device" in told()


@pytest.mark.slow
def test_a_machine_without_compiled_kernels_prepares_within_a_short_limit(tmp_path):
    out = tmp_path / "lib"
    command = f"-m bidexdata prepare shapes:box --out {out} --workers 1 --set limits.cpu_seconds=10"
    environment = {**os.environ, "WARP_CACHE_PATH": str(tmp_path / "kernels")}
    done = subprocess.run([sys.executable, *command.split()], check=True, env=environment)
    assert done.returncode == 0
    assert len(list((tmp_path / "kernels").rglob("*.o"))) == 3
