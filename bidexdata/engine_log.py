"""Where MuJoCo's own warnings go: to `logging`, not to a MUJOCO_LOG.TXT in the working folder."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

_log = logging.getLogger(__name__)


@contextmanager
def engine_warnings_logged() -> Iterator[None]:
    """Send warnings of the engine to this module's logger while the block runs.

    The engine has one handler per process; the one found is put back. Callers read what happened
    from `MjData.warning`, not from the log.
    """
    import mujoco

    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda text: _log.debug("MuJoCo: %s", text))
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)
