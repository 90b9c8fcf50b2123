"""References, errors and limits of the plan; the equations are in `problem.py`."""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

import math

from slot_core.compiled import kernel
from slot_core.elementary import cos, sin


@kernel
def set_reference(rows, place, drift, sag, dt, reach, pose):
    """Write the poses (K, 6) that the rollouts are to have, from a preview's reference (n, 12).

    place: x, y (m), yaw (rad) of the robot; drift: v_x, v_y (m/s), yaw rate (rad/s), heading frame;
    sag: m by which the torso is lower; reach: m. Roll and pitch are the means of the gait's.
    """
    count = pose.shape[0]
    roll = pitch = 0.0
    for k in range(count):
        roll += rows[k + 1, 0] / count
        pitch += rows[k + 1, 1] / count
    ahead, aside = rows[0, 3] - place[0], rows[0, 4] - place[1]
    distance = math.sqrt(ahead * ahead + aside * aside)
    share = 1.0 - reach / distance if distance > reach else 0.0
    c, s = cos(place[2]), sin(place[2])
    for k in range(count):
        row, time = rows[k + 1], dt * (k + 1)
        x, y = time * drift[0], time * drift[1]
        pose[k, 0], pose[k, 1] = roll, pitch
        pose[k, 2] = row[2] - time * drift[2]
        pose[k, 3] = row[3] - share * ahead - (c * x - s * y)
        pose[k, 4] = row[4] - share * aside - (s * x + c * y)
        pose[k, 5] = row[5] - sag


@kernel
def set_errors(pose, reference, w, yaw, error):
    """Write errors (P, K, 6) of poses (P, K, 6), x and y along and across the heading.

    w: (6,) weights of the errors.
    """
    c, s = cos(yaw), sin(yaw)
    for p in range(pose.shape[0]):
        for k in range(pose.shape[1]):
            is_, should, e = pose[p, k], reference[k], error[p, k]
            x, y = is_[3] - should[3], is_[4] - should[4]
            turn = is_[2] - should[2] + math.pi
            turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi)) + math.pi
            e[0], e[1], e[2] = (
                (is_[0] - should[0]) * w[0],
                (is_[1] - should[1]) * w[1],
                turn * w[2],
            )
            e[3], e[4] = (c * x + s * y) * w[3], (c * y - s * x) * w[4]
            e[5] = (is_[5] - should[5]) * w[5]


@kernel
def set_limits(nominal, deviation, least, largest, most, step, low, high):
    """Write the limits (8 K + 4,) of the changes of a plan's angles, then of their differences.

    nominal, deviation: (K + 1, 4) rad; least, largest: of an angle, rad; most: largest deviation,
    rad; step: largest difference between two stages, rad. What the plan violates already may stay.
    """
    count = nominal.size
    for k in range(nominal.shape[0]):
        for leg in range(4):
            i, angle, b = 4 * k + leg, nominal[k, leg], deviation[k, leg]
            low[i] = min(max(least - angle, -most) - b, 0.0)
            high[i] = max(min(largest - angle, most) - b, 0.0)
            if k + 1 < nominal.shape[0]:
                rise, change = nominal[k + 1, leg] - angle, deviation[k + 1, leg] - b
                low[count + i] = min(min(-step - rise, 0.0) - change, 0.0)
                high[count + i] = max(max(step - rise, 0.0) - change, 0.0)
