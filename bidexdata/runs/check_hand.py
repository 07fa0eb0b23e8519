"""Check a user's own hand: spec against model, side against side, engine against engine, a grasp.

The order is that of dependence: a check whose ground has failed is not made.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from bidexdata.errors import BidexError
from bidexdata.hands.findings import Finding, worst

if TYPE_CHECKING:
    from bidexdata.hands.model import Hand, Side
    from bidexdata.hands.spec import HandSpec
    from bidexdata.objects.prepared import PreparedObject
    from bidexdata.record import GraspBatch

OBJECT = "shapes:box"
SIZE_MM = 300
GRASPS = 4
"""Grasps of the trial; one that holds is enough, since one object says nothing about a rate."""
PROTOCOL = "paper-1"
OVERLAP = 0.001
"""Deepest overlap of a hand's own links in a starting posture [m]: the simulation pushes them
apart."""
CHECKS = ("model", "limits", "spec", "armature", "mirror", "palm", "contacts", "spheres", "engines",
          "postures", "grasp")  # fmt: skip
"""All checks in their order."""


@dataclass(frozen=True, slots=True)
class Trial:
    """The grasps of the trial, best first, with their verdicts."""

    obj: PreparedObject
    batch: GraspBatch
    success: np.ndarray
    """(N,) bool."""


@dataclass(frozen=True, slots=True)
class HandReport:
    """What the checks of one hand said."""

    name: str
    findings: tuple[Finding, ...]
    picture: Path | None
    """None where the hand could not be loaded."""
    trial: Trial | None
    seconds: float

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the checks that failed, each once, in their order."""
        names = {f.check for f in self.findings if f.passed is False}
        return tuple(name for name in CHECKS if name in names)

    def as_dict(self) -> dict[str, Any]:
        """Plain data for `--json`."""
        return {
            "hand": self.name,
            "passed": not self.failed,
            "checks": [f._asdict() for f in self.findings],
            "picture": None if self.picture is None else str(self.picture),
            "grasps": 0 if self.trial is None else len(self.trial.success),
            "grasps_held": 0 if self.trial is None else int(self.trial.success.sum()),
            "seconds": round(self.seconds, 3),
        }


def check_hand(
    name: str,
    picture: Path,
    *,
    seed: int = 0,
    say: Callable[[str], None] = lambda _: None,
) -> HandReport:
    """Check one hand and draw what there is to see.

    Args:
        name: A hand that comes with the package, or the path of a YAML spec.
        picture: Image file to write.
        seed: Of the trial grasps.
        say: Takes a line before each part that takes its time.

    Raises:
        UnknownName: No hand has this name and no file this path.
        BadConfig: The file is no spec.
    """
    from bidexdata.hands.registry import hand_spec

    start = time.monotonic()
    spec = hand_spec(name)
    say("load the models, compare them with the spec, move the fingers")
    findings, hands = inspect_hand(name)
    trial = drawn = None
    if hands:
        say(f"grasp {OBJECT} at {SIZE_MM / 1000:g} m, and test the grasps")
        made, trial = _grasp(hands, findings, seed)
        findings.append(made)
        say("draw")
        _draw(spec.name, hands, trial, picture)
        drawn = picture
    seen = {f.check for f in findings}
    findings += [Finding(c, None, "not made: see above") for c in CHECKS if c not in seen]
    return HandReport(spec.name, tuple(findings), drawn, trial, time.monotonic() - start)


def inspect_hand(name: str) -> tuple[list[Finding], list[Hand]]:
    """Make every check but the grasp.

    Returns:
        What was found, in order, and the sides, the written one first; no side where the hand
        cannot be loaded.

    Raises:
        UnknownName: No hand has this name and no file this path.
        BadConfig: The file is no spec.
    """
    from bidexdata.hands.registry import hand_spec

    spec = hand_spec(name)
    findings, hands = _loaded(name, spec)
    if hands:
        findings += [*_of_hands(spec, hands), _postures(hands)]
    return findings, hands


def _loaded(name: str, spec: HandSpec) -> tuple[list[Finding], list[Hand]]:
    """Load every side, the written one first, or say what stands against it."""
    from bidexdata.hands import load_hand
    from bidexdata.hands.checks import check_limits
    from bidexdata.hands.mirror import NoMirrorImage
    from bidexdata.hands.registry import spec_path
    from bidexdata.hands.source import load_model
    from bidexdata.hands.tree import read_tree

    sides = sorted(spec.sides, key=lambda side: side != spec.written_for)
    trees, findings = {}, []
    for side in sides:
        try:
            mjcf = load_model(spec, cast("Side", side), spec_path(name).parent)
            trees[side] = read_tree(mjcf.make_spec().compile())
        except BidexError as err:
            return [Finding("model", False, f"{side}: {err}")], []
    sizes = [f"{s}: {len(t.joint_names)} joints, {len(t.actuator_names)} actuators"
             for s, t in trees.items()]  # fmt: skip
    findings.append(Finding("model", True, "; ".join(sizes)))
    findings += [check_limits(spec, side, tree) for side, tree in trees.items()]
    if any(f.passed is False for f in findings):
        return findings, []
    try:
        hands = [load_hand(name, cast("Side", side)) for side in sides]
    except NoMirrorImage as err:
        return [*findings, Finding("mirror", False, str(err))], []
    except BidexError as err:
        return [*findings, Finding("spec", False, str(err))], []
    named = f"{len(spec.fingers)} fingers, {len(spec.contacts)} contact points"
    return [*findings, Finding("spec", True, f"{named}; all names are in the model")], hands


def _of_hands(spec: HandSpec, hands: Sequence[Hand]) -> list[Finding]:
    from bidexdata.hands.agreement import check_engines, check_mirror
    from bidexdata.hands.checks import (
        check_armature,
        check_contacts,
        check_palm,
        check_spheres,
    )

    models = [hand.make_spec().compile() for hand in hands]
    armature = [check_armature(hand, model) for hand, model in zip(hands, models, strict=True)]
    if len(hands) == 2:
        found = [check_mirror(spec, hands[0], hands[1], (models[0], models[1]))]
    else:
        found = [Finding("mirror", None, "the spec has one side")]
    for check in (check_palm, check_contacts, check_spheres, check_engines):
        found += [check(hand, model) for hand, model in zip(hands, models, strict=True)]
    return [*armature, *found]


def _postures(hands: Sequence[Hand]) -> Finding:
    """No two links of a hand overlap in a starting posture, as the simulation sees them."""
    from bidexdata.simulation.distances import list_contacts
    from bidexdata.simulation.scene import build_scene
    from bidexdata.simulation.state import set_pose

    faults, deepest = [], 0.0
    for hand in hands:
        scene = build_scene([hand], None, 1.0)
        for posture in ("open", "curved"):
            joints = hand.posture_open if posture == "open" else hand.posture_curved
            set_pose(scene, np.zeros(3), [1, 0, 0, 0], np.zeros((1, 3)), [[1, 0, 0, 0]], [joints])
            contacts = list_contacts(scene, 0.0, full_broad_phase=True)
            for geoms, dist in zip(contacts.geoms, contacts.dist, strict=True):
                deepest = max(deepest, -float(dist))
                if dist < -OVERLAP:
                    a, b = (hand.plain_body_names[scene.geom_body[g]] for g in geoms)
                    faults.append(
                        f"{hand.side}: {a} and {b} overlap by {-1e3 * dist:.1f} mm in "
                        f"postures.{posture}; spread them, or list the pair in exclude_contacts if "
                        "the links always touch"
                    )
    return worst("postures", faults, f"links overlap by at most {1e3 * deepest:.1f} mm")


def _grasp(
    hands: Sequence[Hand], findings: Sequence[Finding], seed: int
) -> tuple[Finding, Trial | None]:
    """Grasp a box with both hands and test the grasps."""
    if len(hands) < 2:
        return Finding(
            "grasp", None, "synthesis makes two-handed grasps; the spec has one side"
        ), None
    if any(f.passed is False for f in findings):
        return Finding("grasp", None, "not made: the checks above come first"), None
    trial = try_grasps(hands, seed)
    held, count = int(trial.success.sum()), len(trial.success)
    about = (
        f"{held} of {count} grasps of {OBJECT} at {SIZE_MM / 1000:g} m hold ({PROTOCOL}, test f)"
    )
    if held:
        return Finding("grasp", True, about), trial
    statuses = next(iter(trial.batch.header.counts.values()), {})
    attempts = ", ".join(f"{n} {label}" for label, n in sorted(statuses.items()))
    advice = "look at the picture: do the pads face the object, and do the fingers reach it?"
    return Finding("grasp", False, f"{about}; attempts: {attempts}; {advice}"), trial


def try_grasps(hands: Sequence[Hand], seed: int) -> Trial:
    """Make and test the trial grasps.

    Args:
        hands: Both sides, in any order.
        seed: Of the synthesis.
    """
    from bidexdata.objects.prepare import prepare_object
    from bidexdata.record import Scene
    from bidexdata.synthesis.pipeline import synthesize
    from bidexdata.validation.protocols import load_protocol
    from bidexdata.validation.validate import validate_grasps

    left, right = sorted(hands, key=lambda hand: hand.side)
    obj = prepare_object(OBJECT)
    scene = Scene(obj.object_id, SIZE_MM)
    batch = synthesize(obj, (left, right), [scene], seed=seed, grasps=GRASPS)
    batch = batch.select(batch["selected"])
    verdicts = validate_grasps(batch, obj, (left, right), load_protocol(PROTOCOL))
    return Trial(obj, batch.with_columns(**verdicts), np.asarray(verdicts["success"], bool))


def _draw(name: str, hands: Sequence[Hand], trial: Trial | None, out: Path) -> None:
    """Write the sheet: each side in both postures, as drawn and as spheres, and a trial grasp."""
    from bidexdata.pictures.hand_views import hand_tiles
    from bidexdata.pictures.picture import draw_grasp, drawn_by
    from bidexdata.pictures.sheet import Caption, Tile, contact_sheet, save_picture

    tiles = [tile for hand in hands for tile in hand_tiles(hand)]
    if trial is not None and len(trial.success):
        left, right = sorted(hands, key=lambda hand: hand.side)
        row = int(np.argmax(trial.success))
        held = bool(trial.success[row])
        for stage in ("pregrasp", "grasp", "squeeze"):
            pixels = draw_grasp(trial.batch, row, trial.obj, (left, right), stage=stage)
            words = Caption(
                f"trial grasp, {stage}", ("holds" if held else "does not hold",), (held,)
            )
            tiles.append(Tile(pixels, words))
    sheet = contact_sheet(tiles, title=f"hand {name}", footer=drawn_by(), columns=4)
    save_picture(sheet, out)
