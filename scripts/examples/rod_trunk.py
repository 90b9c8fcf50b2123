"""Bends a tapered trunk by its tendon against a wall, which it slides along; no robot is needed."""

import numpy as np

from slot_core.rod.cosserat_rod import CosseratRod
from slot_core.rod.model import (
    Circle,
    Geometry,
    Loads,
    Material,
    Plane,
    RodTendon,
)

NODES, RADIUS = 31, 6e-3  # m, of the trunk at its tip
# m, the tendon comes nearer to the middle along the taper
OFFSET = np.column_stack([np.zeros(NODES), np.linspace(9e-3, 5e-3, NODES)])
WALL = Plane(
    point=(0.0, 0.0, 0.04),
    normal=(0.0, 0.0, -1.0),
    stiffness=1e6,
    radius=RADIUS,
    friction=0.3,
)

shape = Geometry(0.3, Circle((20e-3, 2 * RADIUS)))
rubber = Material(1e6, 3.3e5, 1100.0, 2e-2)  # Pa, Pa, kg/m^3, s
tendons, pull = [RodTendon(OFFSET)], Loads(pull=(3.0,))
free = CosseratRod(rubber, shape, NODES, tendons=tendons)
trunk = CosseratRod(rubber, shape, NODES, tendons=tendons, planes=[WALL])
for rod in (free, trunk):
    rod.solve_static(pull)
    print("tip, mm:", (1e3 * np.array(rod.tip.position)).round(2))
height = 1e3 * (WALL.point[2] - RADIUS)
print(f"centre line at the wall: {height:.1f} mm")
above = (trunk.state.position[:, 2] > WALL.point[2] - RADIUS).sum()
print(f"{above} of {NODES} nodes touch")
path = trunk.run(1e-3, 600, Loads(pull=(5.0,)), samples=6)
print("pulled on, tip every 0.1 s, mm:", (1e3 * path[:, ::2]).round(1).tolist())
