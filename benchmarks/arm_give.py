"""How far hands on arms give way to their own grasp, beside hands on welds, and what they then lift.

    python -m benchmarks.arm_give RUN --gains 1 4 1:4

The squeeze leads by what the weld of `paper-1` gives way (`staging.base_lead`); servos of an arm give way
otherwise. Of the rows of a tabletop run that the arms of a rig have a motion to, test l is run on welds and
test a on arms, once for each gain: `G`, or `ARM:WRIST`, is a multiple of the stiffness of the servos in the
arms' models (`arm.arm_gain`, `arm.wrist_gain`), before the protocol's bound on servos (`arm.servo_bound`);
`--unbound` tests arms without that bound too. Printed are medians over hands at the end of the squeeze:
how far the hand frame is from where it was commanded, how much it is turned, by how much the wrist alone turns
it, and the sum of the normal forces of one hand on the object; in brackets the 95th percentile. Before it how
fast the fastest joint of the arms still turns after the rest at the pre-grasp, and at which share of all looks (one
every 0.02 s) a motor of the arms is at its torque limit: servos that are too stiff for the time step never come to rest.
Early ends of loads are on, as in `validate`.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from benchmarks.rows import over_tasks, pool, task_rows
from bidexdata import Run
from bidexdata.arms.arm_scene import ArmScene, build_arm_scene
from bidexdata.arms.chain import chain_forward
from bidexdata.arms.robot import Robot
from bidexdata.frames import matrix_from_quat
from bidexdata.record import GraspBatch, Status
from bidexdata.record.fields import PHASES
from bidexdata.simulation.assembly import hand_prefix
from bidexdata.simulation.scene import SimScene
from bidexdata.validation import Execution, load_protocol
from bidexdata.validation.arm_lift import ArmTest, lift_with_arms, servo_settings
from bidexdata.validation.lift import lift
from bidexdata.validation.protocols import Protocol
from bidexdata.validation.stages import Grasp
from bidexdata.validation.validate import grasp_of, scene_of_rows
from bidexdata.validation.verdict import Verdict

WELD = "weld"


class Carrying(NamedTuple):
    """How the servos of arms differ from the models'."""

    arm: float
    wrist: float
    bound: bool = True
    """With the protocol's `servo_bound`."""

    def __str__(self) -> str:
        wrist = f", wrist x {self.wrist:g}" if self.wrist != self.arm else ""
        return f"arms, gains x {self.arm:g}{wrist}{'' if self.bound else ', without the bound'}"


class Given(NamedTuple):
    """What one grasp did on one carrier."""

    grasp_id: str
    size_mm: int
    carrier: str
    status: str
    """Label of the verdict."""
    shift: list[float]
    """Of each hand frame from where it was commanded, at the end of the squeeze [m]."""
    turn: list[float]
    """[rad]."""
    wrist: list[float]
    """By how much the wrist alone turns it [rad]; NaN on a weld, or without a wrist."""
    force: list[float]
    """Normal forces of each hand on the object, summed [N]."""
    speed: list[float]
    """Of each arm's fastest joint when the hands begin to close [rad/s]; NaN on a weld."""
    limited: float
    """Share of looks at which a motor of the arms is at its torque limit [-]; NaN on a weld."""


class _Give:
    """A watch that keeps how the hands stand at the last look of the closing."""

    def __init__(self, pos: np.ndarray, rot: np.ndarray, q: np.ndarray, arms: ArmScene | None):
        self._pos, self._rot, self._q, self._arms = pos, rot, q, arms
        nothing = [float("nan")] * len(pos)
        self.shift, self.turn, self.wrist, self.force = nothing, nothing, nothing, nothing
        self.speed, self._limited = nothing, list[bool]()

    @property
    def limited(self) -> float:
        """Share of looks at which a motor is at its limit."""
        return float(np.mean(self._limited)) if self._limited else float("nan")

    def __call__(self, phase: str, lasted: float, scene: SimScene) -> None:
        if self._arms is not None:
            self._limited.append(_at_limit(self._arms))
        if phase == "approach" and self._arms is not None:
            self.speed = [float(np.abs(scene.data.qvel[v]).max()) for v in self._arms.arm_qvel]
        if phase != "closing":
            return
        bodies = [
            scene.data.body(hand_prefix(i) + hand.root_body) for i, hand in enumerate(scene.hands)
        ]
        shifts = [b.xpos - p for b, p in zip(bodies, self._pos, strict=True)]
        self.shift = [float(np.linalg.norm(s)) for s in shifts]
        self.turn = [
            _angle(b.xmat.reshape(3, 3), R) for b, R in zip(bodies, self._rot, strict=True)
        ]
        self.force = _normal_forces(scene)
        if self._arms is not None:
            self.wrist = [self._of_wrist(self._arms, i) for i in range(2)]

    def _of_wrist(self, arms: ArmScene, i: int) -> float:
        chain = arms.robot.arms[i].chain
        if not chain.wrist:
            return float("nan")
        q = self._q[i, : chain.joints].copy()
        q[-chain.wrist :] = arms.scene.data.qpos[arms.arm_qpos[i]][-chain.wrist :]
        return _angle(chain_forward(chain, q[None])[1][0], self._rot[i])


def measure(
    path: str, rig: str | None, arms: Sequence[Carrying], rows: int, workers: int
) -> list[Given]:
    """Test the first rows by grasp_id, which is a hash, on the weld and on each kind of arms."""
    run = Run.open(path, rig=rig)
    name = run.rig
    if not name:
        raise SystemExit(f"{path} has no arm solutions; make them with `bidexdata arms {path}`")
    ids: list[str] = []
    for task in run.tasks:
        if run.is_armed(task):
            batch = run.task_arms(task, run.task_batch(task))
            ids += batch["grasp_id"][batch["arm_status"] == Status.OK].tolist()
    chosen = frozenset(sorted(ids)[:rows])
    with pool(workers) as executor:
        parts = over_tasks(executor, run, _of_task, name, chosen, tuple(arms))
    return [one for part in parts for one in part]


def summary(found: Sequence[Given]) -> dict[str, dict[str, Any]]:
    """Per carrier: rows, passes, passes of the rows that pass on the weld, and medians."""
    held = {g.grasp_id for g in found if g.carrier == WELD and g.status == "ok"}
    out: dict[str, dict[str, Any]] = {}
    for carrier in dict.fromkeys(g.carrier for g in found):
        mine = [g for g in found if g.carrier == carrier]
        passed = {g.grasp_id for g in mine if g.status == "ok"}
        numbers = {
            "shift_mm": 1e3 * np.array([g.shift for g in mine]),
            "turn_deg": np.degrees([g.turn for g in mine]),
            "wrist_deg": np.degrees([g.wrist for g in mine]),
            "force_n": np.array([g.force for g in mine]),
            "speed": np.array([g.speed for g in mine]),
            "limited": 100 * np.array([g.limited for g in mine]),
        }
        statuses = sorted({g.status for g in mine} - {"ok"})
        out[carrier] = {
            "rows": len(mine),
            "passed": len(passed),
            "held_by_weld": len(held),
            "passed_of_held": len(passed & held),
            **{f"{name}_median": _percentile(v, 50) for name, v in numbers.items()},
            **{f"{name}_p95": _percentile(v, 95) for name, v in numbers.items()},
            "limited_mean": _mean(numbers["limited"]),
            "failed": {s: sum(g.status == s for g in mine) for s in statuses},
        }
    return out


def table(figures: dict[str, dict[str, Any]]) -> str:
    """The summary as Markdown."""
    lines = [
        "| what carries the hands | rows | lifted and held | of those that the weld holds |"
        " at the pre-grasp a joint turns at [rad/s] | looks with a motor at its limit [%] |"
        " gives way [mm] | turns [degrees] |"
        " the wrist alone [degrees] | normal forces of a hand [N] |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for carrier, f in figures.items():
        speed, shift, turn = (
            f"{_text(f[f'{n}_median'], digits)} ({_text(f[f'{n}_p95'], digits)})"
            for n, digits in (("speed", 2), ("shift_mm", 2), ("turn_deg", 1))
        )
        limited, wrist, force = (
            _text(f[name], 1) for name in ("limited_mean", "wrist_deg_median", "force_n_median")
        )
        lines.append(
            f"| {carrier} | {f['rows']} | {f['passed']} | {f['passed_of_held']} of "
            f"{f['held_by_weld']} | {speed} | {limited} | {shift} | {turn} | {wrist} | {force} |"
        )
    return "\n".join(lines)


def _of_task(
    path: str,
    number: int,
    rig: str,
    chosen: frozenset[str],
    arms: tuple[Carrying, ...],
) -> list[Given]:
    run = _opened(path, rig)
    task = run.tasks[number]
    if not run.is_armed(task):
        return []
    batch = run.task_arms(task, run.task_batch(task))
    batch = batch.select(np.isin(batch["grasp_id"], list(chosen)))
    protocol, robot = load_protocol("paper-1"), _robot(path, rig)
    _, solid, hands = task_rows(path, number)
    found: list[Given] = []
    for size in np.unique(batch["size"]):
        rows = batch.select(batch["size"] == size)
        weld = scene_of_rows(rows, solid, hands, protocol, "l")
        carriers: list[tuple[str, Protocol, ArmScene | None]] = [(WELD, protocol, None)]
        for one in arms:
            assert protocol.arm is not None
            rules = replace(
                protocol.arm,
                arm_gain=one.arm,
                wrist_gain=one.wrist,
                servo_bound=protocol.arm.servo_bound if one.bound else None,
            )
            servos = servo_settings(rules)
            scene = build_arm_scene(robot, solid, float(size), protocol.scene, servos)
            carriers.append((str(one), replace(protocol, arm=rules), scene))
        for row in range(len(rows)):
            found += [_tested(rows, row, robot, weld, *carrier) for carrier in carriers]
    return found


def _tested(
    batch: GraspBatch,
    row: int,
    robot: Robot,
    weld: SimScene,
    carrier: str,
    protocol: Protocol,
    arms: ArmScene | None,
) -> Given:
    grasp = grasp_of(batch, row)
    give, verdict = _run(grasp, robot, weld, protocol, arms)
    return Given(
        str(batch["grasp_id"][row]),
        int(batch["size_mm"][row]),
        carrier,
        verdict.status.label,
        give.shift,
        give.turn,
        give.wrist,
        give.force,
        give.speed,
        give.limited,
    )


def _run(
    grasp: Grasp, robot: Robot, weld: SimScene, protocol: Protocol, arms: ArmScene | None
) -> tuple[_Give, Verdict]:
    if arms is None:
        rot = matrix_from_quat(grasp.hand_quat[:, 2])
        give = _Give(grasp.hand_pos[:, 2], rot, np.zeros((2, 0)), None)
        return give, lift(weld, protocol, grasp, Execution(), give)
    assert grasp.motion is not None
    last = sum(grasp.motion.knots[: PHASES.index("squeeze") + 1])
    q = grasp.motion.path[:, last]
    ends = [chain_forward(a.chain, q[i, : a.chain.joints][None]) for i, a in enumerate(robot.arms)]
    pos, rot = (np.concatenate([end[k] for end in ends]) for k in range(2))
    give = _Give(pos, rot, q, arms)
    return give, lift_with_arms(ArmTest(weld, arms), protocol, grasp, Execution(), give)


def _at_limit(arms: ArmScene) -> bool:
    model, data = arms.scene.model, arms.scene.data
    servos = np.concatenate(arms.arm_actuators)
    torque, limit = data.actuator_force[servos], model.actuator_forcerange[servos, 1]
    return bool((np.abs(torque) > 0.999 * limit).any())


def _normal_forces(scene: SimScene) -> list[float]:
    import mujoco

    total, force = [0.0] * len(scene.hands), np.zeros(6)
    for k, pair in enumerate(scene.geom_owner[scene.data.contact.geom].reshape(-1, 2).tolist()):
        low, high = sorted(pair)
        if high == scene.object_owner and 0 <= low < high:
            mujoco.mj_contactForce(scene.model, scene.data, k, force)
            total[low] += float(force[0])
    return total


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.arccos(np.clip((np.trace(a @ b.T) - 1) / 2, -1, 1)))


def _text(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _percentile(values: np.ndarray, percent: float) -> float | None:
    return float(np.nanpercentile(values, percent)) if np.isfinite(values).any() else None


def _mean(values: np.ndarray) -> float | None:
    return float(np.nanmean(values)) if np.isfinite(values).any() else None


@cache
def _opened(path: str, rig: str) -> Run:
    return Run.open(path, rig=rig)


@cache
def _robot(path: str, rig: str) -> Robot:
    return _opened(path, rig).robot()


def parse_gain(text: str) -> tuple[float, float]:
    """Read `G` or `ARM:WRIST`."""
    arm, _, wrist = text.partition(":")
    return float(arm), float(wrist or arm)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, then all figures as JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("run")
    parser.add_argument("--rig")
    parser.add_argument("--gains", nargs="+", type=parse_gain, default=[(1.0, 1.0)])
    parser.add_argument("--unbound", action="store_true", help="arms without `servo_bound` too")
    parser.add_argument("--rows", type=int, default=200, help="at most (%(default)s)")
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args(arguments)
    bounds = (True, False) if asked.unbound else (True,)
    arms = [Carrying(arm, wrist, bound) for arm, wrist in asked.gains for bound in bounds]
    found = measure(asked.run, asked.rig, arms, asked.rows, asked.workers)
    figures = summary(found)
    print(table(figures))
    print(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
