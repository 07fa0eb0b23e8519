"""Attempts: what is tried in each scene, before anything is optimised.

Attempts of a scene are numbered over region pairs and random draws. Every scene has its own seed,
so that neither the other scenes of a call nor their order change it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from bidexdata.frames import matrix_from_quat
from bidexdata.hands.contact_sets import ContactSet, contact_view, usable_sets
from bidexdata.record import Scene, Status
from bidexdata.synthesis.placement import Placement, interleaved, place_palms
from bidexdata.synthesis.regions import RegionPairs, select_region_pairs
from bidexdata.synthesis.table import table_plane
from bidexdata.synthesis.workspace import Start

if TYPE_CHECKING:
    from bidexdata.arms.reach import Reach
    from bidexdata.hands.model import Hand
    from bidexdata.objects.prepared import PreparedObject
    from bidexdata.synthesis.config import SynthConfig


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Attempts:
    """M attempts of one scene, of which K have a start."""

    scene: Scene
    seed: int
    """Of this scene; every draw for it derives from this."""
    status: Int[np.ndarray, " M"]
    """OK where there is a start, else why not."""
    region_id: Int[np.ndarray, "M 2"]
    """Anchor of each hand's region; -1 without a region pair."""
    region_score: Float[np.ndarray, " M"]
    contact_set: tuple[ContactSet, ...]
    """What the hands of each attempt touch with, (M,)."""
    pairs: RegionPairs
    """What the attempts choose from, best first."""
    placed: Placement | None
    """Region pair and start of every attempt; None without a region pair."""
    start: Start
    """The K starts, in the order of their attempts, object frame."""

    @property
    def start_sets(self) -> tuple[ContactSet, ...]:
        """What the hands of each start touch with, (K,)."""
        return tuple(
            s for s, ok in zip(self.contact_set, self.status == Status.OK, strict=True) if ok
        )

    def of_set(self, name: ContactSet) -> Attempts:
        """Keep the attempts of one contact set, as a search and what follows it need them."""
        if set(self.contact_set) == {name}:
            return self
        kept = np.array([s == name for s in self.contact_set])
        return replace(
            self,
            status=self.status[kept],
            region_id=self.region_id[kept],
            region_score=self.region_score[kept],
            contact_set=(name,) * int(kept.sum()),
            placed=None,
            start=self.start.rows(np.array([s == name for s in self.start_sets], bool)),
        )


def scene_seed(seed: int, scene_id: str) -> int:
    """Derive the seed of a scene: 63 bits of a hash of run seed and scene."""
    digest = hashlib.sha256(f"{seed}\n{scene_id}".encode()).digest()
    return int.from_bytes(digest[:8], "big") >> 1


def grasp_ids(run_fingerprint: str, scene_id: str, numbers: Sequence[int]) -> list[str]:
    """Name attempts: 16 hex digits of a hash of run, scene and attempt number each."""
    texts = (f"{run_fingerprint}\n{scene_id}\n{number}" for number in numbers)
    return [hashlib.sha256(text.encode()).hexdigest()[:16] for text in texts]


def draw_attempts(
    obj: PreparedObject,
    hands: tuple[Hand, Hand],
    scene: Scene,
    config: SynthConfig,
    seed: int,
    count: int,
    *,
    grown: bool = False,
    device: str = "cpu",
    reach: Reach | None = None,
) -> Attempts:
    """Choose region pairs and place the palms for `count` attempts of a scene.

    Args:
        obj: The object.
        hands: Left and right.
        scene: Of this object.
        config: Of the whole synthesis.
        seed: Of this round of the run.
        count: M.
        grown: Earlier rounds have made attempts of this scene; they may have had the same pairs.
        device: Warp device of the regions; palms are placed on the CPU.
        reach: Arms that must be able to bring the hands to their starts.
    """
    own = scene_seed(seed, scene.scene_id)
    # A region is judged by as many contacts as the hand that comes to it can make.
    fewest = min(hand.fingertips for hand in hands)
    regions = replace(config.regions, contacts=min(config.regions.contacts, fewest))
    pairs = select_region_pairs(
        *(obj, scene, regions, np.random.default_rng([own, 0])),
        closure=config.optimise.closure,
        device=device,
    )
    if len(pairs.score) == 0:
        return _without_start(hands, scene, own, count, pairs)
    on_table = scene.setting == "tabletop"
    sets = usable_sets(
        hands, config.placement.table_contacts if on_table else config.placement.contacts
    )
    placed = interleaved(
        [
            place_palms(
                *(obj, [contact_view(hand, name) for hand in hands], scene, pairs),
                *(config.placement, np.random.default_rng([own, 1]), count),
                grown=grown,
                kind=(k, len(sets)),
                reach=reach,
            )
            for k, name in enumerate(sets)
        ]
    )
    ok, pair = placed.ok, placed.pair_index
    joints = [placed.joints[ok, h, : len(hand.joint_names)] for h, hand in enumerate(hands)]
    nearest_of = config.optimise.energy.region_distance
    targets = pairs.points if nearest_of == "points" else pairs.centres[:, :, None]
    failed = np.where(placed.reachable, Status.NO_PLACEMENT, Status.NOT_REACHABLE)
    start = Start(
        size=np.full(ok.sum(), scene.size),
        position=placed.hand_pos[ok],
        rotation=matrix_from_quat(placed.hand_quat[ok]),
        joints=(joints[0], joints[1]),
        regions=targets[pair[ok]],
        plane=np.tile(table_plane(scene), (ok.sum(), 1)),
    )
    return Attempts(
        scene=scene,
        seed=own,
        status=np.where(ok, Status.OK, failed).astype(np.int8),
        region_id=pairs.anchors[pair],
        region_score=pairs.score[pair],
        contact_set=tuple(sets[k % len(sets)] for k in range(count)),
        pairs=pairs,
        placed=placed,
        start=start,
    )


def gather_starts(attempts: Sequence[Attempts]) -> Start:
    """Join the starts of several scenes of one object."""
    starts = [a.start for a in attempts]
    joints = [np.concatenate([s.joints[h] for s in starts]) for h in range(2)]
    # A scene without starts says nothing about the number of region points.
    regions = [s.regions for s in starts if len(s.regions)] or [starts[0].regions]
    return Start(
        size=np.concatenate([s.size for s in starts]),
        position=np.concatenate([s.position for s in starts]),
        rotation=np.concatenate([s.rotation for s in starts]),
        joints=(joints[0], joints[1]),
        regions=np.concatenate(regions),
        plane=np.concatenate([s.plane for s in starts]),
    )


def _without_start(
    hands: tuple[Hand, Hand], scene: Scene, seed: int, count: int, pairs: RegionPairs
) -> Attempts:
    joints = [np.zeros((0, len(hand.joint_names))) for hand in hands]
    return Attempts(
        scene=scene,
        seed=seed,
        status=np.full(count, Status.NO_REGION_PAIR, np.int8),
        region_id=np.full((count, 2), -1),
        region_score=np.full(count, np.nan),
        contact_set=("fingertips",) * count,
        pairs=pairs,
        placed=None,
        start=Start(
            size=np.zeros(0),
            position=np.zeros((0, 2, 3)),
            rotation=np.zeros((0, 2, 3, 3)),
            joints=(joints[0], joints[1]),
            regions=np.zeros((0, 2, 1, 3)),
            plane=np.zeros((0, 4)),
        ),
    )


def rows_per_scene(attempts: Sequence[Attempts]) -> list[np.ndarray]:
    """Which of the joined starts belong to each scene."""
    ends = np.cumsum([len(a.start.size) for a in attempts])
    starts = np.append(0, ends[:-1])
    return [np.arange(a, b) for a, b in zip(starts, ends, strict=True)]
