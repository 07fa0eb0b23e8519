"""Logs of a run: one file per process, so that writers never meet."""

from __future__ import annotations

import logging
import os
import socket
from pathlib import Path

_open: dict[str, logging.Handler] = {}


def log_to(folder: Path) -> logging.Logger:
    """Send this process's `bidexdata` log to `<folder>/<host>-<pid>.log` and give the logger.

    Calling it again is free; another folder replaces the first.
    """
    path = folder / f"{socket.gethostname()}-{os.getpid()}.log"
    logger = logging.getLogger("bidexdata")
    if str(path) not in _open:
        for handler in _open.values():
            logger.removeHandler(handler)
            handler.close()
        _open.clear()
        folder.mkdir(parents=True, exist_ok=True)
        handler = logging.FileHandler(path, encoding="utf-8", delay=True)
        handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
        logger.addHandler(handler)
        logger.setLevel(logging.INFO)
        _open[str(path)] = handler
    return logger
