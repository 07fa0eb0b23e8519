"""Configuration of the model, its losses and its training, and the presets `paper` and `cpu`.

Constants carry their source. "Facts" are the restatement of the paper that says what it leaves
open; what is marked "ours" was chosen here.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args, get_type_hints

Coordination = Literal["pair", "direct", "single", "none"]
"""How views are chosen: a primary and a second one given it; a pair at once; each hand by itself;
or not at all."""
Schedule = Literal["linear", "cosine"]


class BadSetting(ValueError):
    """A configuration cannot be read: one sentence that says what is wrong and where."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelConfig:
    """Sizes of the network, and which of the paper's three modules it has."""

    points: int = 1024
    """Points of a cloud. Ours; the paper does not say."""
    views: int = 16
    """K, candidate views. Paper, 6."""
    groups: tuple[int, int] = (256, 64)
    """Centres of the two set abstractions; the first is K_p. Paper, 6: K_p = 256; the second is ours."""
    neighbours: int = 16
    """Points of a group. Ours."""
    local: int = 16
    """K_c, groups around an anchor that make the local feature. Paper, 6."""
    width: int = 512
    """Of tokens. Facts, 2: 512 in the group's earlier model."""
    layers: int = 4
    """Blocks of the denoiser. Facts, 2."""
    heads: int = 8
    """Of attention. Facts, 2."""
    coordination: Coordination = "pair"
    """The bimanual coordination module. Paper, 5.1; `direct` and `single` are its ablations."""
    geometry: bool = True
    """The geometry-adaptive feature. Paper, 5.2."""
    anchor: bool = True
    """The scale-adaptive grasp anchor; without it poses are relative to the object. Paper, 5.2."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DiffusionConfig:
    """The noise, and how it is taken away."""

    steps: int = 100
    """T. Facts, 2."""
    schedule: Schedule = "linear"
    """`linear` from `first` to `last`; `cosine`: the squared cosine of Nichol and Dhariwal, 2021."""
    first: float = 1e-4
    """Variance of the first step. Facts, 2."""
    last: float = 1e-2
    """Variance of the last step. Facts, 2. At T = 100 a share of 0.6 of the variance is left."""
    sampler: Literal["ddpm", "ddim"] = "ddpm"
    """Paper, 5.2: DDPM."""
    sampling_steps: int = 20
    """Of DDIM. Facts, 2: 10 to 20."""
    top: int = 5
    """Views that are drawn from. Paper, appendix C."""
    temperature: float = 0.1
    """Of the draw. Paper, appendix C."""
    row_share: bool = False
    """Divide a row of pair scores by its sum before the draw, so that both draws are of
    probabilities of one scale. Ours: the paper's scores of pairs sum to 1 over all K x K."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LossConfig:
    """Weights of the losses and what they depend on."""

    single_view: float = 10.0
    """Paper, appendix C."""
    bi_view: float = 1.0
    """Paper, appendix C."""
    para: float = 15.0
    """Paper, appendix C."""
    chamfer: float = 0.25
    """Paper, appendix C."""
    physic: float = 1.0
    """Paper, appendix C."""
    self_pen: float = 50.0
    """Paper, appendix C."""
    obj_pen: float = 100.0
    """Paper, appendix C."""
    spf: float = 50.0
    """Paper, appendix C."""
    contact_within: float = 0.02
    """tau: pads further from the cloud are left alone [m]. Ours; the paper does not say."""
    surface_points: int = 128
    """Points of a hand's surface. Ours."""
    cloud_points: int = 512
    """Points of the cloud that they are compared with. Ours."""
    snr: bool = False
    """Weigh the parameter loss by 1 / (1 - alpha_bar), so that all noise levels count alike and
    small errors at little noise are not drowned. Ours."""
    geometric_below: float = 1.0
    """Geometric losses count for noise levels up to this share of T: at more noise the prediction
    is a mean of many grasps, whose geometry says nothing. Ours; 1 is the paper."""
    geometric_every: int = 1
    """Geometric losses are taken every so many steps, with so many times the weight. Facts, 3."""
    geometric_from: float = 0.0
    """Share of training after which they begin. Facts, 3."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RefineConfig:
    """How sampled grasps are made to fit the surface. Ours; the paper samples without."""

    steps: int = 0
    """Of Adam; 0 leaves samples as they are."""
    draws: int = 1
    """Samples made for each grasp, of which the one is kept that fits the surface best."""
    rate: float = 0.08
    """Its rate, in spreads of the training data."""
    reach: float = 4.0
    """Times as far per step go the numbers of the pre-grasp, whose spread is small."""
    stay: float = 0.02
    """Weight of the squared distance from the sample."""
    within: float = 0.15
    """tau: pads farther from the surface are left alone [m]."""
    slack: float = 0.015
    """Pads may be so far aside of a point of the cloud: it has gaps [m]."""
    clear: float = 0.005
    """What the pre-grasp keeps from the surface [m]; a fifth of it from the table."""
    contact: float = 48.0
    """Weight of the pads' mean gap [m]."""
    object: float = 100000.0
    """Weight of mean squared depths in the object [m2]."""
    table: float = 64000.0
    """Of those in the table [m2]."""
    self: float = 300.0
    """Of summed squared overlaps of key points [m2]."""

    @property
    def wanted(self) -> bool:
        """Whether samples are moved or chosen, so that surfaces and hands are needed."""
        return self.steps > 0 or self.draws > 1


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainConfig:
    """Optimiser, batches and augmentation."""

    cases: int = 16
    """Scenes of a batch. Facts, 3."""
    grasps: int = 16
    """Grasps of a scene in a batch, drawn anew each time. Facts, 3."""
    repeats: int = 1
    """Noise levels that each grasp of a batch is learned at: the clouds, which cost most, are
    encoded once. Ours."""
    rate: float = 1e-4
    """Learning rate of AdamW. Facts, 2."""
    weight_decay: float = 1e-4
    """Facts, 2."""
    warm_up: int = 100
    """Steps in which the rate grows. Ours."""
    clip: float = 10.0
    """Largest norm of the gradient. Facts, 2."""
    ema: float = 0.999
    """Decay of the averaged weights that sampling uses. Facts, 3."""
    epochs: int = 5
    """Paper, 6; a number of steps or minutes may be given in its place."""
    augment: tuple[str, ...] = ("yaw", "mirror")
    """Facts, 3."""
    single_view: float = 0.0
    """Share of clouds that are seen from one side only. Ours."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """Everything that decides what is learned, but data and seed."""

    preset: str = "paper"
    model: ModelConfig = field(default_factory=ModelConfig)
    diffusion: DiffusionConfig = field(default_factory=DiffusionConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    train: TrainConfig = field(default_factory=TrainConfig)
    refine: RefineConfig = field(default_factory=RefineConfig)

    def __post_init__(self) -> None:
        m = self.model
        for key, (low, high) in _RANGES.items():
            group, _, name = key.partition(".")
            value = getattr(getattr(self, group), name)
            if not low <= value <= high:
                raise BadSetting(f"{key} lies between {low:g} and {high:g}; it is {value:g}")
        if m.width % m.heads:
            raise BadSetting(f"model.width {m.width} must be a multiple of model.heads {m.heads}")
        if not m.points >= m.groups[0] >= m.groups[1] >= m.local:
            raise BadSetting(
                f"model.points {m.points}, groups {m.groups} and local {m.local} must not grow"
            )
        if m.neighbours > m.groups[0]:
            raise BadSetting(f"model.neighbours {m.neighbours} must not exceed {m.groups[0]}")
        if self.diffusion.sampling_steps > self.diffusion.steps:
            raise BadSetting("diffusion.sampling_steps must not exceed diffusion.steps")
        if not set(self.train.augment) <= {"yaw", "mirror"}:
            raise BadSetting(f"train.augment knows yaw and mirror, not {self.train.augment}")


_MANY = 32767
"""Numbers of points are int16 in the tables of neighbours."""
_RANGES: Mapping[str, tuple[float, float]] = {
    **dict.fromkeys(("model.views", "diffusion.steps", "model.points"), (2, _MANY)),
    **{f"model.{n}": (1, _MANY) for n in ("neighbours", "local", "width", "layers", "heads")},
    **{f"diffusion.{n}": (1e-9, 1 - 1e-9) for n in ("first", "last")},
    **{f"diffusion.{n}": (1, _MANY) for n in ("sampling_steps", "top")},
    "diffusion.temperature": (1e-6, math.inf),
    **{f"loss.{n}": (1, _MANY) for n in ("surface_points", "cloud_points", "geometric_every")},
    **{f"loss.{n}": (0, 1) for n in ("geometric_below", "geometric_from")},
    **{f"train.{n}": (1, _MANY) for n in ("cases", "grasps", "repeats", "epochs")},
    **{f"train.{n}": (1e-12, math.inf) for n in ("rate", "clip")},
    **{f"train.{n}": (0, math.inf) for n in ("weight_decay", "warm_up")},
    **{f"train.{n}": (0, 1) for n in ("ema", "single_view")},
    "refine.steps": (0, _MANY),
    "refine.draws": (1, _MANY),
}
PRESETS: Mapping[str, Mapping[str, Mapping[str, Any]]] = {
    "paper": {},
    # 2.5 M parameters, for two cores: what an hour there can teach.
    "cpu": {
        "model": {"width": 160, "layers": 4, "heads": 5},
        "diffusion": {"schedule": "cosine", "sampler": "ddim", "row_share": True},
        "loss": {
            "snr": True,
            "geometric_below": 0.3,
            "geometric_every": 4,
            "geometric_from": 0.4,
        },
        "train": {"rate": 6e-4, "repeats": 4},
        "refine": {"steps": 60},
    },
}
"""What each preset changes."""


def load_preset(name: str) -> Config:
    """Give a preset's configuration.

    Raises:
        BadSetting: There is none of this name.
    """
    if name not in PRESETS:
        raise BadSetting(f"no preset is called {name!r}; there are: {', '.join(PRESETS)}")
    return from_plain({"preset": name, **PRESETS[name]})


def with_settings(config: Config, settings: Mapping[str, Any]) -> Config:
    """Change some keys, such as `{"model.anchor": False}`.

    Raises:
        BadSetting: There is no such key, or its value cannot be used.
    """
    plain = dataclasses.asdict(config)
    for key, value in settings.items():
        group, _, name = key.partition(".")
        if not isinstance(plain.get(group), dict) or name not in plain[group]:
            raise BadSetting(f"no setting is called {key!r}; an example is model.width")
        plain[group][name] = value
    return from_plain(plain)


def from_plain(data: Mapping[str, Any]) -> Config:
    """Build a configuration from dicts, as `dataclasses.asdict` gives them.

    Raises:
        BadSetting: A key is unknown or a value has the wrong type.
    """
    groups = {f.name: f for f in dataclasses.fields(Config)}
    made: dict[str, Any] = {}
    for name, value in data.items():
        if name not in groups:
            raise BadSetting(f"no group of settings is called {name!r}")
        cls = get_type_hints(Config)[name]
        made[name] = value if cls is str else _group(cls, name, value)
    return Config(**made)


def _group(cls: type, name: str, data: Mapping[str, Any]) -> Any:
    hints = get_type_hints(cls)
    made = {}
    for key, value in data.items():
        if key not in hints:
            raise BadSetting(f"no setting is called {name}.{key}; there are {', '.join(hints)}")
        made[key] = _value(f"{name}.{key}", hints[key], value)
    return cls(**made)


def _value(key: str, kind: Any, value: Any) -> Any:
    words = get_args(kind)
    if words and all(isinstance(w, str) for w in words):
        if value not in words:
            raise BadSetting(f"{key} is one of {', '.join(words)}, not {value!r}")
        return value
    if kind in (int, float, bool):
        right = isinstance(value, bool) if kind is bool else isinstance(value, (int, float))
        if not right or (kind is not bool and isinstance(value, bool)) or kind(value) != value:
            raise BadSetting(f"{key} is a number of type {kind.__name__}, not {value!r}")
        return kind(value)
    inner, last = words[0], words[-1]
    if not isinstance(value, (list, tuple)) or not all(type(v) is inner for v in value):
        raise BadSetting(f'{key} is a list such as [256, 64] or ["yaw"], not {value!r}')
    if last is not Ellipsis and len(value) != len(words):
        raise BadSetting(f"{key} has {len(words)} values, not {len(value)}")
    return tuple(value)
