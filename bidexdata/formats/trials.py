"""Successes, rows and wanted rows per test, setting, size and object: what the rates are made of.

Definitions: `formats.figures`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import numpy as np

from bidexdata.record import GraspBatch
from bidexdata.record.rates import Rate, clustered_interval
from bidexdata.record.scene import SceneParts


class Place(NamedTuple):
    """Where a scene is counted."""

    setting: str
    size_mm: int


class TrialTally:
    """Add rows of whole scenes, then read `rate` and `kept`.

    State: counts per (kind, test, place, object); nothing per grasp.
    """

    def __init__(self) -> None:
        # (kind, test, place) -> object -> [successes, rows, rows wanted]
        self._trials: dict[tuple[str, str, Place], dict[str, list[int]]] = defaultdict(dict)
        self._kept: dict[Place, list[int]] = {}
        self._rows: dict[Place, list[int]] = {}

    @property
    def places(self) -> tuple[Place, ...]:
        """Where scenes were counted, sorted."""
        return tuple(sorted(self._kept))

    def add(
        self,
        batch: GraspBatch,
        flags: Mapping[str, np.ndarray],
        passed: Mapping[str, np.ndarray],
        touched: Mapping[str, SceneParts],
        new: Collection[str],
        grasps: int | None,
        among: Mapping[str, np.ndarray] | None = None,
    ) -> None:
        """Count rows.

        Args:
            batch: The rows.
            flags: `selected` and `audit`, (N,).
            passed: Per test that was run, the rows that count as successes, (N,).
            touched: Every scene that the rows stand for.
            new: Those that this run had not touched before.
            grasps: N of the run; None where it had none.
            among: Of tests whose trials are not all rows, those that are, (N,); rows that a scene
                could not fill are then none.
        """
        among = among or {}
        tabletop = batch["setting"] == "tabletop"
        for place in sorted({Place(s.setting, s.size_mm) for s in touched.values()}):
            here = (batch["size_mm"] == place.size_mm) & (tabletop == (place.setting == "tabletop"))
            scenes = {n: s for n, s in touched.items() if (s.setting, s.size_mm) == place}
            fresh = [s for name, s in scenes.items() if name in new]
            kept = self._kept.setdefault(place, [0, 0])
            if grasps is not None:
                kept[0] += _number(flags["selected"] & here)
                kept[1] += grasps * len(fresh)
            rows = self._rows.setdefault(place, [0, 0])
            rows[0] += _number(flags["selected"] & here)
            rows[1] += _number(flags["audit"] & here)
            for obj in sorted({scene.object_id for scene in scenes.values()}):
                mine = here & (batch["object_id"] == obj)
                chosen, drawn = (mine & flags[name] for name in ("selected", "audit"))
                for test, won in passed.items():
                    of = among.get(test, mine)
                    counts = (_number(won & of & chosen), _number(of & chosen))
                    self._count(("selected", test, place), obj, *counts)
                    if grasps is not None:
                        wanted = grasps * sum(1 for scene in fresh if scene.object_id == obj)
                        wanted = 0 if test in among else wanted
                        counts = (_number(won & of & drawn), _number(of & drawn))
                        self._count(("unselected", test, place), obj, *counts, wanted)

    def rate(self, kind: str, test: str, places: Collection[Place]) -> Rate:
        """Rate `selected` or `unselected` of a test over some places."""
        objects: dict[str, list[int]] = {}
        for place in places:
            for obj, (k, n, wanted) in self._trials[(kind, test, place)].items():
                pair = objects.setdefault(obj, [0, 0])
                pair[0] += k
                pair[1] += max(n, wanted)  # audit rows that a scene could not fill are failures
        pairs = [objects[o] for o in sorted(objects)]
        return clustered_interval([p[0] for p in pairs], [p[1] for p in pairs])

    def kept(self, places: Collection[Place]) -> float | None:
        """Selected rows / wanted ones; None where no run wanted a number."""
        wanted = sum(self._kept[place][1] for place in places)
        return sum(self._kept[place][0] for place in places) / wanted if wanted else None

    def rows(self, places: Collection[Place]) -> dict[str, int]:
        """`selected_rows` and `audit_rows`."""
        sums = np.sum([self._rows[place] for place in places] or [[0, 0]], axis=0)
        return dict(zip(("selected_rows", "audit_rows"), sums.tolist(), strict=True))

    def rates(self, tests: Collection[str], places: Collection[Place]) -> dict[str, Any]:
        """`kept`, and `selected_<test>` and `unselected_<test>` of every test."""
        found = {
            f"{kind}_{test}": self.rate(kind, test, places).to_dict()
            for test in tests
            for kind in ("selected", "unselected")
        }
        return {"kept": self.kept(places), **found}

    def _count(
        self, key: tuple[str, str, Place], obj: str, k: int, n: int, wanted: int = 0
    ) -> None:
        trials = self._trials[key].setdefault(obj, [0, 0, 0])
        for i, value in enumerate((k, n, wanted)):
            trials[i] += value


def _number(mask: np.ndarray) -> int:
    return int(np.count_nonzero(mask))
