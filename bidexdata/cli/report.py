"""How a command ends: a JSON object, or lines for a person with the next command last."""

from __future__ import annotations

import itertools
import json
import shlex
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bidexdata.wording import counted, listed

if TYPE_CHECKING:
    from bidexdata.record import GraspBatch
    from bidexdata.runs.stage import StageReport


_WIDEST = 57
"""Longest cell that widens its column: an object id at its longest. Lists of a configuration, which
may fill several lines, do not."""


def finish(
    data: Mapping[str, Any],
    lines: Iterable[str],
    *,
    following: str = "",
    as_json: bool = False,
    quiet: bool = False,
) -> None:
    """Print the result of a command on standard output.

    Args:
        data: What `--json` prints, besides `next`.
        lines: What a person reads.
        following: The command that comes next.
        as_json: Print JSON instead of lines.
        quiet: Print no lines.
    """
    if as_json:
        print(json.dumps({**data, **({"next": following} if following else {})}, default=str))
        return
    if quiet:
        return
    for line in lines:
        print(line)
    if following:
        print(f"next: {following}")


def command(*parts: str | Path) -> str:
    """Spell a bidexdata command so that it can be pasted into a shell."""
    return shlex.join(["bidexdata", *(str(p) for p in parts)])


def free_name(name: str) -> str:
    """A folder to suggest: `name`, or the first of `name-2`, `name-3` ... that is not there."""
    others = (f"{name}-{number}" for number in itertools.count(2))
    return next(n for n in itertools.chain([name], others) if not Path(n).exists())


def validate_again(run: str | Path, protocol: str, rig: str = "") -> str:
    """The command that gives a run its verdicts of a protocol that it has some of.

    Args:
        run: The run.
        protocol: Which.
        rig: Whose arms, where that must be said.
    """
    from bidexdata.runs.chosen import DEFAULT_PROTOCOL
    from bidexdata.validation.protocols import WARP_SUFFIX

    base = protocol.removesuffix(WARP_SUFFIX)
    named = () if base == DEFAULT_PROTOCOL else ("--protocol", base)
    engine = () if base == protocol else ("--backend", "mujoco_warp")
    return command("validate", run, *named, *engine, *(("--rig", rig) if rig else ()))


def warn(text: str) -> None:
    """Print a line on standard error."""
    print(text, file=sys.stderr)


def warn_of_failed(report: StageReport, run: Path) -> None:
    """Say on standard error how many tasks failed, why the first did, and what to do."""
    if report.failures:
        warn(
            f"{len(report.failures)} of {counted(report.tasks, 'task')} failed "
            f"(first: {report.failures[0].reason}); "
            f"{run / 'logs'} has the details, and the same command tries them again"
        )


def refuse_nothing(now: int, batches: Iterable[GraspBatch], column: str, sentence: str) -> None:
    """End the command with exit code 6 unless some row is a success.

    Rows of earlier calls count too: the exit code must not depend on how often one asks.

    Args:
        now: Successes of this call; `batches` is read only when there are none.
        batches: All rows that there are.
        column: The boolean column that says success.
        sentence: What to say otherwise.

    Raises:
        NothingSucceeded: There is none.
    """
    from bidexdata.errors import NothingSucceeded

    if not now and not any(batch[column].any() for batch in batches):
        raise NothingSucceeded(sentence)


def counts_text(counts: Mapping[str, int]) -> str:
    """`12 ok, 3 no_placement`, largest first."""
    ordered = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{n} {label}" for label, n in ordered) or "none"


def earlier_text(tasks: int) -> str:
    """Say that the figures before are those of this call only, where earlier ones did tasks too."""
    return f"; {counted(tasks, 'task')} of earlier calls not counted" if tasks else ""


def no_scene_text(object_ids: Sequence[str]) -> str:
    """Say that objects have no rest pose, and name the first."""
    without = counted(len(object_ids), "object has", "objects have")
    return f"no scene: {without} no rest pose (first: {object_ids[0]})"


def no_grasp_text(scene_ids: Sequence[str]) -> str:
    """Say that scenes gave no grasp to keep, and name the first: object, size and, on a table, pose."""
    named = [_scene_words(scene_id) for scene_id in scene_ids]
    return f"no grasp kept of {counted(len(named), 'scene')}: {listed(named)}"


def _scene_words(scene_id: str) -> str:
    from bidexdata.formats.figures import size_text
    from bidexdata.record.scene import scene_parts

    object_id, size_mm, pose = scene_parts(scene_id)
    return " ".join([object_id, size_text(size_mm), *([] if pose < 0 else [f"table{pose}"])])


def percent(rate: Mapping[str, Any] | None) -> str:
    """A rate with its interval: `91.2 % (88.0-93.6, 456 of 500)`; `-` where there is none."""
    from bidexdata.record.rates import Rate

    return str(Rate(**rate)) if rate and rate["n"] else "-"


def numbers(column: list[str]) -> list[str]:
    """Move the cells of a column of whole numbers, its head too, to the right."""
    width = max(len(cell) for cell in column)
    return [cell.rjust(width) for cell in column]


def table(rows: list[list[str]]) -> list[str]:
    """Align columns; the first row is the head. What is much longer than the rest stands out."""
    widths = [
        max((len(row[i]) for row in rows if len(row[i]) <= _WIDEST), default=0)
        for i in range(len(rows[0]))
    ]
    return [
        "  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
