"""Objects that gave no result: the row of the index that says why, and the traceback in a log."""

from __future__ import annotations

import logging
from pathlib import Path

from bidexdata.objects.config import LimitsConfig
from bidexdata.record.status import Status
from bidexdata.runs.executors import TaskFailure
from bidexdata.runs.left_out import reason_row
from bidexdata.runs.logs import log_to
from bidexdata.runs.prepare_parts import Row
from bidexdata.runs.worker_limits import CPU_SIGNAL

_RAISED = "making the object ended in an unexpected error, whose traceback is in the logs"


def failure_row(failure: TaskFailure, limits: LimitsConfig | None = None) -> Row:
    """The columns of the index that say why a task gave no object.

    Args:
        failure: Of the task.
        limits: That its worker had, where it had any.
    """
    if limits is not None and failure.kind == "timeout":
        return reason_row(Status.TIMED_OUT, f"took longer than {limits.wall_seconds:g} s")
    if limits is not None and failure.signal == CPU_SIGNAL:
        bound = f"limits.cpu_seconds = {limits.cpu_seconds:g} CPU s used up"
        return reason_row(Status.TOO_COMPLEX, f"{bound}: decimate the mesh")
    raised = failure.kind == "exception"
    return reason_row(Status.CRASHED, failure.reason, _RAISED if raised else "")


def log_raised(object_id: str, failure: TaskFailure, logs: Path | None) -> None:
    """Log an exception with its traceback.

    Args:
        object_id: Whose it was.
        failure: Of the task.
        logs: Folder of the log; None: wherever this process logs to.
    """
    if logs is not None:
        log_to(logs)
    logger = logging.getLogger(__name__)
    logger.error("object %s: %s\n%s", object_id, failure.reason, failure.details)
