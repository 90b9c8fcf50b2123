"""Growth over a long walk: what is found and what is no growth."""

import numpy as np
import pytest

from benchmarks.graph.endurance import NODE_FIGURES, Samples, endurance_checks

COUNT = 100


def samples(**grown):
    """Samples of two nodes that grow during the first fifth; the second one also by `grown`."""
    later = np.maximum(np.linspace(-0.25, 1.0, COUNT), 0.0)
    warm_up = np.minimum(np.linspace(0.0, 5.0, COUNT), 1.0)
    result = Samples()
    for warm, share in zip(warm_up, later):
        still = [50.0 + 10.0 * warm, 7.0, 30.0]
        growing = [v + share * grown.get(name, 0.0) for v, name in zip(still, NODE_FIGURES)]
        result.figures.append([still, growing])
        result.shared.append(1.0 + share * grown.get("shared_mb", 0.0))
    return result


def rows(of):
    nodes, shared = of.growth()
    return [
        *(
            {"kind": "endurance", **{f"{n}_grown": v for n, v in zip(NODE_FIGURES, row)}}
            for row in nodes
        ),
        {"kind": "shared memory", "grown_mb": shared},
    ]


def test_what_fills_during_the_warm_up_is_no_growth():
    assert all(check.holds for check in endurance_checks(rows(samples())))


@pytest.mark.parametrize(
    ("name", "amount", "index"),
    [("memory_mb", 1.3, 0), ("threads", 2.0, 1), ("descriptors", 2.0, 2), ("shared_mb", 0.1, 3)],
)
def test_what_grows_fails_its_check_alone(name, amount, index):
    found = endurance_checks(rows(samples(**{name: amount})))
    assert [check.holds for check in found] == [i != index for i in range(4)]
    assert found[index].value == pytest.approx(0.9 * amount, rel=0.02)


def test_without_a_long_walk_nothing_is_checked():
    assert endurance_checks([{"kind": "walk"}]) == []
