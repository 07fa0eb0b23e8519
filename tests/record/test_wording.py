"""A number has its noun in the right form, wherever a command says one."""

import doctest
import io
import re
from pathlib import Path

import pytest

from bidexdata import wording
from bidexdata.runs.progress import Progress
from bidexdata.wording import counted, duration

PACKAGE = Path(wording.__file__).parent
NOUNS = "task|row|object|grasp|input|file|scene|picture|column|attempt|piece"


@pytest.mark.parametrize("n", [0, 1, 2, 11, 21, 1000])
def test_one_is_singular_and_all_else_plural(n):
    assert counted(n, "row") == f"{n} row{'' if n == 1 else 's'}"
    assert counted(n, "task is", "tasks are") == f"{n} {'task is' if n == 1 else 'tasks are'}"
    assert doctest.testmod(wording).failed == 0


@pytest.mark.parametrize("total", [1, 2])
def test_progress_counts_in_the_right_form(total):
    stream = io.StringIO()
    with Progress(total, "file read", already=1, stream=stream) as progress:
        assert progress.text().startswith(f"1 of {counted(total, 'file')} read (")
    assert f"1 of {counted(total, 'file')} read done before" in stream.getvalue()


def test_no_command_writes_a_plural_behind_a_number_by_hand():
    by_hand = re.compile(r"\{[^{}]*\} (?:" + NOUNS + r")s\b")
    for path in sorted((PACKAGE / "cli").glob("*.py")):
        assert not by_hand.findall(path.read_text("utf-8")), path.name


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(59.7, "1 min 0 s"), (119.8, "2 min 0 s"), (3.2, "3 s"), (7199.0, "1 h 59 min")],
)
def test_no_minute_has_sixty_seconds(seconds, text):
    assert duration(seconds) == text
