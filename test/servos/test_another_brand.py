"""A brand of servos in one file runs in simulation and driver node as they are."""

import numpy as np
import pytest
from ideal_servos import IdealServos, make_brand
from real_graph import domain, set_values  # noqa: F401 - a fixture
from simulated_rig import SimulatedRig
from std_srvs.srv import Trigger
from stub_supervisor import DRIVER, StubSupervisor

from slot_core.config import ConfigError
from slot_core.safety.states import Action, State
from slot_core.servos import registry
from slot_core.simulation.supervised_loop import SupervisedLoop


def test_the_robot_stands_on_servos_of_another_brand(own_config, monkeypatch):
    monkeypatch.setitem(registry.BRANDS, "ideal", make_brand)
    set_values(own_config, {"servo_bus": {"brand": "ideal"}})
    loop = SupervisedLoop("flat", "stand", None, 0, hardware="fake_bus")
    reports = list(loop.run(3.0))
    assert reports[-1].state is State.STANDING
    assert reports[-1].followed
    assert loop.servos.session.bus.facts.brand == "ideal"
    assert loop.plant.robot.position[2] == pytest.approx(0.04, abs=2e-3)
    assert loop.servos.close(running=True) == ""


def test_the_driver_node_drives_servos_of_another_brand(tmp_path, monkeypatch):
    rig = SimulatedRig(
        tmp_path, {"servo_bus": {"brand": "ideal"}}, only=[], hardware="real"
    )
    servos = IdealServos()
    brand = make_brand(servos, rig.seconds)
    monkeypatch.setitem(registry.BRANDS, "ideal", lambda: brand)
    rig.every(0.01, lambda: servos.advance(0.01))
    rig.start(DRIVER)
    stub = StubSupervisor(rig)
    stub.move_to(1.0)
    rig.run(0.5)
    assert rig.last("/joint_states").position == pytest.approx(np.ones(4))
    assert all(rig.last("/servo_health").torque)
    rig.wait_for(lambda: rig.messages["/diagnostics"])
    assert rig.last("/diagnostics").status[1].hardware_id == "ideal"
    stub.permission, begin = Action.OFF, rig.now()
    rig.wait_for_torque_off(begin)
    answer = rig.call(Trigger, f"/{DRIVER}/zero_fl")
    assert (answer.success, answer.message) == (
        False,
        "servos of ideal have no such service",
    )
    rig.close()


@pytest.mark.parametrize(
    ("brand", "reason"),
    [
        ("other", r"brand = 'other': expected one of dynamixel"),
        ("bare", "cannot be emulated"),
    ],
)
def test_a_brand_that_is_unknown_or_has_no_emulator_cannot_be_simulated(
    own_config, monkeypatch, brand, reason
):
    bare = registry.Brand(lambda: None, lambda settings: None)
    monkeypatch.setitem(registry.BRANDS, "bare", lambda: bare)
    set_values(own_config, {"servo_bus": {"brand": brand}})
    with pytest.raises(ConfigError, match=reason):
        SupervisedLoop("flat", "stand", None, 0, hardware="fake_bus")
    with pytest.raises(ConfigError, match="have no tools"):
        bare.tools([])
