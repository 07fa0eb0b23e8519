"""Parts of a library: what several machines that prepare one folder leave for each other.

There is no server. A part writes the folders of its objects and, when it is through, one file with
the reasons of its failures. An input is settled when its object is there or somebody has said why
not; the part that finds every input settled writes the index, as a single run would, and removes
these files. A part that is done twice, or by two machines, does no harm.
"""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bidexdata.config import canonical_json, fingerprint
from bidexdata.errors import BidexError, Contradiction
from bidexdata.kinds import PARTS
from bidexdata.objects.library import ASKED, Library
from bidexdata.record.status import Status
from bidexdata.runs.shards import write_text

Row = dict[str, Any]
Failure = Mapping[str, Any]
"""The columns of the index that say why an input gave no object."""

_COLUMNS = ("status", "status_label", "reason")
_NOT_OF_ITSELF = (Status.OK, Status.DUPLICATE, Status.NEAR_DUPLICATE)
"""Statuses that are no failures or that depend on the other inputs, which may be others now."""


class Parts:
    """The failures of all parts of one plan: inputs in their order, and what was asked of them."""

    def __init__(self, library: Path, rows: Sequence[Row], asked: Mapping[str, Any]):
        self._library, self._asked = library, asked
        self._inputs = [(r.get("object_id"), r.get("source_sha256")) for r in rows]
        # Parts of other inputs, another configuration or version say nothing of these.
        self._folder = library / PARTS / fingerprint([self._inputs, asked])

    def write(self, part: tuple[int, int], failures: Mapping[int, Row]) -> None:
        """Say which inputs of a part failed, by their number; an empty list says that none did."""
        path = self._folder / f"{part[0]}-of-{part[1]}.json"
        found = {str(n): _failure(row) for n, row in sorted(failures.items())}
        text = json.dumps(found, indent=1, sort_keys=True) + "\n"
        for _ in range(3):
            # Another part may have finished the library and be removing the folder right now.
            with contextlib.suppress(FileNotFoundError):
                write_text(path, text)
                return
        write_text(path, text)

    def failures(self) -> dict[int, Failure]:
        """What is known of the failures of all inputs, by their number."""
        # In this order: whoever removes the parts has written them into the index before.
        from_parts = self._from_parts()
        return {**self._from_index(), **from_parts}

    def remove(self) -> None:
        """Remove the files of all parts; the index says everything now."""
        shutil.rmtree(self._library / PARTS, ignore_errors=True)

    def _from_parts(self) -> dict[int, Failure]:
        found: dict[int, Failure] = {}
        for path in sorted(self._folder.glob("[!.]*.json")):
            try:
                rows = json.loads(path.read_text(encoding="utf-8"))
                found |= {int(n): _failure(row) for n, row in rows.items()}
            except FileNotFoundError:  # removed just now
                continue
            except (ValueError, AttributeError, KeyError, TypeError) as err:
                what = type(err).__name__
                raise Contradiction(
                    f"{path}: damaged ({what}); delete it and run that part again"
                ) from err
        return found

    def _from_index(self) -> dict[int, Failure]:
        try:
            index = Library.open(self._library).index
        except BidexError:  # none yet, or a damaged one, which is written anew
            return {}
        if (index.schema.metadata or {}).get(ASKED.encode()) != canonical_json(
            self._asked
        ).encode():
            return {}
        failed = (r for r in index.to_pylist() if r["status"] not in _NOT_OF_ITSELF)
        rows = {(r["object_id"], r["source_sha256"]): r for r in failed}
        known = ((n, rows.get(key)) for n, key in enumerate(self._inputs))
        return {n: _failure(r) for n, r in known if r is not None}


def _failure(row: Mapping[str, Any]) -> Failure:
    return {name: row[name] for name in _COLUMNS}
