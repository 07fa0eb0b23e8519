"""Explain one grasp of a run: make its scene again, check that it repeats, and write what happened.

Everything goes to RUN/explain/GRASP_ID/; nothing else of the run changes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bidexdata.config import from_plain
from bidexdata.devices import check_device
from bidexdata.errors import ConfigConflict, Contradiction, NotUsable
from bidexdata.record import GraspBatch, Status
from bidexdata.record.fields import DIRECTIONS
from bidexdata.record.status import TestStage, sentence_at
from bidexdata.runs.explain_words import StageWords, stage_words
from bidexdata.runs.first_digits import id_digits, require_one
from bidexdata.runs.made_with import made_with
from bidexdata.runs.plan import Task, scene_of
from bidexdata.runs.rigged import reach_of_object
from bidexdata.runs.run import Run
from bidexdata.runs.shards import read_mark, shard_path, write_atomically, write_text
from bidexdata.runs.synth import round_seed
from bidexdata.synthesis.attempts import grasp_ids
from bidexdata.wording import listed

if TYPE_CHECKING:
    from PIL.Image import Image

    from bidexdata.synthesis.explain import Explanation

FOLDER = "explain"


class FoundAttempt(NamedTuple):
    """Which attempt of a run an id names."""

    grasp_id: str
    task: Task
    scene_id: str
    number: int
    """Place among the attempts of its round, from 0."""


class Repeat(NamedTuple):
    """How the rows that were made again compare with those that the run stores of the scene."""

    rows: int
    """Stored rows of the scene's round."""
    differing: tuple[str, ...]
    """Columns that differ in a row."""
    elsewhere: tuple[str, ...]
    """What made the stored rows otherwise than here: device and versions, in words."""


class StoredVerdict(NamedTuple):
    """What the run says of the grasp in one test."""

    protocol: str
    test: str
    status: str
    """Label of the `Status`."""
    failed_stage: str
    """Label of the `TestStage`: `start`, `closing`, `lift`, `hold` or `none`."""
    direction: str
    """First failing load of test f, such as `+x`; empty where no load failed."""
    text: str
    """All of it, for a person."""


@dataclass(frozen=True, slots=True)
class ExplainReport:
    """What `explain_grasp` found and wrote."""

    grasp_id: str
    scene_id: str
    attempt: int
    """As the column of that name: over all rounds."""
    attempts: int
    """Of the scene in the attempt's round."""
    stored: bool
    """Whether the run keeps the attempt as a row."""
    repeat: Repeat
    explanation: Explanation
    said: tuple[StageWords, ...]
    verdicts: tuple[StoredVerdict, ...]
    """By protocol and test; empty where the run has none of the attempt."""
    files: tuple[Path, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain data for `--json`."""
        one, found, i = self.explanation, self.explanation.found, self.explanation.number
        return {
            "grasp_id": self.grasp_id,
            "scene_id": self.scene_id,
            "attempt": self.attempt,
            "status": one.status.label,
            "reasons": [r.label for r in one.finished.reasons] if one.finished else [],
            "stored": self.stored,
            "repeats": not self.repeat.differing,
            "differing": list(self.repeat.differing),
            "selected": bool(found.selected[i]),
            "audit": bool(found.audit[i]),
            "rank": one.rank,
            "may_be_kept": len(one.order),
            "stages": [s._asdict() for s in self.said],
            "verdicts": [v._asdict() for v in self.verdicts],
            "files": [str(path) for path in self.files],
        }


def explain_grasp(
    library: str | Path, out: str | Path, wanted: str, *, device: str = "cpu"
) -> ExplainReport:
    """Make one attempt of a run again, by the run's own settings, and write what became of it.

    Args:
        library: The run's library.
        out: The run.
        wanted: A grasp_id, or the first digits of one.
        device: Warp device of the optimisation and the pictures.

    Raises:
        PathNotFound: There is no run or no library.
        BadValue: `wanted` is no such number.
        NotUsable: No attempt, or several, are meant; its task is not done; the run is imported, or
            made by a peer's method.
        ConfigConflict: The run was made of another library, or its hands have changed.
        Contradiction: What the run stores is not what its settings give.
    """
    from bidexdata.objects.library import Library
    from bidexdata.synthesis.config import SynthConfig
    from bidexdata.synthesis.explain import explain_attempt
    from bidexdata.synthesis.method_names import DEFAULT_METHOD

    check_device(device)
    run, source = Run.open(out), Library.open(library)
    if run.spec.kind != "synth":
        raise NotUsable(f"{out} holds grasps that were not synthesised here: nothing to explain")
    if run.spec.method not in ("", DEFAULT_METHOD):
        raise NotUsable(
            f"{out} was made by the method {run.spec.method}; only grasps of {DEFAULT_METHOD} can be "
            "explained"
        )
    if source.fingerprint != run.spec.source_fingerprint:
        change = f"{run.spec.source_fingerprint!r} -> {source.fingerprint!r}"
        raise ConfigConflict(out, [f"library.fingerprint: {change}"])
    named = find_attempt(run, wanted)
    task, one_round = named.task, run.spec.rounds[named.task.round]
    if not run.is_done(task):
        raise NotUsable(
            f"grasp {named.grasp_id} is of task {task.task_id}, which is not done yet; run the "
            "same command without --explain first"
        )
    obj, config = source.load(task.object_id), from_plain(SynthConfig, run.spec.config)
    left, right = run.hands()
    one = explain_attempt(
        *(obj, (left, right), scene_of(named.scene_id, obj), config),
        round_seed(run.spec.seed, task.round),
        named.number,
        grasps=one_round.grasps,
        candidates=one_round.candidates,
        run_fingerprint=run.fingerprint,
        first_attempt=one_round.first_attempt,
        device=device,
        reach=reach_of_object(run, task.object_id, device=device),
    )
    stored = run.task_batch(task)
    stored = stored.select(stored["scene_id"] == named.scene_id)
    said = tuple(stage_words(one, config, one_round.grasps))
    report = ExplainReport(
        grasp_id=named.grasp_id,
        scene_id=named.scene_id,
        attempt=one_round.first_attempt + named.number,
        attempts=one_round.candidates,
        stored=named.grasp_id in stored["grasp_id"].tolist(),
        repeat=_compared(run, task, stored, one.rows, device),
        explanation=one,
        said=said,
        verdicts=_verdicts(run, task, named.grasp_id),
        files=(),
    )
    return _written(run, report, obj, (left, right), device)


def _verdicts(run: Run, task: Task, grasp_id: str) -> tuple[StoredVerdict, ...]:
    """What every test that the run has verdicts of came to for one grasp."""
    from bidexdata.pictures.captions import failure_place

    batch, found = run.task_batch(task), []
    rows = np.flatnonzero(batch["grasp_id"] == grasp_id)
    for protocol, test in run.verdict_tests() if len(rows) else ():
        if not run.is_done(task, protocol, test):
            continue
        row = {n: c[rows[0]] for n, c in run.task_verdicts(task, batch, protocol, test).items()}
        status, stage = Status(int(row["verdict_status"])), TestStage(int(row["failed_stage"]))
        direction = int(row["direction"])
        place = failure_place(stage, direction, float(row["time"]))
        if status is Status.OK:
            text = f"passes test {test} of {protocol}"
        elif status is Status.NOT_RUN:
            text = f"has no verdict of test {test} of {protocol}: it was not tested"
        else:
            said = sentence_at(status, stage)
            text = f"fails test {test} of {protocol}{place}: {status.label}: {said}"
        load = DIRECTIONS[direction] if 0 <= direction < len(DIRECTIONS) else ""
        found.append(StoredVerdict(protocol, test, status.label, stage.label, load, text))
    return tuple(found)


def find_attempt(run: Run, wanted: str) -> FoundAttempt:
    """Find the attempt that an id, or its first digits, names, whether the run stores it or not.

    Raises:
        BadValue: It is no hexadecimal number of at most 16 digits.
        NotUsable: There is none, or more than one.
    """
    digits = id_digits("--explain", wanted)
    found = []
    for task in run.tasks:
        one = run.spec.rounds[task.round]
        numbers = range(one.first_attempt, one.first_attempt + one.candidates)
        for scene_id in task.scene_ids:
            ids = grasp_ids(run.fingerprint, scene_id, numbers)
            found += [
                FoundAttempt(grasp_id, task, scene_id, k)
                for k, grasp_id in enumerate(ids)
                if grasp_id.startswith(digits)
            ]
    require_one(run.path, wanted, [f.grasp_id for f in found], "attempts")
    return found[0]


def same_rows(stored: GraspBatch, made: GraspBatch) -> tuple[str, ...]:
    """Names of the columns in which two batches differ, bit for bit; NaN equals NaN."""
    names = sorted({*stored.columns, *made.columns})
    return tuple(
        n for n in names if n not in stored or n not in made or not _same(stored[n], made[n])
    )


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    return np.array_equal(a, b, equal_nan=a.dtype.kind == "f")


def _compared(run: Run, task: Task, stored: GraspBatch, made: GraspBatch, device: str) -> Repeat:
    path = shard_path(run.stage_folder("rows"), task.task_id)
    there, here = read_mark(path).made_with, made_with(device)
    differing = same_rows(stored, made)
    elsewhere = _changes(there, here)
    if differing and not elsewhere:
        raise Contradiction(
            f"{path}: its rows are not those that the run's settings give (columns "
            f"{listed(differing)}); delete it and run `bidexdata synth` again"
        )
    return Repeat(len(stored), differing, elsewhere)


def _changes(there: Mapping[str, str], here: Mapping[str, str]) -> tuple[str, ...]:
    names = sorted({*there, *here})
    return tuple(
        f"{n} {there.get(n, 'unknown')} -> {here.get(n, 'unknown')}"
        for n in names
        if there.get(n) != here.get(n)
    )


def _written(
    run: Run, report: ExplainReport, obj: Any, hands: tuple[Any, Any], device: str
) -> ExplainReport:
    """Write pictures, numbers and words; give the report with their paths."""
    import dataclasses

    from bidexdata.runs.explain_page import energies_csv, explain_page
    from bidexdata.runs.explain_pictures import energies_chart, stages_sheet

    one, folder = report.explanation, run.path / FOLDER / report.grasp_id
    title = f"{report.scene_id}  grasp {report.grasp_id}  {_outcome(report)}"
    sheet = stages_sheet(one, report.said, obj, hands, title=title, device=device)
    _save(folder / "stages.png", sheet)
    files = [folder / "stages.png"]
    if one.trace is not None:
        _save(folder / "energies.png", energies_chart(one.trace, title=title))
        write_text(folder / "energies.csv", energies_csv(one.trace))
        files += [folder / "energies.png", folder / "energies.csv"]
    files.append(folder / "explain.md")
    report = dataclasses.replace(report, files=tuple(files))
    write_text(folder / "explain.md", explain_page(report, run.fingerprint))
    return report


def _outcome(report: ExplainReport) -> str:
    """How the attempt ended, then what each test said of it."""
    ended = f"attempt {report.explanation.status.label}"
    return ", ".join([ended, *(v.text for v in report.verdicts)])


def _save(path: Path, image: Image) -> None:
    write_atomically(path, lambda temporary: image.save(temporary, format="PNG"))
