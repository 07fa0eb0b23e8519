"""`bidexdata hands`: the hands that there are; `bidexdata hands check SPEC`: does a spec fit."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bidexdata.cli import options
from bidexdata.cli.checks import finish_check, picture_place
from bidexdata.cli.report import command, finish, table, warn

hands = typer.Typer(invoke_without_command=True, no_args_is_help=False)


@hands.callback()
def _list(
    context: options.Context,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """List the hands that come with the package, or check a hand of your own.

    --json keys: hands (a list of name, description, licence).
    """
    if context.invoked_subcommand is not None:
        return
    from bidexdata.hands import hand_names
    from bidexdata.hands.registry import hand_spec

    specs = {name: hand_spec(name) for name in hand_names()}
    found = [
        {"name": name, "description": s.description, "licence": s.licence}
        for name, s in specs.items()
    ]
    lines = table([[f["name"], f["licence"], f["description"]] for f in found])
    lines.append(f"a hand of your own: {command('hands', 'check', 'SPEC')} (docs/own_hand.md)")
    finish({"hands": found}, lines, as_json=as_json, quiet=quiet)


@hands.command("check")
def _check(
    spec: Annotated[
        str, typer.Argument(metavar="SPEC", help="A YAML spec, or the name of a hand.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Picture of the hand (.png .jpg .webp); NAME_check.png in this folder.",
        ),
    ] = None,
    seed: options.Seed = 0,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Check a hand's spec: does it fit the model, and can the hand grasp.

    Joint limits, the mirror image, palm frame, contact points on their pads, collision spheres
    against the collision geometry, forward kinematics in three engines, postures without overlaps,
    and grasps of a box by both hands, of which one must hold. The picture shows each side in its
    open posture and as spheres in its curved one, with contact points, normals (red) and the palm
    frame (x red, y green, z blue), and a trial grasp. Exit code 3 when a check fails.

    --json keys: hand, passed, checks (a list of check, passed, says; passed is null where a check
    was not made), picture, grasps, grasps_held, seconds.
    """
    from bidexdata.runs.check_hand import check_hand

    picture = picture_place(out, spec, "hand")
    say = (lambda _: None) if quiet else (lambda text: warn(f"-- {text}"))
    report = check_hand(spec, picture, seed=seed, say=say)
    following = command("synth", "LIBRARY", "--out", "RUN", "--hand", spec)
    finish_check(report, "hand", following, as_json=as_json, quiet=quiet)
