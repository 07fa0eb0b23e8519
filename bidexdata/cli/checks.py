"""What `hands check` and `rigs check` have in common: where the picture goes, and how they end."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bidexdata.cli.report import finish, table
from bidexdata.wording import counted

if TYPE_CHECKING:
    from bidexdata.runs.check_hand import HandReport
    from bidexdata.runs.check_rig import RigReport

_WORDS = {True: "ok", False: "FAILED", None: "-"}


def picture_place(out: Path | None, spec: str, what: str, mounted: str = "") -> Path:
    """Give the file that a check draws to, NAME_check.png here when none is named.

    Args:
        out: The file that is asked for.
        spec: What is checked.
        what: `hand` or `rig`.
        mounted: Hands that a rig is asked to carry; they make another picture.

    Raises:
        BadConfig: Its ending says no format of pictures.
        PathNotFound: Its folder is not there.
    """
    from bidexdata.errors import PathNotFound
    from bidexdata.pictures.sheet import PICTURE_ENDINGS, require_ending

    name = "_".join([Path(spec).stem, *(Path(hand).stem for hand in mounted.split(",") if hand)])
    picture = out or Path(f"{name}_check.png")
    require_ending(picture, PICTURE_ENDINGS, f"a picture of a {what}")
    if not picture.resolve().parent.is_dir():
        raise PathNotFound(picture.parent, "a folder for the picture")
    return picture


def finish_check(
    report: HandReport | RigReport, what: str, following: str = "", *, as_json: bool, quiet: bool
) -> None:
    """Print what every check said, and end with an error where one failed.

    Args:
        report: Of the checks.
        what: `hand` or `rig`; docs/own_WHAT.md explains the checks.
        following: The next command, where all passed.
        as_json: One JSON object in place of lines.
        quiet: Only errors.

    Raises:
        NotUsable: A check failed.
    """
    from bidexdata.errors import NotUsable

    lines = table([[f.check, _WORDS[f.passed], f.says] for f in report.findings])
    if report.picture is not None:
        lines.append(f"look at {report.picture}")
    passed = not report.failed
    finish(
        report.as_dict(),
        lines,
        following=following if passed else "",
        as_json=as_json,
        quiet=quiet,
    )
    if not passed:
        failed = ", ".join(report.failed)
        if quiet or as_json:  # nobody has read the table of checks
            failed = "; ".join(f"{f.check}: {f.says}" for f in report.findings if f.passed is False)
        raise NotUsable(
            f"{what} {report.name} does not pass {counted(len(report.failed), 'check')}: "
            f"{failed}; docs/own_{what}.md says what each asks for"
        )
