"""Energy of a leg in its plane, written without the kernels: an oracle for tests."""

import numpy as np


def strains(rod, node):
    """Extensions (N-1,), m, and changes of the turning angles (N-1,), rad, at nodes (N, 2)."""
    chord = np.diff(node, axis=0)
    turn = np.diff(np.unwrap(np.arctan2(chord[:, 1], chord[:, 0])), prepend=0.0)
    bend = turn - rod.rest_angle
    return np.hypot(*chord.T) - rod.rest_length - rod.shortening * bend**2, bend


def mass_matrix(rod):
    """(N, N) kg, consistent mass of a rod's nodes along an axis."""
    mass = np.diag(rod.mass)
    for k, mu in enumerate(rod.coupling):
        mass[k : k + 2, k : k + 2] += mu * np.array([[-1.0, 1.0], [1.0, -1.0]])
    return mass


def rod_energy(rod, node):
    """Elastic energy of a rod at nodes (N, 2), J."""
    extension, bend = strains(rod, node)
    return (rod.axial @ extension**2 + rod.bending @ bend**2) / 2


def cable_length(rod, tendon, node):
    """Length of a routed tendon less its natural length, m, at nodes (N, 2)."""
    extension, bend = strains(rod, node)
    return tendon.along @ extension + tendon.around @ bend


def leg_energy(model, node, angle, height):
    """Energy of rod, cable, floor and weight of a leg with a routed tendon, J.

    node: (N, 2) m from the clamp, which is at a height (m); angle: of the tendon, rad.
    """
    rod, tendon = model.rod, model.tendon
    slack = tendon.relaxed - tendon.around @ rod.rest_angle
    cable = max(
        0.0, cable_length(rod, tendon, node) - slack + tendon.spool_radius * angle
    )
    ends = np.column_stack([node[:-1, 1], node[1:, 1]]).ravel()  # of the segments
    depth = np.minimum(0.0, height + np.repeat(ends, 2))  # both edges touch
    stored = tendon.stiffness * cable**2 + model.floor.stiffness @ depth**2
    return rod_energy(rod, node) + stored / 2 - model.gravity[2] * rod.mass @ node[:, 1]
