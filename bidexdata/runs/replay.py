"""One grasp of a run tested again, with every moment kept, and a video of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bidexdata.errors import BadConfig, NotUsable
from bidexdata.record import GraspBatch, Status
from bidexdata.record.batch import in_metres
from bidexdata.record.fields import WITH_ARMS
from bidexdata.runs.first_digits import DIGITS, id_digits, require_one
from bidexdata.runs.progress import Progress
from bidexdata.runs.run import Run
from bidexdata.runs.shards import read_mark, shard_path

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from bidexdata.arms.robot import Robot
    from bidexdata.pictures.simulated import Beside, SimulatedPose
    from bidexdata.runs.plan import Task
    from bidexdata.simulation.scene import SimScene
    from bidexdata.validation.protocols import Protocol
    from bidexdata.validation.verdict import Verdict

FPS = 25
"""Pictures per second; one per 0.04 s of simulation shows it at its own speed."""
ARM_FPS = 12.5
"""The same with arms, which take longer to draw and twice as long to move."""
_LAST_SECONDS = 1.0
"""The last picture stays for so long [s]."""


class Moment(NamedTuple):
    """What the scene looked like at one time."""

    time: float
    """Simulated since the start of the test, loads one after the other [s]."""
    phase: str
    """`closing`, `lift`, `hold`, in test f `load +x` and so on, with arms `approach` before all."""
    pose: SimulatedPose


@dataclass(frozen=True, slots=True)
class Replay:
    """A test of one grasp, moment by moment."""

    grasp_id: str
    test: str
    protocol: str
    verdict: Verdict
    stored: str | None
    """Label of the verdict that the run has; None where it has none."""
    moments: tuple[Moment, ...]
    video: Path | None
    frames: int
    """Pictures in the video, the last of which stands still; 0 without one."""

    def as_dict(self) -> dict[str, Any]:
        """Plain data for `--json`."""
        v = self.verdict
        return {
            "grasp_id": self.grasp_id,
            "protocol": self.protocol,
            "test": self.test,
            "success": v.status is Status.OK,
            "status": v.status.label,
            "failed_stage": v.failed_stage.label,
            "direction": v.direction,
            "stored_status": self.stored,
            "seconds_simulated": round(self.moments[-1].time, 3) if self.moments else 0.0,
            "frames": self.frames,
            "video": None if self.video is None else str(self.video),
        }


def replay_grasp(
    run: Run,
    wanted: str,
    protocol: Protocol,
    test: str,
    video: str | Path | None = None,
    *,
    quiet: bool = False,
) -> Replay:
    """Test one grasp of a run again, as its stored verdict was made, and look on.

    Args:
        run: The run.
        wanted: The grasp_id of one of its rows that has a grasp, or the first digits of it.
        protocol: The settings.
        test: Which test.
        video: An .mp4 file to write.
        quiet: No progress bar.

    Raises:
        BadValue: `wanted` is no such number.
        NotUsable: No such grasp, or several, a row without a pose, or no scene can be built.
        BadConfig: The video's ending is another.
        MissingExtra: The package that writes videos is not installed.
    """
    from bidexdata.engine_log import engine_warnings_logged
    from bidexdata.validation.protocols import require_test
    from bidexdata.validation.stages import Execution
    from bidexdata.validation.validate import (
        TESTS,
        arm_test_of_rows,
        grasp_of,
        scene_of_rows,
        statuses_before,
    )

    require_test(protocol, test)
    path = None if video is None else Path(video)
    if path is not None:
        _check_video(path)
    batch, stored, plain = _row(run, wanted, protocol.name, test)
    grasp_id = str(batch["grasp_id"][0])
    hands, solid = run.hands(), run.load_solid(str(batch["object_id"][0]))
    before = Status(int(statuses_before(batch, hands)[0]))
    if before is not Status.OK:
        raise NotUsable(f"grasp {grasp_id} cannot be replayed: {before.sentence}")
    robot = run.robot() if test in WITH_ARMS else None
    if robot is None:
        scenes = scene = scene_of_rows(batch, solid, hands, protocol, test)
        joints = ()
    else:
        scenes = arm_test_of_rows(batch, solid, robot, protocol)
        scene, joints = scenes.arms.scene, scenes.arms.arm_qpos
    moments: list[Moment] = []
    frames = 0
    with engine_warnings_logged():
        grasp = grasp_of(batch, 0)
        watch = _keep(moments, joints, fps_of(test))
        verdict = TESTS[test](scenes, protocol, grasp, Execution(plain=plain), watch)
    if path is not None:
        if not moments:
            raise NotUsable(f"grasp {grasp_id} was not simulated: {verdict.status.sentence}")
        beside = None if robot is None else _arms_of(robot)
        frames = _draw(path, batch, solid, scene, test, moments, verdict, beside, quiet=quiet)
    return Replay(grasp_id, test, protocol.name, verdict, stored, tuple(moments), path, frames)


def fps_of(test: str) -> float:
    """Pictures per second of a film of a test."""
    return ARM_FPS if test in WITH_ARMS else float(FPS)


def _check_video(path: Path) -> None:
    from bidexdata.pictures.video import require_encoder

    if path.suffix.lower() != ".mp4":
        raise BadConfig(f"--video {path}: a replay is written as .mp4")
    require_encoder()


def _row(run: Run, wanted: str, protocol: str, test: str) -> tuple[GraspBatch, str | None, bool]:
    """The row, the label of its stored verdict, and whether that is of a plain simulation."""
    task, batch, row = _stored(run, wanted)
    stored, plain = None, False
    if run.is_done(task, protocol, test):
        path = shard_path(run.stage_folder("validate", protocol, test), task.task_id)
        plain = bool(read_mark(path).notes.get("execution", {}).get("plain", False))
        verdicts = run.task_verdicts(task, batch, protocol, test)
        stored = Status(int(verdicts["verdict_status"][row])).label
    if test in WITH_ARMS:
        batch = run.task_arms(task, batch)
    return batch.select(np.arange(len(batch)) == row), stored, plain


def _stored(run: Run, wanted: str) -> tuple[Task, GraspBatch, int]:
    """The stored grasp whose id begins with some digits: its task, with all rows, and its row."""
    digits, done = id_digits("--replay", wanted), run.done()
    found = []
    for task in (t for t in run.tasks if t.task_id in done):
        batch = run.task_batch(task)
        rows = np.flatnonzero(np.strings.startswith(batch["grasp_id"].astype(str), digits))
        found += [(task, batch, int(row)) for row in rows]
        if found and len(digits) == DIGITS:  # no other grasp has all of them
            break
    ids = [str(batch["grasp_id"][row]) for _, batch, row in found]
    require_one(run.path, wanted, ids, "stored grasps")
    return found[0]


def _arms_of(robot: Robot) -> Beside:
    """What draws the arms, what they stand on and the table between them."""
    from bidexdata.arms.robot_shapes import arm_parts, room_parts

    still = room_parts(robot)
    return lambda pose: [*arm_parts(robot, pose.arm_joints), *still]


def _keep(
    moments: list[Moment], arm_qpos: Sequence[NDArray[np.intp]], fps: float
) -> Callable[[str, float, SimScene], None]:
    """A watch that keeps one moment per picture of the video."""
    from bidexdata.pictures.simulated import read_simulated_pose

    known, began, film = "", 0.0, 0.0  # the phase, when it began in the film, the last look

    def watch(phase: str, lasted: float, scene: SimScene) -> None:
        nonlocal known, began, film
        new = phase != known
        if new:
            known, began = phase, film
        film = began + lasted
        if new or film - moments[-1].time > 1 / fps - 1e-6:
            moments.append(Moment(film, phase, read_simulated_pose(scene, arm_qpos)))

    return watch


def _draw(
    path: Path,
    batch: GraspBatch,
    solid: Any,
    scene: SimScene,
    test: str,
    moments: list[Moment],
    verdict: Verdict,
    beside: Beside | None,
    *,
    quiet: bool,
) -> int:
    """Film a test and give the number of pictures in the file."""
    from bidexdata.pictures.captions import outcome_words
    from bidexdata.pictures.sheet import GAP, Caption, wrapped
    from bidexdata.pictures.simulated import WIDTH, simulation_camera, simulation_frames
    from bidexdata.pictures.video import save_video
    from bidexdata.simulation.assembly import TABLE_GEOM

    fps = fps_of(test)
    total = len(moments) - 1 + round(_LAST_SECONDS * fps)
    size = in_metres(batch["size"][0])
    # Arms bring a table of their own, which is larger.
    table = not beside and TABLE_GEOM in {
        scene.model.geom(i).name for i in range(scene.model.ngeom)
    }
    ends = [moments[0].pose, moments[len(moments) // 2].pose, moments[-1].pose]
    camera = simulation_camera(ends, solid, size, scene.hands, table=table, beside=beside)
    head = f"{batch['object_id'][0]}  {batch['size_mm'][0]} mm  {batch['grasp_id'][0]}"
    passed = verdict.status is Status.OK
    outcome = outcome_words(test, verdict.status, verdict.direction, verdict.failed_stage)
    # All pictures have as many lines as the last, which alone tells the outcome.
    told = wrapped(outcome, WIDTH - GAP)

    def captions():
        for moment in moments:
            last = moment is moments[-1]
            words = f"{moment.time:5.2f} s  {moment.phase}"
            lines = told if last else ("",) * len(told)
            yield Caption(head, (words, *lines), (passed if last else None,) * len(told))

    def frames():
        shown = zip((m.pose for m in moments), captions(), strict=True)
        drawn = simulation_frames(
            shown, solid, size, scene.hands, camera, table=table, beside=beside
        )
        with Progress(total, "picture", quiet=quiet) as progress:
            for number, picture in enumerate(drawn, start=1):
                times = total - len(moments) + 1 if number == len(moments) else 1
                yield from [picture] * times
                progress.advance(times)

    save_video(frames(), path, fps)
    return total
