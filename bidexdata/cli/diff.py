"""`bidexdata diff`: what differs between two releases."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bidexdata.cli import options
from bidexdata.cli.report import finish, table
from bidexdata.wording import counted

if TYPE_CHECKING:
    from bidexdata.formats.diff import ReleaseDiff, Sides

_SHOWN = 20
"""Figures that are listed; --json has all."""


def diff(
    first: Annotated[Path, typer.Argument(metavar="A", help="A release.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="The release it is compared with.")],
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Compare two releases: names, versions, columns, objects, rows by grasp_id, figures.

    Exit code 0 whether they differ or not; `same` of --json says which. Names and versions are no
    difference of content. Files are not hashed: `verify` does that.

    --json keys: same, about, columns, figures (each with a and b), objects, rows (only_a, only_b,
    both, changed, by_column, first).
    """
    from bidexdata.formats.diff import diff_releases
    from bidexdata.formats.release import Release

    found = diff_releases(Release.open(first), Release.open(second))
    finish(found.to_dict(), _lines(found), as_json=as_json, quiet=quiet)


def _lines(found: ReleaseDiff) -> list[str]:
    lines = table([["", "A", "B"], *([k, str(a), str(b)] for k, (a, b) in found.about.items())])
    for name, (mine, theirs) in found.columns.items():
        lines += [f"columns of {name} only in A: {', '.join(mine)}"] * bool(mine)
        lines += [f"columns of {name} only in B: {', '.join(theirs)}"] * bool(theirs)
    lines.append(_sides("objects", found.objects))
    lines.append(_sides("rows", found.rows))
    if found.figures:
        lines.append(f"{counted(len(found.figures), 'figure differs', 'figures differ')}:")
        shown = list(found.figures.items())[:_SHOWN]
        lines += table(
            [["  figure", "A", "B"], *([f"  {k}", str(a), str(b)] for k, (a, b) in shown)]
        )
        more = len(found.figures) - len(shown)
        lines += [f"  and {more} more (--json lists all)"] * bool(more)
    lines.append("the same content" if found.same else "not the same content")
    return lines


def _sides(noun: str, found: Sides) -> str:
    text = (
        f"{noun}: {found.both} in both, {found.changed} of them changed, {found.only_a} only in A, "
        f"{found.only_b} only in B"
    )
    columns = ", ".join(f"{name} {n}" for name, n in found.by_column.items())
    first = f" (first: {', '.join(found.first)})" if found.first else ""
    return text + (f"; changed per column: {columns}" if columns else "") + first
