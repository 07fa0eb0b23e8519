"""`bidexdata rigs`: the rigs that there are; `bidexdata rigs check FILE`: does a rig work."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bidexdata.cli import options
from bidexdata.cli.checks import finish_check, picture_place
from bidexdata.cli.report import command, finish, table, warn

rigs = typer.Typer(invoke_without_command=True, no_args_is_help=False)


@rigs.callback()
def _list(
    context: options.Context,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """List the rigs that come with the package, or check a rig of your own.

    --json keys: rigs (a list of name, description, licence of the arm's model, hands).
    """
    if context.invoked_subcommand is not None:
        return
    from bidexdata.arms.registry import rig_names, rig_spec

    specs = {name: rig_spec(name) for name in rig_names()}
    found = [
        {
            "name": name,
            "description": spec.description,
            "licence": spec.arm.licence,
            "hands": ["any other" if hand == "*" else hand for hand in spec.mounts],
        }
        for name, spec in specs.items()
    ]
    rows = [[str(f["name"]), str(f["licence"]), f"{f['description']}; hands: "
             f"{', '.join(f['hands'])}"] for f in found]  # fmt: skip
    lines = table(rows)
    lines.append(f"a rig of your own: {command('rigs', 'check', 'FILE')} (docs/own_rig.md)")
    finish({"rigs": found}, lines, as_json=as_json, quiet=quiet)


@rigs.command("check")
def _check(
    spec: Annotated[str, typer.Argument(metavar="FILE", help="A YAML spec, or the name of a rig.")],
    hand: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Hand to mount, or LEFT,RIGHT; the first of the rig's."),
    ] = None,
    object_mass: Annotated[
        float | None,
        typer.Option(metavar="KG", help="Heaviest object; 0.25, that of the largest size."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Picture of the rig (.png .jpg .webp); NAME_check.png, "
            "with --hand NAME_HAND_check.png.",
        ),
    ] = None,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Check a rig's spec: do the arms fit it, carry the hands, and reach objects on the table.

    Models and joint limits, mounts, rated load and torque against hand and half the object,
    overlaps at rest, forward kinematics in three engines, and the share of generic pairs of palm
    poses that the arms reach, lift and leave without touching anything. The picture shows the rig at
    rest, pairs that it reaches, and a map of its reach. Exit code 3 when a check fails.

    --json keys: rig, hand, passed, checks (a list of check, passed, says; passed is null where a
    check was not made), carried_kg, payload_kg, reach (shares by reason), reach_by_size, picture,
    seconds.
    """
    from bidexdata.errors import BadValue
    from bidexdata.runs.check_rig import check_rig

    if object_mass is not None and not 0 <= object_mass < float("inf"):
        raise BadValue(f"--object-mass {object_mass}: must be zero or more")
    picture = picture_place(out, spec, "rig", hand or "")
    say = (lambda _: None) if quiet else (lambda text: warn(f"-- {text}"))
    report = check_rig(spec, picture, hand=hand, object_mass=object_mass, say=say)
    finish_check(report, "rig", as_json=as_json, quiet=quiet)
