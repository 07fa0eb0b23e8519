"""Words about a grasp for people: what it is, what became of it, why."""

from __future__ import annotations

from bidexdata.objects.prepared import Solid
from bidexdata.pictures.sheet import Caption
from bidexdata.record import GraspBatch, Status


def grasp_caption(batch: GraspBatch, row: int, *, test: str = "f") -> Caption:
    """Object, size, grasp and verdict of one row.

    Args:
        batch: With identity columns; synthesis and verdict columns are used where present.
        row: Which row.
        test: Name of the test that the verdict columns are of.
    """
    head = f"{batch['object_id'][row]}  {batch['size_mm'][row]} mm"
    grasp = f"grasp {batch['grasp_id'][row]}"
    if "selected" in batch and not batch["selected"][row]:
        grasp += "  (audit)"
    words, good = verdict_words(batch, row, test=test)
    return Caption(head, (grasp, words), good)


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
        return "not validated", None
    verdict = Status(number)
    if bool(batch["success"][row]):
        return f"passes test {test}", True
    where = _direction(batch, row)
    return f"fails test {test}{where}: {verdict.sentence}", False


def _direction(batch: GraspBatch, row: int) -> str:
    number = int(batch["direction"][row]) if "direction" in batch else -1
    names = ("+x", "-x", "+y", "-y", "+z", "-z")
    return f" (load {names[number]})" if 0 <= number < len(names) else ""


def object_caption(solid: Solid) -> Caption:
    """Name, pieces and repair of one object."""
    known = solid.provenance
    pieces = f"{len(solid.pieces)} convex piece{'s' if len(solid.pieces) != 1 else ''}"
    made = [pieces, *(str(known[k]) for k in ("piece_method", "licence") if known.get(k))]
    warnings = known.get("warnings") or ()
    lines = (" · ".join(made), str(warnings[0]) if warnings else "")
    return Caption(solid.object_id, lines)
