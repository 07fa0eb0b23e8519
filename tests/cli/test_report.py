"""How commands end: what failed is said once, and nothing made is nothing however often one asks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bidexdata.cli.report import refuse_nothing, warn_of_failed
from bidexdata.errors import NothingSucceeded
from bidexdata.runs.executors import TaskFailure
from bidexdata.runs.stage import StageReport


def test_failed_tasks_are_counted_with_the_first_reason_and_what_to_do(capsys):
    failures = (TaskFailure(None, "ValueError: bad"), TaskFailure(None, "died"))
    warn_of_failed(StageReport(tasks=5, before=1, failures=failures), Path("here/run"))
    said = capsys.readouterr().err
    assert said.startswith("2 of 5 tasks failed (first: ValueError: bad); here/run/logs has")
    assert len(said.splitlines()) == 1
    warn_of_failed(StageReport(tasks=5, before=1), Path("here/run"))
    assert capsys.readouterr().err == ""


def rows(*success: bool) -> list[dict[str, np.ndarray]]:
    return [{"success": np.array([one])} for one in success]


def test_a_success_of_this_call_or_an_earlier_one_is_enough():
    refuse_nothing(1, rows(), "success", "none")
    refuse_nothing(0, rows(False, True), "success", "none")
    for found in (rows(), rows(False, False)):
        with pytest.raises(NothingSucceeded, match="none") as caught:
            refuse_nothing(0, found, "success", "none")
        assert caught.value.exit_code == 6


def test_rows_are_not_read_when_this_call_had_a_success():
    def unread():
        pytest.fail("the rows were read")
        yield

    refuse_nothing(1, unread(), "success", "none")
