"""The command `bidexdata`: its commands, and what becomes of errors.

Only light modules are imported here; a command imports what it needs when it runs, so that
`--help` stays under half a second.
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Sequence
from typing import Annotated, cast

# Plain help: rich would add a third of a second, and its boxes do not survive a pipe.
os.environ.setdefault("TYPER_USE_RICH", "0")

import typer

from bidexdata.cli.arms import arms
from bidexdata.cli.bench import bench
from bidexdata.cli.demo import demo
from bidexdata.cli.diff import diff
from bidexdata.cli.export import export
from bidexdata.cli.hands import hands
from bidexdata.cli.import_ import import_
from bidexdata.cli.info import info
from bidexdata.cli.merge import merge
from bidexdata.cli.migrate import migrate
from bidexdata.cli.names import presets, protocols
from bidexdata.cli.pack import pack
from bidexdata.cli.prepare import prepare
from bidexdata.cli.publish import publish
from bidexdata.cli.render import render
from bidexdata.cli.rigs import rigs
from bidexdata.cli.split import split
from bidexdata.cli.subset import subset
from bidexdata.cli.synth import synth
from bidexdata.cli.table import table
from bidexdata.cli.validate import validate
from bidexdata.cli.verify import verify
from bidexdata.cli.view import view
from bidexdata.errors import BidexError
from bidexdata.extras import missing_extra

INTERRUPTED = 130
REPEATABLE = ("--set", "--author")
"""Options that may be given more than once."""
# click's class, or that of the copy which newer typer carries.
_UsageError = cast("type[Exception]", typer.BadParameter.__bases__[0])

COMMANDS = {
    "prepare": prepare,
    "synth": synth,
    "arms": arms,
    "validate": validate,
    "import": import_,
    "pack": pack,
    "export": export,
    "view": view,
    "render": render,
    "info": info,
    "table": table,
    "verify": verify,
    "diff": diff,
    "migrate": migrate,
    "merge": merge,
    "split": split,
    "subset": subset,
    "publish": publish,
    "hands": hands,
    "rigs": rigs,
    "protocols": protocols,
    "presets": presets,
    "bench": bench,
    "demo": demo,
}

app = typer.Typer(
    name="bidexdata",
    help="Turn mesh files into published, verified, trainable datasets of two-handed grasps.",
    epilog=(
        "Exit codes: 0 done; 1 a bug; 2 an option or value that cannot be read or is out of range; "
        "3 something named does not exist or cannot be used; 4 a release, run or library contradicts "
        "its manifest or header; 5 another configuration; 6 nothing succeeded; 130 interrupted."
    ),
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for _name, _command in COMMANDS.items():
    if isinstance(_command, typer.Typer):
        app.add_typer(_command, name=_name)
    else:
        app.command(_name)(_command)


def _show_version(wanted: bool) -> bool:
    if wanted:
        from bidexdata import __version__

        print(f"bidexdata {__version__}")
        raise typer.Exit
    return wanted


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version."),
    ] = False,
) -> None:
    pass


def main() -> None:
    """Entry point of the command line."""
    sys.exit(run(sys.argv[1:]))


def run(arguments: Sequence[str]) -> int:
    """Run one command and give its exit code; errors are one sentence on standard error."""
    try:
        _refuse_twice(arguments)
        code = int(app(args=list(arguments), prog_name="bidexdata", standalone_mode=False) or 0)
        sys.stdout.flush()
        # Typer turns Ctrl-C into this code, or into Abort, depending on its version.
        return _interrupted() if code == INTERRUPTED else code
    except _UsageError as err:
        return _usage(err, arguments)
    except BidexError as err:
        return _complain(str(err), err.exit_code, arguments)
    except (KeyboardInterrupt, typer.Abort):
        return _interrupted()
    except BrokenPipeError:
        # The reader of our output went away (`| head`); nothing more can be said to it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as err:
        missing = missing_extra(err)
        if missing is not None:
            return _complain(str(missing), missing.exit_code, arguments)
        text = str(err).strip().splitlines()
        what = f"{type(err).__name__}: {text[0]}" if text else type(err).__name__
        hint = (
            "run it again with --debug and report what it prints, together with "
            "`bidexdata --version`, on the project's issue tracker"
        )
        return _complain(f"this is a bug in bidexdata ({what}); {hint}", 1, arguments)


def _refuse_twice(arguments: Sequence[str]) -> None:
    """Refuse an option that is there twice: the first one would be forgotten without a word."""
    given = [word.partition("=")[0] for word in arguments if word.startswith("--")]
    for option in given:
        if given.count(option) > 1 and option not in REPEATABLE:
            raise typer.BadParameter(f"{option} is given twice")


def _usage(err: Exception, arguments: Sequence[str]) -> int:
    context = getattr(err, "ctx", None)
    where = context.command_path if context is not None else f"bidexdata {arguments[0]}"
    message = getattr(err, "format_message", lambda: str(err))()
    if message and not message.startswith("Usage:"):
        print(f"error: {message.rstrip('.')}; see {where} --help", file=sys.stderr)
    elif context is not None:  # no arguments at all: the error is the help text
        print(context.get_help(), file=sys.stderr)
    return 2


def _interrupted() -> int:
    print("interrupted; the same command goes on after the last finished task", file=sys.stderr)
    return INTERRUPTED


def _complain(sentence: str, code: int, arguments: Sequence[str]) -> int:
    if "--debug" in arguments:
        traceback.print_exc()
    print(f"error: {sentence}", file=sys.stderr)
    return code
