"""Energy and momentum of a leg and of the robot, written without the kernels: oracles for tests.

The masses of a segment move linearly between its nodes. With its coupling mu, spin inertia I, chord
e, difference of its nodes' velocities u and swirl S it adds to the lumped masses

    angular momentum I S - mu e x u,      kinetic energy (I S.S - mu u.u) / 2.
"""

import numpy as np
from scipy.spatial.transform import Rotation

# rows t, d, b before a leg's first segment, in leg axes
CLAMP = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))


def strains(rod, node):
    """Extensions (N-1,), m, and changes of the turning angles (N-1,), rad, at nodes (..., N, 2)."""
    chord = np.diff(node, axis=-2)
    x, z = chord[..., 0], chord[..., 1]
    bend = np.diff(np.unwrap(np.arctan2(z, x)), prepend=0.0) - rod.rest_angle
    return np.hypot(x, z) - rod.rest_length - rod.shortening * bend**2, bend


def mass_matrix(rod):
    """(N, N) kg, consistent mass of a rod's nodes along an axis."""
    mass = np.diag(rod.mass)
    for k, mu in enumerate(rod.coupling):
        mass[k : k + 2, k : k + 2] += mu * np.array([[-1.0, 1.0], [1.0, -1.0]])
    return mass


def elastic_energy(  # noqa: PLR0917
    model, angle, stretch, twist, bend, side, fault=(0.0, 1.0)
):
    """J, of rod and cable at strains (N-1,) of the segments, less those at rest, m and rad.

    fault: additional slack of the tendon, m, and 0 for a broken one.
    """
    rod, tendon = model.rod, model.tendon
    stored = rod.axial @ stretch**2 + rod.torsion @ twist**2
    stored += rod.bending @ bend**2 + rod.lateral @ side**2
    cable = tendon.spool_radius * angle - tendon.relaxed - fault[0]
    cable += tendon.along @ stretch + tendon.around @ (bend + rod.rest_angle)
    return (stored + fault[1] * tendon.stiffness * max(0.0, cable) ** 2) / 2


def frame_strains(rod, node, director, clamp=CLAMP):
    """Strains (4, ..., N-1) as for `elastic_energy` of legs at nodes (..., N, 3).

    director: (..., N-1, 3); clamp: rotation of the frame before the first segment.
    """
    t = directions(node)
    frames = np.stack([t, director, np.cross(t, director)], axis=-1)
    before = np.roll(frames, 1, axis=-3)
    before[..., 0, :, :] = clamp.as_matrix()
    between = (before.swapaxes(-1, -2) @ frames).reshape(-1, 3, 3)
    turns = Rotation.from_matrix(between).as_rotvec().reshape(t.shape)
    twist, bend, side = np.moveaxis(turns, -1, 0)
    bend = bend - rod.rest_angle
    length = np.linalg.norm(np.diff(node, axis=-2), axis=-1)
    bulge = rod.shortening * (bend**2 + side**2)
    return np.stack([length - rod.rest_length - bulge, twist, bend, side])


def masses(sim):
    """Mass (n,), kg, place and velocity (n, 3) in odom of a robot's nodes, torso and payload."""
    nodes, velocity, *_ = sim._observe()
    arm = sim.rotation @ sim.model.payload[1:]
    carried = sim.velocity + np.cross(sim.rotation @ sim.angular_velocity, arm)
    mass = [sim.model.torso.mass, sim.model.payload[0]]
    return (
        np.append(np.tile(sim.model.rod.mass, 4), mass),
        np.vstack([*nodes, sim.position, sim.position + arm]),
        np.vstack([*velocity, sim.velocity, carried]),
    )


def robot_energy(sim):
    """J, of a robot on a level floor: kinetic, gravity, rods, cables, floor and bristles."""
    model, state = sim.model, sim.state
    mass, place, velocity = masses(sim)
    total = mass @ ((velocity**2).sum(axis=1) / 2 - place @ model.gravity)
    total += state.rate @ model.torso.inertia @ state.rate / 2
    moving = np.diff(sim._observe()[1], axis=1)
    spinning = ((state.swirl**2).sum(axis=-1) @ model.rod.spin).sum()
    linear = ((moving**2).sum(axis=-1) @ model.rod.coupling).sum()
    total += (spinning - linear) / 2
    strains = frame_strains(model.rod, state.node, state.director)
    for leg, angle in enumerate(state.tendon_angle):
        fault = model.fault[:, leg]
        total += elastic_energy(model, angle, *strains[:, leg], fault)
    return total + floor_energy(sim)


def floor_energy(sim):
    """J, of the springs and bristles of all contact points on a level floor."""
    floor, state = sim.model.floor, sim.state
    # ends and edges of the segments, in the order of `contact.Floor`
    height = sim.nodes[:, :, 2]
    ends = np.stack([height[:, :-1], height[:, 1:]], axis=-1)
    edge = floor.half_width * sim.directors[:, :, 2, None] * [-1.0, 1.0]
    points = (ends[..., None] + edge[:, :, None]).reshape(4, -1)
    number = np.arange(points.shape[1])
    stiffness = floor.stiffness * (number // 4 + number // 2 % 2 >= floor.first)
    corners = sim.position + sim.model.torso.corners @ sim.rotation.T
    pressed = (np.minimum(0.0, points) ** 2 @ stiffness).sum()
    pressed += (
        floor.corner_stiffness * (np.minimum(0.0, corners[:, 2]) ** 2).sum()
    )
    bent = ((state.bristle**2).sum(axis=-1) @ stiffness).sum()
    bent += floor.corner_stiffness * (state.corner_bristle**2).sum()
    return (pressed + floor.bristle * bent) / 2


def chain_strains(rod, clamp, node, director, moved, twist):  # noqa: PLR0917
    """Strains (4, N-1) of a chain of frames as for `elastic_energy`, and its directors (N-1, 3).

    clamp: rotation of the clamp. The frames are carried from nodes (N, 3) and directors (N-1, 3) to
    the nodes `moved`, as little as their segments turn, then turned about them by twist (N-1,), rad.
    """
    directors = []
    for k, (old, t) in enumerate(zip(directions(node), directions(moved))):
        axis = np.cross(old, t)
        size = np.linalg.norm(axis)
        axis *= np.arctan2(size, old @ t) / size if size else 0.0
        turn = Rotation.from_rotvec(twist[k] * t) * Rotation.from_rotvec(axis)
        directors.append(turn.apply(director[k]))
    directors = np.array(directors)
    return frame_strains(rod, moved, directors, clamp * CLAMP), directors


def directions(node):
    """(..., N-1, 3) unit vectors of the segments between nodes (..., N, 3)."""
    chord = np.diff(node, axis=-2)
    return chord / np.linalg.norm(chord, axis=-1, keepdims=True)
