"""Warp kernels of the regions: who belongs to one, and how close two come to each other."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def region_members_kernel(
    # Surface in farthest-point order:
    points: wp.array[wp.vec3],
    normals: wp.array[wp.vec3],
    radius: float,
    same_side: float,
    # Out:
    members_out: wp.array2d[int],
    filled_out: wp.array[int],
):
    """List the first points near each anchor on its sheet, repeated until all places are full."""
    a = wp.tid()
    # An anchor is in its own region even if a duplicate point or a needle's normal is not.
    found = int(0)  # noqa: RUF046  (Warp: a variable that a loop changes)
    for i in range(points.shape[0]):
        d = points[i] - points[a]
        near = wp.dot(d, d) <= radius * radius
        if i == a or (near and wp.dot(normals[i], normals[a]) > same_side):
            members_out[a, found] = i
            found += 1
            if found == members_out.shape[1]:
                break
    filled_out[a] = found
    for j in range(found, members_out.shape[1]):
        members_out[a, j] = members_out[a, j - found]


@wp.kernel
def regions_apart_kernel(
    # Regions:
    points: wp.array2d[wp.vec3],
    anchors: wp.array[wp.vec3],
    reach: wp.array[float],
    # Pairs in:
    pairs_in: wp.array2d[int],
    gap: float,
    # Out:
    apart_out: wp.array[int],
):
    """Tell for each pair whether no two points of its regions are nearer than the gap."""
    pair = wp.tid()
    a = pairs_in[pair, 0]
    b = pairs_in[pair, 1]
    apart = int(1)  # noqa: RUF046  (Warp: a variable that a loop changes)
    # Only points of a that come near b's anchor can come near one of b's points.
    bound = (gap + reach[b]) * (gap + reach[b])
    for i in range(points.shape[1]):
        p = points[a, i]
        to_b = p - anchors[b]
        if apart == 1 and wp.dot(to_b, to_b) < bound:
            for j in range(points.shape[1]):
                d = p - points[b, j]
                if wp.dot(d, d) < gap * gap:
                    apart = 0
                    break
    apart_out[pair] = apart
