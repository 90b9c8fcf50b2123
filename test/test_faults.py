"""Faults of the simulated robot: planned in a scene, injected, cleared, refused."""

import math

import numpy as np
import pytest
from rod_robots import plant

from slot_core import config
from slot_core.dynamics.scene import read_scene
from slot_core.faults import Fault
from slot_core.refusal import DivergenceError

START, MILLISECOND = 7_000_000_000, 1_000_000  # ns
SETTLE = 0.3  # s, enough for the tendons to be taut


def planned(kind, leg="FL", time=0.0, duration=0.0, value=0.0):
    return {
        "kind": kind,
        "leg": leg,
        "time": time,
        "duration": duration,
        "value": value,
    }


def make(solver="standard", bus=False, tendons=None, **faults):
    changes = {"faults": faults, "start.settle": SETTLE} | (tendons or {})
    changes["solver"] = config.load(f"solver/{solver}")
    return plant(config.replace(read_scene("flat"), changes), bus=bus)


def advance(plant, milliseconds):
    list(plant.advance(plant.now + milliseconds * MILLISECOND))


def recorded(plant, milliseconds, read):
    """Values of `read` before each of the next milliseconds and after the last."""
    values = [read()]
    for _ in range(milliseconds):
        advance(plant, 1)
        values.append(read())
    return np.array(values)


@pytest.mark.parametrize("solver", ["standard", "map"])
def test_a_planned_fault_begins_at_its_time_on_its_leg_and_ends_after_its_duration(
    solver,
):
    broken = planned("tendon_broken", "RL", 0.010, 0.020)
    longer = planned("tendon_slack", "FR", 0.010, 0.0, 0.003)
    plant = make(solver, broken=broken, longer=longer)
    plant.start(START)
    tension = recorded(plant, 60, lambda: plant.robot.tension)
    assert (tension[:11] > 1.0).all()
    # the tension is that of the last step's stage
    assert (tension[11:31, 2] == 0.0).all()
    assert tension[60, 2] > 1.0
    assert tension[11, 1] < 0.8 * tension[10, 1]
    # no effect on the others within one step
    assert tension[11, [0, 3]] == pytest.approx(tension[10, [0, 3]], rel=0.05)
    assert (tension[:, [0, 3]] > 1.0).all()


def test_a_fault_adds_to_the_tendon_damage_of_the_scene_and_ends_without_it():
    broken = {"tendons.broken": [False, True, False, False]}
    plant = make(tendons={"tendons.slack": [0.001, 0, 0, 0]} | broken)
    plant.start(START)
    plant.faults.inject(Fault("tendon_slack", "all", 0, 0.01, 0.002))
    plant.faults.inject(Fault("tendon_broken", "all", 0, 0.01, 0))
    fault = plant.robot.model.fault
    assert fault.tolist() == [[0.003, 0.002, 0.002, 0.002], [0.0] * 4]
    advance(plant, 11)
    assert fault.tolist() == [[0.001, 0.0, 0.0, 0.0], [1.0, 0.0, 1.0, 1.0]]


def test_the_end_of_a_replaced_or_cleared_fault_does_not_end_its_successor():
    plant = make()
    plant.start(START)
    slack = plant.robot.model.fault[0]
    plant.faults.inject(Fault("tendon_slack", "FL", 0, 0.010, 0.001))
    with pytest.raises(ValueError, match="no fault 'tendon_slack' at 'FR'"):
        plant.faults.clear("tendon_slack", "FR")
    advance(plant, 5)
    plant.faults.inject(Fault("tendon_slack", "all", 0, 0.020, 0.002))
    advance(plant, 10)  # beyond the end of the first
    assert slack.tolist() == [0.002] * 4
    plant.faults.clear("tendon_slack", "RR")
    assert slack.tolist() == [0.002, 0.002, 0.002, 0.0]
    plant.faults.inject(Fault("tendon_slack", "RR", 0, 0, 0.003))
    advance(plant, 20)
    assert slack.tolist() == [0.0, 0.0, 0.0, 0.003]


def test_a_fault_injected_before_the_start_acts_at_once_and_its_time_runs_from_the_start():
    plant = make()
    plant.readings_at_rest(START)
    plant.faults.inject(Fault("tendon_broken", "FL", 0, 0.010, 0))
    holds = plant.robot.model.fault[1]
    assert holds[0] == 0.0
    plant.start(START + 1000 * MILLISECOND)
    assert (
        recorded(plant, 15, lambda: holds[0]).tolist() == [0.0] * 10 + [1.0] * 6
    )


@pytest.mark.parametrize(
    ("solver", "fault", "message"),
    [
        (
            "standard",
            planned("silent"),
            r"fault 'silent': only the servos of hardware fake_bus can",
        ),
        (
            "paper",
            planned("tendon_slack", value=0.003),
            r"'tendon_slack': legs of the model 'paper' cannot",
        ),
        (
            "paper",
            planned("tendon_broken"),
            r"'tendon_broken': legs of the model 'paper' cannot",
        ),
        (
            "map",
            planned("nan"),
            r"'nan': legs of the model 'map' cannot have it",
        ),
    ],
)
def test_a_fault_that_the_model_does_not_support_is_refused(
    solver, fault, message, monkeypatch
):
    if solver == "paper":  # as printed it diverges while it settles
        monkeypatch.setattr(f"{__name__}.SETTLE", 0.0)
    with pytest.raises(config.ConfigError, match=message):
        make(solver, wrong=fault)
    plant = make(solver)
    with pytest.raises(config.ConfigError, match=message):
        plant.faults.inject(config.build(Fault, fault, "test"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"kind": "tired"},
            r"kind = 'tired': expected one of silent, .*, tendon_broken, nan",
        ),
        ({"leg": "tail"}, r"leg = 'tail': expected one of all, FL, FR, RL, RR"),
        (
            {"duration": -1.0},
            r"duration = -1\.0: outside \[0\.0, 1000000\.0\] s",
        ),
        ({"value": 0.2}, r"value = 0\.2: outside \[0\.0001, 0\.1\] m"),
        ({"value": 0.0}, r"value = 0\.0: outside \[0\.0001, 0\.1\] m"),
        ({"value": math.nan}, r"value = nan: outside"),
        (
            {"kind": "wrong_id", "value": 253},
            r"value = 253\.0: outside \[0\.0, 252\.0\] as an id",
        ),
        (
            {"kind": "corrupt", "value": 1.1},
            r"value = 1\.1: outside \[0\.001, 1\.0\] of the",
        ),
    ],
)
def test_an_invalid_fault_is_refused_by_name(change, message):
    with pytest.raises(config.ConfigError, match=rf"bad\.yaml: {message}"):
        config.build(Fault, planned("tendon_slack") | change, "bad.yaml")


def test_a_robot_on_a_bus_has_faults_of_its_bus_and_of_its_legs_by_simulated_time():
    plant = make(
        bus=True, warm=planned("overheating", "RR", 0.010, 0.020, 90.0)
    )
    plant.start(START)
    bus = plant.emulated.bus
    hot = recorded(plant, 40, lambda: bus.servos[3].forced_temperature == 90.0)
    assert np.flatnonzero(hot).tolist() == list(range(10, 30))
    plant.faults.inject(Fault("tendon_broken", "FL", 0, 0, 0))
    plant.faults.inject(Fault("unplugged", "FL", 0, 0, 0))
    advance(plant, 2)
    assert plant.robot.tension[0] == 0.0
    assert bus.unplugged
    plant.faults.clear("unplugged", "FL")
    assert not bus.unplugged


def test_a_nan_in_a_rod_raises_divergence_and_its_state_can_be_saved_and_loaded(
    tmp_path,
):
    plant = make(lost=planned("nan", "RL", 0.020))
    plant.start(START)
    command = plant.robot.tendon_angle + 0.1
    plant.command(command)
    with pytest.raises(
        DivergenceError, match=r"in step 21 at 0\.0200 s: .* not a number"
    ) as raised:
        advance(plant, 100)
    path = tmp_path / "log" / "lost.npz"
    raised.value.save(path, "flat")
    state = np.load(path)  # numbers and text: nothing to unpickle
    assert str(state["scene"]) == "flat"
    assert state["time"] == pytest.approx(0.020)  # of steps of 1 ms
    assert state["command"] == pytest.approx(command, abs=0.0)
    damaged = np.isnan(state["before_nodes"]).any(axis=2)
    assert np.argwhere(damaged).tolist() == [
        [2, read_scene("flat").solver.nodes - 1]
    ]
    assert set(state) >= STATE


STATE = {
    "position",
    "rotation",
    "velocity",
    "angular_velocity",
    "tendon_angle",
    "tension",
}


@pytest.mark.parametrize("solver", ["map", "paper"])
def test_every_model_attaches_its_state_to_the_divergence(solver, monkeypatch):
    monkeypatch.setattr(f"{__name__}.SETTLE", 0.0)
    plant = make(solver)
    plant.start(START)
    # m/s, beyond the speed limit of every model
    plant.robot.state.velocity[:] = 2000.0
    plant.command(np.full(4, 0.5))
    with pytest.raises(DivergenceError) as raised:
        advance(plant, 10)
    state = raised.value.state
    assert state["command"].tolist() == [0.5] * 4
    assert {"time", "nodes"} | STATE <= set(state)
