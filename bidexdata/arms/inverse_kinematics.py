"""Joint angles that bring a hand to a pose: batched Levenberg-Marquardt, many starts.

The same kernels run on CPU and CUDA. A target is the pose of the record's `hand` frame in the
world. A target is tried from the postures of a pool whose hands are nearest to it; the pool is
spread over the joint ranges without a random generator, so a target's answer depends on nothing but
the chain, the target and the configuration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from bidexdata.arms.chain import Chain, chain_forward
from bidexdata.arms.chain_arrays import chain_on_device, floats_on_device, twisted_on_device
from bidexdata.config import refuse_outside
from bidexdata.devices import start_warp

LEAST_ERROR = 1e-6
"""Least error that can be asked for [m] or [rad]: float32 angles place a hand to a micrometre."""


@dataclass(frozen=True, slots=True, kw_only=True)
class IkConfig:
    """How targets are solved. Values without another source are those of the measurements."""

    starts: int = 16
    """Postures from which each target is tried [-]."""
    pool: int = 256
    """Postures of which the nearest are tried [-]."""
    iterations: int = 20
    """Steps from each [-]. A start that needs more stands before a local minimum as a rule."""
    tolerance_pos: float = 1e-4
    """Error of position at which a start stops [m]."""
    tolerance_rot: float = 1e-3
    """Error of rotation at which it stops [rad]."""
    accept_pos: float = 1e-3
    """Largest error of position of a solution [m]."""
    accept_rot: float = math.radians(0.5)
    """Largest error of rotation of a solution [rad]."""
    length: float = 0.3
    """Metres that weigh as much as one radian [m/rad]."""
    damping: float = 1e-2
    """First damping of a start [m^2/rad^2]."""
    damp_less: float = 0.2
    """Factor of the damping after a step that lowered the error [-]."""
    damp_more: float = 4.0
    """Factor after one that did not [-]."""
    largest_step: float = 0.6
    """Largest turn of a joint in one step [rad]."""
    rest_gain: float = 0.05
    """Share of the way to the rest posture that the redundant joints go in a step [-]."""
    jump: float = 0.2
    """Largest turn of a joint between two waypoints of the reach report, which makes no motion
    [rad]. Motions go by `PathConfig.largest_step`, between knots that lie nearer together."""

    def __post_init__(self) -> None:
        refuse_outside(self, "starts", 1, 1024)
        refuse_outside(self, "pool", self.starts, 65_536)
        refuse_outside(self, "iterations", 1, 10_000)
        for name in ("tolerance_pos", "tolerance_rot", "length", "damping", "largest_step", "jump"):
            refuse_outside(self, name, 1e-9, 10)
        # 1 cm beside its grasp is another grasp.
        refuse_outside(self, "accept_pos", LEAST_ERROR, 0.01)
        refuse_outside(self, "accept_rot", LEAST_ERROR, 0.1)
        refuse_outside(self, "damp_less", 1e-3, 1)
        refuse_outside(self, "damp_more", 1, 100)
        refuse_outside(self, "rest_gain", 0, 1)


class IkSolutions(NamedTuple):
    """What S starts gave for each of N targets."""

    q: Float[np.ndarray, "N S A"]
    """Joint angles within the limits [rad]."""
    error_pos: Float[np.ndarray, "N S"]
    """[m]."""
    error_rot: Float[np.ndarray, "N S"]
    """[rad]."""
    ok: Bool[np.ndarray, "N S"]
    """Both errors are small enough."""
    manipulability: Float[np.ndarray, "N S"]
    """Root of det(J J^T), turns weighted by `IkConfig.length`."""
    iterations: Int[np.ndarray, "N S"]


class FirstSolutions(NamedTuple):
    """The first good posture for each of N targets; the nearest where no start gave one."""

    q: Float[np.ndarray, "N A"]
    """[rad]."""
    error_pos: Float[np.ndarray, " N"]
    """[m]."""
    error_rot: Float[np.ndarray, " N"]
    """[rad]."""
    ok: Bool[np.ndarray, " N"]
    manipulability: Float[np.ndarray, " N"]
    iterations: Int[np.ndarray, " N"]
    """Steps over all starts."""
    tried: Int[np.ndarray, " N"]
    """Starts that were needed."""


class Followed(NamedTuple):
    """Paths through T waypoints of each of N rows from S postures; NaN behind the first miss."""

    q: Float[np.ndarray, "N S T A"]
    """[rad]."""
    error_pos: Float[np.ndarray, "N S T"]
    """[m]."""
    error_rot: Float[np.ndarray, "N S T"]
    """[rad]."""
    step: Float[np.ndarray, "N S T"]
    """Largest turn of a joint since the waypoint before [rad]."""
    reached: Int[np.ndarray, "N S"]
    """Waypoints that were reached one after the other; T: all."""


def start_postures(chain: Chain, count: int) -> Float[np.ndarray, "S A"]:
    """Postures to start from: rest, the middle of the ranges, then evenly spread ones [rad]."""
    share = np.concatenate(
        [np.full((1, chain.joints), 0.5), even_spread(max(count - 1, 0), chain.joints)]
    )
    spread = chain.lower + share * (chain.upper - chain.lower)
    return np.concatenate([chain.rest[None], spread])[:count]


def even_spread(count: int, dims: int) -> Float[np.ndarray, "N D"]:
    """Points spread evenly over the unit cube, without a random generator.

    An additive recurrence with the powers of the generalised golden ratio (M. Roberts, "The
    unreasonable effectiveness of quasirandom sequences", 2018), so the first of many are the same as
    of few.
    """
    ratio = 1.5
    for _ in range(40):
        ratio = (1.0 + ratio) ** (1.0 / (dims + 1))
    stride = ratio ** -np.arange(1.0, dims + 1)
    return np.mod(0.5 + np.arange(1, count + 1)[:, None] * stride, 1.0)


def solve_ik(
    chain: Chain,
    pos: Float[np.ndarray, "N 3"],
    rot: Float[np.ndarray, "N 3 3"],
    config: IkConfig,
    *,
    starts: Float[np.ndarray, "S A"] | None = None,
    device: str = "cpu",
) -> IkSolutions:
    """Solve every target from every start.

    Args:
        chain: The chain.
        pos: Origins of the hand frame in the world [m].
        rot: Its orientations.
        config: How.
        starts: Postures to start from, for every target in this order [rad]; the nearest of the
            pool when omitted.
        device: A Warp device.
    """
    import warp as wp

    from bidexdata.arms.ik_kernels import solve_every_start

    n, s = len(pos), config.starts if starts is None else len(starts)
    if n == 0:
        none = np.zeros((0, s))
        return IkSolutions(
            np.zeros((0, s, chain.joints)), none, none, none > 0, none, none.astype(np.int32)
        )
    arrays, rules = twisted_on_device(chain, device), _rules(config)
    q = wp.empty((n, s, chain.joints), dtype=float, device=device)
    off, twist, ease = (wp.empty((n, s), dtype=float, device=device) for _ in range(3))
    used = wp.empty((n, s), dtype=int, device=device)
    problem = _problem(chain, pos, rot, config, starts, device)
    wp.launch(
        solve_every_start,
        dim=(n, s),
        inputs=[arrays, rules, *problem, q, off, twist, ease, used],
        device=device,
    )
    error_pos, error_rot = _numbers(off), _numbers(twist)
    ok = (error_pos <= config.accept_pos) & (error_rot <= config.accept_rot)
    return IkSolutions(_numbers(q), error_pos, error_rot, ok, _numbers(ease), used.numpy())


def solve_first(
    chain: Chain,
    pos: Float[np.ndarray, "N 3"],
    rot: Float[np.ndarray, "N 3 3"],
    config: IkConfig,
    *,
    starts: Float[np.ndarray, "S A"] | None = None,
    device: str = "cpu",
) -> FirstSolutions:
    """Solve every target, from one start after the other until one is good; as `solve_ik`."""
    import warp as wp

    from bidexdata.arms.ik_kernels import solve_until_first

    n = len(pos)
    if n == 0:
        none = np.zeros(0)
        whole = none.astype(np.int32)
        return FirstSolutions(np.zeros((0, chain.joints)), none, none, none > 0, none, whole, whole)
    arrays, rules = twisted_on_device(chain, device), _rules(config)
    q = wp.empty((n, chain.joints), dtype=float, device=device)
    off, twist, ease = (wp.empty(n, dtype=float, device=device) for _ in range(3))
    used, tried = (wp.empty(n, dtype=int, device=device) for _ in range(2))
    problem = _problem(chain, pos, rot, config, starts, device)
    wp.launch(
        solve_until_first,
        dim=n,
        inputs=[arrays, rules, *problem, q, off, twist, ease, used, tried],
        device=device,
    )
    error_pos, error_rot = _numbers(off), _numbers(twist)
    ok = (error_pos <= config.accept_pos) & (error_rot <= config.accept_rot)
    return FirstSolutions(
        _numbers(q), error_pos, error_rot, ok, _numbers(ease), used.numpy(), tried.numpy()
    )


def follow(
    chain: Chain,
    q: Float[np.ndarray, "N S A"],
    pos: Float[np.ndarray, "N T 3"],
    rot: Float[np.ndarray, "N T 3 3"],
    config: IkConfig,
    *,
    device: str = "cpu",
) -> Followed:
    """Go through waypoints from given postures, each from the one before and the step to it.

    A path that turns a joint far between two waypoints is reported by its `step`, not cut: the caller
    decides.

    Args:
        chain: The chain.
        q: Postures to begin with [rad]; not part of the paths. From NaN there is none.
        pos: Origins of the hand frame at the waypoints [m].
        rot: Its orientations.
        config: How.
        device: A Warp device.
    """
    import warp as wp

    from bidexdata.arms.ik_kernels import follow_path

    n, s, t = len(pos), q.shape[1], pos.shape[1]
    if n * s * t == 0:
        none = np.zeros((n, s, t))
        return Followed(
            np.zeros((n, s, t, chain.joints)), none, none, none, np.zeros((n, s), np.int32)
        )
    start_warp()
    out = wp.empty((n, s, t, chain.joints), dtype=float, device=device)
    off, twist, step = (wp.empty((n, s, t), dtype=float, device=device) for _ in range(3))
    reached = wp.empty((n, s), dtype=int, device=device)
    where = [
        wp.array(np.ascontiguousarray(pos, np.float32), dtype=wp.vec3, shape=(n, t), device=device),
        wp.array(
            np.ascontiguousarray(rot, np.float32), dtype=wp.mat33, shape=(n, t), device=device
        ),
    ]
    wp.launch(
        follow_path,
        dim=(n, s),
        inputs=[twisted_on_device(chain, device), _rules(config), floats_on_device(q, device), *where,
                out, off, twist, step, reached],
        device=device,
    )  # fmt: skip
    return Followed(_numbers(out), _numbers(off), _numbers(twist), _numbers(step), reached.numpy())


def forward_on_device(
    chain: Chain, q: Float[np.ndarray, "N A"], *, device: str = "cpu"
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3 3"]]:
    """`chain_forward` by the kernels' functions, in float32."""
    import warp as wp

    from bidexdata.arms.chain_kernels import place_ends

    arrays = chain_on_device(chain, device)
    pos = wp.zeros(len(q), dtype=wp.vec3, device=device)
    rot = wp.zeros(len(q), dtype=wp.mat33, device=device)
    wp.launch(
        place_ends,
        dim=len(q),
        inputs=[arrays, floats_on_device(q, device), pos, rot],
        device=device,
    )
    return _numbers(pos), _numbers(rot)


def _rules(config: IkConfig) -> Any:
    from bidexdata.arms.ik_kernels import IkRules

    rules = IkRules()
    for f in fields(config):
        if f.name not in ("starts", "pool", "jump"):
            setattr(rules, f.name, getattr(config, f.name))
    return rules


@lru_cache(maxsize=16)
def _pool(chain: Chain, count: int, device: str) -> list[Any]:
    """The postures of the pool and their hands' poses on a device, once."""
    postures = start_postures(chain, count)
    return [floats_on_device(postures, device), *_poses(*chain_forward(chain, postures), device)]


def _problem(
    chain: Chain,
    pos: np.ndarray,
    rot: np.ndarray,
    config: IkConfig,
    starts: np.ndarray | None,
    device: str,
) -> list[Any]:
    """Arguments of the two kernels: postures, which of them for each target, targets."""
    import warp as wp

    from bidexdata.arms.ik_kernels import pick_starts

    where, how = _poses(pos, rot, device)
    if starts is not None:
        order = np.tile(np.arange(len(starts), dtype=np.int32), (len(pos), 1))
        return [
            floats_on_device(starts, device),
            wp.array(order, dtype=int, device=device),
            where,
            how,
        ]
    postures, end_pos, end_rot = _pool(chain, config.pool, device)
    pick = wp.empty((len(pos), config.starts), dtype=int, device=device)
    gap = wp.empty((len(pos), config.starts), dtype=float, device=device)
    wp.launch(
        pick_starts,
        dim=len(pos),
        inputs=[end_pos, end_rot, config.length, where, how, gap, pick],
        device=device,
    )
    return [postures, pick, where, how]


def _poses(pos: np.ndarray, rot: np.ndarray, device: str) -> list[Any]:
    import warp as wp

    where = wp.array(
        np.ascontiguousarray(pos, np.float32), dtype=wp.vec3, shape=(len(pos),), device=device
    )
    how = wp.array(
        np.ascontiguousarray(rot, np.float32), dtype=wp.mat33, shape=(len(rot),), device=device
    )
    return [where, how]


def _numbers(array: Any) -> np.ndarray:
    return array.numpy().astype(np.float64)
