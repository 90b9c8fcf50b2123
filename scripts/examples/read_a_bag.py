"""Reads a bag of a walk: its motion, the commands of its tendons, and one plot of both."""

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np

from slot_lab.bags.bag import Bag
from slot_lab.bags.recorded_walk import read_motion, tendon_angles
from slot_lab.bags.topics import MOTION_TOPICS

mpl.use("Agg")
from matplotlib import pyplot as plt

SHIPPED = Path(__file__).parents[2] / "slot_bringup/example/walk"

bag = Bag(sys.argv[1] if len(sys.argv) > 1 else SHIPPED)
for topic, count in sorted(bag.counts.items()):
    print(f"{count:6d}  {topic}  {bag.topics[topic]}")
motion = read_motion(bag, *MOTION_TOPICS)  # truth, else odometry, else estimate
way = motion.position[-1] - motion.position[0]
print(
    f"{motion.t[-1] - motion.t[0]:.2f} s, way {way.round(3)} m, from {motion.source}"
)

tendons = tendon_angles(bag)  # measured, else commanded
figure, (above, below) = plt.subplots(2, sharex=True)
above.plot(motion.t, 1e3 * motion.position[:, 2])
above.set_ylabel("height (mm)")
below.plot(tendons.t, np.degrees(tendons.angle), label=["FL", "FR", "RL", "RR"])
below.set(xlabel="time (s)", ylabel="tendon angles (deg)")
below.legend()
figure.savefig("walk.png")
print("walk.png written")
