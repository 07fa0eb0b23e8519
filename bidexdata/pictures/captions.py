"""Words about a grasp for people: what it is, what became of it, why."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from bidexdata.objects.prepared import Solid
from bidexdata.objects.sources.item import UNKNOWN
from bidexdata.pictures.sheet import Caption
from bidexdata.record import GraspBatch, Status
from bidexdata.record.fields import DIRECTIONS
from bidexdata.record.status import TestStage, sentence_at
from bidexdata.wording import counted


def grasp_caption(tested: Mapping[str, GraspBatch], row: int) -> Caption:
    """Object, size, grasp and one line per verdict of one row.

    Args:
        tested: The same rows with the verdict columns of each test, at least one; synthesis and
            verdict columns are used where present.
        row: Which row.
    """
    batch = next(iter(tested.values()))
    head = f"{batch['object_id'][row]}  {batch['size_mm'][row]} mm"
    grasp = f"grasp {batch['grasp_id'][row]}"
    if "selected" in batch and not batch["selected"][row]:
        grasp += "  (audit)"
    said = verdicts_words(tested, row)
    return Caption(head, (grasp, *said), tuple(said.values()))


def verdicts_words(tested: Mapping[str, GraspBatch], row: int) -> dict[str, bool | None]:
    """Say what became of a row in each test; an attempt that failed before any is said once."""
    return dict(verdict_words(rows, row, test=test) for test, rows in tested.items())


def verdict_words(batch: GraspBatch, row: int, *, test: str = "f") -> tuple[str, bool | None]:
    """Say what became of a row: a sentence, and passed, failed or (None) not tested."""
    if "synth_status" in batch:
        made = Status(int(batch["synth_status"][row]))
        if made != Status.OK:
            return f"{made.label}: {made.sentence}", False
    if "verdict_status" not in batch:
        return "not validated", None
    number = int(batch["verdict_status"][row])
    if number < 0 or number == Status.NOT_RUN:
        return f"not validated by test {test}", None
    direction = int(batch["direction"][row]) if "direction" in batch else -1
    status = Status.OK if bool(batch["success"][row]) else Status(number)
    stage = int(batch["failed_stage"][row]) if "failed_stage" in batch else TestStage.NONE
    return outcome_words(test, status, direction, stage), status is Status.OK


def outcome_words(
    test: str, status: Status, direction: int = -1, failed_stage: int = TestStage.NONE
) -> str:
    """Say how a test ended.

    Args:
        test: Its name.
        status: The verdict.
        direction: First failing load, a place in `DIRECTIONS`; any other number means none.
        failed_stage: A `TestStage`.
    """
    if status is Status.OK:
        return f"passes test {test}"
    # What had gone wrong before any load fails under each: the first one says nothing.
    says = 0 <= direction < len(DIRECTIONS) and status not in (Status.NO_CONTACT, Status.THROWN)
    load = f" (load {DIRECTIONS[direction]})" if says else ""
    return f"fails test {test}{load}: {sentence_at(status, failed_stage)}"


def failure_place(failed_stage: int, direction: int, time: float) -> str:
    """Say where in a test a grasp failed, in brackets after a blank; empty where it did not.

    Args:
        failed_stage: A `TestStage`.
        direction: First failing load, a place in `DIRECTIONS`; any other number means none.
        time: Simulated since that stage began [s].

    >>> failure_place(3, 2, 0.4)
    ' (hold in load +y, after 0.40 s)'
    """
    if failed_stage < 0:
        return ""
    load = f" in load {DIRECTIONS[direction]}" if 0 <= direction < len(DIRECTIONS) else ""
    return f" ({TestStage(failed_stage).label}{load}, after {time:.2f} s)"


def object_caption(solid: Solid) -> Caption:
    """Name, pieces and repair of one object."""
    known = solid.provenance
    made = [
        counted(len(solid.pieces), "convex piece"),
        *([str(known["piece_method"])] if known.get("piece_method") else []),
        f"licence {known.get('licence') or UNKNOWN}",
    ]
    return Caption(solid.object_id, (" · ".join(made), foremost(known.get("warnings") or ())))


_FIRST = ("the repair is up to", "the convex pieces have", "replaced by its hull")
"""How the warnings begin whose solid is another shape than the file, the most important first."""
_SHARE_UNSAID = 0.5
"""Where a warning without a share comes among those with one [%]."""


def foremost(warnings: Sequence[str]) -> str:
    """The warning that a picture of the object needs most; empty where none says anything.

    First what makes the solid another shape than the file, then the largest share. A share that
    rounds to nothing is left out.

    >>> foremost(["2 holes closed, at most 0.0% of a component's area"])
    ''
    >>> foremost(["far from its origin", "open parts with 2.1% of the area dropped"])
    'open parts with 2.1% of the area dropped'
    """

    def place(text: str) -> tuple[int, float]:
        first = next((k for k, begin in enumerate(_FIRST) if text.startswith(begin)), len(_FIRST))
        return first, -_share(text)

    told = [str(w) for w in warnings if _share(str(w)) > 0]
    return min(told, key=place, default="")


def _share(text: str) -> float:
    """The first percentage in a warning."""
    found = re.search(r"(\d+(?:\.\d+)?) ?%", text)
    return float(found[1]) if found else _SHARE_UNSAID
