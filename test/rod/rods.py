"""Rods that several tests use."""

from benchmarks.rod.exact import THIN, THIN_MATERIAL
from slot_core.rod.cosserat_rod import CosseratRod
from slot_core.rod.model import Geometry, Material, Rectangle, Uniform

STRIP = Geometry(1.0, Rectangle(1.0, (THIN, THIN)))
# L = EI = rho A = 1, EI sideways 2, GJ 0.8; it stretches by 1e-6 under a unit force.
OBLONG = Geometry(1.0, Uniform(1e6, 1.0, 2.0, 0.8))
UNIT = Material(1.0, 1.0, 1e-6, 0.0)


def slender(nodes=31, **options):
    """Rod with L = EI = rho A = 1 in the plane, strain 1e-7 under a unit force, stiff sideways."""
    return CosseratRod(THIN_MATERIAL, STRIP, nodes, **options)
