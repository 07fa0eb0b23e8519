"""The pack stage: one or several runs become a release."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from bidexdata.errors import NotUsable
from bidexdata.runs.chosen import DEFAULT_PROTOCOL, chosen_protocol, other_rigs
from bidexdata.runs.pack_inputs import (
    check_hands,
    for_rig,
    named_runs,
    objects_of,
    run_info,
    shared_protocols,
    shared_rig,
    sizes_of,
)
from bidexdata.runs.pack_objects import in_processes
from bidexdata.runs.pack_rows import count_tested, rows_of_object
from bidexdata.runs.progress import Progress
from bidexdata.runs.run import Run
from bidexdata.wording import counted

if TYPE_CHECKING:
    from bidexdata.formats.citation import About
    from bidexdata.formats.rows import ReleaseRows
    from bidexdata.objects.prepared import PreparedObject

LICENCE_HINT = (
    "--licences ids-only packs the grasps without the meshes, and a list file's column `licence` "
    "states licences when they are prepared, for imports an INDEX.csv beside their objects "
    "(docs/releases.md, docs/importing.md)"
)
"""What a person can do about objects that a policy leaves out."""


class LeftOut(NamedTuple):
    """An object that the licence policy leaves out."""

    object_id: str
    licence: str
    """As its source states it."""


class TestedRows(NamedTuple):
    """How many finished rows of a run have verdicts."""

    name: str
    path: Path
    tested: int
    rows: int


@dataclass(frozen=True, slots=True)
class PackReport:
    """What was packed."""

    path: Path
    protocol: str
    """Whose verdicts are `suc_*` and the metrics."""
    figures: Mapping[str, Any]
    """As in the manifest and the card."""
    unfinished: Mapping[str, int] = field(default_factory=dict)
    """Tasks per run that are not done; their rows are not in the release."""
    untested: int = 0
    """Objects without verdicts because not all their rows are validated."""
    left_out: tuple[LeftOut, ...] = ()
    """Objects left out for their licence."""
    half_tested: tuple[TestedRows, ...] = ()
    """Runs with rows that the protocol has not tested."""
    rig: str = ""
    """Whose arm solutions are in the release; empty where it has none."""
    other_rigs: tuple[str, ...] = ()
    """Rigs that the runs have solutions of, too, which are not in the release."""


def pack_runs(
    paths: Sequence[str | Path],
    out: str | Path,
    *,
    name: str,
    version: str,
    form: str = "both",
    licences: str = "nc-ok",
    split: str = "object",
    protocol: str | None = None,
    seed: int = 0,
    about: About | None = None,
    rig: str | Path | None = None,
    pictures: bool = True,
    quiet: bool = False,
) -> PackReport:
    """Write a release of all finished rows of some runs.

    Args:
        paths: Runs of the same hands; every run once.
        out: The release folder; must not exist or be empty.
        name: Name of the data set.
        version: Its version, X.Y.Z.
        form: `both`, `parquet` without the training form, or `hdf5`: rows in that form alone.
        licences: `permissive` and `nc-ok` leave out objects whose licence is unknown or forbids
            what the policy promises; `ids-only` names all objects and leaves out all meshes.
        split: `object`, `category` or `size`: what is never in two splits.
        protocol: Whose verdicts become `suc_*` and the metrics; `paper-1` or the only one that
            the runs have verdicts of when omitted.
        seed: Seed of the split into train and test.
        about: Authors, date and address of the data set.
        rig: Whose arm solutions are packed, of runs that have those of several; see `Run.rig`.
        pictures: Draw the card's picture.
        quiet: No progress.

    Raises:
        BadValue: The name or version cannot be used.
        NotUsable: Nothing to pack, runs that do not fit together, a bad form or target, or
            verdicts of several protocols and no saying which.
        UnknownName: No run has verdicts of the protocol.
    """
    from bidexdata.formats.licences import check_policy
    from bidexdata.formats.splits import check_rule
    from bidexdata.formats.writer import check_names, write_release
    from bidexdata.runs.release_pictures import card_pictures

    check_names(Path(out), name, version, form)  # before anything is read
    check_policy(licences)
    check_rule(split)
    runs = named_runs([for_rig(Run.open(p), rig) for p in paths])
    check_hands(runs)
    arms = shared_rig(runs)
    objects = objects_of(runs)
    left_out = _refused_by_licence(objects, licences)
    ids = sorted(set(objects) - {o.object_id for o in left_out})
    if not ids:
        raise _nothing_left(left_out, licences)
    tests = sorted({t for r in runs for t in r.finished.tests})
    named = " ".join(str(r.run.path) for r in runs)
    protocol = chosen_protocol(named, tests, protocol) or DEFAULT_PROTOCOL
    untested: Counter[str] = Counter()

    def rows_of(object_id: str) -> Iterator[ReleaseRows]:
        for one in runs:
            rows = rows_of_object(one.run, one.finished, object_id, one.name, tests)
            if rows is not None:
                untested[object_id] += int(set(rows.verdicts) < set(one.finished.tests))
                yield rows

    def load_object(object_id: str) -> PreparedObject:
        return objects[object_id].library.load(object_id)

    with Progress(len(ids), "object", quiet=quiet) as progress:
        summary = write_release(
            Path(out),
            name=name,
            version=version,
            object_ids=ids,
            rows_of=rows_of,
            load_object=load_object,
            hands=runs[0].run.hands(),
            runs=[run_info(r) for r in runs],
            tests=tests,
            default_protocol=protocol,
            protocols=shared_protocols(runs, tests),
            seed=seed,
            split_by=split,
            sizes_mm=sizes_of(runs, set(ids)),
            licences=licences,
            about=about,
            rig=arms,
            pictures=card_pictures if pictures else None,
            form=cast("Any", form),
            on_object=lambda object_id: progress.advance(note=object_id),
            each_object=in_processes({i: run.library for i, run in objects.items()}),
        )
    unfinished = {r.name: len(r.run.tasks) - len(r.finished.rows) for r in runs}
    counts = [
        TestedRows(r.name, r.run.path, *count_tested(r.run, r.finished, protocol)) for r in runs
    ]
    return PackReport(
        summary.path,
        protocol,
        summary.figures,
        {k: v for k, v in unfinished.items() if v},
        sum(1 for n in untested.values() if n),
        tuple(left_out),
        tuple(c for c in counts if c.tested < c.rows),
        "" if arms is None else arms.name,
        tuple(sorted({name for one in runs for name in other_rigs(one.run)})),
    )


def _refused_by_licence(objects: Mapping[str, Run], licences: str) -> list[LeftOut]:
    from bidexdata.formats.licences import UNKNOWN, allows

    found = []
    for object_id, run in sorted(objects.items()):
        licence = str(run.library.row(object_id)["licence"] or UNKNOWN)
        if not allows(licence, licences):
            found.append(LeftOut(object_id, licence))
    return found


def _nothing_left(left_out: Sequence[LeftOut], licences: str) -> NotUsable:
    if not left_out:
        return NotUsable("there is nothing to pack: no run has finished rows of a usable object")
    first = left_out[0]
    return NotUsable(
        f"there is nothing to pack under --licences {licences}: "
        f"{counted(len(left_out), 'object has a licence', 'objects have licences')} that "
        f"{'does' if len(left_out) == 1 else 'do'} not allow it (first: {first.object_id}, "
        f"{first.licence}); {LICENCE_HINT}"
    )
