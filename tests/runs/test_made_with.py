"""What a shard was made with: the same on every worker of a machine."""

from __future__ import annotations

import pytest

from bidexdata.devices import start_warp
from bidexdata.runs.executors import run_tasks
from bidexdata.runs.made_with import made_with


def test_every_worker_says_the_same():
    tasks = ["cpu"] * 3
    ran = run_tasks(tasks, made_with, workers=2)
    assert [found for _, found in ran] == [made_with()] * 3


def test_a_gpu_is_named_and_not_numbered():
    start_warp()
    import warp as wp

    gpus = [d for d in wp.get_devices() if d.is_cuda]
    if not gpus:
        pytest.skip("needs a CUDA device")
    for device in (*gpus, wp.get_device("cuda")):
        found = made_with(str(device))
        assert found["device"] == "cuda"
        assert found["device_name"] == device.name
