"""The work of one task of `prepare`: one input becomes a folder, within limits."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from bidexdata.objects.config import PrepareConfig
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.library import object_folder
from bidexdata.objects.prepare import check_selected, prepare_object
from bidexdata.objects.prepared import PreparedObject
from bidexdata.objects.sources import SourceItem
from bidexdata.objects.storage import write_object
from bidexdata.record.status import Status
from bidexdata.runs.left_out import reason_row
from bidexdata.runs.library_report import Taken
from bidexdata.runs.object_folders import made_columns
from bidexdata.runs.prepare_folder import prepare_identity
from bidexdata.runs.prepare_kernels import load_kernels
from bidexdata.runs.prepare_parts import Row
from bidexdata.runs.thumbnails import THUMBNAIL, thumbnail
from bidexdata.runs.worker_limits import cpu_used, limit_memory, limited_cpu

R = TypeVar("R")
TAKEN = "taken"
"""Key of a task's result that goes into no index: how long it took."""


@dataclass(frozen=True, slots=True)
class PrepareTask:
    """One input that has to be prepared: all that its worker needs."""

    item: SourceItem
    object_id: str
    sha256: str
    library: Path
    config: PrepareConfig
    content: str = ""
    """What its folder hashes to by the index of an earlier call, if there is one."""

    @property
    def folder(self) -> Path:
        """Where the object goes."""
        return self.library / object_folder(self.object_id)


def made(task: PrepareTask) -> Row | None:
    """Columns of the object's folder; None where it has to be made."""
    return made_columns(task.folder, task.sha256, content=task.content)


def prepare_one(task: PrepareTask) -> Row:
    """Prepare one input and write its folder: the work of a task.

    Returns:
        The columns that are known here: status and reason, empty when everything succeeded.
    """
    started, (own, search) = time.monotonic(), cpu_used()
    found, row = _within_limits(task, _made_and_drawn)
    if found is not None and made(task) is None:  # else it was made by another machine, meanwhile
        obj, picture = found
        write_object(task.folder, obj, prepare_identity(task.config), {THUMBNAIL: picture})
    cpu = cpu_used()
    return {**row, TAKEN: Taken(time.monotonic() - started, cpu[0] - own, cpu[1] - search)}


def _made_and_drawn(item: SourceItem, config: PrepareConfig) -> tuple[PreparedObject, bytes]:
    obj = prepare_object(item, config)
    return obj, thumbnail(obj)


def checked_one(task: PrepareTask) -> Row:
    """Find out what the selection says of one input, and write nothing."""
    return _within_limits(task, check_selected)[1]


def _within_limits(
    task: PrepareTask, work: Callable[[SourceItem, PrepareConfig], R]
) -> tuple[R | None, Row]:
    """What `work` makes of an input, and the columns that say why there is nothing."""
    limits = task.config.limits
    limit_memory(limits.memory_gib)
    load_kernels()
    try:
        with limited_cpu(limits.cpu_seconds):
            return work(task.item, task.config), {}
    except PrepareFailure as failure:
        return None, reason_row(failure.status, failure.reason)
    except MemoryError:
        bound = f"needs more than limits.memory_gib = {limits.memory_gib:g} GiB"
        return None, reason_row(Status.TOO_COMPLEX, bound)
