"""Laws of a stage: done tasks are left alone, a failed one leaves nothing and is tried again."""

from __future__ import annotations

import io
from functools import partial
from pathlib import Path

import pytest

from bidexdata.runs.plan import Task
from bidexdata.runs.progress import Progress
from bidexdata.runs.shards import done_tasks, shard_path, write_text
from bidexdata.runs.stage import TaskExecution, TaskSummary, run_stage

TASKS = [Task(f"{k:02x}{k:014x}", f"o{k}", (f"o{k}/300/float",), 0) for k in range(5)]


def work(folder: Path, bad: frozenset[str], task: Task) -> TaskSummary:
    if task.object_id in bad:
        raise RuntimeError(f"{task.object_id} is bad")
    write_text(shard_path(folder, task.task_id), task.object_id)
    return TaskSummary(2, 1, {"ok": 1, "no_placement": 1}, task.scene_ids)


def stage(folder: Path, bad: set[str], executor: str = "inline"):
    return run_stage(
        TASKS,
        done_tasks(folder / "synth"),
        partial(work, folder / "synth", frozenset(bad)),
        unit="task",
        logs=folder / "logs",
        execution=TaskExecution(executor=executor, workers=2, quiet=True),
    )


@pytest.mark.parametrize("executor", ["inline", "processes"])
def test_a_failed_task_is_reported_logged_and_tried_again(tmp_path: Path, executor: str):
    first = stage(tmp_path, {"o1", "o3"}, executor)
    assert {f.task.object_id: f.reason for f in first.failures} == {
        "o1": "RuntimeError: o1 is bad",
        "o3": "RuntimeError: o3 is bad",
    }
    assert (first.tasks, first.before, first.finished) == (5, 0, 3)
    assert (first.rows, first.good, first.by_status) == (6, 3, {"ok": 3, "no_placement": 3})
    assert first.without_grasp == ("o0/300/float", "o2/300/float", "o4/300/float")
    logged = "".join(p.read_text() for p in (tmp_path / "logs").iterdir())
    assert "o3 is bad" in logged
    assert "Traceback" in logged

    second = stage(tmp_path, set(), executor)
    assert (second.before, second.finished, second.failures) == (3, 2, ())
    third = stage(tmp_path, {"o0"}, executor)
    assert (third.before, third.finished, third.failures) == (5, 0, ())


def test_progress_on_a_pipe_is_plain_lines_with_rate():
    stream = io.StringIO()
    with Progress(4, "task", already=1, stream=stream) as progress:
        for _ in range(3):
            progress.advance()
    lines = stream.getvalue().splitlines()
    assert lines[0] == "1 of 4 tasks done before"
    assert lines[-1].startswith("4 of 4 tasks (100 %), ")
    assert "tasks/s" in lines[-1]
    assert "\r" not in stream.getvalue()


def test_progress_on_a_terminal_redraws_one_line_and_quiet_says_nothing():
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    stream = Terminal()
    with Progress(2, "task", stream=stream) as progress:
        progress.advance()
        progress.write("a remark")
        progress.advance()
    assert "\r" in stream.getvalue()
    assert "a remark\n" in stream.getvalue()
    assert stream.getvalue().count("2 of 2 tasks") == 1

    silent = Terminal()
    with Progress(2, "task", quiet=True, stream=silent) as progress:
        progress.advance()
        progress.write("a remark")
    assert silent.getvalue() == ""


def test_a_command_for_some_objects_shares_out_their_tasks_alone():
    some = frozenset({"o0", "o2", "o3"})
    whole = TaskExecution(objects=some).part_of(TASKS)
    assert {t.object_id for t in whole} == some
    parts = [TaskExecution(objects=some, shard=(i, 2)).part_of(TASKS) for i in range(2)]
    assert sorted(t.task_id for part in parts for t in part) == [t.task_id for t in whole]
    assert TaskExecution().part_of(TASKS) == TASKS


def test_a_listener_hears_of_every_task_that_was_done_and_of_no_other(tmp_path: Path):
    heard: list[tuple[str, int]] = []
    for bad in ({"o1"}, set()):
        run_stage(
            TASKS,
            done_tasks(tmp_path / "synth"),
            partial(work, tmp_path / "synth", frozenset(bad)),
            unit="task",
            logs=tmp_path / "logs",
            execution=TaskExecution(executor="inline", quiet=True),
            on_task=lambda task, summary: heard.append((task.object_id, summary.rows)),
        )
    assert heard == [("o0", 2), ("o2", 2), ("o3", 2), ("o4", 2), ("o1", 2)]
