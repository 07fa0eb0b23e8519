"""Read the next batches in a thread while the trainer works on this one."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterable, Iterator
from types import TracebackType
from typing import Generic, TypeVar

T = TypeVar("T")


class Prefetch(Generic[T]):
    """Iterate something in a thread, at most `depth` items ahead.

    Reading rows and clouds releases Python's lock, so a thread overlaps with training at none of
    the cost of worker processes. An exception of the source is raised where its item would have
    come. The thread ends with the source, with `close()`, and when iteration is given up.
    """

    def __init__(self, source: Iterable[T], depth: int = 2):
        if depth < 1:
            raise ValueError(f"depth must be at least 1, not {depth}")
        self.source, self.depth = source, depth
        self._passes: list[_Pass[T]] = []

    def __iter__(self) -> Iterator[T]:
        """Begin another pass over the source."""
        run = _Pass(self.source, self.depth)
        self._passes = [p for p in self._passes if p.alive] + [run]
        try:
            yield from run
        finally:
            run.close()

    def __len__(self) -> int:
        """Length of the source, where it has one."""
        return len(self.source)  # pyright: ignore[reportArgumentType]  (a TypeError says so)

    def close(self) -> None:
        """End all threads and wait for them."""
        for run in self._passes:
            run.close()
        self._passes = []

    def __enter__(self) -> Prefetch[T]:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


class _Pass(Generic[T]):
    """One pass: a thread that fills a bounded queue. Entries are (item, error, is there more)."""

    def __init__(self, source: Iterable[T], depth: int):
        self._queue: queue.Queue[tuple[T | None, BaseException | None, bool]] = queue.Queue(depth)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._fill, args=(source,), daemon=True)
        self._thread.start()

    @property
    def alive(self) -> bool:
        return self._thread.is_alive()

    def __iter__(self) -> Iterator[T]:
        while not self._stop.is_set():
            try:
                item, error, more = self._queue.get(timeout=0.1)
            except queue.Empty:
                continue
            if error is not None:
                raise error
            if not more:
                return
            yield item  # pyright: ignore[reportReturnType]  (None only where there is no more)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()

    def _fill(self, source: Iterable[T]) -> None:
        try:
            for item in source:
                if not self._put((item, None, True)):
                    return
            self._put((None, None, False))
        except BaseException as err:
            # Raised again in the thread that asks.
            self._put((None, err, False))

    def _put(self, entry: tuple[T | None, BaseException | None, bool]) -> bool:
        while not self._stop.is_set():
            try:
                self._queue.put(entry, timeout=0.1)
                return True
            except queue.Full:
                continue
        return False
