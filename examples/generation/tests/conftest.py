"""A small release with the built-in hand, so that every test runs without a GPU or downloads."""

from __future__ import annotations

from pathlib import Path

import pytest
from jaxtyping import install_import_hook

# A wrong shape or type anywhere in a test fails there.
install_import_hook("bidexgrasp_model", "beartype.beartype")

from bidexgrasp_model.config import Config, from_plain  # noqa: E402
from bidexgrasp_model.training import Trainer, TrainRequest  # noqa: E402

from bidexdata import Run as BidexRun  # noqa: E402
from bidexdata import (  # noqa: E402
    SynthRequest,
    TaskExecution,
    load_preset,
    load_protocol,
    pack_runs,
    prepare_library,
    synth_library,
    validate_run,
)

INLINE = TaskExecution(executor="inline", quiet=True)


@pytest.fixture(scope="session")
def config() -> Config:
    """A model of a few thousand numbers, with all modules."""
    return from_plain(
        {
            "preset": "test",
            "model": {
                "points": 128, "groups": (32, 16), "neighbours": 8, "local": 4,
                "width": 32, "layers": 2, "heads": 2,
            },
            "diffusion": {"schedule": "cosine", "sampler": "ddim", "sampling_steps": 5},
            "loss": {"snr": True, "surface_points": 16, "cloud_points": 64},
            "train": {"cases": 2, "grasps": 3, "repeats": 2, "warm_up": 1, "rate": 1e-3},
        }
    )  # fmt: skip


@pytest.fixture(scope="session")
def trained(release, config, tmp_path_factory) -> Path:
    """A folder with a checkpoint after 6 steps; read only."""
    out = tmp_path_factory.mktemp("trained")
    Trainer.start(TrainRequest(release=release, out=out, config=config, steps=6, quiet=True)).run()
    return out


@pytest.fixture(scope="session")
def release(tmp_path_factory) -> Path:
    """Four objects on a table, one of them to test on, grasped by the capsule hands."""
    root = tmp_path_factory.mktemp("small")
    shapes = [f"shapes:{name}" for name in ("box", "cylinder", "bracket", "prism")]
    prepare_library(shapes, root / "library", executor="inline", quiet=True)
    request = SynthRequest(
        config=load_preset("default"),
        hand="capsule",
        sizes_mm=(250, 300),
        setting="tabletop",
        grasps=2,
        candidates=4,
    )
    synth_library(root / "library", root / "run", request, execution=INLINE)
    run = BidexRun.open(root / "run")
    validate_run(run, load_protocol("paper-1"), ("l",), execution=INLINE)
    pack_runs(
        [root / "run"], root / "release", name="small", version="0.0.1", pictures=False, quiet=True
    )
    return root / "release"
