"""`bidexdata migrate`: a release of an older schema under the schema of today."""

from __future__ import annotations

from bidexdata.cli import options
from bidexdata.cli.rewritten import Pictures, Source, Target, finish_rewritten


def migrate(
    release: Source,
    out: Target,
    pictures: Pictures = True,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Write a release again under the schema of this version.

    Rows, name, version and split stay; tables, card and manifest are made anew. The old release is
    only read. A release of a schema that this version does not know is refused, with the command
    that upgrades.

    --json keys: release, protocol, whole_scenes, and all figures of the card.
    """
    from bidexdata.runs.rewrite import migrate_release

    report = migrate_release(release, out, pictures=pictures, quiet=quiet)
    finish_rewritten(report, as_json=as_json, quiet=quiet)
