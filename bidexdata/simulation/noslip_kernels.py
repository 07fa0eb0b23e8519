"""Warp kernel of the noslip pass: friction forces without regularisation, normal forces kept.

The pass minimises 0.5 f'Af + b'f over the friction forces, A = J M^-1 J', one row of dry joint
friction or one contact after the other. MuJoCo first writes down A, which costs more than all else
in a step. With M = L'DL, A is B B' for B = J L^-1 D^-1/2, and a row of B is zero but on the
ancestors of what it touches. So we keep B and y = B'f, and never form A but for the 3x3 block of
each contact.

Source:
    MuJoCo, documentation ("Computation", noslip solver), whose result this is.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

# Newton's method on the multiplier: at most so many steps (3 or 4 are usual), to this share of the
# normal force.
NEWTON_STEPS = wp.constant(20)
NEWTON_TOLERANCE = wp.constant(wp.float64(1.0e-12))
# A 3x3 matrix counts as singular when its determinant is below this share of its diagonal's product.
SINGULAR = wp.constant(wp.float64(1.0e-14))
# As in the engine: a normal force [N] below TINY has no friction, and a block that would raise the
# cost by more than COST_TOLERANCE (rounding, a singular block) keeps its forces.
TINY = wp.constant(wp.float64(1.0e-15))
COST_TOLERANCE = wp.constant(wp.float64(1.0e-10))


@wp.struct
class Factor:
    """M = L'DL of the joint-space inertia, sparse by rows; a row holds ancestors, diagonal last."""

    values: wp.array[wp.float64]
    inverse_diagonal: wp.array[wp.float64]
    """Of D, (nv,)."""
    start: wp.array[wp.int32]
    count: wp.array[wp.int32]
    column: wp.array[wp.int32]


@wp.struct
class Rows:
    """Constraint rows of one step; first equalities, then dry friction, limits and contacts."""

    sizes: wp.array[wp.int32]
    """Numbers of equality rows, of rows of dry friction, of all rows, of contacts, (4,)."""
    jacobian: wp.array[wp.float64]
    start: wp.array[wp.int32]
    count: wp.array[wp.int32]
    column: wp.array[wp.int32]
    bias: wp.array[wp.float64]
    """J qacc_smooth - aref."""
    regulariser: wp.array[wp.float64]
    friction_loss: wp.array[wp.float64]
    force: wp.array[wp.float64]
    """Before the pass."""
    contact_row: wp.array[wp.int32]
    """Row of each contact's normal force; -1 where it has none."""
    contact_friction: wp.array2d[wp.float64]
    """Sliding, sliding, spinning, (ncon, 5)."""


@wp.struct
class Scratch:
    """Room for the rows of B: those of dry friction, then three of each contact."""

    loss: wp.array2d[wp.float64]
    loss_dof: wp.array2d[wp.int32]
    loss_count: wp.array[wp.int32]
    loss_square: wp.array[wp.float64]
    block: wp.array2d[wp.vec3d]
    block_dof: wp.array2d[wp.int32]
    block_count: wp.array[wp.int32]
    block_square: wp.array[wp.mat33d]
    lane: wp.array[wp.vec3d]
    """Right-hand sides of a half solve, (nv,); zero between two."""
    marked: wp.array[wp.int32]
    """Degrees of freedom that they reach, (nv,); zero between two."""
    y: wp.array[wp.float64]
    """B'f, (nv,)."""


@wp.func
def solve3(
    a: wp.float64,
    b: wp.float64,
    c: wp.float64,
    d: wp.float64,
    e: wp.float64,
    f: wp.float64,
    rhs: wp.vec3d,
) -> wp.vec3d:
    """Solve with the positive matrix [[a, b, c], [b, d, e], [c, e, f]]; zero where singular."""
    p = d * f - e * e
    q = c * e - b * f
    r = b * e - c * d
    det = a * p + b * q + c * r
    if det <= SINGULAR * (a * d * f):
        return wp.vec3d()
    s = a * f - c * c
    t = b * c - a * e
    u = a * d - b * b
    x, y, z = rhs[0], rhs[1], rhs[2]
    return wp.vec3d(p * x + q * y + r * z, q * x + s * y + t * z, r * x + t * y + u * z) / det


@wp.func
def friction_force(A: wp.mat33d, b: wp.vec3d, mu: wp.vec3d, normal: wp.float64) -> wp.vec3d:
    """Minimise 0.5 f'Af + b'f over |f / mu| <= normal.

    In u = f / mu the set is a ball: where the free minimum lies outside, the multiplier of the ball
    is found by Newton's method on 1/normal - 1/|u|, which is nearly linear in it.
    """
    b0, b1, b2 = mu[0] * b[0], mu[1] * b[1], mu[2] * b[2]
    rhs = wp.vec3d(-b0, -b1, -b2)
    a00, a11, a22 = mu[0] * mu[0] * A[0, 0], mu[1] * mu[1] * A[1, 1], mu[2] * mu[2] * A[2, 2]
    a01, a02, a12 = mu[0] * mu[1] * A[0, 1], mu[0] * mu[2] * A[0, 2], mu[1] * mu[2] * A[1, 2]
    u = solve3(a00, a01, a02, a11, a12, a22, rhs)
    size = wp.length(u)
    if size > normal:
        lift = wp.float64(0.0)
        for _ in range(NEWTON_STEPS):
            w = solve3(a00 + lift, a01, a02, a11 + lift, a12, a22 + lift, u)
            slope = wp.dot(u, w)
            if slope < TINY:
                break
            lift += size * size / slope * (size - normal) / normal
            u = solve3(a00 + lift, a01, a02, a11 + lift, a12, a22 + lift, rhs)
            size = wp.length(u)
            if size - normal < NEWTON_TOLERANCE * normal:
                break
        u *= normal / wp.max(size, TINY)
    return wp.cw_mul(mu, u)


@wp.func
def half_solve(M: Factor, i: int, lane: wp.array[wp.vec3d], marked: wp.array[wp.int32]):
    """Take degree of freedom i out of lane := L^-T lane; from the last to the first."""
    value = lane[i]
    start = M.start[i]
    for k in range(start, start + M.count[i] - 1):
        j = M.column[k]
        lane[j] = lane[j] - M.values[k] * value
        marked[j] = 1
    lane[i] = wp.vec3d()
    marked[i] = 0
    return value * wp.sqrt(M.inverse_diagonal[i])


@wp.func
def reach(M: Factor, rows: Rows, r: int) -> wp.vec2i:
    """Lowest and highest degree of freedom of which row r of B may depend."""
    first = rows.start[r]
    low = rows.column[first]
    return wp.vec2i(M.column[M.start[low]], rows.column[first + rows.count[r] - 1])


@wp.func
def fill_loss(M: Factor, rows: Rows, s: Scratch, i: int):
    """Row of B of dry friction number i."""
    r = rows.sizes[0] + i
    start = rows.start[r]
    for k in range(start, start + rows.count[r]):
        j = rows.column[k]
        s.lane[j] = wp.vec3d(rows.jacobian[k], wp.float64(0.0), wp.float64(0.0))
        s.marked[j] = 1
    count = int(0)  # noqa: RUF046  (Warp: a variable that a loop changes)
    square = wp.float64(0.0)
    ends = reach(M, rows, r)
    for back in range(ends[1] - ends[0] + 1):
        j = ends[1] - back
        if s.marked[j] != 0:
            value = half_solve(M, j, s.lane, s.marked)
            s.loss[i, count] = value[0]
            s.loss_dof[i, count] = j
            square += value[0] * value[0]
            count += 1
    s.loss_count[i] = count
    s.loss_square[i] = square


@wp.func
def fill_block(M: Factor, rows: Rows, s: Scratch, c: int):
    """Rows of B of the friction of contact number c, and their 3x3 block of A."""
    r = rows.contact_row[c] + 1
    start = rows.start[r]
    one = rows.start[r + 1] - start
    two = rows.start[r + 2] - start
    for k in range(start, start + rows.count[r]):
        j = rows.column[k]
        s.lane[j] = wp.vec3d(rows.jacobian[k], rows.jacobian[k + one], rows.jacobian[k + two])
        s.marked[j] = 1
    count = int(0)  # noqa: RUF046  (Warp: a variable that a loop changes)
    square = wp.mat33d()
    ends = reach(M, rows, r)
    for back in range(ends[1] - ends[0] + 1):
        j = ends[1] - back
        if s.marked[j] != 0:
            value = half_solve(M, j, s.lane, s.marked)
            s.block[c, count] = value
            s.block_dof[c, count] = j
            square += wp.outer(value, value)
            count += 1
    s.block_count[c] = count
    s.block_square[c] = square


@wp.func
def settle_loss(rows: Rows, s: Scratch, i: int, force_out: wp.array[wp.float64]) -> wp.float64:
    """Minimise over one row of dry friction; the change of cost."""
    r = rows.sizes[0] + i
    gradient = rows.bias[r]
    for k in range(s.loss_count[i]):
        gradient += s.loss[i, k] * s.y[s.loss_dof[i, k]]
    old = force_out[r]
    most = rows.friction_loss[r]
    square = s.loss_square[i]
    force = wp.clamp(old - gradient / wp.max(square, TINY), -most, most)
    change = force - old
    force_out[r] = force
    for k in range(s.loss_count[i]):
        j = s.loss_dof[i, k]
        s.y[j] = s.y[j] + change * s.loss[i, k]
    return change * (wp.float64(0.5) * change * square + gradient)


@wp.func
def settle_block(rows: Rows, s: Scratch, c: int, force_out: wp.array[wp.float64]) -> wp.float64:
    """Minimise over the friction of one contact; the change of cost."""
    r = rows.contact_row[c]
    normal = rows.force[r]
    gradient = wp.vec3d(rows.bias[r + 1], rows.bias[r + 2], rows.bias[r + 3])
    for k in range(s.block_count[c]):
        gradient += s.block[c, k] * s.y[s.block_dof[c, k]]
    old = wp.vec3d(force_out[r + 1], force_out[r + 2], force_out[r + 3])
    A = s.block_square[c]
    force = wp.vec3d()
    if normal >= TINY:
        mu = wp.vec3d(
            rows.contact_friction[c, 0], rows.contact_friction[c, 1], rows.contact_friction[c, 2]
        )
        force = friction_force(A, gradient - A * old, mu, normal)
    change = force - old
    cost = wp.dot(change, wp.float64(0.5) * (A * change) + gradient)
    if cost > COST_TOLERANCE:
        return wp.float64(0.0)
    for k in range(3):
        force_out[r + 1 + k] = force[k]
    for k in range(s.block_count[c]):
        j = s.block_dof[c, k]
        s.y[j] = s.y[j] + wp.dot(change, s.block[c, k])
    return cost


@wp.func
def fill(M: Factor, rows: Rows, s: Scratch):
    """All rows of B."""
    for i in range(rows.sizes[1]):
        fill_loss(M, rows, s, i)
    for c in range(rows.sizes[3]):
        if rows.contact_row[c] >= 0:
            fill_block(M, rows, s, c)


@wp.func
def sweep(rows: Rows, s: Scratch, force_out: wp.array[wp.float64]) -> wp.float64:
    """Minimise over one row or contact after the other; the gain."""
    gain = wp.float64(0.0)
    for i in range(rows.sizes[1]):
        gain -= settle_loss(rows, s, i, force_out)
    for c in range(rows.sizes[3]):
        if rows.contact_row[c] >= 0:
            gain -= settle_block(rows, s, c, force_out)
    return gain


@wp.func
def add_changes(rows: Rows, force_out: wp.array[wp.float64], qfrc_out: wp.array[wp.float64]):
    """Add J' times what the pass has changed."""
    for r in range(rows.sizes[2]):
        change = force_out[r] - rows.force[r]
        if change != wp.float64(0.0):
            for k in range(rows.start[r], rows.start[r] + rows.count[r]):
                j = rows.column[k]
                qfrc_out[j] = qfrc_out[j] + change * rows.jacobian[k]


@wp.kernel
def noslip(
    # Model:
    nv: int,
    iterations: int,
    tolerance: wp.float64,
    M: Factor,
    # Data in:
    rows: Rows,
    qfrc_in: wp.array[wp.float64],
    # Scratch:
    s: Scratch,
    # Data out:
    force_out: wp.array[wp.float64],
    qfrc_out: wp.array[wp.float64],
):
    """Run the pass on one step; one thread.

    tolerance: Least gain of a sweep after which another one follows, in units of cost.
    qfrc: J'f before and after, (nv,).
    """
    for i in range(nv):
        s.lane[i] = wp.vec3d(qfrc_in[i], wp.float64(0.0), wp.float64(0.0))
    for back in range(nv):
        j = nv - 1 - back
        value = half_solve(M, j, s.lane, s.marked)
        s.y[j] = value[0]
    fill(M, rows, s)
    gain = wp.float64(0.0)
    for r in range(rows.sizes[2]):
        force = rows.force[r]
        force_out[r] = force
        # The first sweep also gains what the regularisation cost.
        gain += wp.float64(0.5) * force * force * rows.regulariser[r]
    for _ in range(iterations):
        gain += sweep(rows, s, force_out)
        if gain < tolerance:
            break
        gain = wp.float64(0.0)
    for i in range(nv):
        qfrc_out[i] = qfrc_in[i]
    add_changes(rows, force_out, qfrc_out)
