"""The task boundary: the one place in `runs` that catches every exception.

A task runs code that this package does not control, and whatever it raises must cost that task
alone, not the run. Inside the boundary and outside it exceptions pass as everywhere else.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from bidexdata.extras import missing_extra

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class Raised:
    """An exception that ended a task."""

    reason: str
    """One line: its type and first line."""
    details: str
    """The traceback."""


def call_task(function: Callable[[T], R], task: T) -> R | Raised:
    """Call `function(task)`; what it raises comes back as a `Raised`."""
    try:
        return function(task)
    except Exception as err:
        return Raised(describe(err), traceback.format_exc())


def describe(err: BaseException) -> str:
    """One line for an exception: its type and first line, or which package to install."""
    missing = missing_extra(err)
    if missing is not None:
        return str(missing)
    lines = str(err).strip().splitlines()
    return f"{type(err).__name__}: {lines[0]}" if lines else type(err).__name__
