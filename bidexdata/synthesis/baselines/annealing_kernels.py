"""The annealing of BimanGrasp: proposals with Langevin noise, and their acceptance.

A grasp's state is what was last accepted; its proposal lies in the arrays that the energies read.
Random numbers are a hash of the grasp's own seed and the step, so neither the batch nor the number
of threads changes them.
"""

import warp as wp

from bidexdata.synthesis.update_kernels import rotation_exponential

wp.set_module_options({"enable_backward": False})

# The released code's guard of the division by the root of the running mean.
GUARD = wp.constant(1.0e-6)


@wp.kernel
def running_squares(
    # Scenes: first grasp of each, and the end
    first: wp.array[int],
    # Rule:
    keep: float,
    # Problem in:
    gradient_in: wp.array2d[float],
    # Problem out:
    mean_inout: wp.array2d[float],
):
    """Running mean of each variable's squared gradient, over the grasps of a scene alike."""
    scene, d = wp.tid()
    count = first[scene + 1] - first[scene]
    total = float(0.0)
    for k in range(count):
        g = gradient_in[first[scene] + k, d]
        total += g * g
    if count > 0:
        mean = total / float(count)
        mean_inout[scene, d] = keep * mean_inout[scene, d] + (1.0 - keep) * mean


@wp.func
def moved(
    g: float, mean: float, step: float, temperature: float, noise: float, lot: float
) -> float:
    """Change of one variable: down the scaled gradient, and Langevin noise of the same scale."""
    scaled = step / (wp.sqrt(mean) + GUARD)
    return -scaled * g + noise * wp.sqrt(2.0 * scaled * temperature) * lot


@wp.kernel
def propose(
    # Hand:
    side: int,
    lower: wp.array[float],
    upper: wp.array[float],
    # Rule:
    clamp: int,
    noise: float,
    # Schedule:
    step: float,
    temperature: float,
    number: int,
    # Problem in:
    scene: wp.array[int],
    seed: wp.array[int],
    mean_in: wp.array2d[float],
    gradient_in: wp.array2d[float],
    position_in: wp.array[wp.vec3],
    rotation_in: wp.array[wp.mat33],
    joints_in: wp.array2d[float],
    # Problem out:
    position_out: wp.array[wp.vec3],
    rotation_out: wp.array[wp.mat33],
    joints_out: wp.array2d[float],
):
    """Propose one hand's next pose; the base turns in the tangent space of rotations."""
    grasp = wp.tid()
    lots = wp.rand_init(seed[grasp] + side, number)
    own = scene[grasp]
    shift = wp.vec3(0.0, 0.0, 0.0)
    turn = wp.vec3(0.0, 0.0, 0.0)
    for k in range(3):
        g = gradient_in[grasp, k]
        shift[k] = moved(g, mean_in[own, k], step, temperature, noise, wp.randn(lots))
    for k in range(3):
        g = gradient_in[grasp, 3 + k]
        turn[k] = moved(g, mean_in[own, 3 + k], step, temperature, noise, wp.randn(lots))
    position_out[grasp] = position_in[grasp] + shift
    rotation_out[grasp] = rotation_exponential(turn) * rotation_in[grasp]
    for d in range(joints_in.shape[1]):
        g = gradient_in[grasp, 6 + d]
        m = mean_in[own, 6 + d]
        u = joints_in[grasp, d] + moved(g, m, step, temperature, noise, wp.randn(lots))
        if clamp == 1:
            u = wp.clamp(u, lower[d], upper[d])
        joints_out[grasp, d] = u


@wp.kernel
def switch_contacts(
    # Rule:
    candidates: wp.array[int],
    probability: float,
    number: int,
    # Problem in:
    seed: wp.array[int],
    index_in: wp.array2d[int],
    # Problem out:
    index_out: wp.array2d[int],
):
    """Draw some of the contacts anew among their hand's candidates."""
    grasp = wp.tid()
    lots = wp.rand_init(seed[grasp] + 2, number)
    for i in range(index_in.shape[1]):
        h = i // (index_in.shape[1] // 2)
        switched = wp.randf(lots) < probability
        drawn = wp.min(int(wp.randf(lots) * float(candidates[h])), candidates[h] - 1)
        index_out[grasp, i] = index_in[grasp, i]
        if switched:
            index_out[grasp, i] = drawn


@wp.kernel
def judge_proposals(
    # Rule:
    weights: wp.array[float],
    # Schedule:
    temperature: float,
    number: int,
    # Problem in:
    seed: wp.array[int],
    terms_in: wp.array2d[float],
    index_in: wp.array2d[int],
    # Problem out: kept energy and terms, kept contacts, and whether the proposal was taken
    energy_inout: wp.array[float],
    terms_inout: wp.array2d[float],
    index_inout: wp.array2d[int],
    taken_out: wp.array[int],
):
    """Metropolis: take a proposal with probability exp((E - E') / T)."""
    grasp = wp.tid()
    energy = float(0.0)
    for k in range(terms_in.shape[1]):
        energy += weights[k] * terms_in[grasp, k]
    lots = wp.rand_init(seed[grasp] + 3, number)
    taken = wp.int32(0)
    # A proposal without an energy compares as false and is refused.
    if number == 0 or wp.randf(lots) < wp.exp((energy_inout[grasp] - energy) / temperature):
        taken = 1
        energy_inout[grasp] = energy
        for k in range(terms_in.shape[1]):
            terms_inout[grasp, k] = terms_in[grasp, k]
        for i in range(index_in.shape[1]):
            index_inout[grasp, i] = index_in[grasp, i]
    taken_out[grasp] = taken


@wp.kernel
def keep_taken(
    # Problem in:
    taken: wp.array[int],
    position_in: wp.array[wp.vec3],
    rotation_in: wp.array[wp.mat33],
    joints_in: wp.array2d[float],
    gradient_in: wp.array2d[float],
    # Problem out:
    position_inout: wp.array[wp.vec3],
    rotation_inout: wp.array[wp.mat33],
    joints_inout: wp.array2d[float],
    gradient_inout: wp.array2d[float],
):
    """Copy one hand's pose and gradient of the proposals that were taken."""
    grasp = wp.tid()
    if taken[grasp] == 1:
        position_inout[grasp] = position_in[grasp]
        rotation_inout[grasp] = rotation_in[grasp]
        for d in range(joints_in.shape[1]):
            joints_inout[grasp, d] = joints_in[grasp, d]
        for d in range(gradient_in.shape[1]):
            gradient_inout[grasp, d] = gradient_in[grasp, d]
