"""BimanGrasp's energies and its annealing as kernels. Axes: N grasps, M contact places, P points.

Every sum is made by one thread in one order, so the bytes repeat. The float64 reference of the
energies is in `bimangrasp_energies.py`.
"""

import warp as wp

from bidexdata.objects.distance_field_kernels import DistanceField, signed_distance

# Loops of 12 x 15 x 18 steps would become that many lines.
wp.set_module_options({"enable_backward": False, "max_unroll": 0})

mat66d = wp.types.matrix(shape=(6, 6), dtype=wp.float64)
vec6d = wp.types.vector(length=6, dtype=wp.float64)

SWEEPS = wp.constant(12)
# Off-diagonal entries of this share of the diagonal's count as zero.
SMALL = wp.constant(wp.float64(1.0e-15))
# The square of `LEAST_SINGULAR`.
LEAST_SQUARED = wp.constant(wp.float64(1.0e-12))
TINY = wp.constant(1.0e-9)
# Distances of the field may be off by this share of the object's size near its surface.
FIELD_ERROR = wp.constant(0.02)
# Terms in the order of `Terms`: fc, dis, pen, spen, joints, vew.
FC = wp.constant(0)
DIS = wp.constant(1)
PEN = wp.constant(2)
SPEN = wp.constant(3)
JOINTS = wp.constant(4)
VEW = wp.constant(5)


@wp.kernel
def gather_contacts(
    # Problem in: candidate number of each contact, and all candidates
    index_in: wp.array2d[int],
    centres_in: wp.array2d[wp.vec3],
    # Problem out:
    chosen_out: wp.array2d[wp.vec3],
):
    """Take the chosen contacts (N, H c) out of all candidates; hand h has its own half of M."""
    grasp, i = wp.tid()
    h = i // (index_in.shape[1] // 2)
    place = h * (centres_in.shape[1] // 2) + index_in[grasp, i]
    chosen_out[grasp, i] = centres_in[grasp, place]


@wp.kernel
def scatter_contacts(
    # Problem in:
    index_in: wp.array2d[int],
    gradient_in: wp.array2d[wp.vec3],
    # Problem out:
    gradient_inout: wp.array2d[wp.vec3],
):
    """Add the gradients of the chosen contacts to their candidates'."""
    grasp = wp.tid()
    for i in range(index_in.shape[1]):
        h = i // (index_in.shape[1] // 2)
        place = h * (gradient_inout.shape[1] // 2) + index_in[grasp, i]
        gradient_inout[grasp, place] = gradient_inout[grasp, place] + gradient_in[grasp, i]


@wp.func
def wrench_column(p: wp.vec3, n: wp.vec3) -> vec6d:
    """Wrench of a unit force along n at p."""
    t = wp.cross(p, n)
    return vec6d(
        wp.float64(n[0]),
        wp.float64(n[1]),
        wp.float64(n[2]),
        wp.float64(t[0]),
        wp.float64(t[1]),
        wp.float64(t[2]),
    )


@wp.func
def eigen(gram: mat66d):
    """Eigenvalues of a symmetric matrix on a diagonal, and eigenvectors as columns (Jacobi)."""
    s = gram
    v = wp.identity(n=6, dtype=wp.float64)
    one = wp.float64(1.0)
    for _sweep in range(SWEEPS):
        for a in range(5):
            for b in range(a + 1, 6):
                if wp.abs(s[a, b]) > SMALL * wp.sqrt(wp.abs(s[a, a] * s[b, b])):
                    theta = (s[b, b] - s[a, a]) / (wp.float64(2.0) * s[a, b])
                    t = one / (wp.abs(theta) + wp.sqrt(theta * theta + one))
                    if theta < wp.float64(0.0):
                        t = -t
                    c = one / wp.sqrt(t * t + one)
                    z = t * c
                    for k in range(6):
                        left = s[k, a]
                        right = s[k, b]
                        s[k, a] = c * left - z * right
                        s[k, b] = z * left + c * right
                    for k in range(6):
                        left = s[a, k]
                        right = s[b, k]
                        s[a, k] = c * left - z * right
                        s[b, k] = z * left + c * right
                    for k in range(6):
                        left = v[k, a]
                        right = v[k, b]
                        v[k, a] = c * left - z * right
                        v[k, b] = z * left + c * right
    return s, v


@wp.kernel
def wrench_terms(
    # Energy:
    weight_fc: float,
    weight_vew: float,
    weight_dis: float,
    # Problem in:
    points_in: wp.array2d[wp.vec3],
    normals_in: wp.array2d[wp.vec3],
    distance_in: wp.array2d[float],
    slope_in: wp.array2d[wp.vec3],
    # Problem out:
    terms_out: wp.array2d[float],
    gradient_out: wp.array2d[wp.vec3],
):
    """E_fc, E_vew and E_dis of the chosen contacts, and their gradient with normals held."""
    grasp = wp.tid()
    gram = mat66d()
    for i in range(points_in.shape[1]):
        w = wrench_column(points_in[grasp, i], normals_in[grasp, i])
        gram = gram + wp.outer(w, w)
    s, v = eigen(gram)
    top = wp.int32(0)
    low = wp.int32(0)
    logs = wp.float64(0.0)
    for a in range(6):
        if s[a, a] > s[top, top]:
            top = a
        if s[a, a] < s[low, low]:
            low = a
        logs += wp.float64(0.5) * wp.log(wp.max(s[a, a], LEAST_SQUARED))
    large = wp.sqrt(wp.max(s[top, top], LEAST_SQUARED))
    small = wp.sqrt(wp.max(s[low, low], LEAST_SQUARED))
    cond = large / small
    vew = wp.exp(-logs / wp.float64(10.0))
    terms_out[grasp, FC] = float(wp.log(cond + wp.float64(1.0)) / wp.float64(10.0))
    terms_out[grasp, VEW] = float(vew)
    by_cond = wp.float64(weight_fc) / (wp.float64(10.0) * (cond + wp.float64(1.0)))
    by_logs = -wp.float64(weight_vew) * vew / wp.float64(10.0)
    distance = float(0.0)
    for i in range(points_in.shape[1]):
        p = points_in[grasp, i]
        n = normals_in[grasp, i]
        w = wrench_column(p, n)
        # d sigma / d column = (u . column) / sigma u; the sum of logs has them all.
        g = vec6d()
        for a in range(6):
            u = vec6d(v[0, a], v[1, a], v[2, a], v[3, a], v[4, a], v[5, a])
            along = wp.dot(u, w)
            size = wp.max(s[a, a], LEAST_SQUARED)
            g = g + (by_logs * along / size) * u
            if a == top:
                g = g + (by_cond * along / (large * small)) * u
            if a == low:
                g = g - (by_cond * cond * along / (small * small)) * u
        torque = wp.vec3(float(g[3]), float(g[4]), float(g[5]))
        distance += wp.abs(distance_in[grasp, i])
        pull = weight_dis * wp.sign(distance_in[grasp, i]) * slope_in[grasp, i]
        gradient_out[grasp, i] = pull + wp.cross(n, torque)
    terms_out[grasp, DIS] = distance


@wp.kernel
def spheres_at_surface(
    # Hand:
    radius: wp.array[float],
    # Object:
    field: DistanceField,
    size: wp.array[float],
    # Problem in:
    spheres_in: wp.array2d[wp.vec3],
    # Problem out:
    near_out: wp.array2d[int],
    count_out: wp.array[int],
):
    """List the spheres that surface points of the object can lie in; saves time, changes nothing."""
    grasp = wp.tid()
    count = wp.int32(0)
    for k in range(radius.shape[0]):
        d = wp.abs(signed_distance(field, size[grasp], spheres_in[grasp, k])[0])
        if d < radius[k] + FIELD_ERROR * size[grasp]:
            near_out[grasp, count] = k
            count += 1
    count_out[grasp] = count


@wp.kernel
def points_in_hand(
    # Hand:
    radius: wp.array[float],
    # Problem in: the first count of the listed spheres, which hold all points that are in any
    near_in: wp.array2d[int],
    count_in: wp.array[int],
    points_in: wp.array2d[wp.vec3],
    spheres_in: wp.array2d[wp.vec3],
    low_in: wp.array[wp.vec3],
    high_in: wp.array[wp.vec3],
    # Problem out:
    owner_out: wp.array2d[int],
):
    """The sphere that each point is deepest in; -1 outside all."""
    grasp, i = wp.tid()
    x = points_in[grasp, i]
    owner = wp.int32(-1)
    if wp.length_sq(x - wp.min(wp.max(x, low_in[grasp]), high_in[grasp])) == 0.0:
        deepest = float(0.0)
        for j in range(count_in[grasp]):
            k = near_in[grasp, j]
            offset = x - spheres_in[grasp, k]
            squared = wp.length_sq(offset)
            if squared < radius[k] * radius[k]:
                depth = radius[k] - wp.sqrt(squared)
                if depth > deepest:
                    deepest = depth
                    owner = k
    owner_out[grasp, i] = owner


@wp.kernel
def push_hand(
    # Hand:
    radius: wp.array[float],
    # Energy:
    weight: float,
    term: int,
    # Problem in:
    owner_in: wp.array2d[int],
    points_in: wp.array2d[wp.vec3],
    spheres_in: wp.array2d[wp.vec3],
    # Problem out:
    terms_inout: wp.array2d[float],
    gradient_inout: wp.array2d[wp.vec3],
):
    """Sum the depths of the points in a hand; adds to the spheres' gradient."""
    grasp = wp.tid()
    total = float(0.0)
    for i in range(points_in.shape[1]):
        k = owner_in[grasp, i]
        if k >= 0:
            offset = points_in[grasp, i] - spheres_in[grasp, k]
            d = wp.length(offset)
            total += radius[k] - d
            push = (weight / wp.max(d, TINY)) * offset
            gradient_inout[grasp, k] = gradient_inout[grasp, k] + push
    terms_inout[grasp, term] = terms_inout[grasp, term] + total


@wp.kernel
def push_points(
    # Energy:
    weight: float,
    # Problem in:
    owner_in: wp.array2d[int],
    points_in: wp.array2d[wp.vec3],
    spheres_in: wp.array2d[wp.vec3],
    # Problem out:
    gradient_inout: wp.array2d[wp.vec3],
):
    """The same with respect to the points, where they move."""
    grasp, i = wp.tid()
    k = owner_in[grasp, i]
    if k >= 0:
        offset = points_in[grasp, i] - spheres_in[grasp, k]
        push = (-weight / wp.max(wp.length(offset), TINY)) * offset
        gradient_inout[grasp, i] = gradient_inout[grasp, i] + push


@wp.kernel
def near_keypoints(
    # Hand:
    pairs: wp.array2d[int],
    # Energy:
    weight: float,
    reach: float,
    # Problem in:
    centres_in: wp.array2d[wp.vec3],
    # Problem out:
    terms_inout: wp.array2d[float],
    gradient_inout: wp.array2d[wp.vec3],
):
    """Sum how much nearer than `reach` pairs of a hand's spheres are, both ways round."""
    grasp = wp.tid()
    total = float(0.0)
    for p in range(pairs.shape[0]):
        a = pairs[p, 0]
        b = pairs[p, 1]
        offset = centres_in[grasp, a] - centres_in[grasp, b]
        squared = wp.length_sq(offset)
        if squared < reach * reach:
            d = wp.sqrt(squared)
            total += 2.0 * (reach - d)
            push = (-2.0 * weight / wp.max(d, TINY)) * offset
            gradient_inout[grasp, a] = gradient_inout[grasp, a] + push
            gradient_inout[grasp, b] = gradient_inout[grasp, b] - push
    terms_inout[grasp, SPEN] = terms_inout[grasp, SPEN] + total


@wp.kernel
def beyond_limits(
    # Hand:
    lower: wp.array[float],
    upper: wp.array[float],
    # Energy:
    weight: float,
    # Problem in:
    joints_in: wp.array2d[float],
    # Problem out:
    terms_inout: wp.array2d[float],
    gradient_inout: wp.array2d[float],
):
    """Sum how far free variables are beyond their limits; adds to the hand's gradient."""
    grasp = wp.tid()
    total = float(0.0)
    for d in range(joints_in.shape[1]):
        over = joints_in[grasp, d] - upper[d]
        under = lower[d] - joints_in[grasp, d]
        if over > 0.0:
            total += over
            gradient_inout[grasp, 6 + d] = gradient_inout[grasp, 6 + d] + weight
        if under > 0.0:
            total += under
            gradient_inout[grasp, 6 + d] = gradient_inout[grasp, 6 + d] - weight
    terms_inout[grasp, JOINTS] = terms_inout[grasp, JOINTS] + total
