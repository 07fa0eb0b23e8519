"""Run: a folder of grasps in the making; what it is, how far it is, and its rows.

`run_folder.py` says where things lie. Rows of later stages have the order of the first stage's;
reading joins by position and checks the ids. A run is opened for one rig and sees the verdicts with
arms of that rig alone.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bidexdata.config import fingerprint, to_plain
from bidexdata.errors import NotUsable, PathNotFound, UnknownName
from bidexdata.kinds import expect_kind
from bidexdata.record import GraspBatch
from bidexdata.record.fields import WITH_ARMS
from bidexdata.record.settings import settings_of_test
from bidexdata.runs.arm_folder import (
    RIG_FILE,
    arms_folder,
    arms_hint,
    chosen_rig,
    read_record,
    rig_name,
    rigs_in,
)
from bidexdata.runs.plan import Task, read_plan
from bidexdata.runs.run_folder import (
    PLAN_FILE,
    protocol_file,
    rows_folder,
    stored_protocol,
    verdict_folder,
    verdict_folders,
)
from bidexdata.runs.run_rows import columns_beside
from bidexdata.runs.run_source import (
    check_release,
    hands_of,
    open_library,
    robot_of,
    source_folder,
)
from bidexdata.runs.shards import done_tasks, read_shard, shard_path
from bidexdata.runs.spec import RunSpec, read_spec

if TYPE_CHECKING:
    from bidexdata.arms.robot import Robot
    from bidexdata.hands import Hand
    from bidexdata.objects.library import Library
    from bidexdata.objects.prepared import Solid
    from bidexdata.validation.protocols import Protocol


@dataclass(frozen=True)
class Run:
    """A run folder, opened; made by `Run.open`, or by `Run.create` from grasps that one has."""

    path: Path
    spec: RunSpec
    """What run.json says."""
    asked_rig: str = ""
    """Name of the rig that is meant, where the caller says."""

    @classmethod
    def open(cls, path: str | Path, *, rig: str | Path | None = None) -> Run:
        """Open a run.

        Args:
            path: Its folder.
            rig: Whose arms are meant, a name or the path of a rig's spec; see `rig` when omitted.

        Raises:
            PathNotFound: There is no run at `path`.
            Contradiction: run.json is damaged or its schema is newer than this package.
            UnknownName: The run has no arm solutions of this rig.
        """
        expect_kind(path, "run")
        run = cls(Path(path), read_spec(Path(path)))
        return run if rig is None else run.for_rig(rig)

    def for_rig(self, rig: str | Path) -> Run:
        """Give the run as opened for another rig that it has arm solutions of.

        Raises:
            UnknownName: It has none of this rig.
        """
        name, known = rig_name(rig), self.arm_rigs()
        if name not in known:
            hint = arms_hint(self.path, rig)
            raise UnknownName(f"rig with arm solutions in {self.path}", name, known, hint)
        return dataclasses.replace(self, asked_rig=name)

    def arm_rigs(self) -> tuple[str, ...]:
        """Names of the rigs that the run has arm solutions of."""
        return rigs_in(self.path)

    @property
    def rig(self) -> str:
        """Name of the rig that is meant; empty where the run has no arm solutions.

        That asked for; else the only one that has solutions, that which the grasps were made for,
        or the default one.

        Raises:
            NotUsable: There are several and no saying which is meant.
        """
        if not self.asked_rig and "rig" not in self._chosen:
            made_for = self.spec.rig
            found = chosen_rig(self.path, made_for.name if made_for else "")
            if not found:
                return ""  # there may be one later
            self._chosen["rig"] = found
        return self.asked_rig or self._chosen["rig"]

    @classmethod
    def create(
        cls,
        path: str | Path,
        rows: GraspBatch | Mapping[str, np.ndarray],
        *,
        source: str | Path,
        hand: str = "shadow",
        about: Mapping[str, Any] | None = None,
        seed: int = 0,
    ) -> Run:
        """Write grasps that a caller has as a run: `validate`, `view`, `render` and `pack` take it.

        Ids, sizes and statuses are filled in. Rows whose joints at the pre-grasp or the grasp are
        out of range have the status `joint_range` and no pose.

        Args:
            path: The run's folder; must not exist, or be empty but for a library of its own.
            rows: `scene_id`, (N) text; `object_pos` (N, 3) [m] and `object_quat_wxyz` (N, 4);
                `hand_pos` (N, H, S, 3) [m], `hand_quat_wxyz` (N, H, S, 4) and `joints` (N, H, S, J)
                [rad], padded as everywhere. `size` (N) [m] where it has no whole millimetres.
                Poses are in the world frame; on a table its surface is z = 0 and the object's
                origin lies at x = y = 0.
            source: Library or release that holds the objects. Only runs of a library can be packed.
            hand: Name of the hand, or LEFT,RIGHT.
            about: Plain data of what made the poses; part of the run's identity.
            seed: Seed that they were drawn with; information only.

        Raises:
            BadConfig: A column is missing, has the wrong shape, or a pose is not finite.
            NotUsable: `path` holds something, or scenes of several settings are mixed.
            PathNotFound: There is no library or release at `source`.
            UnknownName: There is no such hand or object.
        """
        from bidexdata.runs.generated import write_generated

        return write_generated(path, rows, source=source, hand=hand, about=about, seed=seed)

    @property
    def fingerprint(self) -> str:
        """Hash of the configuration, hands, library and seed that made the run."""
        return self.spec.fingerprint

    @cached_property
    def tasks(self) -> tuple[Task, ...]:
        """The plan, in its order."""
        path = self.path / PLAN_FILE
        if not path.is_file():
            raise PathNotFound(path, "the plan of a run; `bidexdata synth` writes it")
        return tuple(read_plan(path))

    @property
    def object_ids(self) -> tuple[str, ...]:
        """Objects of the plan, sorted."""
        return tuple(sorted({t.object_id for t in self.tasks}))

    @cached_property
    def library(self) -> Library:
        """The library that the run was made from.

        Raises:
            PathNotFound: It is not where run.json says.
            SourceChanged: It has changed since.
        """
        return open_library(self.path, self.spec)

    def check_source(self) -> None:
        """Refuse to go on where what the run was made of has changed.

        Raises:
            PathNotFound: The library, or the release that is re-tested, is not where run.json says.
            SourceChanged: It is there and holds something else.
        """
        if self.spec.of_release:
            check_release(self.path, self.spec)
        else:
            _ = self.library

    def load_solid(self, object_id: str) -> Solid:
        """Load an object of the run from its library (or from the release it re-tests)."""
        if self.spec.of_release:
            from bidexdata.formats.release import Release

            return Release.open(source_folder(self.path, self.spec)).load_solid(object_id)
        return self.library.load_solid(object_id)

    def hands(self, *, drawn: bool = False) -> tuple[Hand, ...]:
        """Load the run's hands, in the order of the H axis.

        Args:
            drawn: Only as far as they are drawn, which is sooner.

        Raises:
            ConfigConflict: A hand's spec or files have changed since the run was made.
        """
        return hands_of(self.path, self.spec, drawn=drawn)

    def robot(self) -> Robot:
        """Load the rig that is meant with the run's hands, as the arm solutions were made with.

        Raises:
            NotUsable: The run has no arm solutions, or the rig's models cannot be had.
            ConfigConflict: The rig, its models or a hand have changed since.
        """
        return robot_of(self.path, self._rig_needed(), self.hands())

    def stage_folder(self, stage: str, protocol: str = "", test: str = "") -> Path:
        """Folder of a stage's shards: `rows`, `arms`, or `validate` with a protocol and a test."""
        if stage == "validate":
            rig = self.rig if test in WITH_ARMS else ""
            return verdict_folder(self.path, protocol, test, rig)
        if stage == "arms":
            return self.arms_folder()
        return rows_folder(self.path, self.spec.kind)

    def arms_folder(self) -> Path:
        """Folder of the arm solutions of the rig that is meant.

        Raises:
            NotUsable: The run has none.
        """
        return arms_folder(self.path, self._rig_needed())

    def verdict_folders(self) -> dict[tuple[str, str], Path]:
        """Folders of verdicts per protocol and test, in their order; with arms, of the run's rig."""
        return verdict_folders(self.path, self.rig)

    def verdict_tests(self) -> list[tuple[str, str]]:
        """The (protocol, test) pairs that have shards."""
        return [test for test, folder in self.verdict_folders().items() if done_tasks(folder)]

    def is_armed(self, task: Task) -> bool:
        """Tell whether the arm solutions of one task are there, of the rig that is meant."""
        return bool(self.rig) and shard_path(self.arms_folder(), task.task_id).is_file()

    def armed(self) -> set[str]:
        """Ids of the planned tasks whose arm solutions are there; lists the whole folder."""
        if not self.rig:
            return set()
        return done_tasks(self.arms_folder()) & {t.task_id for t in self.tasks}

    def done(self, protocol: str | None = None, test: str = "f") -> set[str]:
        """Ids of the planned tasks whose rows (or verdicts) are there; lists the whole folder."""
        return done_tasks(self._folder(protocol, test)) & {t.task_id for t in self.tasks}

    def is_done(self, task: Task, protocol: str | None = None, test: str = "f") -> bool:
        """Tell whether the rows (or verdicts) of one task are there; looks at its file alone."""
        return shard_path(self._folder(protocol, test), task.task_id).is_file()

    def task_batch(
        self, task: Task, protocol: str | None = None, test: str | None = None
    ) -> GraspBatch:
        """Rows of one finished task, joined with verdicts where a protocol is named.

        Raises:
            PathNotFound: The task, or its validation, is not done.
            ConfigConflict: Another configuration made the shard.
            Contradiction: A shard is damaged, or its ids are not those of the rows.
        """
        path = shard_path(self.stage_folder("rows"), task.task_id)
        batch = GraspBatch.from_arrow(read_shard(path, self.fingerprint))
        if protocol is None:
            return batch
        return batch.with_columns(**self.task_verdicts(task, batch, protocol, test or "f"))

    def task_verdicts(
        self, task: Task, batch: GraspBatch, protocol: str, test: str
    ) -> dict[str, np.ndarray]:
        """Verdict columns of one validated task, row by row for `batch`.

        Raises:
            PathNotFound: The task is not validated.
            ConfigConflict: Another run, or other settings of the protocol, made the shard.
            Contradiction: The shard is damaged, or its ids are not those of the rows.
        """
        path = shard_path(self.stage_folder("validate", protocol, test), task.task_id)
        mark = self._verdict_mark(protocol, test)
        return columns_beside(path, mark, batch, "validate")[0]

    def task_arms(self, task: Task, batch: GraspBatch) -> GraspBatch:
        """Join the rows of one task with their arm solutions.

        Args:
            task: A task with arm solutions.
            batch: Its rows.

        Raises:
            PathNotFound: It has no arm solutions.
            ConfigConflict: Another run, robot or configuration made them.
            Contradiction: The shard is damaged, or its ids are not those of the rows.
        """
        path = shard_path(self.arms_folder(), task.task_id)
        columns, joined = columns_beside(path, self.arms_mark(), batch, "arms")
        header = dataclasses.replace(batch.header, arms=joined.arms)
        return GraspBatch(header, {**batch.columns, **columns})

    def arms_mark(self) -> str:
        """What the shards of arm solutions carry: the run, the robot and the configuration."""
        rig = self._rig_needed()
        path = arms_folder(self.path, rig) / RIG_FILE
        key = ("arms", rig, path.stat().st_mtime_ns if path.is_file() else 0)
        if key not in self._marks:
            self._marks[key] = read_record(self.path, rig).fingerprint
        return self._marks[key]

    def batches(self, protocol: str | None = None, test: str | None = None) -> Iterator[GraspBatch]:
        """Yield the rows of every finished task in the order of the plan.

        Args:
            protocol: Join this protocol's verdicts; tasks not yet validated are left out.
            test: Of the protocol; `f` when not given.
        """
        done = self.done()
        if protocol is not None:
            done &= self.done(protocol, test or "f")
        for task in self.tasks:
            if task.task_id in done:
                yield self.task_batch(task, protocol, test)

    def tasks_of(self, object_id: str) -> list[Task]:
        """The tasks of one object, in plan order."""
        return self._by_object.get(object_id, [])

    @cached_property
    def _by_object(self) -> Mapping[str, list[Task]]:
        found: dict[str, list[Task]] = {}
        for task in self.tasks:
            found.setdefault(task.object_id, []).append(task)
        return found

    def protocol(self, name: str) -> Protocol:
        """Settings of a protocol that the run has verdicts of.

        Raises:
            PathNotFound: The run has none of it, and no protocol is called so.
            Contradiction: Its file is damaged.
        """
        return stored_protocol(self.path, name)

    def _folder(self, protocol: str | None, test: str) -> Path:
        if protocol is None:
            return self.stage_folder("rows")
        return self.stage_folder("validate", protocol, test)

    def _verdict_mark(self, protocol: str, test: str) -> str:
        path = protocol_file(self.path, protocol)
        stamp = path.stat().st_mtime_ns if path.is_file() else 0
        key = (protocol, test if test not in WITH_ARMS else f"{test} {self.arms_mark()}", stamp)
        if key not in self._marks:
            self._marks[key] = verdict_fingerprint(self, self.protocol(protocol), test)
        return self._marks[key]

    def _rig_needed(self) -> str:
        if not self.rig:
            raise NotUsable(
                f"{self.path} has no arm solutions; `bidexdata arms {self.path}` makes them"
            )
        return self.rig

    @cached_property
    def _chosen(self) -> dict[str, str]:
        return {}  # what was found once and does not change

    @cached_property
    def _marks(self) -> dict[tuple[str, str, int], str]:
        return {}  # a run has thousands of shards of one protocol


@lru_cache(maxsize=4)
def open_unchanged(path: str, run_fingerprint: str, rig: str | None = None) -> Run:
    """Open the run that a worker's task belongs to, once per worker.

    Args:
        path: Its folder.
        run_fingerprint: Of the run that the command started with.
        rig: Name of the rig whose arms are meant, where there are arms.

    Raises:
        NotUsable: It is not the run that the command started with.
    """
    run = Run.open(path, rig=rig)
    if run.fingerprint != run_fingerprint:
        raise NotUsable(f"{path} changed while it was being worked on")
    return run


def verdict_fingerprint(run: Run, protocol: Protocol, test: str) -> str:
    """What a validate shard carries: run, protocol settings and test, and with arms their mark."""
    arms = [run.arms_mark()] if test in WITH_ARMS else []
    settings = settings_of_test(to_plain(protocol), test)
    return fingerprint([run.fingerprint, settings, test, *arms])
