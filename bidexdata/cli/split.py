"""`bidexdata split`: the rows of a release, split anew."""

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


def split(
    release: Source,
    out: Target,
    version: NewVersion,
    by: Annotated[
        str, typer.Option(help="object, category or size: what is never in two splits.")
    ] = "object",
    test_fraction: Annotated[
        float, typer.Option(help="Share of objects, categories or sizes that test.")
    ] = 0.2,
    name: NewName = None,
    seed: options.Seed = 0,
    pictures: Pictures = True,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Split a release anew into train and test.

    Objects of the same shape stay together, unless the split is by size.

    --json keys: release, protocol, whole_scenes, and all figures of the card.
    """
    from bidexdata.errors import BadValue
    from bidexdata.runs.rewrite import split_release

    if not 0 < test_fraction < 1:
        raise BadValue(f"--test-fraction must lie between 0 and 1, not {test_fraction}")
    report = split_release(
        release,
        out,
        by=by,
        version=version,
        name=name,
        test_fraction=test_fraction,
        seed=seed,
        pictures=pictures,
        quiet=quiet,
    )
    finish_rewritten(report, as_json=as_json, quiet=quiet)
