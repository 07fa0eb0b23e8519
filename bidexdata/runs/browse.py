"""One way to look into a library, a run or a release: objects, and the grasps of one object.

Pictures and the viewer read through `Browsable` and do not know which of the three is behind it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from bidexdata.errors import NotUsable
from bidexdata.kinds import Kind, expect_kind
from bidexdata.record import GraspBatch, HandHeader
from bidexdata.record.batch import empty_columns
from bidexdata.record.fields import TESTS, columns_written_by
from bidexdata.record.status import Status
from bidexdata.runs.chosen import chosen_protocol, refuse_other_rig

if TYPE_CHECKING:
    from bidexdata.arms.robot import Robot
    from bidexdata.formats.release import Release
    from bidexdata.hands.model import Hand, Side
    from bidexdata.objects.library import Library
    from bidexdata.objects.prepared import Solid
    from bidexdata.runs.release_rows import ReleaseRowsIndex
    from bidexdata.runs.run import Run


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


class LibrarySource:
    """Objects of a library; there are no grasps."""

    kind: Kind = "library"
    test = protocol = ""
    tests: tuple[str, ...] = ()

    def __init__(self, path: Path, protocol: str | None = None, rig: str | Path | None = None):
        from bidexdata.objects.library import Library

        refuse_other_rig(path, "", rig)
        if protocol is not None:
            raise NotUsable(f"{path} is a library: it has no verdicts of {protocol!r}")
        self.path = path
        self.library: Library = Library.open(path)

    @property
    def object_ids(self) -> tuple[str, ...]:
        """Objects, sorted."""
        return tuple(sorted(self.library.object_ids))

    def categories(self) -> tuple[str, ...]:
        """As the library's index has them."""
        return _categories(self.library, self.object_ids)

    def load_solid(self, object_id: str) -> Solid:
        """Read one object."""
        return self.library.load_solid(object_id)

    def index(self) -> ReleaseRowsIndex | None:
        """None: there are no rows."""
        return None

    def grasps(self, object_id: str, test: str = "") -> GraspBatch | None:
        """None: a library holds no grasps."""
        return None

    def hands(self) -> tuple[Hand, ...]:
        """No hands."""
        return ()

    @property
    def rig(self) -> str:
        """None."""
        return ""

    def arms(self, object_id: str) -> GraspBatch | None:
        """None: a library holds no grasps."""
        return None

    def robot(self) -> Robot | None:
        """None."""
        return None


class RunSource:
    """Rows of a run, also of one that is still being made; verdicts where they are there."""

    kind: Kind = "run"

    def __init__(self, path: Path, protocol: str | None = None, rig: str | Path | None = None):
        from bidexdata.runs.run import Run

        self.path = path
        self.run: Run = Run.open(path, rig=rig)
        tests = self.run.verdict_tests()
        self.protocol = chosen_protocol(path, tests, protocol)
        self.tests = _tests_of(self.protocol, tests)
        self.test = next(iter(self.tests), "")

    @property
    def object_ids(self) -> tuple[str, ...]:
        """Objects of the plan, sorted."""
        return self.run.object_ids

    def categories(self) -> tuple[str, ...]:
        """As the run's library has them; a run that tests a release anew names none."""
        if self.run.spec.of_release:
            return ("",) * len(self.object_ids)
        return _categories(self.run.library, self.object_ids)

    def load_solid(self, object_id: str) -> Solid:
        """Read one object of the run's library."""
        return self.run.load_solid(object_id)

    def index(self) -> ReleaseRowsIndex | None:
        """None: rows lie in shards, which are read object by object."""
        return None

    def grasps(self, object_id: str, test: str = "") -> GraspBatch | None:
        """Rows of the tasks that are done by now; those not yet validated say so in every row."""
        from bidexdata.runs.run_rows import join_tasks

        found, test = [], test or self.test
        for task in self.run.tasks_of(object_id):
            if not self.run.is_done(task):
                continue
            batch = self.run.task_batch(task)
            if test and self.run.is_done(task, self.protocol, test):
                verdicts = self.run.task_verdicts(task, batch, self.protocol, test)
            elif test:
                verdicts = _no_verdicts(batch)
            else:
                verdicts = {}
            found.append(batch.with_columns(**verdicts))
        return join_tasks(found) if found else None

    def hands(self) -> tuple[Hand, ...]:
        """Load the run's hands as far as they are drawn."""
        return self.run.hands(drawn=True)

    @property
    def rig(self) -> str:
        """The run's."""
        return self.run.rig

    def arms(self, object_id: str) -> GraspBatch | None:
        """Rows of the tasks whose arms are solved by now."""
        from bidexdata.runs.run_rows import join_tasks

        tasks = [t for t in self.run.tasks_of(object_id) if self.run.is_armed(t)]
        found = [self.run.task_arms(t, self.run.task_batch(t)) for t in tasks]
        return join_tasks(found) if found else None

    def robot(self) -> Robot | None:
        """The run's."""
        return self.run.robot() if self.run.rig else None


class ReleaseSource:
    """Rows of a release, selected and audit, with the verdicts of one protocol."""

    kind: Kind = "release"

    def __init__(
        self,
        path: Path,
        protocol: str | None = None,
        rig: str | Path | None = None,
        *,
        release: Release | None = None,
    ):
        from bidexdata.formats.release import Release

        self.path = path
        self.release: Release = Release.open(path) if release is None else release
        refuse_other_rig(path, self.release.rig, rig)
        tests, default = self.release.protocols, self.release.default_protocol
        self.protocol = chosen_protocol(path, tests, protocol, default=default)
        self.tests = _tests_of(self.protocol, tests)
        self.test = next(iter(self.tests), "")

    @classmethod
    def of(cls, release: Release) -> ReleaseSource:
        """Look into a release that is open already, such as one that is being written."""
        return cls(release.path, release=release)

    @property
    def object_ids(self) -> tuple[str, ...]:
        """Objects, sorted."""
        return self.release.object_ids

    def categories(self) -> tuple[str, ...]:
        """As the objects table has them."""
        return self.index().categories

    def load_solid(self, object_id: str) -> Solid:
        """Read one object."""
        return self.release.load_solid(object_id)

    def index(self) -> ReleaseRowsIndex:
        """Rows by the index columns of the release."""
        return self._index

    @cached_property
    def _index(self) -> ReleaseRowsIndex:
        from bidexdata.runs.release_rows import ReleaseRowsIndex

        return ReleaseRowsIndex(self.release, self.protocol, self.tests)

    def grasps(self, object_id: str, test: str = "") -> GraspBatch | None:
        """Selected rows, then audit rows that are not selected too."""
        protocol, test = self.protocol or None, test or self.test or "f"
        batch = self.release.stored(object_id, protocol=protocol, test=test)
        return batch if len(batch) else None

    def hands(self) -> tuple[Hand, ...]:
        """Load hands of the names, sides and joints that the release states, as far as drawn.

        Raises:
            NotUsable: A hand is not known here, or its joints are others.
        """
        from bidexdata.hands import load_drawn

        return tuple(hand_here(header, self.path, load_drawn) for header in self.release.hands)

    @property
    def rig(self) -> str:
        """The release's."""
        return self.release.rig

    def arms(self, object_id: str) -> GraspBatch | None:
        """Selected rows, then audit rows that are not selected too."""
        if not self.release.rig:
            return None
        batch = self.release.stored(object_id)
        return self.release.with_arms(batch) if len(batch) else None

    def robot(self) -> Robot | None:
        """The rig of this installation that has the release's name and content.

        Raises:
            NotUsable: There is none, or it has changed.
        """
        from bidexdata.arms.registry import load_rig
        from bidexdata.arms.robot import mount_robot

        if not self.release.rig:
            return None
        robot = mount_robot(load_rig(self.release.rig), self.hands())
        if robot.digest != self.release.header.arms[0].rig_hash:
            raise NotUsable(
                f"{self.path}: its rig {self.release.rig!r} is another than that of this name here; "
                "use the version of bidexdata that made it"
            )
        return robot


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


def _tests_of(protocol: str, tests: Iterable[tuple[str, str]]) -> tuple[str, ...]:
    """The tests that a protocol has verdicts of, in the order of `TESTS`."""
    found = set(tests)
    return tuple(test for test in TESTS if (protocol, test) in found)


def _categories(library: Library, object_ids: Iterable[str]) -> tuple[str, ...]:
    names = ("object_id", "status", "category")
    rows = zip(*(library.index.column(n).to_pylist() for n in names), strict=True)
    known = {object_id: category for object_id, status, category in rows if status == Status.OK}
    return tuple(known.get(object_id) or "" for object_id in object_ids)


def _no_verdicts(batch: GraspBatch) -> dict[str, np.ndarray]:
    missing = [n for n in columns_written_by("validate") if n not in batch]
    return empty_columns(batch.header, missing, len(batch))


def hand_here(
    header: HandHeader, path: Path, load: Callable[[str, Side], Hand] | None = None
) -> Hand:
    """Load the hand of this installation that a header names.

    Args:
        header: Of the release at `path`.
        path: For messages.
        load: How; `hands.load_hand` when omitted.

    Raises:
        NotUsable: There is none, or its joints are others.
    """
    from bidexdata.hands import load_hand

    side = "left" if header.side == "left" else "right"
    hand = (load or load_hand)(header.name, side)
    if hand.joint_names != header.joint_names or hand.root_body != header.root_body:
        raise NotUsable(
            f"{path}: its {header.side} hand {header.name!r} has other joints or another root body "
            "than the hand of that name here; use the version of bidexdata that made it"
        )
    return hand
