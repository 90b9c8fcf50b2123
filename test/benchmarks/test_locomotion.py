"""Benchmark of the locomotion: a controller that does nothing fails its checks."""

import numpy as np

from benchmarks.locomotion import benchmark
from benchmarks.locomotion.cases import COLUMNS, WalkMotion
from benchmarks.locomotion.rows import rows

SEEDS = dict.fromkeys(COLUMNS, (1,))


def still(case, column, seed):
    """Motion of a robot that stands level at 40 mm, whatever is commanded."""
    time = np.arange(0.0, case.duration, 0.033)
    position = np.tile([0.0, 0.0, 0.04], (len(time), 1))
    return WalkMotion(
        time, position, np.zeros((len(time), 3)), *np.zeros((2, len(time))), False
    )


def checks_of(wanted, move):
    jobs = [(c, column, 1) for row in wanted for c in row.cases for column in COLUMNS]
    motions = {job: move(*job) for job in jobs}
    return benchmark.checks(wanted, benchmark.measured(wanted, motions, SEEDS))


def test_a_controller_without_effect_fails_every_benefit():
    """Equal motions with and without it, here those of a robot that does not move."""
    wanted = rows(quick=False)
    checks = checks_of(wanted, still)
    found = [check for check in checks if check.name.endswith("over the gait alone")]
    assert len(found) > 20
    assert not [check.name for check in found if check.holds]
