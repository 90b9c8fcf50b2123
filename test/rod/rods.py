"""Rods that several tests use."""

import numpy as np

from benchmarks.rod.exact import LEG, THIN, THIN_MATERIAL, TPU
from slot_core.rod.cosserat_rod import CosseratRod
from slot_core.rod.model import FREE, Geometry, Material, Rectangle, Uniform
from slot_core.rod.motion import RodState

STRIP = Geometry(1.0, Rectangle(1.0, (THIN, THIN)))
UNDAMPED = Material(TPU.young_modulus, TPU.shear_modulus, TPU.density, 0.0)
# L = EI = rho A = 1, EI sideways 2, GJ 0.8; it stretches by 1e-6 under a unit force.
OBLONG = Geometry(1.0, Uniform(1e6, 1.0, 2.0, 0.8))
UNIT = Material(1.0, 1.0, 1e-6, 0.0)


def slender(nodes=31, **options):
    """Rod with L = EI = rho A = 1 in the plane, strain 1e-7 under a unit force, stiff sideways."""
    return CosseratRod(THIN_MATERIAL, STRIP, nodes, **options)


def flying(scheme, nodes=17):
    """Curved, tapered, undamped leg in free flight that tumbles, bends and twists."""
    geometry = Geometry(LEG.length, LEG.section, curvature=4.0)
    rod = CosseratRod(UNDAMPED, geometry, nodes, base=FREE, scheme=scheme)
    state, rate = rod.state, np.array([6.0, 8.0, -4.0])
    r = state.position
    velocity = np.cross(rate, r) + np.array([0.3, -0.2, 0.1])
    velocity[:, 1:] += np.outer((r[:, 0] - 0.1) ** 2, [40.0, 60.0])  # bends the leg
    t = np.diff(r, axis=0)
    t /= np.linalg.norm(t, axis=1)[:, None]
    spin = t @ rate + np.linspace(-20.0, 30.0, nodes - 1)  # twists it
    rod.state = RodState(r, state.director, velocity, spin[:, None] * t, state.ends)
    return rod
