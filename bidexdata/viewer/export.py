"""One grasp as one HTML file: the scene in 3D, moving through its stages, and what is said of it.

The file needs no server and no network. The package that draws the page records the scene.
"""

from __future__ import annotations

import html
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bidexdata.errors import BadConfig, NotUsable
from bidexdata.pictures.posing import has_pose, poses_at
from bidexdata.record import GraspBatch, Status
from bidexdata.runs.arm_pictures import rows_with_arms
from bidexdata.runs.browse import Browsable, open_browsable, rows_by_test
from bidexdata.runs.first_digits import DIGITS, id_digits, require_one
from bidexdata.runs.shards import write_text
from bidexdata.viewer.nodes import GraspNodes
from bidexdata.viewer.server import DEFAULT_HOST, free_port, require_viser, silent, started
from bidexdata.viewer.view import FIELD_OF_VIEW, view_of_grasp, view_of_motion
from bidexdata.viewer.words import (
    arms_markdown,
    identity_markdown,
    object_markdown,
    scores,
    verdict_html,
)

if TYPE_CHECKING:
    import viser

    from bidexdata.arms.motion import Motion
    from bidexdata.objects.prepared import Solid

PAGE_ENDINGS = (".html", ".htm")
STEPS = 41
"""Poses from pre-grasp over grasp to squeeze, both ends included."""
STEP_SECONDS = 0.06
MOTION_STEP = 0.1
"""Between two poses of a motion of arms [s]."""
REST_SECONDS = 1.0
"""How long the first, the middle and the last pose stand still [s]."""
_ASPECT = 1.0
"""Width over height of the picture that the scene fits into: a square in the middle of the window,
which the words at its side leave free where it is about twice as wide as high."""
_STYLE = (
    "position:fixed;top:1em;right:1em;width:21em;max-height:calc(100vh - 6em);overflow:auto;"
    "background:#fffffff2;color:#222;font:13px/1.45 system-ui,sans-serif;padding:.8em 1em;"
    "border-radius:6px;box-shadow:0 1px 6px #0004;z-index:1000"
)


class ExportedGrasp(NamedTuple):
    """What was written."""

    grasp_id: str
    object_id: str
    out: Path
    bytes: int


def export_grasp(
    path: str | Path,
    wanted: str,
    out: str | Path,
    *,
    protocol: str | None = None,
    rig: str | Path | None = None,
) -> ExportedGrasp:
    """Write one grasp of a run or a release as a page of its own.

    Args:
        path: The run or release.
        wanted: A grasp_id, or the first digits of it.
        out: An .html file; one that is there is replaced.
        protocol: Whose verdicts are told; as `open_browsable` takes it.
        rig: Whose arms move it, likewise; without arms the hands move alone.

    Raises:
        BadValue: `wanted` is no such number.
        BadConfig: The file's ending is another.
        NotUsable: No such grasp, or several, or one without a pose, or a library.
        MissingExtra: viser is not installed.
    """
    out = Path(out)
    if out.suffix.lower() not in PAGE_ENDINGS:
        raise BadConfig(f"--out {out}: a page is written as one of {', '.join(PAGE_ENDINGS)}")
    digits = id_digits("--export", wanted)
    require_viser()
    source = open_browsable(path, protocol, rig)
    tested = find_grasp(source, digits)
    batch = next(iter(tested.values()))
    grasp_id, object_id = str(batch["grasp_id"][0]), str(batch["object_id"][0])
    if not has_pose(batch, 0):
        raise NotUsable(f"grasp {grasp_id} of {path} has no pose: the attempt ended before it")
    solid = source.load_solid(object_id)
    armed = rows_with_arms(source, object_id, batch) if source.rig else None
    text = _recorded(source, solid, batch, armed)
    panel, title = _panel(tested, solid, armed), f"grasp {grasp_id}"
    text = re.sub(r"<title>.*?</title>", f"<title>{title}</title>", text, count=1, flags=re.DOTALL)
    at = text.rindex("</body>")
    write_text(out, text[:at] + panel + text[at:])
    return ExportedGrasp(grasp_id, object_id, out, out.stat().st_size)


def find_grasp(source: Browsable, digits: str) -> dict[str, GraspBatch]:
    """The grasp whose id begins with some digits: one row, with the verdicts of every test.

    Raises:
        NotUsable: There is not exactly one, or the source is a library.
    """
    if source.kind == "library":
        raise NotUsable(f"{source.path} is a library: it has objects but no grasps")
    index = source.index()
    if index is not None:
        named = index.rows_named(digits)
        require_one(source.path, digits, [name for _, name in named], "grasps")
        return {test: index.read(named[0][0], test) for test in source.tests or ("f",)}
    found: list[dict[str, GraspBatch]] = []
    for object_id in source.object_ids:
        tested = rows_by_test(source, object_id)
        ids = next(iter(tested.values()))["grasp_id"].astype(str) if tested else np.zeros(0, str)
        for row in np.flatnonzero(np.strings.startswith(ids, digits)).tolist():
            one = slice(row, row + 1)
            found.append({test: rows.select(one) for test, rows in tested.items()})
        if found and len(digits) == DIGITS:  # no other grasp has all of them
            break
    require_one(
        source.path, digits, [str(next(iter(f.values()))["grasp_id"][0]) for f in found], "grasps"
    )
    return found[0]


def _recorded(source: Browsable, solid: Solid, batch: GraspBatch, armed: GraspBatch | None) -> str:
    motion = _motion(source, armed)
    server = started(DEFAULT_HOST, free_port())
    try:
        camera = server.initial_camera
        view = (
            view_of_grasp(source.hands(), batch, 0, float(batch["size"][0]))
            if motion is None
            else view_of_motion(motion)
        )
        camera.position, camera.look_at = view.aim(_ASPECT)
        camera.fov = FIELD_OF_VIEW
        nodes = GraspNodes(server.scene, source.hands())
        nodes.show_scene(solid, batch, 0, "mesh")
        nodes.show_contacts(batch, 0)
        nodes.set_visible(contacts=True, forces=False)
        if motion is not None:
            return _film_of_motion(server, nodes, motion)
        return _film(server, nodes, batch)
    finally:
        with silent():
            server.stop()


def _film(server: viser.ViserServer, nodes: GraspNodes, batch: GraspBatch) -> str:
    nodes.pose(poses_at(batch, 0, 0.0))
    serializer = server.get_scene_serializer()
    for moment in np.linspace(0.0, 2.0, STEPS):
        nodes.pose(poses_at(batch, 0, float(moment)))
        serializer.insert_sleep(REST_SECONDS if moment in (0.0, 1.0, 2.0) else STEP_SECONDS)
    return serializer.as_html()


def _motion(source: Browsable, armed: GraspBatch | None) -> Motion | None:
    if armed is None or int(armed["arm_status"][0]) != Status.OK:
        return None
    from bidexdata.arms.motion import motion_of

    robot = source.robot()
    assert robot is not None  # there are arm solutions
    return motion_of(robot, armed, 0)


def _film_of_motion(server: viser.ViserServer, nodes: GraspNodes, motion: Motion) -> str:
    """The motion at its own speed, key frames included; it rests at the grasp and at its end."""
    from bidexdata.arms.motion import hand_poses
    from bidexdata.viewer.arm_nodes import ArmNodes

    arms = ArmNodes(server.scene, motion.robot)
    arms.show(True)
    even = np.linspace(0.0, motion.seconds, round(motion.seconds / MOTION_STEP) + 1)
    times = np.unique(np.concatenate([even, motion.key_time]))
    rests = motion.key_time[[0, 3, 5]]

    def show(time: float) -> None:
        moment = motion.at(time)
        arms.move(moment)
        nodes.pose(hand_poses(motion.robot, moment))
        nodes.raise_object(moment.object_pos - motion.object_pos[0])

    show(0.0)
    serializer = server.get_scene_serializer()
    for time, after in zip(times, [*times[1:], times[-1]], strict=True):
        show(float(time))
        serializer.insert_sleep(float(after - time) + (REST_SECONDS if time in rests else 0.0))
    return serializer.as_html()


def _panel(tested: Mapping[str, GraspBatch], solid: Solid, armed: GraspBatch | None = None) -> str:
    batch = next(iter(tested.values()))
    rows = "".join(
        f"<tr><td>{html.escape(words)}</td><td align=right>{html.escape(value)}</td></tr>"
        for words, value in scores(tested, 0)
    )
    return (
        f'<div id="bidexdata" style="{_STYLE}">'
        f"<p>{_as_html(object_markdown(solid))}</p><p>{_as_html(identity_markdown(batch, 0))}</p>"
        f"<p>{_as_html(arms_markdown(armed, 0))}</p>"
        f'{verdict_html(tested, 0)}<table style="width:100%">{rows}</table>'
        "<p>left hand blue, right hand green, contacts and outward normals red</p></div>"
    )


def _as_html(markdown: str) -> str:
    """The little Markdown that our words use: line ends, code and bold."""
    text = html.escape(markdown).replace("  \n", "<br>")
    text = re.sub(r"`([^`]*)`", r"<code>\1</code>", text)
    return re.sub(r"\*\*([^*]*)\*\*", r"<b>\1</b>", text)
