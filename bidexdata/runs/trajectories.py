"""`export --format trajectories-...`: motions of arms become files for controllers and spreadsheets."""

from __future__ import annotations

import csv
import json
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from bidexdata.errors import NotUsable, UnknownName
from bidexdata.formats.new_folder import new_folder
from bidexdata.record import FIELDS, Status
from bidexdata.record.batch import fill_value
from bidexdata.record.fields import PHASES
from bidexdata.runs.arm_folder import RIG_FILE
from bidexdata.runs.browse_run import RunSource
from bidexdata.runs.chosen import rig_option
from bidexdata.runs.progress import Progress
from bidexdata.runs.trajectory_rig import rig_file, rig_lines

if TYPE_CHECKING:
    from bidexdata.record import GraspBatch
    from bidexdata.runs.browse import Browsable

Form = Literal["csv", "ros"]
FORMATS: Mapping[str, Form] = {"trajectories-csv": "csv", "trajectories-ros": "ros"}
"""Name on the command line -> form."""
INDEX = "INDEX.csv"
README = "README.md"
NOT_ASKED = "not_asked"
"""What a row is counted as that the arms were never asked to reach."""
_COLUMNS = (
    *("grasp_id", "scene_id", "object_id", "size"),
    *(f"object_pos_{axis}" for axis in "xyz"),
    *(f"object_quat_{part}" for part in "wxyz"),
    *("seconds", "files"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryReport:
    """What was written."""

    out: Path
    rig: str
    grasps: int
    """Motions written."""
    skipped: Mapping[str, int]
    """Selected rows without a motion, per label of their arm status."""
    seconds: float


def export_trajectories(
    path: str | Path,
    out: str | Path,
    form: Form,
    *,
    rig: str | Path | None = None,
    split: str | None = None,
    limit: int | None = None,
    only: str | None = None,
    quiet: bool = False,
) -> TrajectoryReport:
    """Write the motions of the selected rows that have one, by object.

    Everything is written into a folder beside `out` that takes its name when all is done.

    Args:
        path: A run or a release with arm solutions.
        out: A folder that does not exist yet, or is empty.
        form: `csv`, a file per grasp, or `ros`, a message per arm and per hand of each grasp.
        rig: Whose arms, where a run has solutions of several rigs; see `Run.rig` when omitted.
        split: Only this split of a release.
        limit: Only the first so many motions.
        only: `success` or `failure`: only what test a said this of.
        quiet: No progress.

    Raises:
        PathNotFound: There is no run or release.
        UnknownName: There are no arm solutions of this rig, or no such split or outcome.
        NotUsable: There are no arm solutions or motions, no verdicts to choose by, a run is to be
            split, or `out` holds something.
    """
    from bidexdata.kinds import expect_kind
    from bidexdata.runs.browse import open_browsable

    start, out = time.monotonic(), Path(out)
    expect_kind(path, "run", "release")
    if only not in (None, "success", "failure"):
        raise UnknownName("outcome", only, ("success", "failure"))
    source = open_browsable(path, rig=rig)
    _check(source, only)
    scenes = _scenes_of(source, split)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise NotUsable(f"{out} is there already; export into another --out")
    skipped: Counter[str] = Counter()
    written, first = 0, None
    with new_folder(out) as folder, open(folder / INDEX, "w", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(_COLUMNS)
        for batch in _motions(source, scenes, only, skipped, quiet=quiet):
            first = first or batch
            for row in range(len(batch) if limit is None else min(len(batch), limit - written)):
                table.writerow(_index_row(batch, row, _write(folder, batch, row, form)))
                written += 1
            if written == limit:
                break
        if first is None:
            raise NotUsable(_none_words(source, skipped))
        rig_text = rig_file(source).read_text(encoding="utf-8")
        (folder / RIG_FILE).write_text(rig_text, encoding="utf-8")
        about = rig_lines(json.loads(rig_text)["spec"], first.header.hands)
        (folder / README).write_text(_readme(source, first, form, about), encoding="utf-8")
    return TrajectoryReport(
        out=out,
        rig=source.rig,
        grasps=written,
        skipped=dict(sorted(skipped.items())),
        seconds=time.monotonic() - start,
    )


def _check(source: Browsable, only: str | None) -> None:
    path, run = source.path, source.run if isinstance(source, RunSource) else None
    if not source.rig:
        made = f"`bidexdata arms {path}` makes them"
        raise NotUsable(
            f"{path} has no arm solutions; "
            f"{'pack runs that `bidexdata arms` solved' if run is None else made}"
        )
    if only is not None and "a" not in source.tests:
        arms = "" if run is None else " ".join(["", *rig_option(run)])
        made = f"`bidexdata validate {path} --tests a{arms}` gives them"
        raise NotUsable(
            f"{path} has no verdicts of test a with arms of {source.rig} to choose by; "
            f"{'pack runs that have some' if run is None else made}"
        )


def _scenes_of(source: Browsable, split: str | None) -> frozenset[str] | None:
    """Scenes of a split; None where all are meant."""
    if split is None:
        return None
    from bidexdata.runs.browse_release import ReleaseSource

    if not isinstance(source, ReleaseSource):
        raise NotUsable(f"{source.path} is a run, and splits are made by pack: leave out --split")
    release = source.release
    if split not in release.split_names:
        raise UnknownName("split", split, release.split_names)
    pairs = zip(*(release.scenes.column(n).to_pylist() for n in ("scene_id", "split")), strict=True)
    return frozenset(scene for scene, name in pairs if name == split)


def _motions(
    source: Browsable,
    scenes: frozenset[str] | None,
    only: str | None,
    skipped: Counter[str],
    *,
    quiet: bool,
) -> Iterator[GraspBatch]:
    """Selected rows with a motion, object by object; counts the others."""
    none_asked = fill_value(FIELDS["arm_status"])
    with Progress(len(source.object_ids), "object read", quiet=quiet) as progress:
        for object_id in source.object_ids:
            batch = source.arms(object_id)
            progress.advance()
            if batch is None:
                continue
            wanted = batch["selected"].copy()
            if scenes is not None:
                wanted &= np.isin(batch["scene_id"], list(scenes))
            if only is not None:
                wanted &= np.isin(batch["grasp_id"], _judged(source, object_id, only))
            status = batch["arm_status"]
            moves = status == Status.OK
            for value in status[wanted & ~moves].tolist():
                skipped[NOT_ASKED if value == none_asked else Status(value).label] += 1
            if np.any(wanted & moves):
                yield batch.select(wanted & moves)


def _judged(source: Browsable, object_id: str, only: str) -> np.ndarray:
    """Ids of the rows of an object that test a was run on with this outcome."""
    rows = source.grasps(object_id, "a")
    assert rows is not None  # there are rows of the object
    tested = (rows["verdict_status"] >= 0) & (rows["verdict_status"] != Status.NOT_RUN)
    passed = rows["success"] if only == "success" else ~rows["success"]
    return rows["grasp_id"][tested & passed]


def _write(folder: Path, batch: GraspBatch, row: int, form: Form) -> list[str]:
    """Write one motion; gives the names of its files."""
    from bidexdata.formats.exporters.trajectories import csv_text, ros_messages

    place = folder / str(batch["object_id"][row])
    place.mkdir(exist_ok=True)
    name = f"{place.name}/{batch['grasp_id'][row]}"
    if form == "csv":
        (folder / f"{name}.csv").write_text(csv_text(batch, row), encoding="utf-8")
        return [f"{name}.csv"]
    names = []
    for part, message in ros_messages(batch, row):
        names.append(f"{name}_{part}.json")
        (folder / names[-1]).write_text(json.dumps(message) + "\n", encoding="utf-8")
    return names


def _index_row(batch: GraspBatch, row: int, files: list[str]) -> list[str]:
    numbers = [
        batch["size"][row],
        *batch["object_pos"][row],
        *batch["object_quat_wxyz"][row],
        batch["arm_time"][row, -1],
    ]
    ids = [str(batch[name][row]) for name in _COLUMNS[:3]]
    return [*ids, *(f"{v:.9g}" for v in numbers), " ".join(files)]


def _none_words(source: Browsable, skipped: Counter[str]) -> str:
    found = ", ".join(f"{n} {label}" for label, n in sorted(skipped.items()))
    return f"{source.path} has no selected grasp with a motion of {source.rig} to export" + (
        f" ({found})" if found else ""
    )


_FILES: Mapping[Form, str] = {
    "csv": """`<object_id>/<grasp_id>.csv`: a row per knot. `time` [s] since home; `phase` that led to the
row, `home` in the first; then `<side>/<joint>` [rad]: the arms with their wrists, then the fingers.
""",
    "ros": """`<object_id>/<grasp_id>_<side>_arm.json` and `..._hand.json`: one message of type
trajectory_msgs/JointTrajectory each, as JSON, which is YAML too. Points have positions and times alone:
between such points the joint_trajectory_controller of ros2_control goes in straight lines, which is how the
motions were checked. With velocities it would take splines, which leave them by centimetres of the hand.
Speed changes at the knots at once; a controller that bounds accelerations needs the times stretched.
Joints have the names of the models, and both arms may have the same: rename them as your robot description
does. Wrist joints of a hand are among those of its arm.
""",
}


def _readme(source: Browsable, batch: GraspBatch, form: Form, about: Iterable[str]) -> str:
    arms = batch.header.arms
    knots = ", ".join(f"{phase} {n}" for phase, n in zip(PHASES, arms[0].knots, strict=True))
    lines = [
        f"# Motions of {arms[0].rig}",
        "",
        f"Written by `bidexdata export` from {source.path.name}; rig {arms[0].rig}, sha256 {arms[0].rig_hash}.",
        "",
        _FILES[form],
        f"A motion begins at home. Knots of its phases: {knots}. Between knots joints move in straight "
        "lines.",
        "Fingers have the pre-grasp of this grasp from home until `close`, which ends at the grasp; `squeeze` goes",
        "on to the squeeze, whose angles are what is commanded: the object stops the fingers before. The last row",
        "or point is the end of the lift.",
        "",
        *about,
        "",
        f"`{INDEX}` has the object of each motion, its size [m] and its pose in `world` (z up, the table's",
        "surface is z = 0, x forward from the robot, y left): put the object there, or move the motion.",
        "",
        *(f"- {arm.side} arm: {', '.join(arm.joint_names)}" for arm in arms),
        *(f"- {h.side} hand: {', '.join(h.joint_names)}" for h in batch.header.hands),
        "",
        "The motions were planned without your robot's controller, cell and safety rules. Check them in your own",
        "simulation before anything moves.",
        "",
    ]
    return "\n".join(lines)
