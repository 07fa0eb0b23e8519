"""Pictures of one attempt: its stages on a contact sheet, and its energies over the steps."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from bidexdata.frames import matrix_from_quat, quat_multiply, quat_rotate
from bidexdata.pictures.camera import framed
from bidexdata.pictures.chart import Band, Line, log_chart
from bidexdata.pictures.drawing import (
    CONTACT_COLOUR,
    CONTACT_RADIUS,
    OBJECT_COLOUR,
    hand_part,
    joined,
    solid_parts,
    table_part,
)
from bidexdata.pictures.patches import surface_patch
from bidexdata.pictures.picture import drawn_by
from bidexdata.pictures.raycast import RayScene
from bidexdata.pictures.scene import Colour, Part, arrow, moved, sphere
from bidexdata.pictures.sheet import Caption, Tile, contact_sheet
from bidexdata.pictures.views import choose_views, subject_points
from bidexdata.runs.explain_words import TERM_WORDS, StageWords
from bidexdata.synthesis.trace import TERMS

if TYPE_CHECKING:
    from PIL.Image import Image

    from bidexdata.hands.model import Hand
    from bidexdata.objects.prepared import Solid
    from bidexdata.record import Scene
    from bidexdata.synthesis.explain import Explanation, StagePose
    from bidexdata.synthesis.trace import Trace

WIDTH, HEIGHT = 330, 250
"""Pixels of one view; a tile has two, one above the other."""
COLUMNS = 4
SIDES = ("left", "right")
REGION_COLOURS: dict[str, Colour] = {"left": (0.45, 0.66, 0.98), "right": (0.50, 0.88, 0.62)}
ANCHOR_COLOUR: Colour = (0.12, 0.12, 0.14)
FORCE_COLOURS: dict[str, Colour] = {"left": (0.10, 0.28, 0.70), "right": (0.06, 0.48, 0.24)}
ANCHOR_RADIUS = 0.007
"""Radius of the ball at a region's centre [m]."""
FORCE_LENGTH = 0.12
"""Length of the arrow of a force of one cap [m]."""
TITLES = {
    "start": "start",
    "quarter": "a quarter of the approach",
    "approach": "end of the approach",
    "pregrasp": "pre-grasp",
    "grasp": "grasp",
    "squeeze": "squeeze",
}
LINE_COLOURS = {
    "closure_left": (64, 128, 216),
    "closure_right": (60, 168, 108),
    "closure_coupled": (120, 70, 170),
    "distance": (222, 120, 30),
    "region": (150, 110, 60),
    "pad": (200, 90, 160),
    "penetration": (204, 36, 40),
    "self_penetration": (60, 170, 185),
}
TOTAL_COLOUR = (35, 38, 42)
_APART = 6  # steps


def stages_sheet(
    one: Explanation,
    said: Sequence[StageWords],
    solid: Solid,
    hands: Sequence[Hand],
    *,
    title: str,
    device: str = "cpu",
) -> Image:
    """Draw every stage that an attempt came to, from two sides.

    The camera stands still while there are hands, and comes nearer where there are none.

    Args:
        one: The attempt.
        said: What to write under the pictures.
        solid: The object, at unit diagonal.
        hands: Left and right.
        title: One line at the top.
        device: A Warp device.
    """
    scene = one.attempts.scene
    ground = _ground(solid, scene)
    regions = _regions(one, scene)
    seen = {m.name: _hands(m, hands, scene) for m in one.poses if _finite(m)}
    shots = [("regions", "regions", [*ground, *regions])]
    for name, parts in seen.items():
        marks = _contacts(one, scene) if name in ("grasp", "squeeze") else regions
        shots.append((name, TITLES[name], [*ground, *marks, *parts]))
    if one.finished is not None and "grasp" in seen:
        forces = ("forces", "forces that the hands balance", [*ground, *_forces(one, scene)])
        place = next(i for i, shot in enumerate(shots) if shot[0] == "grasp") + 1
        shots.insert(place, forces)
    model = seen.get("grasp") or next(iter(seen.values()), [])
    directions = choose_views([*ground, *model], RayScene([*ground, *model], device), 2)
    whole = np.concatenate([subject_points(parts) for _, _, parts in shots])
    words = {s.stage: s for s in said}
    tiles = []
    for name, head, parts in shots:
        rays, points = RayScene(parts, device), whole if name in seen else subject_points(parts)
        cameras = [framed(points, d, WIDTH / HEIGHT) for d in directions]
        views = [rays.draw(camera, WIDTH, HEIGHT) for camera in cameras]
        tiles.append(Tile(np.concatenate(views), _caption(head, words.get(name))))
    return contact_sheet(tiles, title=title, footer=drawn_by(device), columns=COLUMNS)


def energies_chart(trace: Trace, *, title: str) -> Image:
    """Draw the weighted energy terms over the steps, and their sum."""
    weighted = np.column_stack([trace.energy * trace.weight, trace.total()])
    # The finished grasp stands apart from the last step, as a dot.
    weighted = np.insert(weighted, len(weighted) - 1, np.full((_APART, 1), np.nan), axis=0)
    names = [TERM_WORDS[t] for t in TERMS]
    inks = [LINE_COLOURS[t] for t in TERMS]
    lines = [
        Line(name, values, ink, width)
        for name, values, ink, width in zip(
            [*names, "sum"], weighted.T, [*inks, TOTAL_COLOUR], [2] * len(TERMS) + [1], strict=True
        )
        if np.isfinite(values).any()
    ]
    cuts = [i for i in range(len(trace.phase)) if i == 0 or trace.phase[i] != trace.phase[i - 1]]
    bands = [Band(trace.phase[first], first, stop) for first, stop in itertools.pairwise(cuts)]
    bands.append(Band("end", cuts[-1] + 1, len(weighted)))
    footer = (
        "weight x energy before the move of each step; dots: the finished grasp, with pads wanted "
        "on the surface and contacts where the pads are"
    )
    return log_chart(lines, title=title, footer=footer, bands=bands)


def _caption(head: str, said: StageWords | None) -> Caption:
    if said is None:
        return Caption(head)
    lines = tuple(part for part in said.text.split("; ") if part)
    return Caption(head, lines, () if said.passed is not False else (False,) * len(lines))


def _ground(solid: Solid, scene: Scene) -> list[Part]:
    """The simulated solid, on which everything is computed, and the table under it."""
    pos, quat = scene.object_pos, scene.object_quat_wxyz
    pieces = solid_parts(solid, scene.size, pos, quat, surface="pieces")
    parts = [joined(pieces, OBJECT_COLOUR, "object")]
    if scene.setting == "tabletop":
        parts.append(table_part(scene.size, (pos[0], pos[1])))
    return parts


def _regions(one: Explanation, scene: Scene) -> list[Part]:
    placed, pairs = one.attempts.placed, one.attempts.pairs
    if placed is None:
        return []
    k, parts = int(placed.pair_index[one.number]), []
    for h, side in enumerate(SIDES):
        points, normals = pairs.points[k, h], pairs.normals[k, h]
        plates = surface_patch(points, normals, REGION_COLOURS[side], "region")
        centre = sphere(pairs.centres[k, h], ANCHOR_RADIUS, ANCHOR_COLOUR, "region")
        parts += [_in_world(plates, scene), _in_world(centre, scene)]
    return parts


def _hands(pose: StagePose, hands: Sequence[Hand], scene: Scene) -> list[Part]:
    origin, turn = np.array(scene.object_pos), np.array(scene.object_quat_wxyz)
    pos = quat_rotate(turn, pose.position) + origin
    quat = quat_multiply(turn, pose.quat_wxyz)
    return [hand_part(hand, pos[h], quat[h], pose.joints[h]) for h, hand in enumerate(hands)]


def _contacts(one: Explanation, scene: Scene) -> list[Part]:
    if one.finished is None:
        return []
    points = np.concatenate(one.finished.points)
    balls = [sphere(p, CONTACT_RADIUS, CONTACT_COLOUR, "contact") for p in points]
    return [_in_world(ball, scene) for ball in balls]


def _forces(one: Explanation, scene: Scene) -> list[Part]:
    """Arrows that end at the contacts: the object hides what lies behind them."""
    done, parts = one.finished, []
    assert done is not None
    for side, points, forces in zip(SIDES, done.points, done.forces, strict=True):
        for point, force in zip(points, forces, strict=True):
            parts.append(sphere(point, CONTACT_RADIUS, CONTACT_COLOUR, "contact"))
            colour = FORCE_COLOURS[side]
            shaft = arrow(point - FORCE_LENGTH * force, point, 0.0025, colour, "force")
            parts += [shaft] if shaft else []
    return [_in_world(part, scene) for part in parts]


def _in_world(part: Part, scene: Scene) -> Part:
    return moved(part, matrix_from_quat(np.array(scene.object_quat_wxyz)), scene.object_pos)


def _finite(pose: StagePose) -> bool:
    numbers = (pose.position, pose.quat_wxyz, *pose.joints)
    return all(bool(np.isfinite(n).all()) for n in numbers)
