"""Back ends: which engine judges, and the name that its verdicts have.

MuJoCo's C engine is the one that protocols mean. MuJoCo Warp gives other verdicts, close to those
and not equal, so they belong to another protocol: the same settings, `engine` filled in, and a
name that ends in `-warp`. Folders, fingerprints, releases and reports go by that name.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, get_args

from bidexdata.errors import NotUsable, UnknownName

from .protocols import WARP_SUFFIX, Engine, Protocol, without_arms
from .stages import Execution
from .warp_backend import require_supported
from .warp_worlds import engine_identity

Backend = Literal["mujoco", "mujoco_warp"]
BACKENDS: tuple[str, ...] = get_args(Backend)


def on_backend(protocol: Protocol, backend: str, device: str = "cpu") -> Protocol:
    """Give the protocol that verdicts of a back end are stored under.

    Args:
        protocol: The settings; returned as they are for `mujoco`.
        backend: `mujoco` or `mujoco_warp`.
        device: Warp device of `mujoco_warp`.

    Raises:
        UnknownName: No back end is called so.
        MissingExtra: MuJoCo Warp is not installed.
        NotUsable: No such device, settings that the engine does not run, a protocol that belongs
            to another engine, or one whose only test has arms.
    """
    check_backend(protocol, backend, device)
    if backend == "mujoco" or protocol.engine is not None:
        return protocol
    return replace(
        without_arms(protocol),
        name=protocol.name + WARP_SUFFIX,
        description=f"{protocol.description}; judged by MuJoCo Warp",
        engine=engine_identity(device),
    )


def check_backend(
    protocol: Protocol, backend: str, device: str, execution: Execution | None = None
) -> None:
    """Refuse a back end that cannot judge by a protocol here, or must not.

    Raises:
        UnknownName: No back end is called so.
        MissingExtra: MuJoCo Warp is not installed.
        NotUsable: No such device, something that the engine does not do, or a protocol that
            belongs to another engine.
    """
    if backend not in BACKENDS:
        raise UnknownName("back end", backend, BACKENDS)
    known = protocol.engine
    if backend == "mujoco":
        if known is not None:
            raise NotUsable(
                f"the verdicts of protocol {protocol.name!r} are those of {_spelled(known)}: "
                "use --backend mujoco_warp"
            )
        if device != "cpu":
            raise NotUsable(
                f"MuJoCo's C engine does not run on device {device!r}: use --backend mujoco_warp"
            )
        return
    if execution is not None and execution.load_margin:
        raise NotUsable("the back end mujoco_warp measures no load margin: use --backend mujoco")
    require_supported(protocol)
    here = engine_identity(device)
    if known not in (None, here):
        raise NotUsable(
            f"the verdicts of protocol {protocol.name!r} are those of {_spelled(known)}, and this "
            f"is {_spelled(here)}: judge by {protocol.name.removesuffix(WARP_SUFFIX)!r} instead, "
            "under a name of its own"
        )


def _spelled(engine: Engine) -> str:
    return f"MuJoCo Warp {engine.mujoco_warp} with Warp {engine.warp} on a device {engine.device!r}"
