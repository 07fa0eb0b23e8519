"""Look into a release: its stored rows with the verdicts of one protocol."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from bidexdata.kinds import Kind
from bidexdata.record import GraspBatch
from bidexdata.runs.chosen import chosen_protocol, refuse_other_rig, tests_of_protocol
from bidexdata.runs.installed import hand_here, robot_here

if TYPE_CHECKING:
    from bidexdata.arms.robot import Robot
    from bidexdata.formats.release import Release
    from bidexdata.hands.model import Hand
    from bidexdata.objects.prepared import Solid
    from bidexdata.runs.release_rows import ReleaseRowsIndex


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
        self.tests = tests_of_protocol(self.protocol, tests)
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
        if not self.release.rig:
            return None
        return robot_here(self.release.header.arms[0], self.hands(), self.path)
