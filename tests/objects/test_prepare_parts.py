"""Several machines prepare one folder: the library is the one that a single run makes, bit for bit."""

from __future__ import annotations

import multiprocessing
import os
import shutil
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import pytest
from mesh_files import library_files as files
from mesh_files import mixed_folder

from bidexdata.errors import Contradiction, NotUsable
from bidexdata.kinds import kind_of
from bidexdata.objects.config import PrepareConfig, RestConfig, SdfConfig
from bidexdata.objects.library import Library
from bidexdata.runs import prepare_parts
from bidexdata.runs.prepare import prepare_library
from bidexdata.runs.prepare_report import PrepareReport


@pytest.fixture(scope="module")
def small(small: PrepareConfig) -> PrepareConfig:
    """Few drops too: these tests are about what surrounds the objects."""
    return replace(small, rest=RestConfig(drops=24))


@pytest.fixture(scope="module")
def meshes(tmp_path_factory: pytest.TempPathFactory, box) -> Path:
    """Good, the same bytes again, failures of several kinds, good again; read only."""
    folder = mixed_folder(tmp_path_factory.mktemp("parts") / "meshes", box)
    (folder / "f_empty.ply").touch()
    return folder


@pytest.fixture(scope="module")
def single(meshes: Path, small: PrepareConfig) -> dict[str, bytes]:
    """The files of a library that one run made."""
    part(meshes, meshes.parent / "single", small, None)
    return files(meshes.parent / "single")


def part(meshes: Path, out: Path, config: PrepareConfig, shard, **options) -> PrepareReport:
    options = {"executor": "inline", "quiet": True, **options}
    return prepare_library([str(meshes)], out, config, shard=shard, **options)


@pytest.mark.parametrize("order", [*permutations(range(3))])
def test_parts_in_any_order_give_the_bytes_of_one_run(tmp_path, meshes, small, single, order):
    out = tmp_path / "lib"
    *first, last = order
    for i in first:
        report = part(meshes, out, small, (i, 3))
        assert report.waiting > 0
        assert report.fingerprint == ""
        assert len(report.rows) == 2
        assert kind_of(out) == "library"
        with pytest.raises(NotUsable, match="unfinished"):
            Library.open(out)
    report = part(meshes, out, small, (last, 3))
    assert report.waiting == 0
    assert len(report.rows) == 6
    assert report.by_status == {"duplicate": 1, "no_faces": 1, "ok": 2, "unreadable": 2}
    assert report.fingerprint == Library.open(out).fingerprint
    assert files(out) == single


def test_more_parts_than_inputs_and_a_single_part(tmp_path, meshes, small, single):
    for n in (1, 9):
        out = tmp_path / f"lib{n}"
        reports = [part(meshes, out, small, (i, n)) for i in range(n)]
        assert [r.waiting for r in reports][-1] == 0
        assert files(out) == single


def _one_part(meshes: Path, out: Path, config: PrepareConfig, i: int) -> None:
    part(meshes, out, config, (i, 3))


def test_parts_at_the_same_time_give_the_bytes_of_one_run(
    tmp_path, meshes, small, single, monkeypatch
):
    # The forked machines have the address space of all tests before: no bound of a worker fits it.
    monkeypatch.setattr("bidexdata.runs.prepare_task.limit_memory", lambda gib: None)
    out = tmp_path / "lib"
    context = multiprocessing.get_context("fork")
    # Every part twice, so that two also write the same objects at the same time.
    machines = [
        context.Process(target=_one_part, args=(meshes, out, small, i % 3)) for i in range(6)
    ]
    for machine in machines:
        machine.start()
    for machine in machines:
        machine.join(120)
    assert [m.exitcode for m in machines] == [0] * 6
    assert files(out) == single


def test_parts_resume_and_a_part_of_a_finished_library_changes_nothing(
    tmp_path, meshes, small, single
):
    out = tmp_path / "lib"
    part(meshes, out, small, (0, 2))
    assert part(meshes, out, small, (0, 2)).resumed == 2
    part(meshes, out, small, (1, 2))
    assert part(meshes, out, small, (0, 2)).waiting == 0
    assert part(meshes, out, small, (3, 5)).waiting == 0
    assert part(meshes, out, small, None).resumed == 2
    assert files(out) == single


def test_a_run_of_everything_finishes_what_parts_began(tmp_path, meshes, small, single):
    out = tmp_path / "lib"
    part(meshes, out, small, (1, 3))
    part(meshes, out, small, None)
    assert files(out) == single


def test_a_cut_object_of_another_part_is_waited_for(tmp_path, meshes, small, single):
    out = tmp_path / "lib"
    part(meshes, out, small, (0, 2))
    next(out.rglob("pieces.npz")).unlink()
    assert part(meshes, out, small, (1, 2)).waiting == 1
    assert part(meshes, out, small, (0, 2)).waiting == 0
    assert files(out) == single


def test_a_damaged_object_of_another_part_is_waited_for(tmp_path, meshes, small, single):
    out = tmp_path / "lib"
    part(meshes, out, small, None)
    damaged = next(out.rglob("geometry.npz"))
    damaged.write_bytes(b"damaged")
    # It belongs to one of the two parts: the library is whole when both went over it.
    for i in range(2):
        part(meshes, out, small, (i, 2))
    for i in range(2):
        assert part(meshes, out, small, (i, 2)).waiting == 0
    assert files(out) == single


def test_parts_of_other_inputs_or_another_configuration_say_nothing(tmp_path, meshes, small):
    out = tmp_path / "lib"
    failing = tmp_path / "failing"
    failing.mkdir()
    for name in ("c_points.obj", "d_half.stl"):
        shutil.copy(meshes / name, failing / name)
    part(failing, out, small, (0, 2))
    other = replace(small, sdf=SdfConfig(cells=41))
    assert part(failing, out, other, (1, 2)).waiting == 1
    assert part(failing, out, other, (0, 2)).waiting == 0
    assert part(failing, out, small, (1, 2)).waiting == 1


def test_what_other_machines_are_writing_is_left_alone(tmp_path, meshes, small):
    out = tmp_path / "lib"
    theirs = out / "objects" / "00" / ".box-00000000.elsewhere.1.partial"
    mine = out / "objects" / "00" / f".box-00000001.{os.uname().nodename}.{os.getpid()}.partial"
    for partial in (theirs, mine):
        partial.mkdir(parents=True)
    part(meshes, out, small, (0, 2))
    assert theirs.is_dir()
    assert mine.is_dir()


def test_a_part_says_its_failures_although_another_removes_the_folder(
    tmp_path, meshes, small, single, monkeypatch
):
    out = tmp_path / "lib"
    part(meshes, out, small, (0, 2))
    real, calls = prepare_parts.write_text, []

    def removed_meanwhile(path: Path, text: str) -> None:
        calls.append(path)
        if len(calls) == 1:
            raise FileNotFoundError(path)
        real(path, text)

    monkeypatch.setattr(prepare_parts, "write_text", removed_meanwhile)
    assert part(meshes, out, small, (1, 2)).waiting == 0
    assert len(calls) == 2
    assert files(out) == single


def test_a_damaged_part_is_named(tmp_path, meshes, small):
    out = tmp_path / "lib"
    part(meshes, out, small, (0, 2))
    (damaged,) = (out / ".parts").rglob("0-of-2.json")
    damaged.write_text("{")
    with pytest.raises(Contradiction, match=r"0-of-2\.json: damaged .* run that part again"):
        part(meshes, out, small, (1, 2))


def test_a_dry_run_of_a_part_lists_its_inputs(tmp_path, meshes, small):
    names = [
        {r["source_name"] for r in part(meshes, tmp_path / "no", small, (i, 2), dry_run=True).rows}
        for i in range(2)
    ]
    assert names[0].isdisjoint(names[1])
    assert names[0] | names[1] == {p.name for p in meshes.iterdir()}
