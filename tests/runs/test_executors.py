"""Laws of the executors: whatever becomes of one task, the others give their results."""

from __future__ import annotations

import ast
import multiprocessing
import os
import re
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from bidexdata.errors import NotUsable, UnknownName
from bidexdata.runs.executors import TaskFailure, run_tasks

ROOT = Path(__file__).resolve().parents[2]
WITH_PACKAGE = {**os.environ, "PYTHONPATH": str(ROOT)}


def square(n: int) -> int:
    return n * n


def misbehave(n: int) -> int:
    if n == 1:
        raise ValueError("one is refused\nsecond line")
    if n == 2:
        os._exit(7)
    if n == 3:
        os.kill(os.getpid(), signal.SIGSEGV)
    if n == 4:
        os.kill(os.getpid(), signal.SIGKILL)
    return n * n


def unsendable(n: int):
    return (lambda: n) if n == 1 else n


class Cursed:
    def __reduce__(self):
        return (misbehave, (1,))


def unreadable(n: int):
    return Cursed() if n == 1 else n


def sleepy(n: int) -> int:
    time.sleep(60 if n == 1 else 0)
    return n


def threads(_: int) -> dict[str, str | None]:
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    return {name: os.environ.get(name) for name in names}


def test_every_task_gives_its_result_once():
    for tasks in ([], [3], list(range(7))):
        for executor, workers in (("inline", 0), ("processes", 1), ("processes", 2)):
            got = dict(run_tasks(tasks, square, executor=executor, workers=workers))
            assert got == {n: n * n for n in tasks}


def test_a_dead_worker_costs_only_its_task():
    got = dict(run_tasks(list(range(8)), misbehave, workers=2))
    assert {n: r for n, r in got.items() if not isinstance(r, TaskFailure)} == {
        n: n * n for n in (0, 5, 6, 7)
    }
    assert got[1].kind == "exception"
    assert got[1].reason == "ValueError: one is refused"
    assert "second line" in got[1].details
    assert "exit code 7" in got[2].reason
    assert "SIGSEGV" in got[3].reason
    assert "SIGKILL" in got[4].reason
    assert {got[n].kind for n in (2, 3, 4)} == {"died"}
    assert [got[n].signal for n in (1, 2, 3, 4)] == ["", "", "SIGSEGV", "SIGKILL"]


def test_an_exception_inline_is_the_same_failure_as_in_a_worker():
    (inline,) = [r for _, r in run_tasks([1], misbehave, executor="inline")]
    (worker,) = [r for _, r in run_tasks([1], misbehave, workers=1)]
    assert (inline.task, inline.reason, inline.kind) == (worker.task, worker.reason, worker.kind)


def test_a_result_that_cannot_be_sent_is_a_failure_of_its_task():
    got = dict(run_tasks([0, 1, 2], unsendable, workers=1))
    assert (got[0], got[2]) == (0, 2)
    assert "cannot be sent" in got[1].reason


def test_a_result_that_cannot_be_read_is_a_failure_of_its_task():
    got = dict(run_tasks([0, 1, 2], unreadable, workers=1))
    assert (got[0], got[2]) == (0, 2)
    assert got[1].reason == "ValueError: one is refused"
    assert got[1].kind == "exception"


def test_runs_catches_every_exception_in_one_place():
    broad = []
    for path in (ROOT / "bidexdata" / "runs").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ExceptHandler):
                caught = ast.unparse(node.type) if node.type else "Exception"
                broad += [path.name] * bool(re.search(r"\b(Base)?Exception\b", caught))
    assert broad == ["boundary.py"]


def test_a_task_past_its_time_is_ended():
    start = time.monotonic()
    got = dict(run_tasks([0, 1, 2], sleepy, workers=2, timeout=2.0))
    assert (got[0], got[2]) == (0, 2)
    assert got[1].kind == "timeout"
    assert time.monotonic() - start < 30


def test_workers_are_single_threaded_and_the_parent_keeps_its_environment():
    before = dict(os.environ)
    ((_, seen),) = run_tasks([0], threads, workers=1)
    assert set(seen.values()) == {"1"}
    assert dict(os.environ) == before


def test_unknown_executors_and_worker_counts_are_refused():
    with pytest.raises(UnknownName, match="processes, inline, ray"):
        run_tasks([1], square, executor="threads")
    with pytest.raises(NotUsable, match="workers -1"):
        run_tasks([1], square, workers=-1)


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    # A zombie whose parent has not read its status is not running.
    return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"


def _wait_until(condition, seconds: float = 30.0) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.05)
    return False


def _started_workers(folder: Path, number: int) -> list[int]:
    assert _wait_until(lambda: len(list(folder.iterdir())) == number)
    return [int(p.name.split("-")[1]) for p in folder.iterdir()]


def test_leaving_the_iterator_ends_the_workers():
    others = {child.pid for child in multiprocessing.active_children()}
    results = run_tasks([0, 1, 2], sleepy, workers=2)
    next(results)
    pids = [c.pid for c in multiprocessing.active_children() if c.pid not in others]
    assert len(pids) == 2
    results.close()
    assert not any(map(_alive, pids))


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_nothing_is_left_running_when_the_parent_ends(tmp_path: Path, how: signal.Signals):
    script = tmp_path / "script.py"
    folder = tmp_path / "pids"
    folder.mkdir()
    script.write_text(
        "import sys, os, time\n"
        "from functools import partial\n"
        "from pathlib import Path\n"
        "from bidexdata.runs.executors import run_tasks\n"
        "def work(folder, n):\n"
        "    (folder / f'{n}-{os.getpid()}').touch()\n"
        "    time.sleep(60)\n"
        "if __name__ == '__main__':\n"
        f"    list(run_tasks([0, 1], partial(work, Path({str(folder)!r})), workers=2))\n"
    )
    parent = subprocess.Popen([sys.executable, script], stderr=subprocess.DEVNULL, env=WITH_PACKAGE)
    pids = _started_workers(folder, 2)
    parent.send_signal(how)
    parent.wait(30)
    assert _wait_until(lambda: not any(map(_alive, pids)))


def test_a_script_without_main_guard_gets_a_sentence(tmp_path: Path):
    script = tmp_path / "script.py"
    script.write_text(
        "from bidexdata.runs.executors import run_tasks\n"
        "def work(n):\n    return n\n"
        "list(run_tasks([0], work, workers=1))\n"
    )
    done = subprocess.run(
        [sys.executable, script],
        check=False,
        capture_output=True,
        text=True,
        timeout=60,
        env=WITH_PACKAGE,
    )
    assert done.returncode != 0
    assert "__main__" in done.stderr.splitlines()[-1]


@pytest.mark.slow
def test_ray_gives_the_same_results_and_failures():
    pytest.importorskip("ray")
    work = partial(misbehave)  # as stages give: Ray itself takes functions only
    got = dict(run_tasks(list(range(5)), work, executor="ray", workers=2))
    assert got[0] == 0
    assert got[1].reason == "ValueError: one is refused"
    assert {got[n].kind for n in (2, 3, 4)} == {"died"}


def test_tasks_that_cannot_be_read_by_the_worker_are_refused_at_once():
    with pytest.raises((AttributeError, TypeError, NotUsable)):
        list(run_tasks([0], lambda n: n, workers=1))
