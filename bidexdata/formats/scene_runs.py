"""Which runs worked on a scene: those of its rows, and others that fit what is stated of it.

The scenes table says how many runs worked on a scene and how many grasps they wanted of it, but not
which runs made the attempts of a scene without rows.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

from bidexdata.errors import Contradiction

_WAYS = 1000
"""Sets of runs that are tried; of more runs than give so many, the first set is taken."""


class SceneRuns:
    """Finds the runs of scenes.

    State: whether for some scene several sets of runs would do.
    """

    def __init__(self, wanted: Mapping[str, int | None]):
        """Know the runs.

        Args:
            wanted: Grasps per scene that every run of the release wanted; None where it did not say.
        """
        self._wanted = wanted
        self.ambiguous = False
        """Whether what was said of some scene fits other runs too."""

    def of(self, scene: Mapping[str, Any], known: set[str]) -> set[str]:
        """Runs of a scene.

        Args:
            scene: Its row of the scenes table.
            known: The runs of its rows.

        Raises:
            Contradiction: No runs give what the scenes table says.
        """
        missing = scene["runs"] - len(known)
        if missing <= 0:
            return known
        wanted = scene["grasps_wanted"] - sum(self._wanted[run] or 0 for run in known)
        others = sorted(set(self._wanted) - known)
        ways = list(itertools.islice(itertools.combinations(others, missing), _WAYS + 1))
        fits = [way for way in ways if sum(self._wanted[run] or 0 for run in way) == wanted]
        self.ambiguous |= len(fits) > 1 or len(ways) > _WAYS
        if not fits and len(ways) <= _WAYS:
            raise Contradiction(f"scene {scene['scene_id']}: no runs give its grasps_wanted")
        return known.union((fits or ways)[0])
