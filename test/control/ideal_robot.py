"""A robot that moves exactly as the reference of its gait scheduler says."""

import numpy as np

from slot_core.clock import SECOND
from slot_core.control.force_map import read_springs
from slot_core.gait.gait import read_gaits
from slot_core.gait.gait_scheduler import GaitScheduler
from slot_core.robot import read_robot

ROBOT, GAITS = read_robot(), read_gaits()
SPRINGS = read_springs()
WALK = GAITS.strides["walk"]
TICK = 33_000_000  # ns
NOTHING = np.zeros(3)
AHEAD = np.array([0.05, 0.0, 0.0])


class Ideal:
    """A robot that moves exactly as its reference says, after `seconds` of ticks."""

    def __init__(self, gait="stand", velocity=NOTHING, path=None, seconds=0.0):
        self.scheduler = GaitScheduler(GAITS, ROBOT, SPRINGS, gait, velocity, path)
        self.now, self.state, self.previews = SECOND, 0.06 * np.eye(12)[5], []
        self.run(seconds)

    def run(self, seconds):
        """Previews of the ticks of that time."""
        ran = []
        for _ in range(round(seconds * SECOND / TICK)):
            ran.append(self.scheduler.step(self.now, self.state))
            reference = ran[-1].reference[0]
            v = reference[[9, 10, 8]] if ran[-1].gait in GAITS.strides else np.zeros(3)
            self.state[[3, 4, 2]] += v * TICK * 1e-9
            self.state[[5, 0, 1]] = reference[[5, 0, 1]]
            self.now += TICK
        self.previews += ran
        return ran

    @property
    def steps(self):
        """Largest change (n,) of an angle from tick to tick, rad."""
        angle = np.array([preview.tendon_angle[0] for preview in self.previews])
        return np.abs(np.diff(angle, axis=0)).max(axis=1)


def stands(preview):
    """Whether the legs are loaded, corrected and at rest over the horizon."""
    moves = np.ptp(preview.tendon_angle, axis=0).max()
    return preview.corrected and bool(moves < 1e-12)
