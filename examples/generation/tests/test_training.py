"""Laws of data and training, on a release made by the built-in hand."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from bidexgrasp_model.checkpoint import Checkpoint
from bidexgrasp_model.config import BadSetting, load_preset, with_settings
from bidexgrasp_model.data import Cases
from bidexgrasp_model.hand_shape import HandShapes
from bidexgrasp_model.model import Scenes
from bidexgrasp_model.objective import total_loss
from bidexgrasp_model.places import depth_clouds, places_of_split, release_clouds
from bidexgrasp_model.rotations import matrix_from_quat
from bidexgrasp_model.sampling import run_columns, sample
from bidexgrasp_model.state import GRASP
from bidexgrasp_model.systems import scene_columns
from bidexgrasp_model.tables import tables_of
from bidexgrasp_model.training import Trainer, TrainRequest
from bidexgrasp_model.views import nearest_view, view_labels

from bidexdata import Release, Run


def request(release, out, config, **changes):
    return TrainRequest(release=release, out=out, config=config, quiet=True, **changes)


def gaps(cases, batch, release):
    """Distance of the nearest pad of each hand to the cloud at the grasp [m]."""
    hands = HandShapes.of_release(release, 16)
    pos, rot, joints = (part[:, :, GRASP] for part in batch.poses)
    pads = hands(pos, rot, joints).pads
    between = torch.cdist(pads, batch.solid[batch.case]).min(-1).values
    return between.unflatten(1, (2, -1)).min(-1).values


def test_augmentation_keeps_contacts(release, config):
    """Pads of turned and mirrored grasps are as close to the object as those of stored ones."""
    plain = Cases(release, config, augment=False)
    changed = Cases(release, config)
    order = torch.Generator().manual_seed(0)
    for epoch in range(4):
        changed.set_epoch(epoch)
        items = range(min(3, len(plain)))
        a = plain.batch([plain[k] for k in items], order.manual_seed(0))
        b = changed.batch([changed[k] for k in items], order.manual_seed(0))
        # The mirror image swaps the hands, so gaps are compared as a set.
        mine, other = (gaps(c, x, release).sort(1).values for c, x in ((plain, a), (changed, b)))
        torch.testing.assert_close(mine, other, atol=1e-5, rtol=0)
        torch.testing.assert_close(a.y.sum(), b.y.sum())


def test_tables_of_moved_clouds_are_those_of_the_stored_ones(release, config):
    cases = Cases(release, config)
    batch = cases.batch([cases[0]])
    fresh = tables_of(batch.clouds, config.model)
    centre, radius = (Scenes.of(batch.clouds, t) for t in (batch.tables, fresh))
    torch.testing.assert_close(centre.centre, radius.centre, atol=1e-5, rtol=0)
    torch.testing.assert_close(centre.radius, radius.radius, atol=1e-5, rtol=0)
    outside = (batch.clouds - centre.centre).norm(dim=-1).max() - centre.radius
    assert outside < 1e-5
    same = [set(a.tolist()) == set(b.tolist()) for a, b in zip(batch.tables.first[0], fresh.first[0], strict=True)]  # fmt: skip
    assert np.mean(same) > 0.9  # float32 ties between equally near points may break differently


def test_losses_are_finite_at_the_first_and_the_last_noise_level(release, config, trained):
    model = Checkpoint.load(trained).model()
    cases = Cases(release, config)
    batch = cases.batch([cases[0], cases[1]])
    hands = HandShapes.of_release(release, 16)
    for t in (0, 1, config.diffusion.steps):
        levels = torch.full((len(batch.case) * config.train.repeats,), t)
        for snr in (True, False):
            model.config = with_settings(config, {"loss.snr": snr})
            total, terms = total_loss(model, hands, batch, levels=levels)
            assert torch.isfinite(total)
            assert all(torch.isfinite(v) for v in terms.values())
            model.zero_grad()
            total.backward()
            grads = [p.grad for p in model.parameters() if p.grad is not None]
            assert all(torch.isfinite(g).all() for g in grads)
        if t == 0:
            assert sum(float(v.detach()) for n, v in terms.items() if n.startswith("para")) < 1e-8


def test_half_precision_is_the_network_s_alone(release, config, trained):
    """At noise level 0 the state is the answer: what is then measured of hands is exact."""
    model = Checkpoint.load(trained).model()
    cases = Cases(release, config)
    batch = cases.batch([cases[0], cases[1]])
    hands = HandShapes.of_release(release, 16)
    levels = torch.zeros(len(batch.case) * config.train.repeats, dtype=torch.long)
    whole, half = (
        total_loss(model, hands, batch, levels=levels, mixed=mixed)[1] for mixed in (False, True)
    )
    for name in ("chamfer", "self_pen", "obj_pen", "spf", "para_translation"):
        torch.testing.assert_close(half[name], whole[name], atol=1e-7, rtol=1e-4)
    assert not torch.equal(half["single_view"], whole["single_view"])
    torch.testing.assert_close(half["single_view"], whole["single_view"], atol=0.02, rtol=0.1)


def test_views_are_those_of_the_turned_scene(release, config):
    """Augmentation turns clouds and grasps alike, and the labels are counted anew behind it."""
    plain = Cases(release, config, augment=False)
    turned = Cases(release, with_settings(config, {"train.augment": ["yaw"]}))
    turned.set_epoch(3)
    a, b = plain[0], turned[0]
    R = matrix_from_quat(b["object_quat_wxyz"]) @ matrix_from_quat(a["object_quat_wxyz"]).T
    assert R[2, 2] > 0.999
    assert R[0, 0] < 0.999, "this scene must be turned"
    torch.testing.assert_close(b["cloud_solid"], a["cloud_solid"] @ R.T, atol=1e-5, rtol=0)
    alone = with_settings(config, {"train.grasps": 1000})
    plain.config = turned.config = alone
    before, after = plain.batch([a]), turned.batch([b])
    centre = Scenes.of(before.clouds, before.tables).centre[0] @ R.T
    wrists = before.poses.pos[:, :, GRASP] @ R.T
    view = nearest_view(wrists, centre.expand_as(wrists), plain.views)
    y, y_bi = view_labels(view, len(plain.views))
    torch.testing.assert_close(after.y[0], y)
    torch.testing.assert_close(after.y_bi[0], y_bi)
    assert sorted(after.view.tolist()) == sorted(view.tolist())


@pytest.mark.parametrize(
    "changes",
    [
        {"model.coordination": "none", "model.geometry": False, "model.anchor": False},
        {"model.coordination": "single"},
        {"model.anchor": False},
        {"train.single_view": 1.0},
    ],
    ids=["ddpm", "single", "no-anchor", "single-view"],
)
def test_every_ablation_row_trains_and_samples(release, config, changes, tmp_path):
    made = Trainer.start(request(release, tmp_path, with_settings(config, changes), steps=2)).run()
    assert made.step == 2
    opened = Release.open(release)
    places = places_of_split(opened, "train")[:2]
    clouds = release_clouds(opened, places, config.model.points)
    found = sample(made.model(), clouds, 3, made.hands, torch.Generator().manual_seed(0))
    assert found.poses.pos.shape == (6, 2, 3, 3)
    assert all(torch.isfinite(part).all() for part in found.poses)


def test_a_resumed_training_has_the_same_next_loss(release, config, tmp_path):
    whole = Trainer.start(request(release, tmp_path / "whole", config, steps=8))
    whole.run()
    first = dataclasses.replace(request(release, tmp_path / "parts", config, steps=8))
    trainer = Trainer.start(first)
    batches = trainer._batches()
    for _ in range(5):
        trainer.train_step(next(batches))
    trainer.checkpoint().save(tmp_path / "parts" / "checkpoint.pt")
    again = Trainer.start(first)
    assert again.step == 5
    again.run()
    for a, b in zip(whole.model.parameters(), again.model.parameters(), strict=True):
        assert torch.equal(a, b), "a resumed run is the run that was not stopped, bit for bit"


@pytest.mark.slow
def test_a_killed_training_goes_on_from_its_checkpoint(release, config, tmp_path):
    script = (
        "import sys, pathlib, torch; sys.path.insert(0, sys.argv[1]); torch.set_num_threads(1)\n"
        "from bidexgrasp_model.training import Trainer, TrainRequest\n"
        "from bidexgrasp_model.config import from_plain\n"
        "import json\n"
        "c = from_plain(json.loads(sys.argv[4]))\n"
        "Trainer.start(TrainRequest(release=pathlib.Path(sys.argv[2]), out=pathlib.Path(sys.argv[3]),"
        " config=c, steps=40, save_every=0.0, quiet=True)).run()\n"
    )
    args = [
        sys.executable, "-c", script, str(Path(__file__).parents[1]), str(release),
        str(tmp_path / "killed"), json.dumps(dataclasses.asdict(config)),
    ]  # fmt: skip
    child = subprocess.Popen(args)
    path = tmp_path / "killed" / "checkpoint.pt"
    until = time.monotonic() + 120
    while not path.is_file() and time.monotonic() < until:
        time.sleep(0.05)
    os.kill(child.pid, signal.SIGKILL)
    child.wait()
    assert 0 < Checkpoint.load(path).step < 40, "it was killed on the way"
    subprocess.run(args, check=True, timeout=300)
    whole = Trainer.start(request(release, tmp_path / "whole", config, steps=40)).run()
    for name, value in Checkpoint.load(path).weights.items():
        assert torch.equal(value, whole.weights[name]), name


def test_a_checkpoint_says_what_it_was_made_of(release, config, trained):
    found = Checkpoint.load(trained)
    assert found.config == config
    assert found.release.name == "small"
    assert len(found.release.fingerprint) == 16
    assert found.setting == "tabletop"
    assert not torch.equal(found.average["std"], torch.ones_like(found.average["std"]))
    rows = (trained / "log.csv").read_text().splitlines()
    assert rows[0].startswith("step,epoch,seconds")


def test_other_settings_do_not_go_on_from_a_checkpoint(release, config, trained):
    other = with_settings(config, {"train.rate": 0.5})
    with pytest.raises(BadSetting, match="other settings or data"):
        Trainer.start(request(release, trained, other, steps=9))
    with pytest.raises(BadSetting, match="--seed 0, not 1"):
        Trainer.start(request(release, trained, config, steps=9, seed=1))


def test_a_training_that_is_over_leaves_its_files_alone(release, config, trained):
    """What was sampled from a checkpoint is known by its bytes: `make evaluate` trains first."""
    files = sorted(p for p in trained.iterdir() if p.is_file())
    before = [(p.read_bytes(), p.stat().st_mtime_ns) for p in files]
    Trainer.start(request(release, trained, config, steps=6)).run()
    assert [(p.read_bytes(), p.stat().st_mtime_ns) for p in files] == before


def test_no_batch_is_lost_where_a_training_ends_and_is_made_longer(release, config, tmp_path):
    order = with_settings(config, {"train.warm_up": 0})
    first = Trainer.start(request(release, tmp_path, order, steps=2))
    made = first.run()
    longer = Trainer.start(request(release, tmp_path, order, steps=4))
    whole = Trainer.start(request(release, tmp_path / "whole", order, steps=4))
    batches = whole._batches()
    skipped = [[c["scene_id"] for c in next(batches)] for _ in range(3)]
    assert [c["scene_id"] for c in next(longer._batches())] == skipped[2]
    assert made.step == 2


def test_samples_are_grasps_within_limits_that_a_run_takes(release, config, trained, tmp_path):
    checkpoint, opened = Checkpoint.load(trained), Release.open(release)
    places = places_of_split(opened, "train")
    for clouds in (
        release_clouds(opened, places, config.model.points),
        depth_clouds(opened, places, config.model.points, np.random.default_rng(0)),
    ):
        found = sample(checkpoint.model(), clouds, 2, checkpoint.hands, torch.Generator())
        R = found.poses.rot.double()
        eye = torch.eye(3, dtype=torch.float64).expand_as(R)
        torch.testing.assert_close(R @ R.transpose(-1, -2), eye, atol=1e-5, rtol=0)
        chosen = [places[b] for b in found.cloud.tolist()]
        rows = {**run_columns(found.poses, checkpoint.hands), **scene_columns(chosen)}
    run = Run.create(tmp_path / "run", rows, source=release, hand="capsule")
    assert all((batch["synth_status"] == 0).all() for batch in run.batches())
    assert sum(len(batch) for batch in run.batches()) == 2 * len(places)


def test_presets_and_settings_are_read_and_mistakes_named():
    assert load_preset("paper").model.width == 512
    assert load_preset("cpu").diffusion.sampler == "ddim"
    for key, value, words in (
        ("model.widht", 1, "no setting"),
        ("model.width", "x", "number"),
        ("model.coordination", "both", "one of"),
        ("model.width", 30, "multiple"),
        ("train.augment", ["turn"], "yaw and mirror"),
        ("train.augment", "yaw", "a list"),
        ("model.groups", 5, "a list"),
        ("model.groups", [64], "2 values"),
        ("model.groups", [64, 128], "must not grow"),
        ("model.neighbours", 400, "must not exceed 256"),
        ("diffusion.steps", 0, "between 2"),
        ("diffusion.temperature", 0, "diffusion.temperature"),
        ("diffusion.sampling_steps", 101, "must not exceed"),
        ("loss.geometric_every", 0, "between 1"),
        ("train.cases", 0, "train.cases"),
        ("train.single_view", 1.5, "between 0 and 1"),
    ):
        with pytest.raises(BadSetting, match=words):
            with_settings(load_preset("paper"), {key: value})
    with pytest.raises(BadSetting, match="no preset"):
        load_preset("gpu")
