"""Legs that relax, compared with the creep of a material with two Maxwell branches."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from slot_core import config
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.robot import read_robot
from slot_core.simulation.make_robot import make_robot
from slot_core.simulation.rod_robot import RodRobot

HELD = 1e9  # kg, a torso that no leg moves
# m/s^2: the legs bend in both planes, twist and stretch
FIELD = np.array([-2.0, 4.0, -1.0])
SHARE, TIME, DAMPING = (0.7, 0.4), (0.05, 0.6), 0.01
RELAXING = config.replace(
    read_robot(),
    {
        "leg.young_modulus": 9e8,  # small deflections, above all vibrations
        "leg.relaxation_share": SHARE,
        "leg.relaxation_time": TIME,
        "leg.damping_time": DAMPING,
    },
)


def loaded(robot):
    """The robot above the floor, its torso held, its legs under a field from time 0 on."""
    held = dataclasses.replace(
        robot, torso=dataclasses.replace(robot.torso, mass=HELD)
    )
    start = {
        "start.height": 5.0,
        "start.settle": 0.0,
        "gravity": FIELD.tolist(),
    }
    sim = RodRobot(
        held, config.replace(read_scene("flat"), start), read_servo()
    )
    sim.push(-HELD * FIELD, np.zeros(3))
    return sim


def creep(times):
    """Strain over its static value under a constant load, e = e_static f(t)."""

    def rate(_, y):
        e, a = y[0], y[1:]
        return [(1.0 - e - np.dot(SHARE, e - a)) / DAMPING, *((e - a) / TIME)]

    return solve_ivp(
        rate, (0.0, times[-1]), np.zeros(3), t_eval=times, rtol=1e-9, atol=1e-12
    ).y[0]


def test_a_loaded_leg_creeps_as_its_material_to_the_strain_of_youngs_modulus():
    sim = loaded(RELAXING)
    begin, times, course = (
        sim.state.node[0, -1].copy(),
        np.arange(1, 201) * 0.01,
        [],
    )
    for _ in times:
        sim.advance(10, np.zeros(4))
        course.append(sim.state.node[0, -1] - begin)
    plain = loaded(
        config.replace(RELAXING, {"leg.relaxation_share": (0.0, 0.0)})
    )
    for robot in (sim, plain):
        robot.advance(10_000, np.zeros(4))
    static, expected = plain.state.node[0, -1] - begin, creep(times)
    np.testing.assert_allclose(sim.state.node[0, -1] - begin, static, rtol=1e-4)
    assert np.abs(static).min() > 1e-6
    assert expected[10] < 0.7
    shares = np.array(course) / static
    for axis in range(3):
        assert shares[1:, axis] == pytest.approx(expected[1:], abs=3e-3), axis


@pytest.mark.parametrize("legs", ["map", "paper"])
def test_only_spatial_legs_relax(legs):
    scene = config.replace(read_scene("flat"), {"solver.legs": legs})
    with pytest.raises(
        config.ConfigError,
        match=f"leg.relaxation_share = .* model '{legs}' cannot",
    ):
        make_robot(RELAXING, scene, read_servo())
