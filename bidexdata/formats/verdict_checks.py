"""Laws of verdicts: that the tables agree, and that a random sample is judged so again."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.errors import Contradiction
from bidexdata.formats.row_groups import aligned
from bidexdata.formats.row_index import RowIndex
from bidexdata.formats.tables import of_first_test
from bidexdata.record import GraspBatch, Status
from bidexdata.record.fields import JUDGED, MEASURED, TESTS, WITH_ARMS
from bidexdata.wording import counted

if TYPE_CHECKING:
    import pyarrow as pa

    from bidexdata.formats.release import Release
    from bidexdata.objects.prepared import Solid


class Judged(NamedTuple):
    """What simulating rows again gave."""

    success: NDArray[np.bool_]
    """Per row, (N,)."""
    note: str = ""
    """What a reader must know of how it was done; empty where all came from the release."""


Resimulate = Callable[["Release", GraspBatch, "Solid", str], Judged]
"""Judges rows of one object again by a test of the default protocol."""


def verdict_tables(release: Release) -> str:
    """Check ids and flags of all verdicts, and what the grasps table repeats of them."""
    keys = release.protocols
    names = ["grasp_id", "scene_id", "synth_status", *(f"suc_{t}" for t in TESTS), *MEASURED]
    tables = {"grasps": names, **{"verdicts/" + "-".join(key): None for key in keys}}
    count = 0
    for configuration in release.configurations:
        for split in release.split_names:
            for grasps, *judged in aligned(release, tables, configuration, split):
                for table in judged:
                    _check_success(grasps, table)
                found = {
                    t: j
                    for (p, t), j in zip(keys, judged, strict=True)
                    if p == release.default_protocol
                }
                _check_repeated(grasps, found)
                count += grasps.num_rows * len(judged)
    tested = f"{counted(count, 'verdict')} in {counted(len(keys), 'table')} per configuration"
    return f"{tested}, repeated in the grasps table as they are" if keys else "none was tested"


def _check_success(grasps: pa.Table, judged: pa.Table) -> None:
    success = judged.column("success").fill_null(False).to_numpy()
    bad = success & (grasps.column("synth_status").to_numpy() != Status.OK)
    _refuse(grasps, bad, "an attempt without a grasp is marked successful")
    status = judged.column("verdict_status").to_numpy()
    tested = judged.column("success").is_valid().to_numpy()
    _refuse(grasps, success != (tested & (status == Status.OK)), "success and reason disagree")


def _check_repeated(grasps: pa.Table, judged: dict[str, pa.Table]) -> None:
    """`suc_*` and the metrics of the grasps table are those of the default protocol's verdicts."""
    nothing = np.full(grasps.num_rows, -1, np.int8)
    for test in TESTS:
        expected = _tri_state(judged[test].column("success")) if test in judged else nothing
        bad = _tri_state(grasps.column(f"suc_{test}")) != expected
        _refuse(grasps, bad, f"suc_{test} is not the verdict of its table")
    for name in MEASURED:
        tables = [judged[test] for test in TESTS if test in judged]
        tests = [
            ({name: t.column(name).to_numpy()}, t.column("success").is_valid().to_numpy())
            for t in tables
        ]
        expected = of_first_test(name, grasps.num_rows, tests)
        found = grasps.column(name).to_numpy()
        same = (found == expected) | (np.isnan(found) & np.isnan(expected))
        _refuse(grasps, ~same, f"{name} is not that of its verdict table")


def _tri_state(column: Any) -> NDArray[np.int8]:
    import pyarrow as pa

    return column.cast(pa.int8()).fill_null(-1).to_numpy()


def _refuse(grasps: pa.Table, bad: NDArray[np.bool_], text: str) -> None:
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        grasp, scene = (grasps.column(n)[row].as_py() for n in ("grasp_id", "scene_id"))
        raise Contradiction(f"grasp {grasp} of {scene}: {text} ({int(bad.sum())} such rows)")


def verdicts(release: Release, resimulate: Resimulate, sample: int, seed: int) -> str:
    """Judge a random sample of tested rows again and compare with their stored verdicts.

    Args:
        release: Where.
        resimulate: Judges rows of one object again.
        sample: Rows of each test, selected and audit rows together.
        seed: Seed of the sample.
    """
    name = release.default_protocol
    engine = release.protocol_settings.get(name, {}).get("engine")
    if engine is not None:  # its last digits vary from run to run
        words = ", ".join(f"{key} {value}" for key, value in engine.items())
        return f"not judged again, for {name} is not MuJoCo's C engine ({words})"
    if not release.has_shapes:
        return "not judged again, for the licence policy leaves out the meshes"
    rng = np.random.default_rng(seed)
    notes: dict[str, None] = {}
    said = []
    for test in JUDGED:
        if (name, test) not in release.protocols:
            continue
        if test in WITH_ARMS:
            notes[f"; test {test} not, for a release has no models of arms"] = None
            continue
        chosen = _drawn(release, test, sample, rng)
        for configuration, rows in chosen.items():
            notes |= dict.fromkeys(_judge(release, resimulate, test, configuration, rows))
        counts = [f"{len(rows)} {c}" for c, rows in chosen.items()]
        said.append(f"{' and '.join(counts)} rows of test {test}")
    again = f"{', '.join(said)} judged again with the stored verdict"
    none = "no row has a verdict to be judged again"
    return (again if said else none) + "".join(notes)


def _drawn(
    release: Release, test: str, sample: int, rng: np.random.Generator
) -> dict[str, NDArray[np.int64]]:
    """Draw rows of all configurations together; numbers within each, sorted."""
    tested = {c: _tested(release, c, test) for c in release.configurations}
    counts = [len(rows) for rows in tested.values()]
    drawn = np.sort(rng.choice(sum(counts), min(sample, sum(counts)), replace=False))
    starts = np.cumsum([0, *counts])
    parts = zip(tested.items(), starts[:-1], starts[1:], strict=True)
    return {c: rows[drawn[(drawn >= a) & (drawn < b)] - a] for (c, rows), a, b in parts}


def _tested(release: Release, configuration: str, test: str) -> NDArray[np.int64]:
    """Rows of a configuration that hold a grasp and a verdict; audit rows only once."""
    import pyarrow.compute as pc

    compute: Any = pc
    columns = [f"suc_{test}", "synth_status", "selected"]
    index = release.index(configuration, columns=columns)
    use = index.column(f"suc_{test}").is_valid().to_numpy()
    use = use & (index.column("synth_status").to_numpy() == Status.OK)
    if configuration != "selected":
        use &= compute.invert(index.column("selected")).to_numpy()
    return np.flatnonzero(use)


def _judge(
    release: Release,
    resimulate: Resimulate,
    test: str,
    configuration: str,
    rows: NDArray[np.int64],
) -> list[str]:
    """Judge rows of a configuration, given by number, and give the notes."""
    notes = []
    index = RowIndex(release, configuration)
    owners = index.object_index[rows]
    for number in np.unique(owners).tolist():
        object_id = release.object_ids[number]
        stored = release.grasps(object_id, configuration=configuration, test=test)
        ranges = [np.arange(low, high) for low, high in index.object_ranges(object_id)]
        batch = stored.select(np.searchsorted(np.concatenate(ranges), rows[owners == number]))
        judged = resimulate(release, batch, release.load_solid(object_id), test)
        differ = np.asarray(judged.success) != batch["success"]
        if differ.any():
            row = int(np.flatnonzero(differ)[0])
            raise Contradiction(
                f"grasp {batch['grasp_id'][row]} of {batch['scene_id'][row]} was judged "
                f"{'' if judged.success[row] else 'not '}successful when test {test} was "
                f"simulated again{judged.note}"
            )
        notes.append(judged.note)
    return notes
