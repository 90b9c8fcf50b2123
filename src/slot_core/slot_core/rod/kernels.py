"""Compiled kernels of the spatial rod: time step, equilibrium, tangent and energy.

A step solves the theta scheme for the velocities V of the nodes, the spins Omega of the segments
about themselves and the angular velocities of the ends' sections, all at the stage t + theta h. The
spin's angular momentum is kept as a vector, as in `dynamics/spatial/leg.py`.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

import math

from slot_core.compiled import helper, kernel
from slot_core.dynamics.algebra import (
    add,
    combined,
    cross,
    dot,
    minus,
    plus,
    put,
    rotation,
    row,
    scaled,
    times,
)
from slot_core.dynamics.spatial.strain import (
    frame,
    frame_before,
    measure,
    orient,
    point_along,
    refine,
    rotation_vector,
    turned,
)
from slot_core.rod.elimination import (
    WIDTH,
    assemble,
    eliminate,
    lengthen,
    pull,
    substitute,
    tighten,
    turn_tip,
)

# rod lengths and rad; a step that ends with more has diverged
LARGEST_INCREMENT = 1.0
ZERO = (0.0, 0.0, 0.0)


@helper
def copy(out, source):
    """Copy rows of three numbers, as many as `out` has."""
    for i in range(out.shape[0]):
        put(out, i, row(source, i))


@helper
def end_frame(work, out, source, end, turn):
    """Turn the frame of an end's section by a rotation vector (3 numbers), rad."""
    rotation(work.rotation, turn)
    for i in range(3):
        put(out[end], i, times(work.rotation, row(source[end], i)))


@helper
def show_tip(work, nodes, frames):
    """Let the last row of the nodes stand for the tip's section."""
    n = work.spin.size
    put(nodes, n, add(row(nodes, n - 1), row(frames[1], 0)))
    put(work.segments.director, n - 1, row(frames[1], 1))


@helper
def look(mesh, work):
    """Strains and their rates at the stage, after its frames."""
    n, s = work.spin.size, work.segments
    rate, t = row(work.rate, 1), row(work.stage_frame[1], 0)
    put(work.speed, n, add(row(work.speed, n - 1), cross(rate, t)))
    work.spin[n - 1] = dot(rate, t)
    base = frame_before(s, 0, work.stage_frame[0])
    measure(s, mesh.rod, work.speed, work.spin, base, row(work.rate, 0))
    refine(mesh.refinement, s, mesh.rod)


@helper
def stage(work, tau):
    """Positions and frames at the stage, tau after the start of the step."""
    n = work.spin.size
    for i in range(n):
        put(work.stage, i, plus(row(work.node, i), tau, row(work.speed, i)))
    for end in range(2):
        turn = scaled(tau, row(work.rate, end))
        end_frame(work, work.stage_frame, work.frame, end, turn)
    show_tip(work, work.stage, work.stage_frame)
    point_along(work.segments, work.stage)
    orient(work.segments, work.begin, work.from_director, work.spin, ZERO, tau)
    show_tip(work, work.stage, work.stage_frame)


@helper
def start(mesh, work, target, h):
    """First iterate of a step: the velocities at its start, and the supports' velocities."""
    s, n = work.segments, work.spin.size
    show_tip(work, work.node, work.frame)
    point_along(s, work.node)
    copy(work.begin, s.direction)
    copy(work.from_director, work.director)
    put(work.from_director, n - 1, row(work.frame[1], 1))
    copy(work.speed, work.velocity)
    copy(work.before, work.velocity)
    copy(work.rate, work.turning)
    for k in range(n - 1):
        work.spin[k] = dot(row(work.swirl, k), row(s.direction, k))
    for end in range(2):
        drive(mesh, work, target[end], end, h)


@helper
def drive(mesh, work, target, end, h):
    """Velocities that move held components to the target (4, 3), place and frame, within h."""
    i, held = end * (work.spin.size - 1), mesh.held[end]
    for c in range(3):
        if held[c]:
            work.speed[i, c] = (target[0, c] - work.node[i, c]) / h
    if not (held[3] or held[4] or held[5]):
        return
    f = work.frame[end]
    own = (row(f, 0), row(f, 1), row(f, 2))
    wanted = (row(target, 1), row(target, 2), row(target, 3))
    v, _ = rotation_vector(own, wanted)
    turn = combined(v[0], own[0], v[1], own[1], v[2], own[2])
    for j in range(3):
        if held[3 + j]:
            work.rate[end, j] = turn[j] / h


@helper
def move(mesh, work, inv):
    """Add the Newton increment to the velocities and the axial forces."""
    x, n = work.change, work.spin.size
    pull(mesh, work, inv)
    for k in range(n):
        at = 4 * k + 4
        for c in range(3):
            work.speed[k, c] += x[at + c] * inv
        if k < n - 1:
            work.spin[k] += x[at + 3] * inv
    for c in range(3):
        work.rate[0, c] += x[c] * inv
        work.rate[1, c] += x[4 * n + 4 + c] * inv


@helper
def finish(mesh, work, h, theta):
    """State at the end of the step from the stage."""
    s, n, past = work.segments, work.spin.size, 1.0 / theta
    for k in range(n - 1):
        p = row(work.swirl, k)
        change = minus(scaled(work.spin[k], row(s.direction, k)), p)
        put(work.swirl, k, plus(p, past, change))
    for i in range(n):
        v, p = row(work.speed, i), row(work.before, i)
        put(work.node, i, plus(row(work.node, i), h, v))
        put(work.velocity, i, plus(p, past, minus(v, p)))
    point_along(s, work.node)
    orient(s, work.begin, work.from_director, work.spin, ZERO, h)
    copy(work.director, s.director)
    copy(work.turning, work.rate)
    for end in range(2):
        finish_end(mesh, work, end, h)


@helper
def finish_end(mesh, work, end, h):
    """Velocity and section of an end after the step.

    A held component's velocity at the stage is its mean over the step; that at the end follows from
    the last two, since an extrapolation from the start would oscillate after a jump. A section that
    turns freely has no mass: it keeps the stage's position to its segment.
    """
    i, k, f = end * (work.spin.size - 1), end * (work.spin.size - 2), work.frame
    for c in range(3):
        v = work.speed[i, c]
        if mesh.held[end, c]:
            work.velocity[i, c] = v + 0.5 * (v - work.driven[end, c])
        work.driven[end, c] = v
    if mesh.held[end, 3] or mesh.held[end, 4] or mesh.held[end, 5]:
        end_frame(work, f, f, end, scaled(h, row(work.rate, end)))
        return
    follow(work, end, k)


@helper
def follow(work, end, k):
    """Carry the frame of a free end with segment k, from the stage to the end of the step."""
    s, x = work.segments, work.stage
    now = frame(s, k)
    chord = minus(row(x, k + 1), row(x, k))
    t = scaled(1.0 / math.sqrt(dot(chord, chord)), chord)
    d = row(work.stage_director, end)
    b = cross(t, d)
    for i in range(3):
        v = row(work.stage_frame[end], i)
        p, q, r = dot(v, t), dot(v, d), dot(v, b)
        own = combined(p, now[0], q, now[1], r, now[2])
        put(work.frame[end], i, own)


@helper
def advance(mesh, work, loads, target, h, scheme):
    """One step; returns the largest entry of the last Newton increment.

    target: (2, 4, 3) place and frame that held components of both ends reach; scheme: (theta,
    iterations, tolerance).
    """
    theta, iterations, tolerance = scheme
    work.gap[:] = 0.0
    tau, size = theta * h, 0.0
    inv = 1.0 / tau
    start(mesh, work, target, h)
    stage(work, tau)
    for _ in range(iterations):
        look(mesh, work)
        eliminate(mesh, work, loads, inv, 0.0)
        size = substitute(mesh, work)
        move(mesh, work, inv)
        stage(work, tau)
        if not size > tolerance:
            break
    n = work.spin.size
    put(work.stage_director, 0, row(work.segments.director, 0))
    put(work.stage_director, 1, row(work.segments.director, n - 2))
    finish(mesh, work, h, theta)
    return size


@kernel
def run(mesh, work, loads, target, h, scheme, steps, record):
    """Advance `steps` steps; writes the tip's position to record (m, 3) every steps/m steps.

    Returns the number of steps done. It is less than `steps` where the last Newton increment of a
    step was not finite or above LARGEST_INCREMENT.
    """
    every, tip = max(1, steps // max(1, record.shape[0])), work.spin.size - 1
    for n in range(steps):
        size = advance(mesh, work, loads, target, h, scheme)
        if not size < LARGEST_INCREMENT:
            return n
        work.unconverged[0] += size > scheme[2]
        if (n + 1) % every == 0 and (n + 1) // every <= record.shape[0]:
            put(record, (n + 1) // every - 1, row(work.node, tip))
    return steps


@helper
def displace(work, x):
    """Add an increment (4 N + 7,) to the posture: nodes, directors and ends' sections.

    Segments turn by their rotation vectors and change their lengths by the increment along them.
    For Newton's method, large turns then do not stretch them.
    """
    s, n, m = work.segments, work.spin.size, work.rotation
    at, frames = 4 * n + 4, work.stage_frame
    end_frame(work, frames, frames, 0, (x[0], x[1], x[2]))
    end_frame(work, frames, frames, 1, (x[at], x[at + 1], x[at + 2]))
    put(work.stage, 0, add(row(work.stage, 0), (x[4], x[5], x[6])))
    for k in range(n - 1):
        i, t, d = 4 * k + 4, row(s.direction, k), row(work.from_director, k)
        u = (x[i + 4] - x[i], x[i + 5] - x[i + 1], x[i + 6] - x[i + 2])
        turn = plus(cross(t, u), s.length[k] * x[i + 3], t)
        rotation(m, scaled(s.per_length[k], turn))
        ahead, length = times(m, t), s.length[k] + dot(t, u)
        put(work.stage, k + 1, plus(row(work.stage, k), length, ahead))
        put(work.from_director, k, turned(times(m, d), ahead, 0.0))
    show_tip(work, work.stage, work.stage_frame)
    point_along(s, work.stage)
    copy(work.begin, s.direction)


@helper
def close(mesh, work, place):
    """Set the increments that bring the tip's node to its place (3,) where it is held."""
    tip = work.spin.size - 1
    for c in range(3):
        if mesh.held[1, c]:
            work.gap[4 * tip + 4 + c] = place[c] - work.stage[tip, c]


@helper
def strain_posture(mesh, work):
    """Strains of the posture at rest."""
    work.speed[:] = 0.0
    work.spin[:] = 0.0
    work.rate[:] = 0.0
    point_along(work.segments, work.stage)
    copy(work.segments.director, work.from_director)
    show_tip(work, work.stage, work.stage_frame)
    look(mesh, work)


@kernel
def pose(mesh, work, loads):
    """Set the posture to the state, with the axial forces of its strains and of the tendons."""
    n = work.spin.size
    copy(work.stage, work.node)
    for end in range(2):
        copy(work.stage_frame[end], work.frame[end])
    show_tip(work, work.stage, work.stage_frame)
    point_along(work.segments, work.stage)
    copy(work.begin, work.segments.direction)
    copy(work.from_director, work.director)
    relax(mesh, work, loads)
    work.tension[n - 1] = 0.0


@helper
def relax(mesh, work, loads):
    """Set the independent axial forces from the strains and the tendons."""
    strain_posture(mesh, work)
    tighten(mesh, work, loads)
    for k in range(work.tension.size):
        force = mesh.rod.axial[k] * work.segments.extension[k]
        work.tension[k] = force + work.carried[k]


@kernel
def settle(work):
    """Set the state to the posture, at rest."""
    copy(work.node, work.stage)
    copy(work.director, work.from_director)
    for end in range(2):
        copy(work.frame[end], work.stage_frame[end])
    work.velocity[:] = 0.0
    work.swirl[:] = 0.0
    work.turning[:] = 0.0
    work.driven[:] = 0.0


@kernel
def push_aside(mesh, work, loads, change):
    """Displace the posture by an increment (4 N + 7,), with the axial forces of its strains."""
    displace(work, change)
    relax(mesh, work, loads)


@kernel
def equilibrium(mesh, work, loads, place, shift, iterations, tolerance):
    """Newton's method for an equilibrium, from the posture, with a held tip at its place (3,), m.

    With shift > 0 the tangent is augmented by shift times the metric: the iterations are then
    damped steps. Returns (largest entry of the last increment, negative pivots, iterations).
    """
    size, negative = math.inf, 0
    for n in range(iterations):
        strain_posture(mesh, work)
        close(mesh, work, place)
        negative = eliminate(mesh, work, loads, 0.0, shift)
        size = substitute(mesh, work)
        if not size < math.inf:
            return size, negative, n + 1
        pull(mesh, work, 0.0)
        displace(work, work.change)
        if size < tolerance:
            return size, negative, n + 1
    return size, negative, iterations


@kernel
def dense(mesh, work, loads, matrix):
    """Write the tangent of the posture to matrix (4 N + 7, 4 N + 7), held unknowns included."""
    matrix[:] = 0.0
    strain_posture(mesh, work)
    assemble(mesh, work, loads, 0.0)
    for i in range(work.pull.shape[0]):
        lengthen(mesh, work, i)
        g = work.gradient[i]
        for r in range(g.size):
            for c in range(g.size):
                matrix[r, c] += work.pull[i, 1] * g[r] * g[c]
    for r in range(matrix.shape[0]):
        for c in range(r, min(r + WIDTH, matrix.shape[0])):
            matrix[r, c] += work.factor[r, c - r]
            matrix[c, r] = matrix[r, c]
    last = 4 * work.normal.size
    turn_tip(mesh, work, loads, matrix[last:, last:])


@kernel
def elastic_energy(mesh, work):
    """Elastic energy of the posture, J."""
    strain_posture(mesh, work)
    s, rod, total = work.segments, mesh.rod, 0.0
    for k in range(work.normal.size):
        bend = s.turn[k] - rod.rest_angle[k]
        total += (
            rod.axial[k] * s.extension[k] ** 2
            + rod.torsion[k] * s.twist[k] ** 2
        )
        total += rod.bending[k] * bend * bend + rod.lateral[k] * s.side[k] ** 2
    return total / 2
