"""Failures are excused on a machine that did not keep up, and on no other; with given samples."""

from types import SimpleNamespace

import pytest
from machine_load import Cpu, Judge, Load, own_cpu, read_cpu

CORES = 2


def load(late=(0.001,), others=(0.0,), own=0.5):
    """Load of late wake-ups (s); others take those shares of the CPU in seconds, the test `own`."""
    cpu = [Cpu(100.0, 50.0, 20.0)]
    for share in others:
        last = cpu[-1]
        busy = last.busy + CORES * (share + own)
        cpu.append(Cpu(last.passed + CORES, busy, last.own + CORES * own))
    return Load(list(late), cpu)


KEPT_UP = [
    load(),
    Load(),  # a test shorter than a period
    load(late=[0.001] * 99 + [0.4]),  # once
    load(others=[0.2] * 10),
    load(others=[0.5, *[0.0] * 9]),
    load(own=1.0, others=[0.0] * 10),  # the graph under test may use all there is
    load(
        own=0.0, others=[-0.01, 0.0]
    ),  # the counts of kernel and processes differ by a step
]
OVERLOADED = [
    (
        load(late=[0.001] * 97 + [0.08, 0.3, 0.06]),
        "3 % of the wake-ups more than 50 ms late, at most 300 ms",
    ),
    (
        load(others=[0.3] * 10),
        "other programs took 30 % of the CPU, at most 30 % in a second",
    ),
    (
        load(others=[0.7, *[0.0] * 9]),
        "other programs took 7 % of the CPU, at most 70 % in a second",
    ),
]


def report(failed=True):
    return SimpleNamespace(
        failed=failed, outcome="failed" if failed else "passed", longrepr=""
    )


@pytest.mark.parametrize("kept_up", KEPT_UP)
def test_on_a_machine_that_kept_up_a_failure_stays_a_failure(kept_up):
    failed = report()
    Judge().judge(failed, ("file", 1), AssertionError(), kept_up)
    assert (kept_up.overload(), failed.outcome) == ("", "failed")


@pytest.mark.parametrize(("overloaded", "reason"), OVERLOADED)
def test_on_an_overloaded_machine_a_failure_is_skipped_with_the_figures(
    overloaded, reason
):
    failed, passed = report(), report(failed=False)
    for each in (failed, passed):
        Judge().judge(each, ("file", 1), AssertionError(), overloaded)
    assert failed.outcome == "skipped"
    assert failed.longrepr == ("file", 1, f"Skipped: machine too slow: {reason}")
    assert passed.outcome == "passed"


def test_a_fixture_that_failed_on_an_overloaded_machine_is_excused_in_every_test_that_uses_it():
    judge, error = Judge(), RuntimeError("the run failed")
    first, second, other = report(), report(), report()
    judge.judge(first, ("file", 1), error, load(others=[0.9]))
    judge.judge(second, ("file", 2), error, load())
    judge.judge(other, ("file", 3), RuntimeError("the run failed"), load())
    assert [each.outcome for each in (first, second, other)] == [
        "skipped",
        "skipped",
        "failed",
    ]


def test_the_cpu_of_this_process_is_its_own():
    """CPU time of this process between two readings counts as its own."""
    before, used = read_cpu(), own_cpu()
    while own_cpu() - used < 0.1:
        pass
    after = read_cpu()
    assert after.own - before.own >= 0.1
    assert after.busy - before.busy >= 0.1 - 0.02  # the kernel's step, on two cores
    assert after.passed > before.passed
