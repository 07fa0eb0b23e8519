"""Work in one thread beside the caller's, in order, with few jobs waiting.

Compressing, hashing and summing release the interpreter's lock, so rows can be read meanwhile.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from typing import Any

MOST_WAITING = 2
"""Jobs that wait; each holds a row group, some 10 MB."""


class Background:
    """A thread that does jobs one after the other.

    State: the thread, its queue, and the first exception of a job, which ends the work.
    """

    def __init__(self) -> None:
        self._queue: queue.Queue[Callable[[], Any] | None] = queue.Queue(MOST_WAITING)
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def do(self, job: Callable[[], Any]) -> None:
        """Have a job done after those before; raises what one of them raised."""
        self._raise()
        self._queue.put(job)

    def close(self) -> None:
        """Wait for all jobs; raises what one of them raised."""
        self.stop()
        self._raise()

    def stop(self) -> None:
        """Wait for all jobs, whatever became of them."""
        if self._thread.is_alive():
            self._queue.put(None)
            self._thread.join()

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    def _work(self) -> None:
        while (job := self._queue.get()) is not None:
            if self._error is not None:
                continue  # empty the queue, so that nobody waits for room in it
            try:
                job()
            except BaseException as err:
                self._error = err
