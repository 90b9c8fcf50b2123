"""Identification of a stride on the simulated robot: steering, tables.

Free numbers of a pattern: the symmetry of a stride gives the rest of its coefficients.

A pattern has 4 x 5 coefficients (deg), legs FL FR RL RR, columns m, c1, s1, c2, s2. Symmetries of
the robot, each together with half a stride:

    forward   left and right exchanged: FR = FL, RR = RL half a stride later; 10 numbers
    lateral   the forward pattern reflected at the diagonal: FR and RL exchanged
    turn      half a turn of the robot: RR = FL, RL = FR half a stride later; 10 numbers
    steering  antisymmetric where forward is symmetric, so that it only turns the robot; 10 numbers
"""

from dataclasses import replace
from typing import Any

import numpy as np

from slot_core.arrays import Array
from slot_core.gait.gait import (
    FRONT_REAR,
    HALF_STRIDE_LATER,
    LEFT_RIGHT,
    TORSO_MOTION,
    FourHarmonics,
    Pattern,
    Steering,
    Stride,
    harmonics,
)
from slot_core.geometry import rotate
from slot_core.refusal import InputError
from slot_lab.tuning.stride_run import (
    HEIGHT,
    HELD,
    PITCH,
    ROLL,
    YAW,
    Job,
    RunAll,
    StrideMotion,
    TuningSettings,
)

V_X, V_Y, YAW_RATE, ROLL_MEAN = 0, 1, 2, 4  # in the means of a motion
STEERED = [V_Y, YAW_RATE, ROLL_MEAN]
STEERED_AMPLITUDE = 0.8
PATTERNS = ("forward", "lateral", "turn")


class IdentificationError(InputError):
    """A run of the identification has diverged."""


def run_jobs(run_all: RunAll, jobs: list[Job]) -> list[StrideMotion]:
    """Motions of the jobs; raises IdentificationError if one diverges."""
    motions = []
    for job, motion in zip(jobs, run_all(jobs)):
        if motion is None:
            raise IdentificationError(
                f"the simulation diverges at velocity {job.velocity}, friction {job.friction}"
            )
        motions.append(motion)
    return motions


def find_steering(
    stride: Stride, settings: TuningSettings, run_all: RunAll
) -> tuple[Steering, Array]:
    """Antisymmetric change of the forward pattern that alters the yaw rate alone.

    Also returns what one amplitude of it changes (3,): v_y (m/s), yaw rate (rad/s), roll (rad).

    With the effect J (3, 10) of its numbers x on v_y, yaw rate and roll, by central differences,
    and the scales S: min |S (J x - [0, w, 0])|^2 + |damping x|^2.
    """
    step, size = settings.steering_step_deg, len(settings.friction)
    probe = 0.01  # rad/s, of the steering that is tried
    speed = STEERED_AMPLITUDE * stride.forward.speed
    jobs = []
    for column in np.eye(10):
        changed = replace(
            stride,
            forward_steering=Steering(
                probe, probe, rows(steering(step * column))
            ),
        )
        jobs += [
            Job(changed, mu, (speed, 0.0, turn))
            for turn in (probe, -probe)
            for mu in settings.friction
        ]
    means = np.array(
        [motion.means[STEERED] for motion in run_jobs(run_all, jobs)]
    )
    plus, minus = means.reshape(10, 2, size, 3).mean(axis=2).transpose(1, 0, 2)
    effect = (plus - minus).T / (2 * step)
    scale = 1.0 / np.array(settings.steering_scale)[:, None]
    wanted = np.array([0.0, settings.steering_rate, 0.0])
    matrix = np.vstack([scale * effect, settings.steering_damping * np.eye(10)])
    x = np.linalg.lstsq(
        matrix, np.concatenate([scale[:, 0] * wanted, np.zeros(10)]), rcond=None
    )[0]
    change = effect @ x
    return Steering(
        float(change[1]),
        stride.forward_steering.rate_max,
        rows(steering(x)),
    ), change


def tabulate(
    stride: Stride, settings: TuningSettings, run_all: RunAll
) -> dict[str, Pattern]:
    """Patterns with speed, normal forces and sway at amplitude one, mean over the floors.

    The means of their tendon angles take the common offset that holds the height there.
    """
    jobs = []
    for axis, name in zip(np.eye(3), PATTERNS):
        velocity = tuple(axis * getattr(stride, name).speed)
        jobs += [
            Job(stride, mu, velocity, hold_height=name in HELD)
            for mu in settings.friction
        ]
    motions, size = run_jobs(run_all, jobs), len(settings.friction)
    found = {}
    for n, name in enumerate(PATTERNS):
        part = motions[n * size : (n + 1) * size]
        tables = symmetrised(
            name, np.mean([_table(motion, stride) for motion in part], axis=0)
        )
        angle = np.array(getattr(stride, name).angle_deg)
        angle[:, 0] += np.degrees(np.mean([motion.offset for motion in part]))
        motion: dict[str, Any] = {
            key: tuple(row.tolist())
            for key, row in zip(TORSO_MOTION, tables[4:])
        }
        found[name] = replace(
            getattr(stride, name),
            speed=float(np.mean([motion.means[n] for motion in part])),
            angle_deg=rows(angle),
            normal_force=rows(tables[:4]),
            **motion,
        )
    return found


def _table(motion: StrideMotion, stride: Stride) -> Array:
    """Coefficients (9, 5): normal forces (N) and sway, as differences to the stride at rest."""
    posture = motion.track[:, [ROLL, PITCH, HEIGHT]]
    samples = np.hstack(
        [motion.force, posture, rotate(motion.velocity, -motion.track[:, YAW])]
    )
    table = np.linalg.lstsq(harmonics(motion.phase), samples, rcond=None)[0].T
    table[:4, 0] -= stride.centre_force
    table[6, 0] -= stride.height
    table[7:9, 0] = 0.0
    return np.asarray(table)


# legs after the reflection at the diagonal through FL and RR
DIAGONAL = [0, 2, 1, 3]
NUMBERS = {"forward": 10, "turn": 10}
FREE_LEGS = {"forward": (0, 2), "turn": (0, 1)}
"""Rows of a pattern that are its numbers."""
# Symmetry of the motion of each pattern: legs exchanged, and the sway that changes its sign.
EXCHANGED = {"forward": LEFT_RIGHT, "lateral": FRONT_REAR, "turn": [3, 2, 1, 0]}
REVERSED = {
    "forward": {"roll", "v_y"},
    "lateral": {"pitch", "v_x"},
    "turn": {"roll", "pitch", "v_x", "v_y"},
}


def forward(x: Array) -> Array:
    """Coefficients (4, 5) of the numbers (10,): FL's, then RL's."""
    front, rear = x[:5], x[5:]
    return np.stack(
        [front, front * HALF_STRIDE_LATER, rear, rear * HALF_STRIDE_LATER]
    )


def steering(x: Array) -> Array:
    """Coefficients (4, 5) of the numbers (10,): antisymmetric under forward's symmetry."""
    front, rear = x[:5], x[5:]
    return np.stack(
        [front, -front * HALF_STRIDE_LATER, rear, -rear * HALF_STRIDE_LATER]
    )


def lateral(pattern: Array) -> Array:
    """Lateral pattern (4, 5), to the left, of a forward pattern (4, 5)."""
    return np.asarray(pattern[DIAGONAL])


def turn(x: Array) -> Array:
    """Coefficients (4, 5) of the numbers (10,): FL's, then FR's."""
    left, right = x[:5], x[5:]
    return np.stack(
        [left, right, right * HALF_STRIDE_LATER, left * HALF_STRIDE_LATER]
    )


def numbers(kind: str, pattern: Array) -> Array:
    """Numbers of the pattern of a kind ("forward" or "turn") nearest to a pattern (4, 5)."""
    image = pattern[EXCHANGED[kind]] * HALF_STRIDE_LATER
    return np.concatenate((pattern + image)[list(FREE_LEGS[kind])]) / 2


def symmetrised(name: str, table: Array) -> Array:
    """Table (9, 5) of normal forces and sway; terms that the symmetry excludes become zero."""
    sign = [[-1.0 if key in REVERSED[name] else 1.0] for key in TORSO_MOTION]
    exchanged = np.vstack([table[:4][EXCHANGED[name]], sign * table[4:]])
    image = exchanged * HALF_STRIDE_LATER
    return np.asarray((table + image) / 2)


def rows(pattern: Array) -> FourHarmonics:
    """A pattern (4, 5) as the tuples of a settings class."""
    fl, fr, rl, rr = (tuple(float(value) for value in row) for row in pattern)
    return (fl, fr, rl, rr)  # type: ignore[return-value]
