"""Options that several commands share, and how their texts become values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

if TYPE_CHECKING:
    from bidexdata.runs.stage import TaskExecution

    Context = typer.Context
else:
    # What typer hands over is its base: click's class, or that of the copy which it carries.
    Context = typer.Context.__bases__[0]

T = TypeVar("T")

Workers = Annotated[int, typer.Option(min=0, help="Worker processes; 0 means one per core.")]
ExecutorName = Annotated[
    str, typer.Option("--executor", help="processes, inline (no worker process) or ray.")
]
Shard = Annotated[
    str | None,
    typer.Option(
        metavar="I/N",
        help="Do only part I of N of the plan, I from 0 to N-1: one part per machine.",
    ),
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of every random draw.")]
ConfigFile = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="FILE",
        help="YAML file with changes to the configuration, nested as `bidexdata presets NAME` and "
        "`bidexdata protocols NAME` show.",
    ),
]
Assignments = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change one key of it; may be repeated. The keys: `bidexdata presets default` for "
        "synth, `bidexdata presets prepare` for prepare, `bidexdata presets arms` for arms, "
        "`bidexdata protocols paper-1` for validate.",
    ),
]
ProtocolName = Annotated[
    str | None,
    typer.Option(
        "--protocol",
        help="Whose verdicts; when left out a release's default, else paper-1 or the only ones.",
    ),
]
RigName = Annotated[
    str | None,
    typer.Option(
        "--rig",
        metavar="NAME|FILE",
        help="Whose arms, where a run has solutions of several rigs; when left out those that it was "
        "made for (synth --rig), else ur10e_post, or the only ones.",
    ),
]
Json = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on standard output, nothing else.")
]
Quiet = Annotated[bool, typer.Option("--quiet", help="No progress and no report, only errors.")]
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]


def execution_of(executor: str, workers: int, shard: str | None, quiet: bool) -> TaskExecution:
    """Collect where and how a command runs."""
    from bidexdata.runs.stage import TaskExecution

    return TaskExecution(executor=executor, workers=workers, shard=parse_shard(shard), quiet=quiet)


def parse_shard(text: str | None) -> tuple[int, int] | None:
    """Read `I/N` with 0 <= I < N."""
    if text is None:
        return None
    first, slash, second = text.partition("/")
    if not (slash and first.isdecimal() and second.isdecimal() and int(first) < int(second)):
        raise typer.BadParameter(f"--shard {text!r}: write I/N with I from 0 to N-1, such as 0/4")
    return int(first), int(second)


def parse_sizes(text: str) -> tuple[int, ...]:
    """Read sizes in metres, `0.3,0.5`, as whole millimetres."""
    sizes = []
    for part in text.split(","):
        try:
            mm = float(part) * 1000
            if not abs(mm - round(mm)) < 1e-6:
                raise ValueError(part)
        except (ValueError, OverflowError) as err:
            raise typer.BadParameter(
                f"--sizes {text!r}: write metres separated by commas, down to whole millimetres, "
                "such as 0.3,0.5,0.8"
            ) from err
        sizes.append(round(mm))
    return tuple(sizes)


def given_names(given: Mapping[str, bool]) -> str:
    """List the options that were given, for a sentence; empty when none was."""
    return ", ".join(option for option, is_given in given.items() if is_given)


def parse_words(text: str) -> tuple[str, ...]:
    """Read words separated by commas; empty parts do not count."""
    return tuple(part.strip() for part in text.split(",") if part.strip())


def configured(
    base: T, config: Path | None, assignments: list[str] | None, *, own: Sequence[str] = ()
) -> T:
    """Apply `--config FILE`, then every `--set KEY=VALUE`, to a configuration.

    Args:
        base: What is changed.
        config: The file.
        assignments: The assignments.
        own: Options of the command that a person may take for keys, such as `--sizes`.

    Raises:
        BadValue: A value is malformed or outside its range, as for an option of its own.
        UnknownKey: A key does not exist.
        UnknownChoice: A value is none of the words that its key takes.
        NotUsable: The file does not exist or is no YAML mapping.
    """
    from bidexdata.config import from_plain, load_yaml, merge, to_plain, with_overrides
    from bidexdata.errors import BadConfig, BadValue, UnknownChoice, UnknownKey

    changes = {} if config is None else load_yaml(config)
    try:
        if changes:
            base = from_plain(type(base), merge(to_plain(base), changes), f"{config}:")
        return with_overrides(base, assignments or [])
    except UnknownKey as err:
        option = f"--{err.key.replace('_', '-')}"
        if option in own:
            err.args = (f"{err}; it is an option of its own: {option}",)
        raise
    except UnknownChoice:
        raise
    except BadConfig as err:
        raise BadValue(str(err)) from err
