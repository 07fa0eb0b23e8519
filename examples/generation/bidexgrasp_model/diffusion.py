"""The diffusion: noise schedule, noisy states, and the two ways back, DDPM and DDIM.

The network predicts v = sqrt(a) noise - sqrt(1 - a) x0, from which x0 follows without a division:
losses of the paper act on x0, and at little noise the state itself is nearly the answer.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from bidexgrasp_model.config import DiffusionConfig

Predict = Callable[[Tensor, Tensor], Tensor]
"""From noisy states (n, ...) and noise levels (n) to v."""


def shares(config: DiffusionConfig) -> Float[Tensor, " T1"]:
    """alpha_bar of noise levels 0 to T: what is left of the signal's variance; 1 at level 0.

    Source:
        Ho et al. 2020, equation 4 (linear). Nichol and Dhariwal 2021, equation 17 (cosine), kept
        from reaching 0.
    """
    T = config.steps
    if config.schedule == "linear":
        beta = torch.linspace(config.first, config.last, T, dtype=torch.float64)
        return torch.cat([torch.ones(1, dtype=torch.float64), (1 - beta).cumprod(0)]).float()
    t = torch.arange(T + 1, dtype=torch.float64) / T
    level = torch.cos((t + 0.008) / 1.008 * torch.pi / 2) ** 2
    return (level / level[0]).clamp(min=1e-4).float()


def noisy(
    x0: Float[Tensor, "n ..."], noise: Float[Tensor, "n ..."], share: Float[Tensor, " n"]
) -> Float[Tensor, "n ..."]:
    """x_t = sqrt(a) x0 + sqrt(1 - a) noise.

    Source:
        Ho et al. 2020, equation 4.
    """
    a = _wide(share, x0)
    return a.sqrt() * x0 + (1 - a).sqrt() * noise


def clean(
    xt: Float[Tensor, "n ..."], v: Float[Tensor, "n ..."], share: Float[Tensor, " n"]
) -> Float[Tensor, "n ..."]:
    """x0 = sqrt(a) x_t - sqrt(1 - a) v.

    Source:
        Salimans and Ho 2022, appendix D.
    """
    a = _wide(share, xt)
    return a.sqrt() * xt - (1 - a).sqrt() * v


def ddpm_step(
    xt: Float[Tensor, "n ..."],
    x0: Float[Tensor, "n ..."],
    share: Float[Tensor, ""],
    before: Float[Tensor, ""],
    noise: Float[Tensor, "n ..."],
) -> Float[Tensor, "n ..."]:
    """Draw x_(t-1) given x_t and x0.

    Args:
        xt: At level t.
        x0: Predicted.
        share: alpha_bar at t.
        before: alpha_bar at t - 1; at 1 (level 0) the result is x0.
        noise: Standard normal.

    Source:
        Ho et al. 2020, equations 6 and 7.
    """
    beta = 1 - share / before
    mean = (before.sqrt() * beta * x0 + (share / before).sqrt() * (1 - before) * xt) / (1 - share)
    return mean + ((1 - before) / (1 - share) * beta).sqrt() * noise


def ddim_step(
    xt: Float[Tensor, "n ..."],
    x0: Float[Tensor, "n ..."],
    share: Float[Tensor, ""],
    before: Float[Tensor, ""],
) -> Float[Tensor, "n ..."]:
    """Go to an earlier level without noise.

    Source:
        Song et al. 2021, equation 12 with sigma = 0.
    """
    noise = (xt - share.sqrt() * x0) / (1 - share).sqrt()
    return before.sqrt() * x0 + (1 - before).sqrt() * noise


def draw(
    predict: Predict,
    start: Float[Tensor, "n ..."],
    config: DiffusionConfig,
    generator: torch.Generator | None = None,
) -> Float[Tensor, "n ..."]:
    """Take the noise away, from level T to 0.

    Args:
        predict: The network.
        start: Standard normal.
        config: Sampler and steps.
        generator: Of DDPM's noise.
    """
    a = shares(config).to(start.device)
    levels = _levels(config)
    x = start
    for t, earlier in itertools.pairwise(levels):
        level = torch.full((len(x),), t, dtype=torch.long, device=x.device)
        x0 = clean(x, predict(x, level), a[level])
        if config.sampler == "ddim":
            x = ddim_step(x, x0, a[t], a[earlier])
        else:
            noise = torch.randn(x.shape, generator=generator).to(x)
            x = ddpm_step(x, x0, a[t], a[earlier], noise)
    return x


def _levels(config: DiffusionConfig) -> list[int]:
    """Noise levels from T to 0 that a sampler visits."""
    if config.sampler == "ddpm":
        return list(range(config.steps, -1, -1))
    spread = torch.linspace(config.steps, 0, config.sampling_steps + 1)
    return [round(float(t)) for t in spread]


def _wide(share: Float[Tensor, " n"], like: Tensor) -> Tensor:
    return share.reshape(-1, *[1] * (like.ndim - 1))


def draw_levels(
    n: int, config: DiffusionConfig, generator: torch.Generator | None
) -> Int[Tensor, " n"]:
    """Noise levels for training, 1 to T alike."""
    return torch.randint(1, config.steps + 1, (n,), generator=generator)
