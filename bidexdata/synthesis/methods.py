"""Methods of synthesis by name: the paper's, and peers' for comparison on the same scenes.

A method says where hands start, how poses are found, and where the squeeze aims. What comes before
(scenes, seeds, attempts), and after (forces, residuals, depths, selection, rows) is the same for
all, so that their rows mean the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from bidexdata.errors import UnknownName
from bidexdata.synthesis import optimise as bilevel
from bidexdata.synthesis.attempts import Attempts, draw_attempts, gather_starts
from bidexdata.synthesis.baselines import bimangrasp, bimangrasp_starts, bodex, bodex_starts
from bidexdata.synthesis.baselines.bimangrasp_config import BimanGraspConfig
from bidexdata.synthesis.baselines.bodex_config import BodexConfig
from bidexdata.synthesis.config import SynthConfig
from bidexdata.synthesis.method_names import DEFAULT_METHOD
from bidexdata.synthesis.optimise import Optimised, Watch
from bidexdata.synthesis.staging import Press, squeeze

if TYPE_CHECKING:
    from bidexdata.arms.reach import Reach
    from bidexdata.hands.model import Hand
    from bidexdata.objects.prepared import PreparedObject
    from bidexdata.record import Scene
    from bidexdata.synthesis.pose import Pose

MethodConfig = SynthConfig | BodexConfig | BimanGraspConfig
"""Configurations; the class says the method."""


@runtime_checkable
class Draw(Protocol):
    """Where the hands of `count` attempts of a scene start."""

    def __call__(  # noqa: D102
        self,
        obj: PreparedObject,
        hands: tuple[Hand, Hand],
        scene: Scene,
        config: Any,
        seed: int,
        count: int,
        *,
        grown: bool = False,
        device: str = "cpu",
        reach: Reach | None = None,
    ) -> Attempts: ...


@runtime_checkable
class Search(Protocol):
    """Pre-grasps and grasps of all starts, in their order."""

    def __call__(  # noqa: D102
        self,
        obj: PreparedObject,
        hands: tuple[Hand, Hand],
        attempts: Sequence[Attempts],
        config: Any,
        *,
        device: str = "cpu",
    ) -> Optimised: ...


@runtime_checkable
class Aim(Protocol):
    """The squeeze of grasps, given what would press."""

    def __call__(  # noqa: D102
        self, found: Optimised, press: Press, hands: Sequence[Hand], config: Any
    ) -> Pose: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Method:
    """One method of synthesis."""

    name: str
    sentence: str
    config: type[MethodConfig]
    tabletop: bool
    """Knows a table."""
    draw: Draw
    search: Search
    aim: Aim


def search_bilevel(
    obj: PreparedObject,
    hands: tuple[Hand, Hand],
    attempts: Sequence[Attempts],
    config: SynthConfig,
    *,
    device: str = "cpu",
    watch: Watch | None = None,
) -> Optimised:
    """Search of the default method; a watch looks on."""
    start = gather_starts(attempts)
    return bilevel.optimise(obj, hands, start, config.optimise, device=device, watch=watch)


def _squeeze(found: Optimised, press: Press, hands: Sequence[Hand], config: SynthConfig) -> Pose:
    return squeeze(found.pregrasp, found.grasp, press, hands, config.staging)


_METHODS = {
    m.name: m
    for m in (
        Method(
            name=DEFAULT_METHOD,
            sentence="region pairs and decoupled bilevel optimisation, the paper's and ours",
            config=SynthConfig,
            tabletop=True,
            draw=draw_attempts,
            search=search_bilevel,
            aim=_squeeze,
        ),
        Method(
            name="bodex",
            sentence="BODex over both hands: one closure, starts from the hull, no regions",
            config=BodexConfig,
            tabletop=True,
            draw=bodex_starts.draw_starts,
            search=bodex.search,
            aim=bodex.aim,
        ),
        Method(
            name="bimangrasp",
            sentence="BimanGrasp: contacts anywhere on the fingers, annealed with Langevin noise",
            config=BimanGraspConfig,
            tabletop=False,
            draw=bimangrasp_starts.draw_starts,
            search=bimangrasp.search,
            aim=bimangrasp.aim,
        ),
    )
}


def load_method(name: str) -> Method:
    """Give a method by its name.

    Raises:
        UnknownName: No method has this name.
    """
    if name not in _METHODS:
        raise UnknownName("method", name, _METHODS)
    return _METHODS[name]


def method_of(config: MethodConfig) -> Method:
    """Give the method that a configuration belongs to."""
    return next(m for m in _METHODS.values() if type(config) is m.config)
