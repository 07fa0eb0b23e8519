"""Mass properties of closed triangle meshes, and the poses in which a solid rests."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.frames import quat_canonical, quat_from_rotation_vector
from bidexdata.objects.config import RestConfig
from bidexdata.objects.facets import Facets, adjacency, facets
from bidexdata.objects.prepared import TriangleMesh


class MassProperties(NamedTuple):
    """Volume, centre of mass (3,) and inertia (3, 3) about it at unit density."""

    volume: float
    centre: NDArray[np.float64]
    inertia: NDArray[np.float64]


class RestPoses(NamedTuple):
    """Orientations (K, 4) wxyz, heights of the origin over the table (K,), probabilities (K,)."""

    quats_wxyz: NDArray[np.float64]
    heights: NDArray[np.float64]
    probabilities: NDArray[np.float64]


def mass_properties(mesh: TriangleMesh) -> MassProperties:
    """Integrate volume, centre of mass and inertia of a closed mesh, exactly for its triangles.

    Each face spans a tetrahedron with the origin whose moments are known in closed form; signed
    sums over the surface leave the moments of the inside. Inward faces give a negative volume.
    """
    # Moments about a point near the mesh: far from the origin the signed sums cancel badly.
    shift = mesh.vertices.mean(axis=0) if len(mesh.vertices) else np.zeros(3)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] - shift for k in range(3))
    det = np.einsum("ni,ni->n", a, np.cross(b, c))
    volume = float(det.sum() / 6)
    if volume == 0:
        return MassProperties(0.0, shift, np.zeros((3, 3)))
    corners = a + b + c
    centre = (det[:, None] * corners).sum(axis=0) / 24 / volume
    second = np.einsum("n,ni,nj->ij", det, corners, corners)
    for corner in (a, b, c):
        second += np.einsum("n,ni,nj->ij", det, corner, corner)
    second = second / 120 - volume * np.outer(centre, centre)
    inertia = np.trace(second) * np.eye(3) - (second + second.T) / 2
    return MassProperties(volume, centre + shift, inertia)


def surface_area(mesh: TriangleMesh) -> float:
    """Sum of the areas of all faces."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def rest_poses(hull: TriangleMesh, config: RestConfig) -> RestPoses:
    """Find the poses in which a convex body with its centre of mass at the origin rests.

    A facet of the hull carries the body when the centre of mass is over it. A body that lands on
    another facet topples over the edge that the centre of mass is beyond, until a facet carries
    it; every step lowers the centre of mass, so this ends. The probability to land on a facet is
    the solid angle under which it is seen from the centre of mass.

    Args:
        hull: Convex hull in the object frame, faces outward.
        config: Bounds on number and probability.
    """
    groups = facets(hull, config.coplanar)
    count = len(groups.normals)
    share = np.bincount(groups.of_face, weights=solid_angles(hull), minlength=count) / (4 * np.pi)
    probability = np.zeros(count)
    np.add.at(probability, _topple(hull, groups), share)
    # Equal probabilities (a box) keep a fixed order by rounding before the stable sort.
    order = np.argsort(-np.round(probability, 9), kind="stable")[: config.max_poses]
    order = order[probability[order] >= config.min_probability]
    quats = np.array([_facing_down(groups.normals[f]) for f in order]).reshape(-1, 4)
    return RestPoses(quats, groups.offsets[order], probability[order])


def _topple(hull: TriangleMesh, groups: Facets) -> NDArray[np.int64]:
    """For every facet the facet on which a body that lands there comes to rest."""
    of_face, normals, offsets = groups
    first, second, edges = adjacency(hull.faces)
    border = of_face[first] != of_face[second]
    sides = [
        (of_face[first[border]], of_face[second[border]], edges[border]),
        (of_face[second[border]], of_face[first[border]], edges[border][:, ::-1]),
    ]
    beyond = np.full(len(normals), 0.0)
    into = np.arange(len(normals))
    for own, other, edge in sides:
        start, end = hull.vertices[edge[:, 0]], hull.vertices[edge[:, 1]]
        along = (end - start) / np.maximum(np.linalg.norm(end - start, axis=1), 1e-300)[:, None]
        inward = np.cross(normals[own], along)
        # Signed distance of the projected centre of mass (the origin) beyond this edge.
        outside = np.einsum("ni,ni->n", inward, start)
        for facet, neighbour, distance in zip(own, other, outside, strict=True):
            if distance > beyond[facet] and offsets[neighbour] < offsets[facet]:
                beyond[facet], into[facet] = distance, neighbour
    for _ in range(len(into)):
        further = into[into]
        if np.array_equal(further, into):
            break
        into = further
    return into


def solid_angles(mesh: TriangleMesh) -> NDArray[np.float64]:
    """Solid angle [sr] of every face seen from the origin (Van Oosterom and Strackee, 1983)."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    det = np.einsum("ni,ni->n", a, np.cross(b, c))
    dot = np.einsum
    below = la * lb * lc + dot("ni,ni->n", a, b) * lc
    below = below + dot("ni,ni->n", b, c) * la + dot("ni,ni->n", c, a) * lb
    return 2 * np.arctan2(det, below)


def _facing_down(normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Shortest rotation that turns `normal` to -z; a half turn about x when it is +z."""
    down = np.array([0.0, 0.0, -1.0])
    axis = np.cross(normal, down)
    sine, cosine = np.linalg.norm(axis), float(normal @ down)
    if sine < 1e-9:
        return quat_canonical([1.0, 0, 0, 0] if cosine > 0 else [0.0, 1.0, 0, 0])
    return quat_from_rotation_vector(axis / sine * np.arctan2(sine, cosine))
