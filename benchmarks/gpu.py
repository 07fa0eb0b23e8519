"""What a GPU gives, and whether it says the same: `python -m benchmarks.gpu --device cuda:0`.

MuJoCo Warp against the C engine on a sample of unselected grasps, its verdicts a second at several
batch sizes, and the optimiser and the synthesis at several numbers of attempts. Figures of an H100
stand in docs/mujoco_warp.md. `--device cpu --small` rehearses it all with a few grasps.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from benchmarks.machine import median_seconds
from benchmarks.objects import hands, prepared
from benchmarks.report import report
from bidexdata.config import fingerprint, to_plain
from bidexdata.devices import start_warp
from bidexdata.errors import NotUsable
from bidexdata.record import GraspBatch, Scene, Status
from bidexdata.runs.bench_stages import step_microseconds
from bidexdata.synthesis.config import SynthConfig
from bidexdata.synthesis.pipeline import synthesize
from bidexdata.validation import load_protocol, on_backend, validate_grasps
from bidexdata.validation.validate import grasp_of, scene_of_rows
from bidexdata.validation.warp_backend import warp_verdicts


@dataclass(frozen=True, slots=True, kw_only=True)
class Amounts:
    """How much is measured."""

    families: tuple[str, ...] = ("box", "bottle", "mug")
    sizes_mm: tuple[int, ...] = (300, 500, 800)
    attempts: int = 24
    """Per object-size; those with a grasp are the sample."""
    repeated: tuple[int, ...] = (1, 8, 40, 120)
    """The last family's grasps at the middle size, so many times over, are one batch each."""
    starts: tuple[int, ...] = (20, 100, 500, 2000)
    """Attempts that are optimised together, first family, middle size."""

    @property
    def middle(self) -> int:
        """The middle size [mm]."""
        return self.sizes_mm[len(self.sizes_mm) // 2]


SMALL = Amounts(families=("box",), sizes_mm=(300,), attempts=3, repeated=(1,), starts=(5,))


def missing() -> str:
    """Why nothing can be measured here; empty where it can."""
    if find_spec("mujoco_warp") is None:
        return "needs mujoco-warp: pip install 'bidexdata[gpu]'"
    start_warp()
    import warp as wp

    return "" if wp.is_cuda_available() else "this machine has no GPU"


def measure() -> dict[str, Any]:
    """All figures of the first GPU."""
    return {key: value for part in parts("cuda:0", Amounts()) for key, value in part.items()}


def parts(device: str, amounts: Amounts) -> Iterator[dict[str, Any]]:
    """Figures as they come. Compile first, outside every figure; then agreement, verdicts and grasps a second."""
    first = time.perf_counter()
    few = _sample(amounts.families[0], amounts.middle, 2)
    judged = on_backend(load_protocol("paper-1"), "mujoco_warp", device)
    _validate(amounts.families[0], few, device)
    yield {
        "device": _name(device),
        "engine": to_plain(judged.engine),
        "protocol": fingerprint(judged),
        "config": fingerprint(SynthConfig()),
        "first_call_seconds": time.perf_counter() - first,
    }
    yield _agreement(amounts, device)
    yield {"verdicts_per_second": _verdict_rates(amounts, device)}
    yield {"optimiser": _optimiser(amounts, device)}
    yield {"synthesis": _synthesis(amounts, device)}


def _agreement(amounts: Amounts, device: str) -> dict[str, Any]:
    """Verdicts of both engines on the same grasps, and of the second engine twice.

    The C engine's rate is that of one core, metrics included.
    """
    both, repeats, drift, spread = [], [], [], []
    c_seconds = 0.0
    for family in amounts.families:
        for size in amounts.sizes_mm:
            batch = _sample(family, size, amounts.attempts)
            start = time.perf_counter()
            c = _validate(family, batch)
            c_seconds += time.perf_counter() - start
            one, two = (_validate(family, batch, device) for _ in range(2))
            both += zip(_verdicts(c), _verdicts(one), strict=True)
            repeats += [a == b for a, b in zip(_verdicts(one), _verdicts(two), strict=True)]
            drift.append(np.abs(one["drift_pos"] - c["drift_pos"]))
            spread.append(np.abs(one["drift_pos"] - two["drift_pos"]))
    apart = 1000 * np.concatenate(drift)
    return {
        "n": len(both),
        "success_equal": sum(a[0] == b[0] for a, b in both),
        "status_and_direction_equal": sum(a == b for a, b in both),
        "success_c_engine": sum(a[0] for a, _ in both),
        "differ": [[_spelled(a), _spelled(b)] for a, b in both if a != b],
        "same_verdict_twice": sum(repeats),
        "drift_difference_mm_median": float(np.nanmedian(apart)),
        "drift_difference_mm_largest": float(np.nanmax(apart)),
        "drift_twice_mm_largest": 1000 * float(np.nanmax(np.concatenate(spread))),
        "verdicts_per_second_c_engine": len(both) / c_seconds,
    }


def _verdict_rates(amounts: Amounts, device: str) -> dict[str, dict[str, float]]:
    """Start checks and simulation, without the metrics, per number of grasps in one batch."""
    protocol, family = load_protocol("paper-1"), amounts.families[-1]
    batch = _sample(family, amounts.middle, amounts.attempts)
    scene = scene_of_rows(batch, prepared(family), hands(), protocol, "f")
    grasps = [grasp_of(batch, row) for row in range(len(batch))]
    found = {}
    for times in amounts.repeated:
        start = time.perf_counter()
        verdicts = warp_verdicts(scene, protocol, grasps * times, device=device)
        seconds = time.perf_counter() - start
        share = np.mean([v.status is Status.OK for v in verdicts])
        found[str(len(verdicts))] = {
            "rate": len(verdicts) / seconds,
            "success": float(share),
            **_peak_memory(device),
        }
    return found


def _optimiser(amounts: Amounts, device: str) -> dict[str, dict[str, float | None]]:
    """Microseconds per bimanual step, per number of attempts in one batch."""
    obj, found = prepared(amounts.families[0]), {}
    for count in amounts.starts:
        cost = step_microseconds(obj, hands(), [amounts.middle], count, device=device)
        found[str(count)] = {"microseconds_per_bimanual_step": cost}
    return found


def _synthesis(amounts: Amounts, device: str) -> dict[str, dict[str, float]]:
    """Raw grasps a second, regions and placement included, per number of attempts in one batch."""
    found = {}
    for count in amounts.starts:
        kept: list[GraspBatch] = []
        work = _synchronised(
            lambda n=count, kept=kept: kept.append(
                _synthesize(amounts.families[0], amounts.middle, n, device)
            )
        )
        seconds = median_seconds(work, repeats=3)
        share = np.mean(kept[-1].synth_status == Status.OK)
        found[str(count)] = {
            "raw_grasps_per_second": count / seconds,
            "attempts_with_a_grasp": float(share),
        }
    return found


def _sample(family: str, size_mm: int, attempts: int) -> GraspBatch:
    """Unselected grasps, made on the CPU so that they are the same everywhere."""
    batch = _synthesize(family, size_mm, attempts, "cpu")
    return batch.select(batch.synth_status == Status.OK)


def _synthesize(family: str, size_mm: int, attempts: int, device: str) -> GraspBatch:
    obj = prepared(family)
    scenes = [Scene(obj.object_id, size_mm)]
    return synthesize(
        *(obj, hands(), scenes, SynthConfig(), 0),
        grasps=attempts,
        candidates=attempts,
        device=device,
    )


def _validate(family: str, batch: GraspBatch, device: str = "") -> dict[str, np.ndarray]:
    """Verdicts of the C engine, or of MuJoCo Warp where a device is named."""
    protocol, obj = load_protocol("paper-1"), prepared(family)
    if not device:
        return validate_grasps(batch, obj, hands(), protocol)
    return validate_grasps(batch, obj, hands(), protocol, backend="mujoco_warp", device=device)


def _verdicts(columns: dict[str, np.ndarray]) -> list[tuple[bool, int, int]]:
    names = ("success", "verdict_status", "direction")
    return list(zip(*(columns[n].tolist() for n in names), strict=True))


def _spelled(verdict: tuple[bool, int, int]) -> str:
    _, status, direction = verdict
    return f"{Status(status).label} in load {direction}"


def _synchronised(work: Callable[[], object]) -> Callable[[], None]:
    def run() -> None:
        import warp as wp

        work()
        wp.synchronize()

    return run


def _peak_memory(device: str) -> dict[str, float]:
    """The most memory of a GPU that was in use so far; nothing where it keeps no count."""
    import warp as wp

    if not (wp.get_device(device).is_cuda and wp.is_mempool_enabled(device)):
        return {}
    return {"peak_mib": wp.get_mempool_used_mem_high(device) / 2**20}


def _name(device: str) -> str:
    import warp as wp

    return wp.get_device(device).name


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure on one device, print and save results/gpu.json (gpu-small.json)."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--small", action="store_true", help="a few grasps, to try the script")
    asked = parser.parse_args(arguments)
    try:
        figures: dict[str, Any] = {}
        for part in parts(asked.device, SMALL if asked.small else Amounts()):
            figures |= part
            report("gpu-small" if asked.small else "gpu", part, whole=figures)
    except NotUsable as err:
        parser.exit(3, f"error: {err}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
