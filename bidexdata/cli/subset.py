"""`bidexdata subset`: the part of a release that satisfies an expression."""

from __future__ import annotations

from typing import Annotated

import typer

from bidexdata.cli import options
from bidexdata.cli.rewritten import (
    NewName,
    NewVersion,
    Pictures,
    Source,
    Target,
    finish_rewritten,
)


def subset(
    release: Source,
    out: Target,
    version: NewVersion,
    where: Annotated[
        str,
        typer.Option(
            metavar="EXPRESSION",
            help='Such as "category == \'mug\' and size_mm <= 500" or "suc_f and pd < 0.005".',
        ),
    ],
    name: NewName = None,
    pictures: Pictures = True,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Write a part of a release as a release of its own.

    An expression over objects and scenes (category, licence, source, object_id, size_mm, setting,
    split ...) keeps scenes whole. One that names columns of grasps (suc_f, pd, run ...) chooses
    rows, and what is left has no unselected rate.

    --json keys: release, protocol, whole_scenes, and all figures of the card.
    """
    from bidexdata.runs.rewrite import subset_release

    report = subset_release(
        release, out, where=where, version=version, name=name, pictures=pictures, quiet=quiet
    )
    finish_rewritten(report, as_json=as_json, quiet=quiet)
