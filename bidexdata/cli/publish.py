"""`bidexdata publish`: a release goes to a repository of the hub."""

from __future__ import annotations

from typing import Annotated

import typer

from bidexdata.cli import options
from bidexdata.cli.report import command, finish
from bidexdata.cli.rewritten import Source
from bidexdata.wording import counted


def publish(
    release: Source,
    repo: Annotated[
        str, typer.Option(metavar="OWNER/NAME", help="Repository on Hugging Face's hub.")
    ],
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Verify and list the files; upload nothing.")
    ] = False,
    private: Annotated[
        bool, typer.Option("--private", help="A new repository is private.")
    ] = False,
    full: Annotated[
        bool, typer.Option("--full", help="Verify as `verify --full` does before the upload.")
    ] = False,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Upload a release as one commit of a data set repository.

    It is verified first, and a release that contradicts its manifest (exit code 4) or that holds
    meshes of unknown licence (3) is not uploaded. Log in once with `hf auth login`.

    --json keys: release, repo, dry_run, commit, bytes, files (a list of name, bytes).
    """
    from bidexdata.runs.publish import publish_release
    from bidexdata.runs.resimulate import resimulate

    report = publish_release(
        release,
        repo,
        dry_run=dry_run,
        private=private,
        full=full,
        resimulate=resimulate if full else None,
    )
    data = {
        "release": str(report.path),
        "repo": repo,
        "dry_run": report.dry_run,
        "commit": report.commit,
        "bytes": report.bytes,
        "files": [f._asdict() for f in report.files],
    }
    total = f"{counted(len(report.files), 'file')}, {report.bytes} bytes"
    lines = [f"{f.bytes:>12}  {f.name}" for f in report.files] if report.dry_run else []
    lines.append(
        f"would upload {total} to {repo}" if dry_run else f"uploaded {total}: {report.commit}"
    )
    again = ("--private",) * private + ("--full",) * full
    following = command("publish", release, "--repo", repo, *again) if dry_run else ""
    finish(data, lines, following=following, as_json=as_json, quiet=quiet)
