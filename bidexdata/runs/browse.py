"""One way to look into a library, a run or a release: objects, and the grasps of one object.

Pictures and the viewer read through `Browsable` and do not know which of the three is behind it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from bidexdata.kinds import Kind, expect_kind
from bidexdata.record import GraspBatch
from bidexdata.record.status import Status
from bidexdata.runs.browse_library import LibrarySource
from bidexdata.runs.browse_release import ReleaseSource
from bidexdata.runs.browse_run import RunSource

if TYPE_CHECKING:
    from bidexdata.arms.robot import Robot
    from bidexdata.hands.model import Hand
    from bidexdata.objects.prepared import Solid
    from bidexdata.runs.release_rows import ReleaseRowsIndex


@runtime_checkable
class Browsable(Protocol):
    """What can be looked into."""

    kind: Kind
    path: Path
    protocol: str
    """Whose verdicts are shown; empty when nothing is validated."""
    tests: tuple[str, ...]
    """Tests of it that have verdicts."""
    test: str
    """The first of them, by which grasps are chosen; empty when nothing is validated."""

    @property
    def object_ids(self) -> tuple[str, ...]:
        """Objects, sorted."""
        ...

    def categories(self) -> tuple[str, ...]:
        """Category of each object; empty where none is known."""
        ...

    def load_solid(self, object_id: str) -> Solid:
        """Read one object."""
        ...

    def index(self) -> ReleaseRowsIndex | None:
        """What finds rows of all objects without reading them; None where reading is the only way."""
        ...

    def grasps(self, object_id: str, test: str = "") -> GraspBatch | None:
        """All stored rows of one object, with verdict columns where there are verdicts.

        Args:
            object_id: Which.
            test: One of `tests`, the first when empty; the rows are the same.
        """
        ...

    def hands(self) -> tuple[Hand, ...]:
        """Load the hands as far as they are drawn, in the order of the H axis; none for a library."""
        ...

    @property
    def rig(self) -> str:
        """Name of the rig whose arms are meant; empty where nothing has arm solutions."""
        ...

    def arms(self, object_id: str) -> GraspBatch | None:
        """All stored rows of one object that have arm solutions, with them."""
        ...

    def robot(self) -> Robot | None:
        """Load the rig with the hands; None where nothing has arm solutions."""
        ...


def open_browsable(
    path: str | Path, protocol: str | None = None, rig: str | Path | None = None
) -> Browsable:
    """Open whatever is at `path`.

    Args:
        path: A library, a run or a release.
        protocol: Whose verdicts are meant; see `chosen_protocol` when omitted.
        rig: Whose arms are meant; see `Run.rig` when omitted.

    Raises:
        PathNotFound: There is neither a library, a run nor a release.
        UnknownName: There are no verdicts of the protocol, or no arm solutions of the rig.
        NotUsable: There is no saying which protocol is meant, or a library, which has no verdicts.
        Contradiction: It is damaged.
    """
    kind = expect_kind(path, "library", "run", "release")
    sources = {"library": LibrarySource, "run": RunSource, "release": ReleaseSource}
    return sources[kind](Path(path), protocol, rig)


def rows_by_test(
    source: Browsable, object_id: str, batch: GraspBatch | None = None
) -> dict[str, GraspBatch]:
    """All stored rows of one object with the verdicts of each test that was run, first test first.

    Args:
        source: What is looked into.
        object_id: Which object.
        batch: Its rows with the verdicts of the first test, where they were read before.

    Returns:
        Batches of the same rows; one under `f`, without verdicts, where nothing is validated, and
        none where there are no rows.
    """
    first = source.grasps(object_id) if batch is None else batch
    if first is None:
        return {}
    found = {source.test or "f": first}
    for test in source.tests[1:]:
        rows = source.grasps(object_id, test)
        assert rows is not None  # there are rows of the object
        # A run that is being made may have more of them by now.
        found[test] = rows.select(np.isin(rows["grasp_id"], first["grasp_id"]))
    return found


def verdicts_of(batch: GraspBatch) -> np.ndarray:
    """What became of each row: 1 passed, 0 failed (also before the test), -1 not tested, (N,)."""
    outcome = np.full(len(batch), -1)
    if "verdict_status" in batch:
        status = batch["verdict_status"]
        tested = (status >= 0) & (status != Status.NOT_RUN)
        outcome[tested] = batch["success"][tested]
    if "synth_status" in batch:
        outcome[batch["synth_status"] != Status.OK] = 0
    return outcome
