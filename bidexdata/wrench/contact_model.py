"""Point contacts with friction: frames, grasp matrices, cones and the exact projection onto them.

Everything is in one frame, normally the object frame; normals point INTO the object. A contact
pushes along its normal with at most `cap` and resists sliding with at most `mu` times that.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from bidexdata.frames import rotation_with_z

# Below this length a tangential force has no direction [units of the force].
_TINY = 1e-12


def contact_frames(normals: Float[np.ndarray, "*b 3"]) -> Float[np.ndarray, "*b 3 3"]:
    """Complete inward unit normals to right-handed frames.

    Args:
        normals: Unit normals pointing into the object.

    Returns:
        R with columns (n, d, e), n = d x e, defined for every direction of n.

    Source:
        BiDexGrasp, appendix A, contact model; the choice of d is ours (its torsion is free).
    """
    # (d, e, n) with n last becomes (n, d, e).
    return np.ascontiguousarray(np.roll(rotation_with_z(normals), 1, axis=-1))


def grasp_matrix(
    points: Float[np.ndarray, "*b C 3"], frames: Float[np.ndarray, "*b C 3 3"]
) -> Float[np.ndarray, "*b C 6 3"]:
    """Map a force in the contact's frame to the wrench it exerts on the object at the origin.

    Args:
        points: Contact points [m].
        frames: Columns (n, d, e) from `contact_frames`.

    Returns:
        G with w = G f; rows force [N], torque [N m].

    Source:
        BiDexGrasp, appendix A, contact model.
    """
    R = np.asarray(frames, np.float64)
    torque = np.cross(np.asarray(points, np.float64)[..., :, None], R, axis=-2)
    return np.concatenate([R, torque], axis=-2)


def wrench_of(
    points: Float[np.ndarray, "*b C 3"], forces: Float[np.ndarray, "*b C 3"]
) -> Float[np.ndarray, "*b 6"]:
    """Sum the wrenches at the origin of forces given as vectors: force [N], torque [N m]."""
    torque = np.cross(points, forces)
    return np.concatenate([np.sum(forces, axis=-2), np.sum(torque, axis=-2)], axis=-1)


def split_force(
    forces: Float[np.ndarray, "*b 3"], normals: Float[np.ndarray, "*b 3"]
) -> tuple[Float[np.ndarray, "*b"], Float[np.ndarray, "*b 3"]]:
    """Split forces into their normal component and their tangential vector [N]."""
    f_n = np.asarray(np.einsum("...i,...i->...", forces, normals))
    return f_n, forces - f_n[..., None] * normals


def cone_violation(
    forces: Float[np.ndarray, "*b 3"],
    normals: Float[np.ndarray, "*b 3"],
    *,
    mu: float,
    cap: float = 1.0,
) -> Float[np.ndarray, "*b"]:
    """Measure how far forces leave {0 <= f_n <= cap, |f_t| <= mu f_n}: the largest excess [N]."""
    f_n, f_t = split_force(forces, normals)
    slide = np.linalg.norm(f_t, axis=-1) - mu * f_n
    return np.asarray(np.maximum(np.maximum(-f_n, f_n - cap), np.maximum(slide, 0.0)))


def project_to_cone(
    forces: Float[np.ndarray, "*b 3"],
    normals: Float[np.ndarray, "*b 3"],
    *,
    mu: float,
    cap: float = 1.0,
) -> Float[np.ndarray, "*b 3"]:
    """Return the closest forces with 0 <= f_n <= cap and |f_t| <= mu f_n.

    Exact: the closest point of the unbounded cone, or, where that presses harder than `cap`, the
    closest point of the disc that closes the cone.
    """
    f_n, f_t = split_force(np.asarray(forces, np.float64), normals)
    slide = np.linalg.norm(f_t, axis=-1)
    on_mantle = (f_n + mu * slide) / (1.0 + mu * mu)
    pressed = np.clip(np.where(slide <= mu * f_n, f_n, on_mantle), 0.0, cap)
    # |f_t| may not exceed mu times the pressure; inside the cone it already does not.
    kept = np.minimum(1.0, mu * pressed / np.maximum(slide, _TINY))
    return pressed[..., None] * normals + kept[..., None] * f_t
