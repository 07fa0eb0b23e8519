"""How fast each stage is on this machine: one process, built-in objects, nothing on disk.

Kernels are compiled before the clock starts. Rates are medians over objects, so that one object
that is fast or slow says little; two processes on two cores make nearly twice as much.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bidexdata.config import fingerprint, with_overrides
from bidexdata.record.scene import Scene

if TYPE_CHECKING:
    from bidexdata.hands.model import Hand
    from bidexdata.objects.prepared import PreparedObject

FAMILIES = ("box", "bottle", "mug")
SIZES_MM = (300, 500, 800)
ATTEMPTS = 20
"""Per object and size, as many as the paper has per world."""
PROTOCOL = "paper-1"
STEP_SET = "fingertips"
"""A bimanual step is timed with five contacts a hand."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Amounts:
    """What is measured."""

    families: tuple[str, ...] = FAMILIES
    sizes_mm: tuple[int, ...] = SIZES_MM
    attempts: int = ATTEMPTS


def stage_speeds(
    hand: str = "capsule",
    device: str = "cpu",
    amounts: Amounts | None = None,
    *,
    say: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Time preparation, synthesis, one step of the optimiser, and validation.

    Args:
        hand: NAME or LEFT,RIGHT.
        device: Warp device of the synthesis; the validation is on the CPU.
        amounts: Objects, sizes and attempts.
        say: Takes a line before each part.

    Returns:
        `prepare_seconds` per object; `attempts_per_second`; `attempts_with_a_grasp` (share);
        `microseconds_per_bimanual_step`; `verdicts_per_second` of test f with its metrics, of
        attempts with a grasp; `suc_f` of these; and what it is of: `hand`, `device`, `config`
        and `protocol` (fingerprints), `objects`, `attempts`.
    """
    from bidexdata.devices import check_device
    from bidexdata.hands import load_hands
    from bidexdata.objects.prepare import prepare_object
    from bidexdata.record import Status
    from bidexdata.synthesis.config import SynthConfig
    from bidexdata.synthesis.pipeline import synthesize
    from bidexdata.validation import load_protocol, validate_grasps

    check_device(device)
    amounts = amounts or Amounts()
    hands, config, protocol = load_hands(hand), SynthConfig(), load_protocol(PROTOCOL)
    taken: dict[str, list[float]] = {"prepare": [], "synth": [], "validate": []}
    fine: list[float] = []
    passed: list[bool] = []

    say("load or compile kernels")
    first = prepare_object(f"shapes:{amounts.families[0]}")
    warm = [Scene(first.object_id, amounts.sizes_mm[0])]
    synthesize(first, hands, warm, config, grasps=1, candidates=1, device=device)
    for family in amounts.families:
        say(f"{family}: prepare, synthesise, validate")
        obj, seconds = _timed(lambda family=family: prepare_object(f"shapes:{family}"))
        taken["prepare"].append(seconds)
        scenes = [Scene(obj.object_id, size) for size in amounts.sizes_mm]
        n = amounts.attempts

        def make(obj: PreparedObject = obj, scenes: list[Scene] = scenes, n: int = n) -> Any:
            return synthesize(obj, hands, scenes, config, grasps=n, candidates=n, device=device)

        batch, seconds = _timed(make)
        taken["synth"].append(n * len(scenes) / seconds)
        ok = batch["synth_status"] == Status.OK
        fine.append(float(ok.mean()))
        some = batch.select(ok)
        if len(some):
            verdicts, seconds = _timed(
                lambda some=some, obj=obj: validate_grasps(some, obj, hands, protocol)
            )
            taken["validate"].append(len(some) / seconds)
            passed += verdicts["success"].tolist()
    say("one step of the optimiser")
    return {
        "hand": hand,
        "device": device,
        "config": fingerprint(config),
        "protocol": fingerprint(protocol),
        "objects": len(amounts.families),
        "attempts": amounts.attempts * len(amounts.sizes_mm) * len(amounts.families),
        "prepare_seconds": statistics.median(taken["prepare"]),
        "attempts_per_second": statistics.median(taken["synth"]),
        "attempts_with_a_grasp": statistics.mean(fine),
        "microseconds_per_bimanual_step": step_microseconds(
            first, hands, amounts.sizes_mm, 4 * amounts.attempts, device=device
        ),
        "verdicts_per_second": statistics.median(taken["validate"]) if passed else None,
        "suc_f": statistics.mean(passed) if passed else None,
    }


def step_microseconds(
    obj: PreparedObject,
    hands: tuple[Hand, Hand],
    sizes_mm: Sequence[int],
    count: int,
    *,
    contacts: str = STEP_SET,
    device: str = "cpu",
) -> float | None:
    """Give what one step of the optimiser costs per attempt, both hands; median of three.

    None where no attempt has a start.
    """
    from bidexdata.hands.contact_sets import contact_view
    from bidexdata.synthesis.attempts import draw_attempts, gather_starts
    from bidexdata.synthesis.config import SynthConfig
    from bidexdata.synthesis.optimise import optimise

    config = with_overrides(SynthConfig(), [f"placement.contacts=[{contacts}]"])
    scenes = [Scene(obj.object_id, size) for size in sizes_mm]
    start = gather_starts(
        [draw_attempts(obj, hands, s, config, 0, count, device=device) for s in scenes]
    )
    if not len(start.size):
        return None
    touching = [contact_view(hand, contacts) for hand in hands]

    def work() -> None:
        import warp as wp

        optimise(obj, touching, start, config.optimise, device=device)
        wp.synchronize()

    work()
    seconds = statistics.median(_timed(work)[1] for _ in range(3))
    return 1e6 * seconds / (len(start.size) * config.optimise.steps)


def _timed(work: Callable[[], Any]) -> tuple[Any, float]:
    start = time.perf_counter()
    made = work()
    return made, time.perf_counter() - start
