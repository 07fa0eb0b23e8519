"""`bidexdata render`: pictures of grasps for people without a browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bidexdata.cli import options
from bidexdata.cli.report import command, finish
from bidexdata.wording import counted


def render(
    path: Annotated[Path, typer.Argument(metavar="LIBRARY|RUN|RELEASE", help="What to draw from.")],
    out: Annotated[
        Path,
        typer.Option(
            metavar="FILE", help="Contact sheet (.png .jpg .webp), animation (.mp4 .gif .png)."
        ),
    ],
    only: Annotated[
        str | None, typer.Option(help="success or failure: what the test said of the grasps.")
    ] = None,
    status: Annotated[
        str | None,
        typer.Option(
            metavar="LABEL,...",
            help="What became of the attempt, its arms or a test, such as collision_arms or slip.",
        ),
    ] = None,
    protocol: options.ProtocolName = None,
    arms: Annotated[
        bool | None,
        typer.Option(
            "--arms/--no-arms",
            help="Draw the arms; by default in an animation, and with the --status of one.",
            show_default=False,
        ),
    ] = None,
    rig: options.RigName = None,
    count: Annotated[int, typer.Option(min=1, help="Pictures at most.")] = 12,
    views: Annotated[int, typer.Option(min=1, max=4, help="Views of each grasp.")] = 2,
    video: Annotated[
        bool,
        typer.Option("--video", help="Animate pre-grasp, grasp, squeeze; with arms the motion."),
    ] = False,
    seed: options.Seed = 0,
    device: Annotated[str, typer.Option(help="Warp device: cpu or cuda:0.")] = "cpu",
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Draw a contact sheet by ray casting; no screen and no GL library is needed.

    Grasps are spread over objects and sizes; the same seed chooses the same ones. Selected grasps
    are shown, with --only failure and with --status audit grasps too; all leave out attempts that ended before any
    test (`synth --explain` draws them). Left hand blue, right hand green; red balls are contacts on
    the simulated solid, and may show through a thin wall of the mesh, which is what is drawn; red
    arrows their outward normals; the table grey. A library shows its objects, mesh beside solid. An animation (--video)
    is an MP4 (H.264), a GIF or an animated PNG.

    Where `bidexdata arms` has found motions, an animation has the arms and goes from home to the
    lift at its own speed. --status takes several labels, with commas, and shows as many grasps of
    each; of a failure of arms, where they came to and, in red, what stopped them: bodies that
    collide, the hand where it should be, the arm where it would have to be at once.

    --json keys: out, kind, n, shown (ids of grasps or objects), drawn_by, seconds.
    """
    from typing import cast

    from bidexdata.errors import UnknownName
    from bidexdata.runs.arm_pictures import STORED
    from bidexdata.runs.choose import Only
    from bidexdata.runs.render import render as draw

    if only not in (None, "success", "failure"):
        raise UnknownName("outcome", only, ("success", "failure"))
    report = draw(
        path,
        out,
        only=cast("Only | None", only),
        status=options.parse_words(status or ""),
        arms=arms,
        rig=rig,
        protocol=protocol,
        count=count,
        views=views,
        video=video,
        seed=seed,
        device=device,
        quiet=quiet,
    )
    objects = report.kind == "library"
    shown = counted(len(report.shown), "object" if objects else "grasp")
    lines = [f"{report.out}: {shown}, {report.drawn_by}, {report.seconds:.1f} s"]
    following = command("view", path, *report.rig)
    if objects:
        following = command("synth", path, "--out", "RUN")
    elif report.motions:
        lines.append(
            f"it shows {STORED}: in the lift the object is drawn as if it rose with the hands"
        )
        if only == "failure" and not status:
            lines.append(
                "failures without a motion are left out; --status LABEL draws what stopped them"
            )
        if report.kind == "run":
            again = ("--replay", report.shown[0], "--tests", "a", "--video", "FILE.mp4")
            following = command("validate", path, *again, *report.rig)
    finish(report.as_dict(), lines, following=following, as_json=as_json, quiet=quiet)
