"""Energy of a leg, in its plane and in space, written without the kernels: an oracle for tests."""

import numpy as np
from scipy.spatial.transform import Rotation


def strains(rod, node):
    """Extensions (N-1,), m, and changes of the turning angles (N-1,), rad, at nodes (..., N, 2)."""
    chord = np.diff(node, axis=-2)
    x, z = chord[..., 0], chord[..., 1]
    turn = np.diff(np.unwrap(np.arctan2(z, x)), prepend=0.0)
    bend = turn - rod.rest_angle
    return np.hypot(x, z) - rod.rest_length - rod.shortening * bend**2, bend


def mass_matrix(rod):
    """(N, N) kg, consistent mass of a rod's nodes along an axis."""
    mass = np.diag(rod.mass)
    for k, mu in enumerate(rod.coupling):
        mass[k : k + 2, k : k + 2] += mu * np.array([[-1.0, 1.0], [1.0, -1.0]])
    return mass


def leg_energy(model, node, angle, height):
    """Energy of rod, cable, floor and weight of a leg with a routed tendon, J.

    node: (N, 2) m from the clamp, which is at a height (m); angle: of the tendon, rad.
    """
    rod, still = model.rod, np.zeros(len(node) - 1)
    extension, bend = strains(rod, node)
    stored = elastic_energy(model, angle, extension, still, bend, still)
    ends = np.column_stack(
        [node[:-1, 1], node[1:, 1]]
    ).ravel()  # of the segments
    depth = np.minimum(0.0, height + np.repeat(ends, 2))  # both edges touch
    floor = model.floor.stiffness @ depth**2 / 2
    return stored + floor - model.gravity[2] * rod.mass @ node[:, 1]


def elastic_energy(model, angle, stretch, twist, bend, side):  # noqa: PLR0917
    """J, of rod and cable at strains (N-1,) of the segments, less those at rest, m and rad."""
    rod, tendon = model.rod, model.tendon
    stored = rod.axial @ stretch**2 + rod.torsion @ twist**2
    stored += rod.bending @ bend**2 + rod.lateral @ side**2
    cable = tendon.spool_radius * angle - tendon.relaxed
    cable += tendon.along @ stretch + tendon.around @ (bend + rod.rest_angle)
    return (stored + tendon.stiffness * max(0.0, cable) ** 2) / 2


def chain_strains(rod, clamp, node, director, moved, twist):  # noqa: PLR0917
    """Strains (4, N-1) of a chain of frames as for `elastic_energy`, and its directors (N-1, 3).

    clamp: rotation of the clamp. The frames are carried from nodes (N, 3) and directors (N-1, 3) to
    the nodes `moved`, as little as their segments turn, then turned about them by twist (N-1,), rad.
    """
    before = clamp * Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
    found, directors = [], []
    for k, (old, t) in enumerate(zip(directions(node), directions(moved))):
        length = np.linalg.norm(moved[k + 1] - moved[k])
        axis = np.cross(old, t)
        size = np.linalg.norm(axis)
        axis *= np.arctan2(size, old @ t) / size if size else 0.0
        turn = Rotation.from_rotvec(twist[k] * t) * Rotation.from_rotvec(axis)
        d = turn.apply(director[k])
        own = Rotation.from_matrix(np.column_stack([t, d, np.cross(t, d)]))
        x, y, z = (before.inv() * own).as_rotvec() - [
            0.0,
            rod.rest_angle[k],
            0.0,
        ]
        bulge = rod.shortening[k] * (y * y + z * z)
        found.append([length - rod.rest_length[k] - bulge, x, y, z])
        directors.append(d)
        before = own
    return np.transpose(found), np.array(directors)


def directions(node):
    """(N-1, 3) unit vectors of the segments between nodes (N, 3)."""
    chord = np.diff(node, axis=0)
    return chord / np.linalg.norm(chord, axis=1, keepdims=True)
