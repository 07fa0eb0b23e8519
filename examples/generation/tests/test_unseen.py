"""Grasps of objects that nobody has prepared, through the functions and through the command."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from bidexgrasp_model.cli import main
from bidexgrasp_model.training import CHECKPOINT, overfit_places
from bidexgrasp_model.unseen import SampleRequest, sample_unseen

from bidexdata import Run

RNG = np.random.default_rng(0)
BLOCK = """OFF
8 12 0
{}
3 0 2 1\n3 0 3 2\n3 4 5 6\n3 4 6 7\n3 0 1 5\n3 0 5 4\n3 1 2 6\n3 1 6 5\n3 2 3 7\n3 2 7 6\n3 3 0 4\n3 3 4 7
"""


@pytest.fixture
def block(tmp_path) -> Path:
    """A mesh of 0.30 x 0.20 x 0.15 m."""
    x, y, z = 0.15, 0.10, 0.075
    signs = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    corners = [f"{a * x} {b * y} {c * z}" for c in (-1, 1) for a, b in signs]
    path = tmp_path / "block.off"
    path.write_text(BLOCK.format("\n".join(corners)), encoding="utf-8")
    return path


@pytest.fixture
def command(monkeypatch, capsys):
    """Run `bidexgrasp-model` and give (exit code, what it said)."""

    def run(*words) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["bidexgrasp-model", *map(str, words)])
        with pytest.raises(SystemExit) as done:
            main()
        said = capsys.readouterr()
        return int(done.value.code or 0), said.out + said.err

    return run


def test_a_mesh_is_grasped_at_the_sizes_that_are_asked_for(command, block, trained, tmp_path):
    out = tmp_path / "grasps"
    code, said = command(
        "sample", block, "--checkpoint", trained, "--out", out, "--sizes", "0.3,0.4",
        "--grasps", 3, "--refine", 2, "--quiet",
    )  # fmt: skip
    assert code == 0, said
    assert "6 grasps of block-" in said
    run = Run.open(out)
    rows = [row for batch in run.batches() for row in batch["size_mm"].tolist()]
    assert sorted(rows) == [300] * 3 + [400] * 3
    assert all((batch["setting"] == "tabletop").all() for batch in run.batches())
    again, said = command("sample", block, "--checkpoint", trained, "--out", out, "--quiet")
    assert again not in (0, 1), said


def test_one_view_of_a_mesh_is_enough(block, trained, tmp_path):
    request = SampleRequest(
        source=block, checkpoint=trained, out=tmp_path / "grasps", sizes_mm=(300,), grasps=2,
        single_view=True, refine=2, draws=3, quiet=True,
    )  # fmt: skip
    assert sum(len(b) for b in sample_unseen(request).batches()) == 2


def test_a_measured_cloud_is_grasped_where_it_stands(trained, tmp_path):
    """A ball of 0.1 m, measured a metre away: its size is kept and it stands on the table."""
    points = RNG.normal(size=(600, 3))
    points = 0.1 * points / np.linalg.norm(points, axis=1, keepdims=True) + [1, 2, 3]
    np.save(tmp_path / "ball.npy", points)
    request = SampleRequest(
        source=tmp_path / "ball.npy", checkpoint=trained, out=tmp_path / "grasps", grasps=2,
        refine=2, quiet=True,
    )  # fmt: skip
    (batch,) = sample_unseen(request).batches()
    assert len(batch) == 2
    assert abs(int(batch["size_mm"][0]) - 346) < 12  # 0.2 m sqrt(3); the solid is 2 % larger
    np.testing.assert_allclose(batch["object_pos"][:, 2], 0.1, atol=0.01)


@pytest.mark.parametrize(
    ("points", "words"),
    [
        (np.zeros((5, 3)), "at least 16"),
        (np.zeros((40, 2)), "rows of x y z"),
        (np.c_[RNG.normal(size=(40, 2)), np.zeros(40)], "flat"),
    ],
    ids=["few", "plane coordinates", "flat"],
)
def test_a_cloud_that_is_none_is_named_in_a_sentence(command, trained, tmp_path, points, words):
    np.save(tmp_path / "cloud.npy", points)
    code, said = command(
        "sample", tmp_path / "cloud.npy", "--checkpoint", trained, "--out", tmp_path / "out"
    )
    assert (code, words in said, "Traceback" in said) == (3, True, False), said


def test_mistakes_are_one_sentence_and_exit_code_3(command, block, release, trained, tmp_path):
    sample = ("sample", block, "--checkpoint", trained, "--out", tmp_path / "out")
    train = ("train", release, "--out", tmp_path / "model", "--steps", 1)
    for words in (
        ("sample", tmp_path / "no.off", *sample[2:]),
        (*sample, "--sizes", "big"),
        ("sample", block, "--checkpoint", tmp_path / "none", "--out", tmp_path / "out"),
        (*train, "--set", "model.widht=3"),
        (*train, "--preset", "gpu"),
        ("train", tmp_path / "no-release", "--out", tmp_path / "model"),
    ):
        code, said = command(*words)
        assert code == 3, (words, said)
        assert said.startswith("bidexgrasp-model: ")
        assert len(said.strip().splitlines()) == 1
    (tmp_path / "torn").mkdir()
    whole = (trained / CHECKPOINT).read_bytes()
    (tmp_path / "torn" / CHECKPOINT).write_bytes(whole[: len(whole) // 2])
    code, said = command("sample", block, "--checkpoint", tmp_path / "torn", *sample[4:])
    assert (code, "unreadable checkpoint" in said) == (3, True), said


def test_cases_learned_by_heart_are_sampled_at_their_own_scenes(command, release, tmp_path):
    model, out = tmp_path / "model", tmp_path / "run"
    small = [f"model.{k}={v}" for k, v in (("points", 128), ("groups", "[32,16]"), ("width", 32),
             ("heads", 2), ("layers", 1), ("local", 4), ("neighbours", 8))]  # fmt: skip
    sets = [w for s in (*small, "refine.steps=0") for w in ("--set", s)]
    code, said = command(
        "train", release, "--out", model, "--steps", 2, "--overfit", 2, "--quiet", *sets
    )
    assert code == 0, said
    code, said = command(
        "sample-train", release, "--checkpoint", model, "--overfit", 2, "--samples", 3, "--out", out
    )
    assert code == 0, said
    learned = {p.scene_id for p in overfit_places(release, model, 2)}
    assert len(learned) == 2
    found = [s for batch in Run.open(out).batches() for s in batch["scene_id"].tolist()]
    assert set(found) == learned
    assert len(found) == 6
