"""Check a user's own rig: models, mounts, payload, rest, engine against engine, and reach.

The order is that of dependence: a check whose ground has failed is not made.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bidexdata.errors import BidexError
from bidexdata.hands.findings import Finding, worst
from bidexdata.wording import share

if TYPE_CHECKING:
    import mujoco

    from bidexdata.arms.payload import CarryFinding
    from bidexdata.arms.reach_report import ReachReport
    from bidexdata.arms.registry import Rig
    from bidexdata.arms.robot import Robot
    from bidexdata.arms.spec import RigSpec

CHECKS = ("model", "mounts", "payload", "rest", "engines", "reach")
"""All checks in their order."""
GAP = 0.02
"""Distance of a hand from the arm from which on it hangs in the air [m]; adapter plates are thinner."""
ENGINES = 1e-5
"""Largest difference between the engines [m]: float32 at a metre resolves 1e-7."""
LEAST_REACH = 0.5
"""Least share of generic pairs that a rig should reach [-]: a bad place gives 0.04, a good one over
0.8."""
STARTS = 32
"""Starts of the reach report [-]; a 6-joint arm gains by them up to here."""
_POSTURES = 200


@dataclass(frozen=True, slots=True)
class RigReport:
    """What the checks of one rig said."""

    name: str
    hand: str
    findings: tuple[Finding, ...]
    picture: Path | None
    """None where the rig could not be loaded."""
    payload: tuple[CarryFinding, ...]
    reach: ReachReport | None
    seconds: float

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the checks that failed, each once, in their order."""
        names = {f.check for f in self.findings if f.passed is False}
        return tuple(name for name in CHECKS if name in names)

    def as_dict(self) -> dict[str, Any]:
        """Plain data for `--json`."""
        from bidexdata.arms.reach_report import REASONS

        reach = self.reach
        return {
            "rig": self.name,
            "hand": self.hand,
            "passed": not self.failed,
            "checks": [f._asdict() for f in self.findings],
            "carried_kg": {f.side: round(f.carried, 3) for f in self.payload},
            "payload_kg": {f.side: f.payload for f in self.payload},
            "reach": {} if reach is None else {r: round(reach.share(r), 4) for r in REASONS},
            "reach_by_size": {}
            if reach is None
            else {f"{size:g}": round(value, 4) for size, value in reach.by_size().items()},
            "picture": None if self.picture is None else str(self.picture),
            "seconds": round(self.seconds, 3),
        }


def check_rig(
    name: str,
    picture: Path,
    *,
    hand: str | None = None,
    object_mass: float | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> RigReport:
    """Check one rig and draw it.

    Args:
        name: A rig that comes with the package, or the path of a YAML spec.
        picture: Image file to write.
        hand: The hand to mount; the first that the rig names when omitted.
        object_mass: Of the heaviest object [kg]; that of the largest size when omitted.
        say: Takes a line before each part that takes its time.

    Raises:
        UnknownName: No rig or hand has this name and no file this path.
        BadConfig: The file is no spec.
    """
    from bidexdata.arms.payload import HEAVIEST
    from bidexdata.arms.registry import rig_spec

    start = time.monotonic()
    spec = rig_spec(name)
    hand = hand or first_hand(spec)
    say(f"load the models and mount the hand {hand}")
    findings, robot = _loaded(name, hand)
    payload, reach, drawn = (), None, None
    if robot is not None:
        say("overlaps at rest, and kinematics in three engines")
        from bidexdata.arms.robot import robot_spec

        model = robot_spec(robot).compile()
        findings += _hanging(robot, model)
        findings.append(_rest(robot, model))
        findings.append(_engines(robot, model))
        from bidexdata.arms.inverse_kinematics import IkConfig
        from bidexdata.arms.payload import check_payload
        from bidexdata.arms.reach_report import reach_report

        say("reach generic pairs of palm poses, and lift them")
        reach = reach_report(robot, config=IkConfig(starts=STARTS))
        findings.append(_reach(reach))
        postures = reach.q[reach.reason == 0]
        payload = check_payload(robot, HEAVIEST if object_mass is None else object_mass, postures)
        findings.append(_payload(robot, payload))
        say("draw")
        _draw(robot, reach, picture)
        drawn = picture
    seen = {f.check for f in findings}
    findings += [Finding(c, None, "not made: see above") for c in CHECKS if c not in seen]
    findings.sort(key=lambda f: CHECKS.index(f.check))
    seconds = time.monotonic() - start
    return RigReport(spec.name, hand, tuple(findings), drawn, payload, reach, seconds)


def first_hand(spec: RigSpec) -> str:
    """The hand that a rig is checked with: the first that it has a mount for, else `capsule`."""
    from bidexdata.hands import hand_names

    return next((name for name in spec.mounts if name in hand_names()), "capsule")


def _loaded(name: str, hand: str) -> tuple[list[Finding], Robot | None]:
    from bidexdata.arms.registry import load_rig
    from bidexdata.arms.robot import mount_robot
    from bidexdata.errors import UnknownName
    from bidexdata.hands import load_hands

    try:
        rig = load_rig(name)
    except BidexError as err:
        return [Finding("model", False, str(err))], None
    findings = [_model(rig)]
    try:
        robot = mount_robot(rig, load_hands(hand))
    except UnknownName:
        raise
    except BidexError as err:
        return [*findings, Finding("mounts", False, str(err))], None
    wrist = [f"{arm.side}: {arm.chain.joints} joints, {arm.chain.wrist} of them of the wrist"
             for arm in robot.arms]  # fmt: skip
    return [*findings, Finding("mounts", True, f"{hand}; " + "; ".join(wrist))], robot


def _model(rig: Rig) -> Finding:
    arms = {arm.spec.source: arm for arm in (rig.left, rig.right)}
    said = [
        f"{source}: {len(arm.spec.joints)} joints within the model's limits"
        for source, arm in arms.items()
    ]
    return Finding("model", True, "; ".join(said))


def _payload(robot: Robot, found: tuple[CarryFinding, ...]) -> Finding:
    from bidexdata.arms.payload import TooHeavy

    faults = [str(TooHeavy(robot, f)) for f in found if not f.fits]
    faults += [
        f"gravity takes {share(f.torque_share)} of a joint's torque of the {f.side} arm in one of "
        "20 postures; use a lighter hand or other places"
        for f in found
        if f.torque_share > 1
    ]
    said = [
        f"{f.side}: {f.carried:.2f} of {f.payload:g} kg, gravity takes at most "
        f"{share(f.torque_share)} of a joint's torque"
        for f in found
    ]
    return worst("payload", faults, "; ".join(said))


def _hanging(robot: Robot, model: mujoco.MjModel) -> list[Finding]:
    """A warning where hands hang in the air: it needs an adapter, or another mount."""
    from bidexdata.arms.mount_gap import mount_gaps

    gaps = dict(zip((arm.side for arm in robot.arms), mount_gaps(robot, model), strict=True))
    wide = [f"{side} {1e3 * gap:.0f} mm" for side, gap in gaps.items() if gap > GAP]
    if not wide:
        return []
    says = (
        f"warning: the hand is away from the arm's last link ({', '.join(wide)}): mind an adapter of that "
        "length, or change the mount's `pos`"
    )
    return [Finding("mounts", True, says)]


def _rest(robot: Robot, model: mujoco.MjModel) -> Finding:
    """Nothing overlaps at rest, and no two links always do."""
    import mujoco

    from bidexdata.arms.arm_spheres import ALWAYS

    data = mujoco.MjData(model)
    address = [_addresses(model, robot, h) for h in range(2)]
    for h, arm in enumerate(robot.arms):
        data.qpos[address[h]] = arm.chain.rest
        _open(model, data, robot, h)
    overlaps = _overlaps(model, data, robot)
    always, rng = Counter(), np.random.default_rng(0)
    for _ in range(_POSTURES):
        for h, arm in enumerate(robot.arms):
            data.qpos[address[h]] = rng.uniform(arm.chain.lower, arm.chain.upper)
        always.update(_overlaps(model, data, robot).keys())
    faults = []
    for (a, b), depth in sorted(overlaps.items(), key=lambda item: -item[1]):
        often = always[a, b] >= ALWAYS * _POSTURES
        advice = (
            "they always overlap: list the pair in exclude_contacts"
            if often
            else "choose another rest posture"
        )
        faults.append(f"{a} and {b} overlap by {1e3 * depth:.1f} mm at rest; {advice}")
    for (a, b), times in always.items():
        if (a, b) not in overlaps and times >= ALWAYS * _POSTURES:
            faults.append(f"{a} and {b} always overlap: list the pair in exclude_contacts")
    return worst("rest", faults, "no links, fixtures or table overlap at rest")


def _overlaps(
    model: mujoco.MjModel, data: mujoco.MjData, robot: Robot
) -> dict[tuple[str, str], float]:
    """Depth of the overlaps [m] that concern an arm, by the names of the bodies.

    As deep as a motion may not go: the simulation pushes links apart.
    """
    import mujoco

    from bidexdata.arms.config import ClearanceConfig
    from bidexdata.simulation.assembly import hand_prefix

    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    hands = {
        hand_prefix(h) + name for h, hand in enumerate(robot.hands) for name in hand.body_names
    }
    found: dict[tuple[str, str], float] = {}
    deepest = ClearanceConfig().depth
    for geoms, dist in zip(data.contact.geom, data.contact.dist, strict=True):
        bodies = [model.body(int(b)).name for b in model.geom_bodyid[geoms]]
        if dist > -deepest or set(bodies) <= hands:
            continue
        named = [
            model.geom(int(g)).name if body == "world" else body
            for g, body in zip(geoms, bodies, strict=True)
        ]
        a, b = sorted(named)
        found[a, b] = max(found.get((a, b), 0.0), -float(dist))
    return found


def _engines(robot: Robot, model: mujoco.MjModel) -> Finding:
    """MuJoCo, the reference and the kernels place the hands alike."""
    import mujoco

    from bidexdata.arms.chain import chain_forward
    from bidexdata.arms.inverse_kinematics import forward_on_device
    from bidexdata.simulation.assembly import hand_prefix

    data, largest, rng = mujoco.MjData(model), 0.0, np.random.default_rng(0)
    for h, (arm, hand) in enumerate(zip(robot.arms, robot.hands, strict=True)):
        chain = arm.chain
        random = rng.uniform(chain.lower, chain.upper, (_POSTURES, chain.joints))
        q = np.concatenate([[chain.lower, chain.upper, chain.rest], random])
        body, address = model.body(hand_prefix(h) + hand.root_body).id, _addresses(model, robot, h)
        placed = []
        for angles in q:
            data.qpos[address] = angles
            mujoco.mj_kinematics(model, data)
            placed.append(data.xpos[body].copy())
        for pos, _ in (chain_forward(chain, q), forward_on_device(chain, q)):
            largest = max(largest, float(np.abs(pos - np.array(placed)).max()))
    fault = (
        f"mujoco and ours place a hand {1e3 * largest:.3g} mm apart; this is a bug of bidexdata: "
        "report it with the rig and the models"
    )
    fine = f"mujoco, numpy and warp agree to {1e6 * largest:.2f} um"
    return worst("engines", [] if largest <= ENGINES else [fault], fine)


def _reach(report: ReachReport) -> Finding:
    from bidexdata.arms.reach_report import REASONS

    lost = ", ".join(f"{r} {share(report.share(r))}" for r in REASONS[1:] if report.share(r) > 0)
    sizes = ", ".join(f"{size:g} m {share(value)}" for size, value in report.by_size().items())
    said = f"{share(report.share())} of generic pairs ({sizes}); lost to: {lost or 'nothing'}"
    advice = "move the bases: benchmarks/rig_places.py tries a grid of places"
    fault = [f"{said}; {advice}"] if report.share() < LEAST_REACH else []
    return worst("reach", fault, said)


def _addresses(model: mujoco.MjModel, robot: Robot, h: int) -> np.ndarray:
    """Where the joints of one chain stand in qpos, (A,)."""
    from bidexdata.arms.assembly import arm_prefix
    from bidexdata.simulation.assembly import hand_prefix

    chain = robot.arms[h].chain
    arms = chain.joints - chain.wrist
    names = [
        (arm_prefix(h) if k < arms else hand_prefix(h)) + name
        for k, name in enumerate(chain.joint_names)
    ]
    return np.array([model.joint(name).qposadr[0] for name in names])


def _open(model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, h: int) -> None:
    """Put one hand into its open posture."""
    from bidexdata.simulation.assembly import hand_prefix

    hand = robot.hands[h]
    for name, angle in zip(hand.joint_names, hand.posture_open, strict=True):
        data.qpos[model.joint(hand_prefix(h) + name).qposadr[0]] = angle


def _draw(robot: Robot, report: ReachReport, out: Path) -> None:
    """Write the sheet: the rig at rest, pairs that it reaches, and the map of reach."""
    from bidexdata.arms.inverse_kinematics import IkConfig
    from bidexdata.arms.reach_report import SIZES
    from bidexdata.arms.views import (
        MAP_HEIGHTS,
        draw_reach,
        draw_robot,
        footprint_radius,
        shape_part,
    )
    from bidexdata.pictures.picture import drawn_by
    from bidexdata.pictures.sheet import Caption, Tile, contact_sheet, save_picture

    rest = np.full((2, robot.joints), np.nan)
    for h, arm in enumerate(robot.arms):
        rest[h, : arm.chain.joints] = arm.chain.rest
    tiles = [
        Tile(draw_robot(robot, rest, view), Caption(f"at rest, {view}"))
        for view in ("front", "side", "top")
    ]
    for size in (SIZES[0], SIZES[2], SIZES[-1]):
        rows = np.flatnonzero((report.reason == 0) & (report.pairs.size == size))
        if len(rows):
            row = int(rows[len(rows) // 2])
            pixels = draw_robot(robot, report.q[row], "front", more=[shape_part(report.pairs, row)])
            tiles.append(Tile(pixels, Caption(f"a generic pair at {size:g} m")))
    words = (
        "blue: left palm, green: right, dark: both, red: none",
        f"x right, y up, ticks of 0.1 m; yellow: the largest {SIZES[-1]:g} m object",
    )
    footprint = footprint_radius(report.pairs)
    for height in MAP_HEIGHTS:
        pixels = draw_reach(robot, height, IkConfig(), footprint=footprint)
        tiles.append(
            Tile(pixels, Caption(f"reach {height:g} m over the table, collisions left out", words))
        )
    sheet = contact_sheet(tiles, title=f"rig {robot.rig.spec.name}", footer=drawn_by(), columns=3)
    save_picture(sheet, out)
