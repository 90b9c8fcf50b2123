"""Lanes compared with NumPy, and four legs in lanes with the same equations leg by leg."""

import copy
import math
from typing import NamedTuple

import numpy as np
import pytest
from numba import njit
from numba.core.errors import NumbaError, TypingError
from rod_robots import advance_one_by_one, simulator

from slot_core import compiled
from slot_core.dynamics import integrator
from slot_core.dynamics.algebra import cosine_sine
from slot_core.dynamics.handle import Handle
from slot_core.dynamics.lanes import (
    all_lanes,
    any_lane,
    in_lanes,
    largest,
    like,
    total,
    where,
)
from slot_core.dynamics.spatial.strain import rotation_vector

FEATURES = {
    "bristles": {"floor__friction_law": "bristle"},
    "direction": {
        "floor__friction_varies": "direction",
        "floor__friction_other": [0.1] * 4,
    },
    "phase": {
        "floor__friction_varies": "phase",
        "floor__friction_other": [0.1] * 4,
    },
    "map": {"floor__height_map": "uneven.csv"},
    "map with bristles": {
        "floor__height_map": "uneven.csv",
        "floor__friction_law": "bristle",
    },
    "tips": {"floor__contact": "tip"},
    "payload": {"payload__mass": 0.5, "payload__place": [0.02, 0.03, 0.04]},
    "faults": {
        "tendons__slack": [0.0, 2e-3, 0.0, 0.0],
        "tendons__broken": [False, False, True, False],
    },
    "pid": {"servo": {"model": "pid", "integral": 5.0, "backlash_deg": 2.0}},
}


def run(sims, degrees, steps):
    """Advance robots, the legs of the second one by one, of the others in lanes."""
    for number, sim in enumerate(sims):
        sim._legs.command[0] = np.radians(degrees)
        if number == 1:
            assert advance_one_by_one(sim, steps) == (steps, -1)
        else:
            assert integrator.advance(sim.handle, steps) == (steps, -1)


@pytest.mark.parametrize("feature", FEATURES)
def test_legs_in_lanes_move_as_legs_one_by_one_with_every_feature(feature):
    """From the start for 0.3 s, tendons pulled and then partly released, each leg differently."""
    rest = {"start__settle": 0.0}
    changed = rest | FEATURES[feature]
    lanes, single, plain = sims = [
        simulator(**c) for c in (changed, changed, rest)
    ]
    for degrees in [[90.0, 40.0, 60.0, 75.0]] * 6 + [
        [30.0, 70.0, 0.0, 75.0]
    ] * 4:
        run(sims, degrees, 30)
        a, b = lanes.state, single.state
        np.testing.assert_allclose(a.buffer, b.buffer, rtol=1e-6, atol=1e-5)
        np.testing.assert_allclose(a.node, b.node, rtol=0, atol=1e-7)
    # m: the feature has an effect
    assert np.abs(lanes.state.node - plain.state.node).max() > 1e-5


def test_legs_in_lanes_halve_the_same_steps_as_legs_one_by_one():
    """An impact at 3 m/s with different tendon angles: contact and large angles in some lanes."""
    start = {"start__height": 0.06, "start__settle": 0.0}
    sims = [simulator(**start, solver__correction_limit=1e-4) for _ in range(2)]
    for sim in sims:
        sim.set_motion(np.array([0.0, 0.0, -3.0]), np.zeros(3))
    run(sims, np.degrees([1.9, 0.0, 1.0, 2.0]), 150)
    nodes, counters = zip(
        *((sim.state.node, sim._work.counter) for sim in sims)
    )
    np.testing.assert_allclose(*nodes, rtol=0, atol=1e-7)
    np.testing.assert_array_equal(*counters)
    assert counters[0][0] > 0


class Pair(NamedTuple):
    """Operands and results of a kernel on lanes, (n, 4)."""

    a: np.ndarray
    out: np.ndarray


def on_lanes(function, count, *rows):
    """(count, 4) results that a function of two Lanes arrays (operands, results) writes."""
    pair = Pair(np.array(rows, dtype=float), np.full((count, 4), 7.0))
    inner = njit(function)

    @njit
    def run(pair):
        view = in_lanes(pair)
        inner(view.a, view.out)

    run(pair)
    return pair.out


A, B = np.array([1.5, -2.0, 0.0, 1e200]), np.array([0.5, 3.0, 2.0, 1e-9])


def test_lanes_compute_as_numpy_does():
    def kernel(v, out):
        a, b = v[0], v[1]
        out[0], out[1], out[2], out[3] = a + b, a - b, a * b, a / b
        out[4], out[5], out[6], out[7] = max(a, b), min(a, b), -a, math.sqrt(b)
        out[8], out[9], out[10], out[11] = (
            2.0 - a,
            3 * b,
            where(a > b, a, b),
            like(4.0, a),
        )
        out[12], out[13] = total(v[2]), largest(v[2])
        out[14] = (
            1.0 if any_lane(v[2] > 3.5) and not any_lane(v[2] < 1.0) else 0.0
        )
        out[15] = (
            1.0 if all_lanes(v[2] >= 1.0) and not all_lanes(v[2] > 3.5) else 0.0
        )
        one, none = like(1.0, a), like(0.0, a)
        out[16], out[17] = (
            where(v[3] < 1.0, one, none),
            where(v[3] >= 1.0, one, none),
        )
        a -= b
        a /= 2.0
        out[18] = a

    expected = [
        A + B,
        A - B,
        A * B,
        A / B,
        np.maximum(A, B),
        np.minimum(A, B),
        -A,
        np.sqrt(B),
    ]
    expected += [
        2 - A,
        3 * B,
        np.maximum(A, B),
        *(np.full(4, x) for x in (4, 10, 4)),
    ]
    # a comparison with NaN is false in its lane
    expected += [
        np.ones(4),
        np.ones(4),
        [0, 1, 0, 0],
        [0, 0, 1, 1],
        (A - B) / 2,
    ]
    special = [4.0, 1.0, 3.0, 2.0], [np.nan, 0.0, 1.0, np.inf]
    np.testing.assert_array_equal(
        on_lanes(kernel, 19, A, B, *special), expected
    )


def test_small_and_large_angles_are_exact_in_the_same_lanes():
    """Series and library function side by side; both are exact to rounding."""

    def kernel(v, out):
        out[0], out[1] = c, s = cosine_sine(v[0])
        one, none = like(1.0, v[0]), like(0.0, v[0])
        fixed = ((one, none, none), (none, one, none), (none, none, one))
        psi, _ = rotation_vector(
            fixed, ((c, none, -s), (none, one, none), (s, none, c))
        )
        out[2], out[3], out[4] = psi

    angles = np.array([0.0, 1e-3, 0.4, -3.0])
    expected = [np.cos(angles), np.sin(angles), 0 * angles, angles, 0 * angles]
    # near 180 deg the cosine's rounding grows by the tangent of half the angle
    np.testing.assert_allclose(
        on_lanes(kernel, 5, angles), expected, rtol=1e-15, atol=1e-16
    )


@pytest.mark.parametrize(
    ("act", "error", "message"),
    [
        (
            lambda: njit(lambda pair: in_lanes(pair).a[0])(
                Pair(np.zeros((4, 3)).T, np.zeros((3, 4)))
            ),
            TypingError,
            "last axis of a contiguous array",
        ),
        (
            lambda: copy.deepcopy(Handle((1.0, np.zeros(3)))),
            TypeError,
            "cannot be copied",
        ),
        (
            lambda: compiled.kernel(lambda n: np.zeros(n).size)(3),
            NumbaError,
            "NRT required|array passed into the function",
        ),
    ],
)
def test_strided_lanes_copied_handles_and_allocating_kernels_are_refused(
    act, error, message
):
    with pytest.raises(error, match=message):
        act()
