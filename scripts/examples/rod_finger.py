"""Curls a finger by the tendon along it: by its pull, then by its length; no robot is needed."""

import math

from slot_core.rod.cosserat_rod import CosseratRod
from slot_core.rod.model import Geometry, Loads, Material, Rectangle, RodTendon

LENGTH, WIDTH, THICKNESS, OFFSET = 0.1, 0.015, 8e-3, 5e-3  # m
YOUNG, SHEAR, DENSITY, DAMPING = 2e6, 7e5, 1100.0, 5e-3  # Pa, Pa, kg/m^3, s
BENDING = YOUNG * WIDTH * THICKNESS**3 / 12  # N m^2
WEIGHT = (0.0, 0.0, -9.81)  # m/s^2

finger = CosseratRod(
    Material(YOUNG, SHEAR, DENSITY, DAMPING),
    Geometry(LENGTH, Rectangle(WIDTH, (THICKNESS, THICKNESS))),
    tendons=[RodTendon(offset=(0.0, OFFSET), stiffness=2e4)],  # N/m
)
print("pull    angle, rod   T d L / (E I)   cable drawn in")
for pull in (0.5, 1.0, 2.0, 4.0):
    finger.solve_static(Loads(pull=(pull,)))
    angle, theory = -finger.tip.rotation[1], pull * OFFSET * LENGTH / BENDING
    drawn = LENGTH - finger.tendons[0, 1]
    print(
        f"{pull:3.1f} N {math.degrees(angle):7.2f} deg {math.degrees(theory):10.2f} deg"
        f" {1e3 * drawn:12.2f} mm"
    )

held = Loads(gravity=WEIGHT, length=(LENGTH - 8e-3,))
finger.solve_static(held)
pull, length = finger.tendons[0]
print(f"held at {1e3 * length:.2f} mm against its weight: pull {pull:.3f} N")
finger.run(1e-3, 1000, Loads(gravity=WEIGHT))
hanging = 1e3 * finger.tip.position[2]
print(f"let go: after 1 s the tip hangs at {hanging:.2f} mm")
