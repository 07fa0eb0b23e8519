"""Pictures of grasps with the arms that a run or release has for them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bidexdata.pictures.captions import grasp_caption, outcome_words
from bidexdata.pictures.sheet import Caption, Tile
from bidexdata.record import GraspBatch, Status
from bidexdata.record.batch import fill_value, in_metres
from bidexdata.record.fields import FIELDS, KEY_FRAMES
from bidexdata.record.status import ARM_STATUSES
from bidexdata.runs.browse import rows_by_test

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from bidexdata.arms.arm_scene import SizedArmScenes
    from bidexdata.arms.config import ArmConfig
    from bidexdata.arms.furthest import Furthest
    from bidexdata.arms.motion import Motion
    from bidexdata.arms.motion_views import Held
    from bidexdata.arms.robot import Robot
    from bidexdata.objects.prepared import Solid
    from bidexdata.runs.browse import Browsable
    from bidexdata.runs.choose import Shown

STORED = "the stored motion, not the simulation"
"""What a film of a motion shows; whether the object comes along is for a replay of the test to show."""
REST_SECONDS = 1.0
"""How long a film of a motion stands still at its end [s]."""


class Size(NamedTuple):
    """Of one view [pixels]."""

    width: int
    height: int


SIZE, FILM_SIZE = Size(400, 320), Size(360, 300)
"""A robot is five times as wide as an object: it needs more pixels than a grasp alone."""


class Drawn(NamedTuple):
    """A grasp with its arms."""

    pixels: NDArray[np.uint8]
    words: str
    """What the picture shows."""


def rows_with_arms(source: Browsable, object_id: str, batch: GraspBatch) -> GraspBatch | None:
    """Rows of one object with the columns of arms, in their order; None where nobody asked for any.

    Rows that the arms were not asked about, such as those that a run got since, have a status
    outside of `ARM_STATUSES` and OK.
    """
    solved = source.arms(object_id)
    return None if solved is None or not len(solved) else join_arms(batch, solved)


def join_arms(batch: GraspBatch, solved: GraspBatch) -> GraspBatch:
    """Rows with the columns of arms of other rows of their object, at least one; by their ids."""
    ids, first = np.unique(solved["grasp_id"], return_index=True)
    at = np.minimum(np.searchsorted(ids, batch["grasp_id"]), len(ids) - 1)
    known = ids[at] == batch["grasp_id"]
    columns = {n: solved[n][first[at]] for n in solved.columns if FIELDS[n].table == "arms"}
    columns["arm_status"] = np.where(
        known, columns["arm_status"], fill_value(FIELDS["arm_status"])
    ).astype(np.int8)
    return GraspBatch(solved.header, {**batch.columns, **columns})


def arm_words(batch: GraspBatch, row: int) -> tuple[str, bool | None]:
    """Say what the arms of a row came to: a sentence, and found, failed or (None) not asked."""
    number, rig = int(batch["arm_status"][row]), batch.header.arms[0].rig
    if number == Status.OK:
        return f"{rig} takes it in {float(batch['arm_time'][row, -1]):.1f} s", True
    if number in ARM_STATUSES:
        status = Status(number)
        return f"{rig}, {status.label}: {status.sentence}", False
    return f"{rig} was not asked", None


class ArmPictures:
    """Draws grasps of one source with its rig.

    Args:
        source: A run or release with arm solutions.
        size: Of one view.
        device: A Warp device.
    """

    def __init__(self, source: Browsable, size: Size, device: str = "cpu"):
        self._source, self._size, self._device = source, size, device
        self._scenes: tuple[str, SizedArmScenes | None] | None = None

    @cached_property
    def robot(self) -> Robot:
        """The rig with the hands of the rows."""
        robot = self._source.robot()
        assert robot is not None  # there are arm solutions
        return robot

    def still(self, batch: GraspBatch, row: int, solid: Solid, views: int) -> Drawn:
        """Draw the arms at the grasp, or what stopped them; at home where they were not asked."""
        from bidexdata.arms.furthest import Furthest
        from bidexdata.arms.motion import at_home
        from bidexdata.arms.motion_views import draw_furthest

        motion = self._motion(batch, row)
        if motion is not None:
            grasp = motion.at(float(motion.key_time[KEY_FRAMES.index("grasp")]))
            found = Furthest(grasp, "at the grasp")
        else:
            found = self._furthest(batch, row, solid)
            found = found or Furthest(at_home(self.robot, batch, row), "at home")
        held = _held(batch, row, solid)
        size = self._size._asdict()
        drawn = draw_furthest(self.robot, found, held, views=views, device=self._device, **size)
        return Drawn(drawn, found.words)

    def film(
        self, batch: GraspBatch, row: int, solid: Solid, times: Sequence[float]
    ) -> Iterator[Drawn] | None:
        """Draw the motion at some times [s]; None where there is none."""
        from bidexdata.arms.motion_views import draw_motion

        motion = self._motion(batch, row)
        if motion is None:
            return None
        drawn = draw_motion(
            *(self.robot, motion, _held(batch, row, solid), times),
            device=self._device,
            **self._size._asdict(),
        )
        ends = [min(time, motion.seconds) for time in times]
        return (
            Drawn(pixels, f"{time:.2f} s  {motion.phase_at(time)}  ({STORED})")
            for pixels, time in zip(drawn, ends, strict=True)
        )

    def _motion(self, batch: GraspBatch, row: int) -> Motion | None:
        from bidexdata.arms.motion import motion_of

        return motion_of(self.robot, batch, row)

    def _furthest(self, batch: GraspBatch, row: int, solid: Solid) -> Furthest | None:
        from bidexdata.arms.furthest import SHOWN, Found, furthest_posture
        from bidexdata.arms.solutions import join_targets
        from bidexdata.objects.sdf import grid_of_pieces
        from bidexdata.runs.arms import targets_of

        number = int(batch["arm_status"][row])
        if number not in SHOWN:
            return None
        scenes = self._scenes_of(solid)
        return furthest_posture(
            self.robot,
            None if scenes is None else scenes.at(in_metres(batch["size"][row])),
            grid_of_pieces(solid.pieces),
            join_targets([targets_of(batch, np.array([row]))]),
            Found(
                Status(number),
                np.asarray(batch["arm_joints"][row], np.float64),
                int(batch["arm_failed_side"][row]),
            ),
            arm_config(self._source),
        )

    def _scenes_of(self, solid: Solid) -> SizedArmScenes | None:
        from bidexdata.arms.arm_scene import SizedArmScenes
        from bidexdata.simulation.scene import SceneNotBuilt

        if self._scenes is None or self._scenes[0] != solid.object_id:
            try:
                self._scenes = solid.object_id, SizedArmScenes(self.robot, solid)
            except SceneNotBuilt:
                self._scenes = solid.object_id, None
        return self._scenes[1]


def arm_config(source: Browsable) -> ArmConfig:
    """What the arm solutions of a run or release were searched with."""
    from bidexdata.arms.config import ArmConfig
    from bidexdata.config import from_plain
    from bidexdata.formats.rig_files import read_rig_files
    from bidexdata.runs.arm_folder import read_record
    from bidexdata.runs.browse_release import ReleaseSource

    path = Path(source.path)
    if isinstance(source, ReleaseSource):
        plain = read_rig_files(path, source.release.header.arms).document["config"]
    else:
        plain = read_record(path, source.rig).config
    return from_plain(ArmConfig, plain)


def film_times(batches: Sequence[tuple[GraspBatch, int]], frame_seconds: float) -> list[float]:
    """Times of the pictures of a film of some rows, from home to the end of the longest motion [s]."""
    ends = [
        float(batch["arm_time"][row, -1])
        for batch, row in batches
        if int(batch["arm_status"][row]) == Status.OK
    ]
    moving = math.ceil(max(ends, default=0.0) / frame_seconds)
    still = round(REST_SECONDS / frame_seconds)
    return [frame_seconds * k for k in range(moving + still + 1)]


def _held(batch: GraspBatch, row: int, solid: Solid) -> Held:
    from bidexdata.arms.motion_views import Held

    quat = np.asarray(batch["object_quat_wxyz"][row], np.float64)
    return Held(solid, in_metres(batch["size"][row]), quat)


def armed_tiles(
    source: Browsable,
    chosen: Sequence[Shown],
    *,
    views: int,
    frame_seconds: float | None,
    device: str,
    quiet: bool,
) -> list[list[Tile]]:
    """Tiles of grasps with their arms, for each picture of a film; one picture when it is none.

    Args:
        source: A run or release with arm solutions.
        chosen: Rows of it.
        views: Views of each grasp; a film has one.
        frame_seconds: From one picture of a film to the next [s]; None: no film.
        device: A Warp device.
        quiet: No progress bar.
    """
    from bidexdata.runs.progress import Progress

    rows = [_with_arms(source, shown) for shown in chosen]
    film = frame_seconds is not None
    times = film_times(rows, frame_seconds) if film else [0.0]
    artist = ArmPictures(source, FILM_SIZE if film else SIZE, device)
    frames: list[list[Tile]] = [[] for _ in times]
    solid: Solid | None = None
    with Progress(len(chosen) * len(times), "picture", quiet=quiet) as progress:
        for shown, (batch, row) in zip(chosen, rows, strict=True):
            if solid is None or solid.object_id != shown.object_id:
                solid = source.load_solid(shown.object_id)
            drawn = artist.film(batch, row, solid, times) if film else None
            if drawn is None:
                still = artist.still(batch, row, solid, 1 if film else views)
                drawn = [still] * len(times)
            caption = grasp_caption(rows_by_test(source, shown.object_id, shown.batch), shown.row)
            for tiles, picture in zip(frames, drawn, strict=True):
                tiles.append(Tile(picture.pixels, _said(caption, batch, row, picture.words)))
                progress.advance()
    return frames


def _with_arms(source: Browsable, shown: Shown) -> tuple[GraspBatch, int]:
    batch = rows_with_arms(source, shown.object_id, shown.batch)
    assert batch is not None  # rows with a status of arms were chosen
    return batch, shown.row


def _said(caption: Caption, batch: GraspBatch, row: int, words: str) -> Caption:
    """The words of a grasp, with what the picture shows and what the arms came to.

    A test that failed because of that is not told beside it.
    """
    (grasp, *tests), (told, good) = caption.lines, arm_words(batch, row)
    same = outcome_words("a", Status(int(batch["arm_status"][row]))) if good is False else ""
    kept = [(line, ok) for line, ok in zip(tests, caption.good, strict=True) if line != same]
    lines = (grasp, words, *(line for line, _ in kept), told)
    return caption._replace(lines=lines, good=(*(ok for _, ok in kept), good))
