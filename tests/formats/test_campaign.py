"""Campaigns: flipped bits are found wherever they are, and a killed `pack` leaves nothing wrong."""

from __future__ import annotations

import json
import multiprocessing
import shutil
import time
from pathlib import Path

import killed_pack
import numpy as np
import pyarrow.parquet as pq
import pytest
from made_release import OBJECTS, made_release

from bidexdata.cli.main import run
from bidexdata.errors import BidexError, Contradiction
from bidexdata.formats import parquet
from bidexdata.formats.verify import verify_release
from bidexdata.runs import release_pictures


def flips(files: list[Path], n: int, seed: int):
    """Draw n single bits over all bytes of some files: path, byte, bit."""
    rng = np.random.default_rng(seed)
    ends = np.cumsum([path.stat().st_size for path in files])
    for at in rng.integers(0, ends[-1], n).tolist():
        which = int(np.searchsorted(ends, at, side="right"))
        yield files[which], at - int(ends[which - 1] if which else 0), int(rng.integers(8))


def flipped(data: bytes, at: int, bit: int) -> bytes:
    changed = bytearray(data)
    changed[at] ^= 1 << bit
    return bytes(changed)


def tree(root: Path) -> dict[str, bytes]:
    return {p.relative_to(root).as_posix(): p.read_bytes() for p in root.rglob("*") if p.is_file()}


@pytest.mark.parametrize("n", [20, pytest.param(200, marks=pytest.mark.slow)])
def test_every_flipped_bit_is_found_by_plain_verify(copied, n):
    files = sorted(p for p in copied.rglob("*") if p.is_file())
    found = 0
    for path, at, bit in flips(files, n, seed=12):
        data = path.read_bytes()
        path.write_bytes(flipped(data, at, bit))
        report = verify_release(copied)
        assert not report.ok, (path, at, bit)
        with pytest.raises(Contradiction) as caught:
            report.raise_if_bad()
        assert caught.value.exit_code == 4
        path.write_bytes(data)
        found += 1
    assert found == n
    assert verify_release(copied).ok


def page_bytes(path: Path) -> set[int]:
    meta, found = pq.ParquetFile(path).metadata, set()
    for group in range(meta.num_row_groups):
        for column in range(meta.num_columns):
            chunk = meta.row_group(group).column(column)
            start = chunk.dictionary_page_offset or chunk.data_page_offset
            found |= set(range(start, start + chunk.total_compressed_size))
    return found


def values(path: Path) -> list[str]:
    table = parquet.read_table(path, parquet.read_schema(path).names)
    return [f"{f.name} {f.type} {table.column(f.name).to_pylist()!r}" for f in table.schema]


@pytest.mark.parametrize("n", [60, pytest.param(1500, marks=pytest.mark.slow)])
def test_a_flip_in_a_page_is_refused_or_changes_no_number(copied, n):
    """Page checksums cover what is in a page; of a page's header, what is not used may flip."""
    files = sorted(p for p in (copied / "grasps").rglob("*.parquet"))
    files += sorted(p for p in (copied / "contacts").rglob("*.parquet"))
    good = {path: values(path) for path in files}
    pages = {path: page_bytes(path) for path in files}
    refused = tried = 0
    for path, at, bit in flips(files, 10 * n, seed=5):
        if at not in pages[path] or tried == n:
            continue
        tried += 1
        data = path.read_bytes()
        path.write_bytes(flipped(data, at, bit))
        try:
            assert values(path) == good[path], (path, at, bit)
        except Contradiction:
            refused += 1
        path.write_bytes(data)
    assert tried == n
    assert refused > 0.9 * n


@pytest.mark.parametrize("n", [40, pytest.param(1000, marks=pytest.mark.slow)])
def test_a_flip_anywhere_in_a_table_gives_no_wrong_number_under_a_name(packed, tmp_path, n):
    """In the footer a flip may rename a column or change its type; asking by name then fails."""
    source = packed / "grasps" / "train-00000.parquet"
    path, data, good = tmp_path / "t.parquet", source.read_bytes(), values(source)
    names = parquet.read_schema(source).names
    for _, at, bit in flips([source], n, seed=7):
        path.write_bytes(flipped(data, at, bit))
        try:
            table = parquet.read_table(path, names)
        except Contradiction:
            continue
        for said in good:
            name, kind = said.split(" ")[:2]
            column = table.column(name)
            if str(column.type) == kind:
                assert said.endswith(f" {column.to_pylist()!r}"), (at, bit, name)


@pytest.fixture(scope="module")
def context():
    """Children of a server that has imported everything: one starts in some milliseconds."""
    found = multiprocessing.get_context("forkserver")
    found.set_forkserver_preload(list(killed_pack.PRELOADED))
    return found


def kill_campaign(context, target, arguments, folder: Path, reference: dict, again, n: int):
    """Kill a writer of `folder/out` n times; what passes `verify` must be the reference."""
    out, rng = folder / "out", np.random.default_rng(3)
    lasted, seen = _whole(context, target, (*arguments, str(folder / "first"))), []
    assert tree(folder / "first") == reference
    shutil.rmtree(folder / "first")
    for trial in range(n):
        # A third at any time, the others where it is most delicate.
        phase = (None, "hashing", "renaming")[trial % 3]
        _killed(context, target, (*arguments, str(out)), phase, lasted, rng)
        for found in folder.iterdir():
            if _passes(found):
                assert tree(found) == reference, found
        seen.append(out.exists())
        if not out.exists():
            again(out)
        assert tree(out) == reference
        assert [p.name for p in folder.iterdir()] == ["out"]  # nothing is left of the killed one
        shutil.rmtree(out)
    return seen


def _whole(context, target, arguments) -> float:
    """Run a child to its end; how long it took once it had begun to write [s]."""
    child, told = _started(context, target, arguments)
    _wait(told, "writing")
    start = time.monotonic()
    _wait(told, "done")
    child.join()
    return time.monotonic() - start


def _killed(context, target, arguments, phase: str | None, lasted: float, rng) -> None:
    child, told = _started(context, target, arguments)
    _wait(told, phase or "writing")
    time.sleep(rng.uniform(0, 1.2 * lasted if phase is None else 0.003))
    if child.is_alive():  # else it was faster than the kill
        child.kill()
    child.join()


def _started(context, target, arguments):
    mine, theirs = context.Pipe()
    child = context.Process(target=target, args=(*arguments, theirs))
    child.start()
    theirs.close()  # so that the death of the child is the end of the file
    return child, mine


def _wait(told, phase: str) -> None:
    while told.poll(60):
        if told.recv() == phase:
            return
    raise AssertionError(f"the child did not come to {phase!r}")


def _passes(folder: Path) -> bool:
    try:
        return verify_release(folder).ok
    except BidexError:
        return False


@pytest.mark.parametrize(("n", "objects"), [(3, 1), pytest.param(20, 3, marks=pytest.mark.slow)])
def test_a_killed_writer_leaves_no_wrong_release(context, tmp_path, n, objects):
    def again(out: Path) -> None:
        made_release(out, OBJECTS[:objects])

    reference, folder = tmp_path / "reference", tmp_path / "killed"
    folder.mkdir()
    again(reference)
    target = killed_pack.write_made
    seen = kill_campaign(context, target, (objects,), folder, tree(reference), again, n)
    assert not all(seen), "every kill came too late"


@pytest.mark.slow
def test_a_killed_pack_of_a_run_leaves_no_wrong_release(
    context, tmp_path, capsys, monkeypatch, shown_on_cards
):
    # The killed children draw whole cards.
    monkeypatch.setattr(release_pictures, "SHOWN", shown_on_cards)
    library, made = tmp_path / "library", tmp_path / "run"
    few = ["--set", "regions.anchors=60", "--set", "optimise.approach.steps=40"]
    few += ["--setting", "tabletop"]  # which has tests f and l
    options = ["--hand", "capsule", "--sizes", "0.3", "--grasps", "2", "--candidates", "8", *few]
    prepare = ["prepare", "shapes:box,cylinder", "--out", str(library), "--quiet"]
    assert run(prepare) == 0
    assert run(["synth", str(library), "--out", str(made), *options, "--quiet"]) == 0
    assert run(["validate", str(made), "--quiet"]) == 0
    pack = ["pack", str(made), "--name", "tiny", "--version", "1.0.0", "--quiet", "--out"]
    assert run([*pack, str(tmp_path / "reference")]) == 0
    folder = tmp_path / "killed"
    folder.mkdir()

    def again(out: Path) -> None:
        assert run([*pack, str(out)]) == 0

    reference = tree(tmp_path / "reference")
    kill_campaign(context, killed_pack.pack_run, (str(made),), folder, reference, again, 20)
    capsys.readouterr()
    assert run(["verify", str(tmp_path / "reference"), "--full", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    details = {c["name"]: c["detail"] for c in told["checks"]}
    assert {"figures", "golden again", "content hash"} <= set(details)
    assert "rows of test f" in details["verdicts"]
    assert "rows of test l" in details["verdicts"]
    assert "installation" not in details["verdicts"]  # the release's own hands
