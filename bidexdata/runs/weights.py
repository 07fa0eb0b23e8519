"""How heavy a run takes its objects to be, and which protocol tests them so.

The squeeze presses in proportion to the weight (`staging.density`, `staging.mass`), and a protocol
gives the simulated object its own. Neither knows the other, so a person is told where they differ.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from bidexdata.runs.chosen import DEFAULT_PROTOCOL

if TYPE_CHECKING:
    from bidexdata.runs.spec import RunSpec
    from bidexdata.validation.protocols import Protocol

Weight = tuple[str, float]
"""(`mass`, kg) or (`density`, kg/m^3)."""


def weight_of_run(spec: RunSpec) -> Weight | None:
    """Give what a run's hands squeeze for; None where its configuration does not say."""
    staging: Mapping[str, Any] = spec.config.get("staging") or {}
    if not {"mass", "density"} <= set(staging):
        return None
    return ("mass", staging["mass"]) if staging["mass"] else ("density", staging["density"])


def weight_of_protocol(protocol: Protocol) -> Weight:
    """Give what the simulated object weighs."""
    scene = protocol.scene
    return ("density", scene.density) if scene.mass is None else ("mass", scene.mass)


def fitting_protocol(spec: RunSpec) -> str:
    """Name the variant of the default protocol whose objects weigh what the run's hands expect."""
    from bidexdata.validation.protocols import load_protocol, protocol_names

    wanted = weight_of_run(spec)
    names = [n for n in protocol_names() if n.startswith(DEFAULT_PROTOCOL)]
    fitting = [n for n in names if weight_of_protocol(load_protocol(n)) == wanted]
    return (fitting or [DEFAULT_PROTOCOL])[0]


def weight_difference(spec: RunSpec, protocol: Protocol) -> str:
    """Say that a protocol's objects weigh something else than the run's hands squeeze for.

    Empty where they agree, or where the run does not say.
    """
    run, test = weight_of_run(spec), weight_of_protocol(protocol)
    if run is None or run == test:
        return ""
    return (
        f"the run's hands squeeze for objects of {_words(run)}, and {protocol.name} tests with "
        f"{_words(test)}; `synth --set staging.{test[0]}={test[1]:g}` makes grasps for that"
    )


def _words(weight: Weight) -> str:
    name, value = weight
    return f"{value:g} {'kg' if name == 'mass' else 'kg/m^3'}"
