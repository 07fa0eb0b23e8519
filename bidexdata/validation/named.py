"""The named protocols. A published name never changes its settings; a change is a new name."""

from __future__ import annotations

from dataclasses import replace

from bidexdata.simulation.settings import SceneSettings

from .arm_rules import ArmRules
from .protocols import LiftRules, MetricRules, Protocol

_PAPER = Protocol(
    name="paper-1",
    description=(
        "BiDexGrasp, section 6: hands on welds, density 2.5 kg/m^3, gravity 9.8 m/s^2 along "
        "each object axis for 3 s after closing, or lifted 0.10 m off a table and held 3 s; "
        "limits 5 cm and 15 degrees"
    ),
    tests=("f", "l", "a"),
    arm=ArmRules(servo_bound=1.0),
)

# DexGraspBench: hand_util.py, eval_func/{base,fc_mocap,tabletop_mocap}.py, assets/hand.
_BENCH = Protocol(
    name="dexgraspbench-1",
    description=(
        "DexGraspBench: one or two hands on welds, 0.1 kg, 1 N along each axis for 2 s, or 1 N "
        "down and a lift of 0.10 m judged at its end; its metrics as it counts them"
    ),
    scene=SceneSettings(mass=0.1, weld_anchor=(0.0, 0.0, -0.034)),
    load="force",
    gravity=10.0,
    directions=("-x", "+x", "-y", "+y", "-z", "+z"),
    hold=2.0,
    check_every=0.2,
    check_closing=False,
    reference="source_origin",
    lift=LiftRules(height=0.10, changes=10, steps=10, hold=0.0),
    metrics=MetricRules(
        deep_counts=False, fingers_by_prefix=True, table_is_hand=True, full_broad_phase=False
    ),
)

_BIMAN = replace(
    _BENCH,
    name="bimandexgraspbench-1",
    description=(
        "BimanDexGraspBench: as dexgraspbench-1 with two hands on slides and hinges, an actuator "
        "per joint with the hand's own gains, gravity-compensated hands and 1 s a segment"
    ),
    scene=replace(
        _BENCH.scene,
        base="slides",
        actuators="joints",
        actuator_kp=None,
        actuator_force=None,
        hand_gravity_compensation=1.0,
    ),
    segment_changes=25,
    lift=replace(_BENCH.lift, changes=25),
    metrics=replace(_BENCH.metrics, table_is_hand=False, last_body_counts=False),
)


def _heavier(name: str, what: str, scene: SceneSettings) -> Protocol:
    return replace(_PAPER, name=name, description=f"paper-1 with {what}", scene=scene)


NAMED: dict[str, Protocol] = {
    protocol.name: protocol
    for protocol in (
        _PAPER,
        _heavier(
            "paper-1-density25", "ten times the density, 25 kg/m^3", SceneSettings(density=25.0)
        ),
        _heavier(
            "paper-1-density250",
            "a hundred times the density, 250 kg/m^3",
            SceneSettings(density=250.0),
        ),
        _heavier(
            "paper-1-mass500g", "objects of 0.5 kg, whatever their size", SceneSettings(mass=0.5)
        ),
        _BENCH,
        _BIMAN,
    )
}
