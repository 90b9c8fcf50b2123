"""Port of the driver: refusals, and a pseudo-terminal of emulated servos, which takes real time."""

import time

import pytest
from driver_rig import TerminalRig

from slot_core.dynamixel.port import BaudRateError, SerialPort, check_latency
from slot_core.faults import Fault
from slot_core.servos.servo_bus import PortError

WAIT_LIMIT = 60.0  # s, on a busy machine


@pytest.fixture
def terminal_rig(tmp_path):
    rig = TerminalRig(tmp_path / "servos")
    yield rig
    rig.close()


def test_a_baud_rate_that_the_port_does_not_support_is_refused(tmp_path):
    with pytest.raises(BaudRateError, match="4500000 baud is not supported"):
        SerialPort(str(tmp_path / "none"), 4500000, 0.01).open()
    with pytest.raises(PortError, match="none"):
        SerialPort(str(tmp_path / "none"), 1000000, 0.01).open()


def test_a_port_cannot_be_opened_twice(terminal_rig):
    terminal_rig.driver.configure()
    with pytest.raises(PortError, match="lock"):
        SerialPort(terminal_rig.terminal.name, 1000000, 0.01).open()


def test_a_slow_latency_timer_is_refused_with_the_udev_rule_against_it(tmp_path):
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


def released(terminal):
    """Whether no driver has a released port open any more, within WAIT_LIMIT."""
    end = time.monotonic() + WAIT_LIMIT
    while terminal.in_use and time.monotonic() < end:
        time.sleep(0.01)
    return not terminal.in_use


def test_a_released_port_is_in_use_until_the_driver_closes_it(terminal_rig):
    driver, terminal = terminal_rig.driver, terminal_rig.terminal
    driver.configure()
    terminal.release()
    driver.activate()
    assert driver.torque_off().complete
    assert terminal.in_use
    driver.close()
    assert released(terminal)


def test_a_released_port_that_no_driver_has_opened_is_not_in_use(terminal_rig):
    terminal_rig.terminal.release()
    assert released(terminal_rig.terminal)


def test_a_lost_port_raises_and_torque_off_is_not_confirmed(terminal_rig):
    rig = terminal_rig
    rig.start()
    rig.run(0.1, (1.9,) * 4)
    rig.terminal.close()
    with pytest.raises(PortError):
        rig.driver.cycle()
    assert not rig.driver.torque_off().complete


def test_a_driver_can_configure_again_after_a_replug(terminal_rig, tmp_path):
    rig = terminal_rig.start()
    rig.fault("unplugged")
    deadline = time.monotonic() + 5.0
    while (tmp_path / "servos").exists():
        assert time.monotonic() < deadline
    with pytest.raises(PortError):
        rig.driver.cycle()
    rig.driver.close()
    with pytest.raises(PortError, match="servos"):
        rig.driver.configure()
    rig.bus.clear(Fault("unplugged", "all", 0, 0, 0))
    while not (tmp_path / "servos").exists():
        assert time.monotonic() < deadline
    rig.start()
    assert rig.run(0.02)[-1].complete
