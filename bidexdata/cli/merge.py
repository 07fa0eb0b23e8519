"""`bidexdata merge`: several releases become one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bidexdata.cli import options
from bidexdata.cli.rewritten import NewVersion, Pictures, Target, finish_rewritten


def merge(
    releases: Annotated[
        list[Path], typer.Argument(metavar="RELEASE...", help="Two releases or more.")
    ],
    out: Target,
    name: Annotated[str, typer.Option(help="Name of the new release.")],
    version: NewVersion,
    split: Annotated[
        str | None,
        typer.Option(help="Split anew by object, category or size; kept where they agree if not."),
    ] = None,
    protocol: options.ProtocolName = None,
    seed: options.Seed = 0,
    pictures: Pictures = True,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Join releases of the same hands.

    The same grasp in two releases, or one object with two shapes, is refused and named. Where one
    release has no meshes (ids-only), the new one has none.

    --json keys: release, protocol, whole_scenes, and all figures of the card.
    """
    from bidexdata.runs.rewrite import merge_releases

    report = merge_releases(
        releases,
        out,
        name=name,
        version=version,
        split=split,
        seed=seed,
        protocol=protocol,
        pictures=pictures,
        quiet=quiet,
    )
    finish_rewritten(report, as_json=as_json, quiet=quiet)
