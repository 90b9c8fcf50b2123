"""Choice between one process for the controller's nodes and a process for each of them."""

import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from slot_bringup.graph import policy_of
from slot_core.clock import LOCKSTEP_START, to_ns
from slot_core.config import ConfigError
from slot_core.control.controller import Controller
from slot_core.control.policy import make_policy
from slot_core.dynamics.scene import read_scene
from slot_core.estimation.state_estimator import read_estimator
from slot_core.gait.gait import read_gaits
from slot_core.robot import GRAVITY, read_robot

SETTLING, MEASURED = 4, 16  # ticks
TORSO_HEIGHT = 0.04  # m, of the standing robot
# M, CPU time of the four nodes in a walk over that within the core
NODES_OVER_CORE = 2.0
# M, of a core: at loads of 0.58 and 0.73 the 99th percentile from odometry to command is 5 and 8 ms
# in one process, 9 and 10 ms in four; at 0.97 and 1.16 it is 15 and 23 ms in one, 11 ms in four.
LOAD_MAX = 0.8
CONTROL_GROUPS = Path("/sys/fs/cgroup")


def choose(values: Mapping[str, Any]) -> tuple[bool, str]:
    """Whether the controller's nodes share a process, and a line that says why; "" if told so.

    One process saves the way of messages through DDS and a third of the CPU time, but it is one
    thread. A process for each node lets them work at a time, where there are cores for it.
    """
    if values["composed"] is not None:
        return values["composed"], ""
    if values["lockstep"]:
        return True, ""  # only one node works at a time
    cores = available_cores()
    if cores < 2.0:
        return (
            True,
            f"controller in one process: {cores:.2g} cores for the graph, less than 2",
        )
    try:
        load = NODES_OVER_CORE * core_load(policy_of(values), values["gait"])
    except ConfigError:
        raise
    except Exception as error:  # of a user's policy, which ends its node too
        found = f"its policy fails, {type(error).__name__}: {error}"
        return False, f"controller in four processes: {found}"
    processes = "one process" if load <= LOAD_MAX else "four processes"
    return load <= LOAD_MAX, (
        f"controller in {processes}: its load is {load:.2f} of a core,"
        f" limit {LOAD_MAX:g}"
    )


def available_cores(groups: Path = CONTROL_GROUPS) -> float:
    """Cores that this process may use: those of its affinity within the quota of its container.

    The quota is the CPU time in a period, both in microseconds; its files differ between the two
    versions of control groups.
    """
    cores = float(len(os.sched_getaffinity(0)))
    for names in (
        ["cpu.max"],
        ["cpu/cpu.cfs_quota_us", "cpu/cpu.cfs_period_us"],
    ):
        try:
            quota, period = " ".join(
                (groups / name).read_text() for name in names
            ).split()
        except (OSError, ValueError):  # no such control group
            continue
        if quota not in ("max", "-1"):
            return min(cores, int(quota) / int(period))
    return cores


def core_load(policy: str, gait: str) -> float:
    """CPU time of estimator, scheduler, policy and force map per second of a walk.

    Measured at a steady pose with the odometry and IMU of the scene `flat`, the median over
    MEASURED ticks. Raises ConfigError as `make_policy`.
    """
    robot, sensors = read_robot(), read_scene("flat").sensors
    controller = Controller(
        robot, make_policy(policy, robot), gait, None, gaits=read_gaits()
    )
    period = read_estimator().timing.period
    step, imu = to_ns(period), to_ns(sensors.imu.period)
    place, level = (
        np.array([0.0, 0.0, TORSO_HEIGHT]),
        np.array([0.0, 0.0, 0.0, 1.0]),
    )
    still, upward = np.zeros(3), np.array([0.0, 0.0, GRAVITY])
    busy: list[float] = []
    for stamp in range(
        LOCKSTEP_START, LOCKSTEP_START + (SETTLING + MEASURED) * step, step
    ):
        begin = time.thread_time()
        controller.estimator.add_odometry(stamp, place, level, still, still)
        for at in range(stamp, stamp + step, imu):
            controller.estimator.add_imu(at, still, upward)
            controller.poll()
        busy.append(time.thread_time() - begin)
    return float(np.median(busy[SETTLING:])) / period
