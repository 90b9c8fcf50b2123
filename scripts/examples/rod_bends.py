"""Bends a Cosserat rod by a force at its tip, then releases it; no robot is needed."""

import numpy as np

from slot_core.rod.cosserat_rod import CosseratRod
from slot_core.rod.model import Geometry, Loads, Material, Rectangle

LENGTH, WIDTH, THICKNESS = 0.2, 0.02, 4e-3  # m
YOUNG, SHEAR, DENSITY, DAMPING = 1e7, 3.3e6, 1200.0, 5e-4  # Pa, Pa, kg/m^3, s
Y, Z = 1, 2
# m^4
SECOND_MOMENT = {Y: THICKNESS * WIDTH**3 / 12, Z: WIDTH * THICKNESS**3 / 12}

strip = Geometry(LENGTH, Rectangle(WIDTH, (THICKNESS, THICKNESS)))
rod = CosseratRod(Material(YOUNG, SHEAR, DENSITY, DAMPING), strip)
print("first frequencies at rest, Hz:", rod.natural_frequencies(3).round(2))
print("force    tip, rod    tip, beam theory (small deflections)")
for axis, force in ((Y, 0.05), (Z, 0.002), (Z, 0.02), (Z, 0.2)):
    rod.solve_static(Loads(force=force * np.eye(3)[axis]))
    beam = force * LENGTH**3 / (3 * YOUNG * SECOND_MOMENT[axis])
    print(
        f"{force:5.3f} N {1e3 * rod.tip.position[axis]:7.3f} mm {1e3 * beam:9.3f} mm"
    )

# from the last equilibrium, without the force
height = rod.run(1e-3, 400, samples=16)[:, Z]
print("released, height of the tip every 25 ms, mm:", (1e3 * height).round())
