"""A pool of spawned worker processes in which a death costs only the task that died.

`concurrent.futures` gives up the whole pool when one worker dies; here every worker has its own
pipe, holds at most one task, and is replaced when it dies. Workers are single-threaded, leave
Ctrl-C to the parent, and end by themselves when the parent is gone.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection, wait
from typing import Any, Literal, NamedTuple

from bidexdata.errors import NotUsable
from bidexdata.runs.boundary import Raised, call_task

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
"""Environment that native libraries read when they load, hence set before a worker starts."""
GRACE = 2.0
"""How long a worker has to end after SIGTERM before it is killed [s]."""


def usable_cores() -> int:
    """Number of cores this process may run on."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on this platform
        return os.cpu_count() or 1


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of task `number`."""

    number: int
    kind: Literal["done", "exception", "died", "timeout"]
    value: Any = None
    reason: str = ""
    details: str = ""
    signal: str = ""
    """Name of the signal that the worker died of."""


class _Death(NamedTuple):
    """How a worker died."""

    reason: str
    signal: str = ""


class _Worker:
    """One process, the parent's end of its pipe, and the task that it holds."""

    def __init__(self, context: Any, work: bytes):
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, work), daemon=True)
        with _single_threaded_environment():
            self.process.start()
        theirs.close()  # else a dead worker's pipe would never read as closed
        self.task: int | None = None
        self.ready = False
        self.since = 0.0

    def give(self, number: int, payload: bytes) -> None:
        self.task, self.since = number, time.monotonic()
        # A worker that died just now cannot take it; the sentinel reports the death.
        with contextlib.suppress(OSError):
            self.pipe.send((number, payload))

    def end(self) -> None:
        self.pipe.close()
        if self.process.is_alive():
            self.process.terminate()
        self.process.join(GRACE)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()

    def death(self) -> _Death:
        self.process.join(GRACE)
        code = self.process.exitcode
        if code is not None and code < 0:
            try:
                name = signal.Signals(-code).name
            except ValueError:
                return _Death(f"the worker died (signal {-code})")
            return _Death(f"the worker died ({name})", name)
        return _Death(f"the worker died (exit code {code})")


class WorkerPool:
    """Workers that all run one function; use as a context manager."""

    def __init__(self, work: Callable[[Any], Any], workers: int, timeout: float | None = None):
        self._work = pickle.dumps(work)
        self._number = workers
        self._timeout = timeout
        self._context = multiprocessing.get_context("spawn")
        self._workers: list[_Worker] = []

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            if worker.process.is_alive():
                worker.process.terminate()
        for worker in self._workers:
            worker.end()

    def run(self, tasks: Sequence[Any]) -> Iterator[Outcome]:
        """Yield one outcome per task, in completion order."""
        waiting = deque(range(len(tasks)))
        left = len(tasks)
        while left:
            while len(self._workers) < min(self._number, left):
                self._workers.append(_Worker(self._context, self._work))
            self._feed(waiting, tasks)
            outcomes = self._collect()
            left -= len(outcomes)
            self._feed(waiting, tasks)  # before the consumer takes its time
            yield from outcomes

    def _feed(self, waiting: deque[int], tasks: Sequence[Any]) -> None:
        for worker in self._workers:
            if worker.ready and worker.task is None and waiting:
                number = waiting.popleft()
                worker.give(number, pickle.dumps(tasks[number]))

    def _collect(self) -> list[Outcome]:
        handles = {w.pipe: w for w in self._workers} | {
            w.process.sentinel: w for w in self._workers
        }
        patience = None if self._timeout is None else min(1.0, self._timeout / 4)
        signalled = {id(handles[h]): handles[h] for h in wait(list(handles), timeout=patience)}
        found = []
        for worker in signalled.values():
            found += self._hear(worker)
        if self._timeout is not None:
            found += self._overdue(self._timeout)
        return found

    def _hear(self, worker: _Worker) -> list[Outcome]:
        """Read what a worker sent; a closed pipe means that it died."""
        found = []
        try:
            while worker.pipe.poll():
                kind, body = worker.pipe.recv()
                if kind == "ready":
                    worker.ready = True
                elif kind == "broken":
                    raise NotUsable(f"a worker process cannot run the task function: {body}")
                else:
                    found.append(_outcome(*body))
                    worker.task = None
        except (EOFError, OSError, pickle.UnpicklingError):
            found += self._bury(worker)
            return found
        if not worker.process.is_alive() and not worker.pipe.poll():
            found += self._bury(worker)
        return found

    def _bury(self, worker: _Worker) -> list[Outcome]:
        death = worker.death()
        worker.end()
        self._workers.remove(worker)
        if not worker.ready:
            raise NotUsable(
                f"a worker process could not start ({death.reason}); a script that starts workers needs "
                'an `if __name__ == "__main__":` line around its calls, or executor="inline"'
            )
        if worker.task is None:
            return []
        return [Outcome(worker.task, "died", reason=death.reason, signal=death.signal)]

    def _overdue(self, timeout: float) -> list[Outcome]:
        found = []
        for worker in list(self._workers):
            if worker.task is not None and time.monotonic() - worker.since > timeout:
                worker.end()
                self._workers.remove(worker)
                reason = f"took longer than {timeout:g} s"
                found.append(Outcome(worker.task, "timeout", reason=reason))
        return found


def _serve(pipe: Connection, pickled_work: bytes) -> None:
    """The life of a worker process: take a task, answer, until the parent closes the pipe."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent acts
    threading.Thread(target=_end_with_parent, daemon=True).start()
    work = call_task(_unpickle, pickled_work)  # imports the caller's module, which may raise
    if isinstance(work, Raised):
        pipe.send(("broken", work.reason))
        return
    _single_threaded_torch()
    pipe.send(("ready", None))
    while True:
        try:
            number, payload = pipe.recv()
        except (EOFError, OSError):
            return
        answer = _answer(work, payload)
        try:
            pipe.send(("answer", (number, answer)))
        except OSError:  # the parent is gone
            return


def _answer(work: Callable[[Any], Any], payload: bytes) -> bytes | Raised:
    """Do one task; its value is pickled here, so that nothing of it can break the pipe."""
    value = call_task(lambda task: work(_unpickle(task)), payload)
    if isinstance(value, Raised):
        return value
    pickled = call_task(pickle.dumps, value)
    if isinstance(pickled, Raised):
        return replace(pickled, reason=f"the result cannot be sent: {pickled.reason}")
    return pickled


def _outcome(number: int, answer: bytes | Raised) -> Outcome:
    value = answer if isinstance(answer, Raised) else call_task(_unpickle, answer)
    if isinstance(value, Raised):
        return Outcome(number, "exception", reason=value.reason, details=value.details)
    return Outcome(number, "done", value)


def _unpickle(data: bytes) -> Any:
    return pickle.loads(data)  # noqa: S301 - sent by the other end of our own pipe


def _end_with_parent() -> None:
    # A killed parent cannot say goodbye; nothing may be left running.
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


def _single_threaded_torch() -> None:
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


@contextlib.contextmanager
def _single_threaded_environment() -> Iterator[None]:
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
