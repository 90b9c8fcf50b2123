"""Port of the driver: refusals, and a pseudo-terminal of emulated servos, which takes real time."""

import time

import pytest
from driver_rig import DriverRig

from slot_core.dynamixel.driver import Driver
from slot_core.dynamixel.emulator.pseudo_terminal import PseudoTerminal
from slot_core.dynamixel.port import BaudRateError, SerialPort, check_latency
from slot_core.faults import Fault
from slot_core.servos.servo_bus import PortError


@pytest.fixture
def rig(tmp_path):
    """Driver and emulated servos behind a pseudo-terminal."""
    rig = DriverRig()
    rig.terminal = PseudoTerminal(rig.bus, tmp_path / "servos")
    # longer than on the robot: a busy machine delays the emulator's thread
    port = SerialPort(rig.terminal.name, 1000000, 1.0)
    rig.driver = Driver(port, rig.driver.settings, lambda: rig.time)
    yield rig
    rig.driver.close()
    rig.terminal.close()


def test_a_baud_rate_that_the_port_does_not_support_is_refused(tmp_path):
    with pytest.raises(BaudRateError, match="4500000 baud is not supported"):
        SerialPort(str(tmp_path / "none"), 4500000, 0.01).open()
    with pytest.raises(PortError, match="none"):
        SerialPort(str(tmp_path / "none"), 1000000, 0.01).open()


def test_a_port_cannot_be_opened_twice(rig):
    rig.driver.configure()
    with pytest.raises(PortError, match="lock"):
        SerialPort(rig.terminal.name, 1000000, 0.01).open()


def test_a_slow_latency_timer_is_refused_with_the_udev_rule_against_it(
    tmp_path,
):
    timer = tmp_path / "ttyUSB7" / "device" / "latency_timer"
    timer.parent.mkdir(parents=True)
    timer.write_text("16\n")
    with pytest.raises(
        PortError, match=r"16 ms, limit 1 ms.*ATTR\{latency_timer\}=\"1\""
    ):
        check_latency("/dev/ttyUSB7", 1, tmp_path)
    timer.write_text("1\n")
    assert check_latency("/dev/ttyUSB7", 1, tmp_path) == 1
    assert check_latency("/dev/ttyACM0", 1, tmp_path) is None


def wait_for(condition):
    """Wait until a condition holds, on a busy machine too."""
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_a_released_port_is_in_use_until_the_driver_closes_it(rig):
    rig.driver.configure()
    rig.terminal.release()
    rig.driver.activate()
    assert rig.driver.torque_off().complete
    assert rig.terminal.in_use
    rig.driver.close()
    wait_for(lambda: not rig.terminal.in_use)


def test_a_released_port_that_no_driver_has_opened_is_not_in_use(rig):
    rig.terminal.release()
    wait_for(lambda: not rig.terminal.in_use)


def test_a_driver_can_configure_again_after_a_replug(rig, tmp_path):
    rig.start()
    rig.fault("unplugged")
    link = tmp_path / "servos"
    wait_for(lambda: not link.exists())
    with pytest.raises(PortError):
        rig.driver.cycle()
    rig.driver.close()
    with pytest.raises(PortError, match="servos"):
        rig.driver.configure()
    rig.bus.set_fault(Fault("unplugged", "all", 0, 0, 0), False)
    wait_for(link.exists)
    rig.start()
    assert rig.run(0.02)[-1].complete
