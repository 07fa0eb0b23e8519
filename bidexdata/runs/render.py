"""Contact sheets and animations of what a library, a run or a release holds.

Which rows are shown follows from the seed, the ids and the filter alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from bidexdata.devices import check_device
from bidexdata.errors import BadConfig, BadValue, NotUsable
from bidexdata.record import Status
from bidexdata.record.status import ARM_STATUSES
from bidexdata.runs.browse import Browsable, open_browsable, rows_by_test
from bidexdata.runs.browse_run import RunSource
from bidexdata.runs.choose import (
    Only,
    Shown,
    chosen_of_each,
    judging_test,
    shuffled,
    statuses_called,
)
from bidexdata.runs.chosen import rig_option
from bidexdata.runs.progress import Progress

if TYPE_CHECKING:
    from bidexdata.objects.prepared import Solid
    from bidexdata.pictures.sheet import Tile

DEFAULT_COUNT = 12
WIDTH, HEIGHT = 280, 240
"""Pixels of one view."""
VIDEO_MOMENTS = (
    0.0,
    0.0,
    *np.linspace(0, 1, 8).tolist(),
    *np.linspace(1, 2, 5)[1:].tolist(),
    2.0,
    2.0,
)
"""Stage numbers of an animation's pictures: it rests at the pre-grasp and at the squeeze."""


@dataclass(frozen=True, slots=True)
class RenderReport:
    """What was drawn."""

    out: Path
    kind: str
    shown: tuple[str, ...]
    """Ids of the grasps or objects, in the order of the sheet."""
    drawn_by: str
    seconds: float
    motions: bool = False
    """Whether it is a film of stored motions of arms."""
    rig: tuple[str, ...] = ()
    """`--rig NAME` where a later command must say it to mean the same arms."""

    def as_dict(self) -> dict[str, Any]:
        """Plain data for `--json`."""
        return {
            "out": str(self.out),
            "kind": self.kind,
            "n": len(self.shown),
            "shown": list(self.shown),
            "drawn_by": self.drawn_by,
            "seconds": round(self.seconds, 3),
        }


def render(
    path: str | Path,
    out: str | Path,
    *,
    only: Only | None = None,
    status: Sequence[str] = (),
    protocol: str | None = None,
    arms: bool | None = None,
    rig: str | Path | None = None,
    count: int = DEFAULT_COUNT,
    views: int = 2,
    video: bool = False,
    seed: int = 0,
    device: str = "cpu",
    quiet: bool = False,
) -> RenderReport:
    """Draw a contact sheet, or with `video` an animation pre-grasp -> grasp -> squeeze.

    Grasps are spread over objects and sizes. Selected rows are shown; with `only="failure"` and with
    `status` audit rows too. A library shows its objects, repaired mesh beside convex pieces. With
    arms an animation is the whole motion, of grasps that have one; a sheet has the arms at the
    grasp, or where they came to and what stopped them.

    Args:
        path: A library, a run or a release.
        out: `.png`, `.jpg` or `.webp`; an animation is `.mp4`, `.gif` or an animated `.png`.
        only: Grasps that passed, or that failed.
        status: Labels of what became of attempts, arms or tests; as many grasps of each.
        protocol: Whose verdicts; when omitted a release's default, else `paper-1` or the only one.
        arms: Draw the arms; when omitted in an animation where there are solutions, and where
            `status` is one of arms.
        rig: Whose arms; see `Run.rig` when omitted.
        count: Pictures at most.
        views: Views of each grasp (an animation has one).
        video: Make an animation.
        seed: Chooses other grasps.
        device: A Warp device, `cpu` or `cuda:0`.
        quiet: No progress bar.

    Raises:
        NotUsable: Nothing matches, there are no verdicts or arm solutions to choose by, no saying
            whose are meant, there is no such device, or pillow is missing.
        UnknownName: There are no verdicts of the protocol, no arms of the rig, or no such status.
        MissingExtra: An `.mp4` without the package that writes it.
        BadConfig: The file's ending is none of these.
        BadValue: `count` is not positive.
        PathNotFound: `path` does not exist.
    """
    started = perf_counter()
    check_device(device)
    source, out = open_browsable(path, protocol, rig), Path(out)
    statuses = statuses_called(status)
    _check(out, source, only=only, statuses=statuses, arms=arms, count=count, video=video)
    from bidexdata.pictures.picture import drawn_by
    from bidexdata.pictures.sheet import FRAME_MS, contact_sheet, save_animation, save_picture
    from bidexdata.pictures.video import save_video

    footer = drawn_by(device)
    if arms is None:
        asked = video or any(s in ARM_STATUSES for s in statuses)
        arms = bool(source.rig) and asked
    if source.kind == "library":
        ids = shuffled(source.object_ids, seed)[:count]
        frames = [_object_tiles(source, sorted(ids), device, quiet)]
        shown, chosen = tuple(sorted(ids)), []
    else:
        chosen = chosen_of_each(source, count, only, statuses, seed, moving=arms and video)
        shown = tuple(str(s.batch["grasp_id"][s.row]) for s in chosen)
        if arms and chosen:
            from bidexdata.runs.arm_pictures import armed_tiles

            seconds = FRAME_MS / 1000 if video else None
            frames = armed_tiles(
                *(source, chosen),
                views=views,
                frame_seconds=seconds,
                device=device,
                quiet=quiet,
            )
        else:
            frames = _grasp_frames(source, chosen, views, device, video=video, quiet=quiet)
    sides = chosen[0].batch.header.hands if chosen else ()
    title = sheet_title(source, only, [h.side for h in sides], statuses, moving=arms and video)
    if not shown:
        raise NotUsable(f"{path}: {_nothing_words(only, statuses, moving=arms and video)}")
    sheets = (contact_sheet(tiles, title=title, footer=footer) for tiles in frames)
    out.parent.mkdir(parents=True, exist_ok=True)
    if out.suffix.lower() == ".mp4":
        save_video(sheets, out, 1000 / FRAME_MS)
    elif video:
        save_animation(list(sheets), out)
    else:
        save_picture(next(sheets), out)
    seconds = perf_counter() - started
    rig_said = rig_option(source.run) if isinstance(source, RunSource) else ()
    return RenderReport(out, source.kind, shown, footer, seconds, arms and video, rig_said)


def grasp_tiles(source: Browsable, chosen: Sequence[Shown], views: int = 2) -> list[Tile]:
    """Pictures of chosen grasps with their captions, drawn on the CPU."""
    return _grasp_frames(source, chosen, views, "cpu", video=False, quiet=True)[0]


def _grasp_frames(
    source: Browsable,
    chosen: Sequence[Shown],
    views: int,
    device: str,
    *,
    video: bool,
    quiet: bool,
) -> list[list[Tile]]:
    """Tiles of each picture of the animation; one picture when it is none."""
    from bidexdata.pictures.captions import grasp_caption
    from bidexdata.pictures.picture import draw_grasp, draw_stages
    from bidexdata.pictures.sheet import Tile

    hands = source.hands() if chosen else ()
    frames: list[list[Tile]] = [[] for _ in (VIDEO_MOMENTS if video else (1,))]
    solid: Solid | None = None
    with Progress(len(chosen), "grasp drawn", quiet=quiet) as progress:
        for shown in chosen:
            if solid is None or solid.object_id != shown.object_id:
                solid = source.load_solid(shown.object_id)
            at = (shown.batch, shown.row, solid, hands)
            size = {"width": WIDTH, "height": HEIGHT, "device": device}
            if video:
                drawn = draw_stages(*at, VIDEO_MOMENTS, **size)
            else:
                drawn = [draw_grasp(*at, views=views, **size)]
            caption = grasp_caption(rows_by_test(source, shown.object_id, shown.batch), shown.row)
            for tiles, pixels in zip(frames, drawn, strict=True):
                tiles.append(Tile(pixels, caption))
            progress.advance()
    return frames


def _object_tiles(
    source: Browsable, object_ids: Sequence[str], device: str, quiet: bool
) -> list[Tile]:
    from bidexdata.pictures.captions import object_caption
    from bidexdata.pictures.picture import draw_object
    from bidexdata.pictures.sheet import Tile

    tiles = []
    with Progress(len(object_ids), "object drawn", quiet=quiet) as progress:
        for object_id in object_ids:
            solid = source.load_solid(object_id)
            pixels = draw_object(solid, width=WIDTH, height=HEIGHT, device=device)
            tiles.append(Tile(pixels, object_caption(solid)))
            progress.advance()
    return tiles


def _nothing_words(only: Only | None, statuses: Sequence[Status], *, moving: bool) -> str:
    words = f" with --only {only}" if only else ""
    if statuses:
        words += f" with --status {','.join(s.label for s in statuses)}"
    if moving and not statuses:
        return f"no grasp{words} has a motion of arms; --no-arms draws the hands alone"
    return f"nothing to draw{words}"


def _check(
    out: Path,
    source: Browsable,
    *,
    only: Only | None,
    statuses: Sequence[Status],
    arms: bool | None,
    count: int,
    video: bool,
) -> None:
    from bidexdata.pictures.sheet import PICTURE_ENDINGS, require_ending

    if video:
        require_ending(out, (".mp4", ".gif", ".png"), "an animation")
    else:
        require_ending(out, PICTURE_ENDINGS, "a contact sheet")
    if video and out.suffix.lower() == ".mp4":
        from bidexdata.pictures.video import require_encoder

        require_encoder()  # before minutes of drawing
    if count < 1:
        raise BadValue(f"--count must be at least 1, not {count}")
    if source.kind == "library" and (only or video or statuses or arms):
        raise BadConfig(f"{source.path} is a library: it has objects but no grasps to choose from")
    if only and not source.test:
        raise NotUsable(
            f"{source.path} has no verdicts, so --only {only} chooses nothing; "
            f"run: bidexdata validate {source.path}"
        )
    of_arms = [s.label for s in statuses if s in ARM_STATUSES and s != Status.NOT_REACHABLE]
    if (arms or of_arms) and not source.rig:
        asked = "--arms draws" if arms else f"--status {of_arms[0]} chooses"
        raise NotUsable(
            f"{source.path} has no arm solutions, so {asked} nothing; run: "
            f"bidexdata arms {source.path}"
        )


def sheet_title(
    source: Browsable,
    only: Only | None,
    sides: Sequence[str],
    statuses: Sequence[Status] = (),
    *,
    moving: bool = False,
) -> str:
    """Say what a sheet shows: whose grasps, chosen by what, and which hand has which colour."""
    from bidexdata.pictures.drawing import HAND_COLOUR_NAMES

    what = {"success": "grasps that passed", "failure": "grasps that failed", None: "grasps"}[only]
    if source.kind == "library":
        return f"{source.path.name}: objects, repaired mesh beside convex pieces"
    # One test chose the grasps; without a choice the verdicts of all are told.
    tests = (judging_test(source, moving=moving),) if only else source.tests
    named = f"{'tests' if len(tests) > 1 else 'test'} {', '.join(tests)}"
    test = f" ({named} of {source.protocol})" if tests else " (not validated)"
    if statuses:
        what = f"{what} with status {', '.join(s.label for s in statuses)}"
    if statuses and all(s in ARM_STATUSES for s in statuses) and source.rig:
        test = f" (arms of {source.rig}; red: what stopped them)"
    colours = ", ".join(f"{side} hand {HAND_COLOUR_NAMES[side]}" for side in sides)
    return f"{source.path.name}: {what}{test}; {colours}"
