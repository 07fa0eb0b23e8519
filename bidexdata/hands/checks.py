"""Does a hand's spec fit its model? One function per thing that specs get wrong.

Every check looks at the assembled hand and its compiled model, not at the code that made it, and
names the key of the spec to change. Limits are ours; they are wider than what the hands that come
with the package need.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bidexdata.frames import apply
from bidexdata.hands.findings import Finding, worst
from bidexdata.hands.geometry import Shape, body_shapes, depth, surface_samples
from bidexdata.hands.kinematics import hand_points
from bidexdata.hands.model import FloatArray, Hand
from bidexdata.hands.tree import HandTree

if TYPE_CHECKING:
    import mujoco

    from bidexdata.hands.spec import HandSpec

PAD_ERROR = 0.0025
"""Largest difference between a pad and its contact sphere in the pad's direction [m]."""
PAD_BEYOND = 0.005
"""So far beyond the pad along its normal there is nothing of its body any more [m]."""
CLOSING = 0.002
"""Contact points that move less between the two postures say nothing about closing [m]."""
PALM_ERROR = 0.006
"""Largest distance of the palm frame's origin from the palm's surface [m]."""
COVER = 0.006
"""Surface this near to a sphere is covered [m]."""
LEAST_COVER = 0.7
"""Least share of a body's surface that is covered [-]."""
SMALL = 5e-4
"""Bodies with less surface need no sphere [m^2]."""
PROTRUSION = 0.012
"""Farthest that a sphere may stand out of its body [m]: a smallest sphere on a plate does."""


def check_limits(spec: HandSpec, side: str, tree: HandTree) -> Finding:
    """Joint limits are a range in radians and hold both postures."""
    prefix = spec.sides[side].prefix
    faults = []
    for name, low, high in zip(tree.joint_names, tree.joint_lower, tree.joint_upper, strict=True):
        joint = name.removeprefix(prefix)
        if not low < high:
            faults.append(f"{side} {joint}: the model's range [{low:g}, {high:g}] is empty")
        elif high - low > 2 * np.pi:
            faults.append(
                f"{side} {joint}: the model's range [{low:g}, {high:g}] is more than a turn; are "
                "these degrees? (MJCF: compiler angle)"
            )
        if side != spec.written_for:
            continue
        for posture in ("open", "curved"):
            named = getattr(spec.postures, posture)
            angle = named.get(joint, 0.0)
            if not low <= angle <= high:
                given = f"is {angle:g}" if joint in named else "is not named, so 0"
                faults.append(
                    f"postures.{posture}: {joint} {given}, outside its limits [{low:.3g}, "
                    f"{high:.3g}] rad"
                )
    count = len(tree.joint_names)
    return worst("limits", faults, f"{side}: {count} joints, both postures within their limits")


def check_armature(hand: Hand, model: mujoco.MjModel) -> Finding:
    """Every joint has the inertia of its motor."""
    without = [n for n, inertia in zip(hand.joint_names, model.dof_armature, strict=True)
               if not inertia > 0]  # fmt: skip
    if without:
        count = f"{len(without)} of {len(hand.joint_names)} joints"
        return Finding(
            "armature",
            False,
            f"{hand.side}: {count} have no armature ({without[0]} ...), and fingers without their "
            "motors' inertia throw light objects; give joint_armature [kg m^2], the rotor's inertia "
            "times the gear ratio squared (hands: 2e-4 to 2e-3)",
        )
    low, high = model.dof_armature.min(), model.dof_armature.max()
    span = f"{low:.2g}" if low == high else f"{low:.2g} to {high:.2g}"
    return Finding("armature", True, f"{hand.side}: {span} kg m^2 a joint")


def check_palm(hand: Hand, model: mujoco.MjModel) -> Finding:
    """The palm frame lies on the palm and faces what the fingers close on."""
    shapes = body_shapes(model)[0]
    origin, z = hand.T_hand_palm[:3, 3], hand.T_hand_palm[:3, 2]
    T_palm_hand = np.linalg.inv(hand.T_hand_palm)
    ahead = [
        apply(T_palm_hand, hand_points(hand, q).contact[: hand.fingertips])[:, 2].mean()
        for q in (hand.posture_open, hand.posture_curved)
    ]
    faults = []
    if shapes:
        off = float(depth(shapes, origin[None])[0])
        out = float(depth(shapes, (origin + 0.02 * z)[None])[0])
        if abs(off) > PALM_ERROR:
            where = "inside" if off > 0 else "off"
            faults.append(
                f"palm_frame.pos lies {1e3 * abs(off):.1f} mm {where} the root body's surface; put "
                "it on the palm"
            )
        elif out > 0:
            faults.append("palm_frame.z points into the root body; it must lead out of the palm")
    if min(ahead) <= 0:
        faults.append(
            "the fingertips' contact points lie behind the palm in a posture; palm_frame.z must point to the "
            "side on which the fingers close"
        )
    fine = f"fingertips {1e3 * min(ahead):.0f} mm ahead of the palm in the mean"
    return worst("palm", [f"{hand.side}: {f}" for f in faults], f"{hand.side}: {fine}")


def check_contacts(hand: Hand, model: mujoco.MjModel) -> Finding:
    """Contact spheres lie on pads, their normals lead out, and closing moves them that way."""
    shapes = body_shapes(model)
    start, end = (hand_points(hand, q) for q in (hand.posture_open, hand.posture_curved))
    faults, largest = [], 0.0
    for c, name in enumerate(hand.contact_names):
        where = f"{hand.side} contact {name}"
        body = hand.body_names[hand.contact_body[c]]
        own, pos = shapes[hand.contact_body[c]], hand.contact_pos[c]
        radius, normal = float(hand.contact_radius[c]), hand.contact_normal[c]
        finger = hand.contact_finger[c]
        if finger and body not in hand.fingers[finger]:
            faults.append(f"{where}: body {body} is none of finger {finger}")
            continue
        if not own:
            faults.append(f"{where}: body {body} has no collision geometry to touch with")
            continue
        error = pad_error(own, pos, radius, normal)
        largest = max(largest, abs(error))
        beyond = float(depth(own, (pos + (radius + PAD_BEYOND) * normal)[None])[0])
        if depth(own, pos[None])[0] < 0:
            faults.append(f"{where}: its centre (pos) lies outside the body {body}")
        elif abs(error) > PAD_ERROR:
            which = "stands out of" if error > 0 else "lies inside"
            faults.append(
                f"{where}: the sphere {which} the pad by {1e3 * abs(error):.1f} mm along its normal; "
                "change pos, radius or normal"
            )
        elif beyond > 0:
            faults.append(f"{where}: its normal leads through the body {body} instead of out of it")
        moved = end.contact[c] - start.contact[c]
        along = float(moved @ start.normal[c])
        if np.linalg.norm(moved) > CLOSING and along < 0:
            faults.append(
                f"{where}: from the open to the curved posture it moves away from where its normal "
                "points; turn the normal or swap the postures"
            )
    fine = f"{len(hand.contact_names)} on their pads to {1e3 * largest:.1f} mm"
    return worst("contacts", faults, f"{hand.side}: {fine}")


def pad_error(shapes: list[Shape], pos: FloatArray, radius: float, normal: FloatArray) -> float:
    """How far a contact sphere stands out of its pad in the pad's direction [m].

    A plane that comes along the normal touches the body at its support; the sphere says where the
    optimiser thinks that is.

    Args:
        shapes: Of the body.
        pos: Centre of the sphere in the body's frame [m], (3,).
        radius: [m].
        normal: Unit, body frame, (3,).
    """
    near = []
    for shape in shapes:
        points = shape.vertices @ shape.R.T + shape.pos
        # The plane meets the pad, not what stands out elsewhere on the body.
        beside = points - pos - ((points - pos) @ normal)[:, None] * normal
        near.append(points[np.linalg.norm(beside, axis=1) <= 2 * radius])
    found = np.concatenate(near)
    surface = float(depth_along(shapes, pos, normal))
    support = float(((found - pos) @ normal).max(initial=surface))
    # A flat or round pad has its support under the normal, a corner beside it: either is right.
    return min((radius - support, radius - surface), key=abs)


def depth_along(shapes: list[Shape], start: FloatArray, direction: FloatArray) -> float:
    """Way from a point inside the shapes along a unit vector to where it leaves them [m]."""
    steps = np.linspace(0.0, 0.1, 401)
    inside = depth(shapes, start + steps[:, None] * direction) > 0
    return float(steps[np.argmin(inside)]) if not inside.all() else float(steps[-1])


def check_spheres(hand: Hand, model: mujoco.MjModel) -> Finding:
    """Collision spheres cover the collision geometry and do not stand out of it."""
    faults, least, farthest = [], 1.0, 0.0
    pads = hand.fingertips
    for body, shapes in enumerate(body_shapes(model)):
        mine = np.flatnonzero(hand.sphere_body == body)
        name = f"{hand.side} {hand.body_names[body]}"
        fitted = mine[mine >= pads]
        if not shapes:
            continue
        share = covered(shapes, hand.sphere_pos[mine], hand.sphere_radius[mine])
        if share is not None:
            least = min(least, share)
        if share is not None and share < LEAST_COVER:
            faults.append(
                f"{name}: spheres cover {100 * share:.0f} % of its collision geometry; lower "
                "spheres.min_radius, spheres.thin or spheres.worth"
            )
        if len(fitted):
            out = hand.sphere_radius[fitted] - depth(shapes, hand.sphere_pos[fitted])
            farthest = max(farthest, float(out.max()))
            if out.max() > PROTRUSION:
                faults.append(
                    f"{name}: a sphere stands {1e3 * out.max():.0f} mm out of its collision "
                    "geometry; lower spheres.protrusion, spheres.min_radius or spheres.max_radius"
                )
    fine = (
        f"{len(hand.sphere_body)} cover at least {100 * least:.0f} % of each body, at most "
        f"{1e3 * farthest:.1f} mm out"
    )
    return worst("spheres", faults, f"{hand.side}: {fine}")


def covered(shapes: list[Shape], centres: FloatArray, radius: FloatArray) -> float | None:
    """Share of the surface that spheres come within `COVER` of; None for a body of no size.

    Args:
        shapes: Of one body.
        centres: Of its spheres, body frame [m], (k, 3).
        radius: [m], (k,).
    """
    points, area = surface_samples(shapes, COVER)
    if area.sum() < SMALL:
        return None
    if not len(centres):
        return 0.0
    gap = np.linalg.norm(points[:, None] - centres, axis=2) - radius
    return float(area[gap.min(axis=1) < COVER].sum() / area.sum())
