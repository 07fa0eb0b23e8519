"""Laws of shards: whole or absent, marked with their configuration, the same bytes each time."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

from bidexdata.errors import ConfigConflict, Contradiction, PathNotFound
from bidexdata.runs.shards import (
    check_mark,
    done_tasks,
    read_mark,
    read_shard,
    shard_path,
    sweep,
    write_atomically,
    write_shard,
    write_text,
)
from bidexdata.temporaries import STALE_AFTER

ROOT = Path(__file__).resolve().parents[2]
pa = pytest.importorskip("pyarrow")


def table(rows: int) -> object:
    rng = np.random.default_rng(0)
    metadata = {"bidexdata": json.dumps({"rows": "of a test"})}
    return pa.table({"x": rng.normal(size=rows), "n": np.arange(rows)}).replace_schema_metadata(
        metadata
    )


@pytest.mark.parametrize("rows", [0, 1, 1000])
def test_a_shard_reads_back_as_written_with_its_metadata(tmp_path: Path, rows: int):
    path = shard_path(tmp_path, "ab12cd")
    write_shard(path, table(rows), "print")
    again = read_shard(path, "print")
    assert again.equals(table(rows))
    assert again.schema.metadata[b"bidexdata"] == table(rows).schema.metadata[b"bidexdata"]
    assert path == tmp_path / "ab" / "ab12cd.arrow"
    assert done_tasks(tmp_path) == {"ab12cd"}


def test_the_same_rows_give_the_same_bytes_whatever_their_chunks(tmp_path: Path):
    whole = table(100)
    cut = pa.concat_tables([whole.slice(0, 30), whole.slice(30)])
    write_shard(tmp_path / "a.arrow", whole, "print")
    write_shard(tmp_path / "b.arrow", cut, "print")
    assert (tmp_path / "a.arrow").read_bytes() == (tmp_path / "b.arrow").read_bytes()


def test_a_shard_says_what_it_was_made_with(tmp_path: Path):
    path = tmp_path / "a.arrow"
    write_shard(path, table(3), "print")
    mark = read_mark(path)
    assert (mark.fingerprint, mark.rows) == ("print", 3)
    assert mark.made_with["device"] == "cpu"
    assert mark.made_with["device_name"]
    for package in ("mujoco", "numpy", "warp-lang"):
        assert mark.made_with[package] == version(package)


def test_a_shard_of_an_older_version_says_nothing_and_is_read(tmp_path: Path):
    from pyarrow import ipc

    old = table(3).replace_schema_metadata(
        {"bidexdata_shard": json.dumps({"fingerprint": "print", "rows": 3})}
    )
    path = tmp_path / "a.arrow"
    with pa.OSFile(str(path), "wb") as sink, ipc.new_file(sink, old.schema) as writer:
        writer.write_table(old)
    assert read_shard(path, "print").num_rows == 3
    assert read_mark(path).made_with == {}


def test_another_configuration_is_refused(tmp_path: Path):
    write_shard(tmp_path / "a.arrow", table(3), "print")
    with pytest.raises(ConfigConflict, match="'print' -> 'other'") as caught:
        read_shard(tmp_path / "a.arrow", "other")
    assert caught.value.exit_code == 5


def test_a_missing_shard_is_not_done(tmp_path: Path):
    with pytest.raises(PathNotFound):
        read_shard(tmp_path / "none.arrow")
    assert done_tasks(tmp_path / "nowhere") == set()


@pytest.mark.parametrize("keep", [0, 10, 0.5, -1])
def test_a_cut_shard_is_damaged(tmp_path: Path, keep: float):
    path = tmp_path / "a.arrow"
    write_shard(path, table(1000), "print")
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data)) if isinstance(keep, float) else keep])
    with pytest.raises(Contradiction, match="delete it"):
        read_shard(path)


def test_a_failed_write_leaves_the_old_file_and_no_other(tmp_path: Path):
    path = tmp_path / "run.json"
    write_text(path, "old")

    def fail(temporary: Path) -> None:
        temporary.write_text("half")
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        write_atomically(path, fail)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_killed_writer_leaves_no_shard_and_the_next_sweep_cleans_up(tmp_path: Path):
    code = (
        "import sys, time; from pathlib import Path\n"
        "from bidexdata.runs.shards import write_atomically\n"
        "def slow(temporary):\n"
        "    temporary.write_text('half'); print('half', flush=True); time.sleep(60)\n"
        "write_atomically(Path(sys.argv[1]), slow)\n"
    )
    path = shard_path(tmp_path, "ab12cd")
    writer = subprocess.Popen(
        [sys.executable, "-c", code, path],
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert writer.stdout is not None
    assert writer.stdout.readline().strip() == b"half"
    assert sweep([tmp_path]) == 0  # its writer lives
    writer.send_signal(signal.SIGKILL)
    writer.wait()
    assert done_tasks(tmp_path) == set()
    assert len(list(tmp_path.rglob("*.tmp"))) == 1
    assert sweep([tmp_path]) == 1
    assert list(tmp_path.rglob("*.tmp")) == []


def test_another_machines_temporary_files_are_orphans_only_after_a_day(tmp_path: Path):
    foreign = tmp_path / f".x.arrow.not-{socket.gethostname()}.1.tmp"
    foreign.write_text("half")
    assert sweep([tmp_path]) == 0
    old = time.time() - STALE_AFTER - 60
    os.utime(foreign, (old, old))
    assert sweep([tmp_path]) == 1


def test_a_mark_is_checked_without_reading_the_rows(tmp_path: Path):
    path = tmp_path / "a.arrow"
    write_shard(path, table(3), "mine")
    check_mark(path, "mine")
    with pytest.raises(ConfigConflict, match=r"a\.arrow.*'mine' -> 'yours'"):
        check_mark(path, "yours")
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(Contradiction, match=r"a\.arrow: damaged shard"):
        check_mark(path, "mine")
