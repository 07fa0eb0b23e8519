"""How good region pairs are before any hand: Q1 of contacts that are drawn in them, per score.

Of every object at every size the first five pairs are taken, five contacts are drawn in each of
their regions, and Q1 says how large a wrench ball these ten resist. All kinds of regions of a scene
have the same random numbers. One file per object: a killed command goes on where it stopped.

Source: BiDexGrasp, appendix "Qualitative Experiments of Region Selection". Q1's friction cones,
units and torque length, which it does not give, are those of DexGraspBench (`validation.analytic`).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bidexdata.config import fingerprint, to_plain, with_overrides
from bidexdata.errors import ConfigConflict, Contradiction
from bidexdata.runs.bench_rows import NO_REGIONS, Change, assignments
from bidexdata.runs.executors import TaskFailure, run_tasks
from bidexdata.runs.progress import Progress
from bidexdata.runs.shards import write_text
from bidexdata.runs.stage import TaskExecution

if TYPE_CHECKING:
    from bidexdata.objects.library import Library
    from bidexdata.synthesis.regions import RegionConfig, RegionPairs

PAIRS = 5
"""Pairs per scene (paper; per object there)."""
CONTACTS = 5
"""Contacts per region (paper)."""
FRICTION = 0.3
"""Half of the simulation's (DexGraspBench); the friction of the scores too [-]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RegionKind:
    """One way of choosing pairs of regions."""

    name: str
    says: str
    preset: str = "default"
    changes: tuple[Change, ...] = ()

    def config(self) -> RegionConfig:
        """Its numbers."""
        from bidexdata.synthesis.presets import load_preset

        return with_overrides(load_preset(self.preset), assignments(self.changes)).regions


KINDS = (
    RegionKind(
        name="paper_random",
        says="random sampling: any two regions, by lot",
        preset="paper",
        changes=NO_REGIONS,
    ),
    RegionKind(name="paper", says="the paper's: best by the force score", preset="paper"),
    RegionKind(
        name="random",
        says="by lot among those that ours allows",
        changes=(Change("regions.score", "random"),),
    ),
    RegionKind(
        name="force",
        says="of those the best by the force score",
        changes=(Change("regions.score", "force"),),
    ),
    RegionKind(name="torque", says="ours: of those the best by balance with torques"),
)


def measure_regions(
    library: Library,
    object_ids: Sequence[str],
    sizes_mm: Sequence[int],
    seed: int,
    folder: Path,
    execution: TaskExecution,
) -> list[TaskFailure]:
    """Measure what is missing: one file per object in `folder`.

    Raises:
        ConfigConflict: A file is of other sizes, regions or contents of the object.
        Contradiction: A file is damaged.
    """
    done = [i for i in object_ids if _path(folder, i).is_file()]
    for object_id in done:
        read_regions(library, object_id, sizes_mm, seed, folder)
    open_ = [i for i in object_ids if i not in set(done)]
    work = partial(object_q1, str(library.path), tuple(sizes_mm), seed)
    failures = []
    with Progress(len(object_ids), "object", quiet=execution.quiet, already=len(done)) as progress:
        results = run_tasks(open_, work, executor=execution.executor, workers=execution.workers)
        for object_id, result in results:
            if isinstance(result, TaskFailure):
                failures.append(result)
                progress.write(f"regions of {object_id} failed: {result.reason}")
            else:
                mark = _mark(library, object_id, sizes_mm, seed)
                data = {"fingerprint": mark, "q1": result}
                write_text(_path(folder, object_id), json.dumps(data, indent=1) + "\n")
            progress.advance()
    return failures


def read_regions(
    library: Library, object_id: str, sizes_mm: Sequence[int], seed: int, folder: Path
) -> dict[str, list[float]] | None:
    """Q1 of one object's pairs per kind; None where it is not measured.

    Raises:
        ConfigConflict: The file is of other sizes, regions or contents of the object.
        Contradiction: It is damaged.
    """
    path = _path(folder, object_id)
    if not path.is_file():
        return None
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        stated, found = data["fingerprint"], {k.name: data["q1"][k.name] for k in KINDS}
    except (ValueError, KeyError, TypeError) as err:
        raise Contradiction(f"{path}: damaged; delete it and run the command again") from err
    mark = _mark(library, object_id, sizes_mm, seed)
    if stated != mark:
        raise ConfigConflict(path, [f"fingerprint: {stated!r} -> {mark!r}"])
    return found


def object_q1(
    library: str, sizes_mm: tuple[int, ...], seed: int, object_id: str
) -> dict[str, list[float]]:
    """Q1 of the first pairs of every kind, size after size; fewer where there are fewer pairs."""
    from bidexdata.objects.library import Library
    from bidexdata.record import Scene
    from bidexdata.synthesis.attempts import scene_seed
    from bidexdata.synthesis.regions import select_region_pairs

    obj = Library.open(library).load(object_id)
    scenes = [Scene(object_id, mm) for mm in sizes_mm]
    found: dict[str, list[float]] = {}
    for kind in KINDS:
        config, values = kind.config(), []
        for scene in scenes:
            own = scene_seed(seed, scene.scene_id)
            pairs = select_region_pairs(obj, scene, config, np.random.default_rng([own, 0]))
            values += pair_q1(pairs, np.random.default_rng([own, 1]))
        found[kind.name] = values
    return found


def pair_q1(pairs: RegionPairs, rng: np.random.Generator) -> list[float]:
    """Q1 of contacts drawn in each of the first region pairs [-]."""
    from bidexdata.validation.analytic import TipContacts, q1

    found = []
    for points, normals in zip(pairs.points[:PAIRS], pairs.normals[:PAIRS], strict=True):
        drawn = [_draw(region, rng) for region in points]
        contacts = TipContacts(
            np.concatenate([points[h][k] for h, k in enumerate(drawn)]).astype(np.float64),
            -np.concatenate([normals[h][k] for h, k in enumerate(drawn)]).astype(np.float64),
        )
        found.append(q1(contacts, FRICTION))
    return found


def _draw(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Numbers of different points of a region, as many as there are up to `CONTACTS`."""
    _, first = np.unique(points, axis=0, return_index=True)
    return rng.permutation(np.sort(first))[:CONTACTS]


def _path(folder: Path, object_id: str) -> Path:
    return folder / f"{object_id}.json"


def _mark(library: Library, object_id: str, sizes_mm: Sequence[int], seed: int) -> str:
    """What decides the numbers of an object."""
    kinds: dict[str, Any] = {kind.name: to_plain(kind.config()) for kind in KINDS}
    contents = library.row(object_id)["content_sha256"]
    return fingerprint([kinds, list(sizes_mm), seed, PAIRS, CONTACTS, FRICTION, contents])
