"""The objects of a release, written by several processes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from bidexdata.runs.executors import TaskFailure, run_tasks

if TYPE_CHECKING:
    from bidexdata.formats.object_pass import EachObject, ObjectPass, ObjectRow
    from bidexdata.objects.library import Library

CHUNK = 16
"""Objects of a task: about a second of work."""
FEW = 64
"""Objects that are done sooner here than by processes that must start first."""


class ObjectChunk(NamedTuple):
    """Some objects of one library, by their numbers in the release."""

    one: ObjectPass
    library: Path
    fingerprint: str
    """Of the library: workers keep it open."""
    objects: tuple[tuple[int, str], ...]


def in_processes(
    libraries: Mapping[str, Library], *, executor: str = "processes", workers: int = 0
) -> EachObject:
    """Do the object pass of a release in several processes, or here where there are few objects.

    Args:
        libraries: object_id -> the library that has it.
        executor: As of `run_tasks`.
        workers: As of `run_tasks`.
    """

    def here(
        one: ObjectPass, objects: Iterable[tuple[int, str]]
    ) -> Iterable[tuple[str, ObjectRow]]:
        for number, object_id in objects:
            yield object_id, one.write(number, *libraries[object_id].load_shape(object_id))

    def each(one: ObjectPass, ids: Sequence[str]) -> Iterable[tuple[str, ObjectRow]]:
        if len(ids) < FEW:
            yield from here(one, enumerate(ids))
            return
        tasks = _chunks(one, ids, libraries)
        for task, done in run_tasks(tasks, write_chunk, executor=executor, workers=workers):
            # Once more here: what is wrong with an object is said by its own exception.
            yield from here(one, task.objects) if isinstance(done, TaskFailure) else done

    return each


def write_chunk(chunk: ObjectChunk) -> list[tuple[str, ObjectRow]]:
    """Write the files and clouds of some objects; give their rows."""
    library = _library(chunk.library, chunk.fingerprint)
    return [(i, chunk.one.write(number, *library.load_shape(i))) for number, i in chunk.objects]


def _chunks(
    one: ObjectPass, ids: Sequence[str], libraries: Mapping[str, Library]
) -> list[ObjectChunk]:
    owned: dict[tuple[Path, str], list[tuple[int, str]]] = {}
    each = {id(library): library for library in libraries.values()}.values()
    known = {library.path: library.fingerprint for library in each}
    for number, object_id in enumerate(ids):
        path = libraries[object_id].path
        owned.setdefault((path, known[path]), []).append((number, object_id))
    return [
        ObjectChunk(one, path, print_, tuple(objects[at : at + CHUNK]))
        for (path, print_), objects in owned.items()
        for at in range(0, len(objects), CHUNK)
    ]


@lru_cache(maxsize=2)
def _library(path: Path, fingerprint: str) -> Library:
    from bidexdata.objects.library import Library

    library = Library.open(path)
    assert library.fingerprint == fingerprint, "the library changed while it was read"
    return library
