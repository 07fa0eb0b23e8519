"""Several processes that train together have one model, and one of them writes."""

from __future__ import annotations

import dataclasses
import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from bidexgrasp_model.checkpoint import Checkpoint

SCRIPT = """
import json, pathlib, sys, torch
torch.set_num_threads(1)
from bidexgrasp_model.config import from_plain
from bidexgrasp_model.ranks import Ranks
from bidexgrasp_model.training import Trainer, TrainRequest
ranks = Ranks.from_environment("cpu")
config = from_plain(json.loads(sys.argv[3]))
request = TrainRequest(release=pathlib.Path(sys.argv[1]), out=pathlib.Path(sys.argv[2]),
                       config=config, steps=21, quiet=True)
made = Trainer.start(request, ranks).run()
torch.save(made.weights, request.out / f"rank{ranks.rank}.pt")
ranks.close()
"""


@pytest.mark.slow
def test_two_processes_end_with_the_same_weights_and_write_one_log(release, config, tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    plain = json.dumps(dataclasses.asdict(config))
    paths = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    children = [
        subprocess.Popen(
            [sys.executable, "-c", SCRIPT, str(release), str(tmp_path), plain],
            env={
                **os.environ, "RANK": str(rank), "WORLD_SIZE": "2", "LOCAL_RANK": str(rank),
                "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "PYTHONPATH": paths,
            },
        )
        for rank in range(2)
    ]  # fmt: skip
    assert [child.wait(timeout=300) for child in children] == [0, 0]
    one, two = (torch.load(tmp_path / f"rank{k}.pt", weights_only=True) for k in range(2))
    stored = Checkpoint.load(tmp_path).weights
    for name, value in one.items():
        assert torch.equal(value, two[name]), name
        assert torch.equal(value, stored[name]), name
    rows = (tmp_path / "log.csv").read_text("utf-8").splitlines()
    assert [row.split(",")[0] for row in rows] == ["step", "20"]
