"""Built-in parametric objects: solids from a family and a number, CC0.

`shapes` gives one of each family, `shapes:box,bottle` one of each named family, and
`shapes:box/5` the first five of a family. Number 0 of a family has typical proportions, the
others are drawn from a generator seeded by family and number. Lengths are metres at a size that
two hands would hold; the library stores them at unit diagonal like everything else.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bidexdata.errors import BadValue, UnknownName
from bidexdata.objects.closed import as_mesh, convex_hull, union
from bidexdata.objects.prepared import TriangleMesh

from .item import SourceItem

if TYPE_CHECKING:
    from manifold3d import Manifold

LICENCE = "CC0-1.0"
_SIDES = 32
"""Corners of a circle: 64 vertices for a cylinder, the most that a piece may have."""
_SPREAD = 0.3
"""Numbered shapes vary each length by up to this share."""


class Family(NamedTuple):
    """How to build a shape from lengths [m], and its typical lengths."""

    build: Callable[..., Manifold]
    lengths: Mapping[str, float]


def shape_families() -> tuple[str, ...]:
    """Names of the built-in families."""
    return tuple(_FAMILIES)


def shape_items(request: str) -> list[SourceItem]:
    """Inputs for `shapes:<request>`; an empty request means one of each family.

    Raises:
        UnknownName: A family does not exist.
        BadValue: A count is not a positive number.
    """
    wanted = [part.strip() for part in request.split(",") if part.strip()] or list(_FAMILIES)
    items = []
    for part in wanted:
        family, slash, count = part.partition("/")
        if family not in _FAMILIES:
            raise UnknownName("family of shapes", family, _FAMILIES)
        if slash and not (count.isdecimal() and int(count) > 0):
            raise BadValue(f"shapes:{part}: write FAMILY/COUNT with a count of at least 1")
        items += [_item(family, k) for k in range(int(count) if slash else 1)]
    return items


def named_shape(name: str) -> SourceItem:
    """Return the built-in shape `FAMILY` or `FAMILY/NUMBER`.

    Raises:
        UnknownName: The family does not exist.
        BadValue: The number is not a number.
    """
    family, _, number = name.partition("/")
    if family not in _FAMILIES:
        raise UnknownName("family of shapes", family, _FAMILIES)
    if number and not number.isdecimal():
        raise BadValue(f"shapes:{name}: write FAMILY/NUMBER, for example shapes:box/2")
    return _item(family, int(number or 0))


def shape_bytes(name: str) -> bytes:
    """The recipe of a shape as canonical JSON: its identity, in place of a file's bytes."""
    family, number = name.split("/")
    recipe = {"family": family, "lengths": _lengths(family, int(number))}
    return json.dumps(recipe, sort_keys=True, separators=(",", ":")).encode()


def shape_mesh(name: str) -> TriangleMesh:
    """Triangles of a built-in shape, `family/number`, z up [m]."""
    family, number = name.split("/")
    return as_mesh(_FAMILIES[family].build(**_lengths(family, int(number))))


def _item(family: str, number: int) -> SourceItem:
    return SourceItem(
        source_name=f"shapes:{family}/{number}",
        shape=f"{family}/{number}",
        source="bidexdata built-in shapes",
        licence=LICENCE,
        author="The bidexdata contributors",
        category=family,
    )


def _lengths(family: str, number: int) -> dict[str, float]:
    typical = _FAMILIES[family].lengths
    if number == 0:
        return dict(typical)
    # crc32 is the same on every machine and in every process, unlike hash().
    rng = np.random.default_rng([zlib.crc32(family.encode()), number])
    factors = rng.uniform(1 - _SPREAD, 1 + _SPREAD, len(typical))
    return {k: round(v * f, 4) for (k, v), f in zip(typical.items(), factors, strict=True)}


def _box(length: float, width: float, height: float) -> Manifold:
    import manifold3d

    return manifold3d.Manifold.cube((length, width, height), True)


def _cylinder(radius: float, height: float) -> Manifold:
    import manifold3d

    return manifold3d.Manifold.cylinder(height, radius, radius, _SIDES, True)


def _prism(radius: float, height: float) -> Manifold:
    import manifold3d

    return manifold3d.Manifold.cylinder(height, radius, radius, 6, True)


def _cone(radius: float, top: float, height: float) -> Manifold:
    import manifold3d

    return manifold3d.Manifold.cylinder(height, radius, top, _SIDES, True)


def _sphere(radius: float) -> Manifold:
    return convex_hull(_ball(radius))


def _ellipsoid(length: float, width: float, height: float) -> Manifold:
    return convex_hull(_ball(0.5) * np.array([length, width, height]))


def _capsule(radius: float, length: float) -> Manifold:
    shift = np.array([0.0, 0.0, length / 2])
    ball = _rings(radius, 12, 5)
    upper, lower = ball[ball[:, 2] >= 0], ball[ball[:, 2] <= 0]
    return convex_hull(np.concatenate([upper + shift, lower - shift]))


def _ring(radius: float, thickness: float) -> Manifold:
    turn = np.arange(12) * 2 * np.pi / 12
    profile = np.column_stack([np.cos(turn), np.sin(turn)]) * thickness / 2
    return _revolved(profile + np.array([radius, 0.0]), 24)


def _tube(radius: float, wall: float, height: float) -> Manifold:
    inner = radius - wall
    return _revolved([(inner, 0), (radius, 0), (radius, height), (inner, height)], 24)


def _bottle(radius: float, height: float, neck: float) -> Manifold:
    body, shoulder = 0.62 * height, 0.78 * height
    outline = [(0, 0), (radius, 0), (radius, body), (neck, shoulder), (neck, height), (0, height)]
    return _revolved(outline, 24)


def _bowl(radius: float, wall: float) -> Manifold:
    turn = np.linspace(-np.pi / 2, 0, 8)
    outer = np.column_stack([np.cos(turn), 0.7 * np.sin(turn)]) * radius
    inner = np.column_stack([np.cos(turn), 0.7 * np.sin(turn)]) * (radius - wall)
    outer[0, 0] = inner[0, 0] = 0.0
    return _revolved(np.concatenate([outer, inner[::-1]]), 24)


def _pan(radius: float, height: float, wall: float, handle: float) -> Manifold:
    import manifold3d

    inner = radius - wall
    dish = _revolved(
        [
            (0, 0),
            (0.85 * radius, 0),
            (radius, height),
            (inner, height),
            (0.85 * inner, wall),
            (0, wall),
        ],
        24,
    )
    grip = manifold3d.Manifold.cube((handle, 2.5 * wall, wall), True)
    return union([dish, grip.translate((radius - wall / 2 + handle / 2, 0, height - wall / 2))])


def _mug(radius: float, height: float, wall: float) -> Manifold:
    import manifold3d

    inner = radius - wall
    cup = _revolved(
        [(0, 0), (radius, 0), (radius, height), (inner, height), (inner, wall), (0, wall)], 24
    )
    reach, thick = 0.32 * height, 1.3 * wall
    square = manifold3d.Manifold.cube((reach, thick, 0.6 * height), True)
    hole = manifold3d.Manifold.cube((reach - thick, 2 * thick, 0.6 * height - 2 * thick), True)
    handle = square - hole.translate((-thick / 2, 0, 0))
    return union([cup, handle.translate((radius - wall / 2 + reach / 2, 0, height / 2))])


def _plate(length: float, width: float, thickness: float) -> Manifold:
    return _box(length, width, thickness)


def _bracket(length: float, height: float, width: float, thickness: float) -> Manifold:
    import manifold3d

    corner = np.array(
        [
            (0, 0),
            (length, 0),
            (length, thickness),
            (thickness, thickness),
            (thickness, height),
            (0, height),
        ]
    )
    return manifold3d.Manifold.extrude(manifold3d.CrossSection([corner]), width).rotate((90, 0, 0))


def _cross(length: float, width: float, thickness: float) -> Manifold:
    return union([_box(length, width, thickness), _box(width, length, thickness)])


def _revolved(outline: ArrayLike, sides: int) -> Manifold:
    """Turn an outline (r, z), counter-clockwise, about the z axis."""
    import manifold3d

    section = manifold3d.CrossSection([np.asarray(outline, np.float64)])
    return manifold3d.Manifold.revolve(section, sides)


def _ball(radius: float) -> NDArray[np.float64]:
    """Points on a sphere, few enough for one piece: 62."""
    return _rings(radius, 12, 7)


def _rings(radius: float, around: int, levels: int) -> NDArray[np.float64]:
    """Points on a sphere: two poles and rings of equal latitude steps."""
    latitude = np.linspace(-np.pi / 2, np.pi / 2, levels)[1:-1]
    turn = np.arange(around) * 2 * np.pi / around
    lat, lon = np.meshgrid(latitude, turn, indexing="ij")
    ring = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1)
    return radius * np.concatenate([ring.reshape(-1, 3), [[0, 0, 1.0], [0, 0, -1.0]]])


_FAMILIES: dict[str, Family] = {
    "box": Family(_box, {"length": 0.30, "width": 0.22, "height": 0.18}),
    "cylinder": Family(_cylinder, {"radius": 0.10, "height": 0.30}),
    "sphere": Family(_sphere, {"radius": 0.15}),
    "capsule": Family(_capsule, {"radius": 0.09, "length": 0.22}),
    "ellipsoid": Family(_ellipsoid, {"length": 0.34, "width": 0.24, "height": 0.18}),
    "cone": Family(_cone, {"radius": 0.14, "top": 0.07, "height": 0.26}),
    "prism": Family(_prism, {"radius": 0.13, "height": 0.24}),
    "bottle": Family(_bottle, {"radius": 0.08, "height": 0.32, "neck": 0.03}),
    "mug": Family(_mug, {"radius": 0.10, "height": 0.22, "wall": 0.015}),
    "bowl": Family(_bowl, {"radius": 0.18, "wall": 0.018}),
    "pan": Family(_pan, {"radius": 0.15, "height": 0.06, "wall": 0.015, "handle": 0.20}),
    "ring": Family(_ring, {"radius": 0.14, "thickness": 0.06}),
    "tube": Family(_tube, {"radius": 0.10, "wall": 0.02, "height": 0.26}),
    "plate": Family(_plate, {"length": 0.34, "width": 0.24, "thickness": 0.025}),
    "bracket": Family(_bracket, {"length": 0.28, "height": 0.22, "width": 0.14, "thickness": 0.04}),
    "cross": Family(_cross, {"length": 0.30, "width": 0.10, "thickness": 0.10}),
}
