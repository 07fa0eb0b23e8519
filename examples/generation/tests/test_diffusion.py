"""Laws of the diffusion: noise and back, both ways of sampling, the draw of views."""

from __future__ import annotations

import pytest
import torch
from bidexgrasp_model.choosing import draw_views, top_draw
from bidexgrasp_model.config import DiffusionConfig
from bidexgrasp_model.coordination import ViewScores
from bidexgrasp_model.diffusion import clean, ddim_step, ddpm_step, draw, noisy, shares

KINDS = [DiffusionConfig(schedule=s, sampler=k) for s in ("linear", "cosine") for k in ("ddpm", "ddim")]  # fmt: skip


def randn(*shape, seed=0):
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("config", KINDS[::2], ids=lambda c: c.schedule)
def test_the_signal_falls_from_all_to_little(config):
    a = shares(config)
    assert len(a) == config.steps + 1
    assert a[0] == 1
    assert (a.diff() < 0).all()
    assert a[-1] > 0
    # Linear from 1e-4 to 1e-2 leaves 0.6, as the facts say; the cosine leaves next to nothing.
    assert (a[-1] > 0.5) == (config.schedule == "linear")


@pytest.mark.parametrize("config", KINDS[::2], ids=lambda c: c.schedule)
def test_what_was_put_in_comes_out_of_the_true_velocity(config):
    x0, noise = randn(20, 2, 7), randn(20, 2, 7, seed=1)
    a = shares(config)[torch.linspace(0, config.steps, 20).long()]
    v = a.sqrt()[:, None, None] * noise - (1 - a).sqrt()[:, None, None] * x0
    torch.testing.assert_close(clean(noisy(x0, noise, a), v, a), x0, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("config", KINDS, ids=lambda c: f"{c.schedule}-{c.sampler}")
def test_a_network_that_knows_the_answer_leads_to_it(config):
    target, a = randn(6, 2, 5), shares(config)

    def predict(x, t):
        share = a[t][:, None, None]
        noise = (x - share.sqrt() * target) / (1 - share).sqrt()
        return share.sqrt() * noise - (1 - share).sqrt() * target

    found = draw(predict, randn(6, 2, 5, seed=3), config, torch.Generator().manual_seed(0))
    torch.testing.assert_close(found, target, atol=2e-3, rtol=0)


def test_ddpm_keeps_the_variance_that_the_schedule_says():
    a = shares(DiffusionConfig(schedule="cosine"))
    x0, n = torch.zeros(200_000), 200_000
    xt = noisy(x0, randn(n), a[[60]].expand(n))
    before = ddpm_step(xt, x0, a[60], a[59], randn(n, seed=1))
    torch.testing.assert_close(before.var(), 1 - a[59], atol=0.01, rtol=0)
    torch.testing.assert_close(ddim_step(xt, x0, a[60], a[59]).var(), 1 - a[59], atol=0.01, rtol=0)
    torch.testing.assert_close(ddpm_step(xt, x0 + 1, a[1], a[0], randn(n)), x0 + 1)


def scores(K=16):
    single = torch.zeros(1, 2, K)
    single[0, 1, 3], single[0, 0, 9] = 4.0, 4.0
    pair = torch.zeros(1, K, K)
    pair[0, 3, 7], pair[0, 5, 2] = 4.0, 9.0
    return ViewScores(single, pair, torch.zeros(1, K, 1))


@pytest.mark.parametrize(
    ("coordination", "left_right"), [("pair", [7, 3]), ("direct", [2, 5]), ("single", [9, 3])]
)
def test_views_are_drawn_as_the_kind_of_coordination_says(coordination, left_right):
    cloud = torch.zeros(50, dtype=torch.long)
    found = draw_views(scores(), cloud, coordination, DiffusionConfig(), torch.Generator())
    assert (found == torch.tensor(left_right)).all()


def test_only_the_best_are_drawn_and_equal_ones_alike():
    score = torch.tensor([[1.0, 1, 1, 0.99, 0.99, 0.9, 0.0]]).expand(20_000, -1)
    found = top_draw(score, DiffusionConfig(top=3), torch.Generator().manual_seed(0))
    counts = found.bincount(minlength=7) / len(found)
    torch.testing.assert_close(counts[:3], torch.full((3,), 1 / 3), atol=0.02, rtol=0)
    assert counts[3:].sum() == 0


def test_a_row_s_scale_changes_nothing_where_shares_are_drawn():
    low = scores()._replace(pair=scores().pair * 1e-3)
    cloud = torch.zeros(200, dtype=torch.long)
    config = DiffusionConfig(row_share=True)
    found = draw_views(low, cloud, "pair", config, torch.Generator().manual_seed(0))
    assert (found[:, 0] == 7).float().mean() > 0.95
