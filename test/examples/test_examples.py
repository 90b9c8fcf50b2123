"""The examples and the listings of the page `extend` run as written, and do what they promise."""

import math
import re
import runpy
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from recorded_run import record

from slot_bringup.arguments import parse
from slot_bringup.run import check_options
from slot_core.safety.states import State
from slot_core.simulation.supervised_loop import SupervisedLoop
from slot_lab.bags.bag import Bag
from slot_lab.bags.check_bag import check_bag
from slot_lab.bags.recorded_walk import read_motion
from slot_lab.bags.topics import MOTION_TOPICS

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "scripts" / "examples"
EXTEND = (ROOT / "slot_bringup/doc/extend.md").read_text()
OWN = str(EXAMPLES / "own_controller.py")


@pytest.fixture
def output(tmp_path, monkeypatch, capsys):
    """A function that runs an example with arguments in an empty directory; what it prints."""
    monkeypatch.chdir(tmp_path)

    def run(name, *arguments):
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        printed = capsys.readouterr()
        assert uncompiled(printed.err) == []
        return printed.out

    return run


def uncompiled(errors):
    """Lines on stderr but those of the first start, which compiles kernels."""
    lines = errors.splitlines()
    return [x for x in lines if not x.startswith("slot_core: compil")]


def numbers(pattern, text):
    return [float(number) for number in re.findall(pattern, text)]


def test_the_five_lines_of_the_readme(tmp_path):
    readme = (ROOT / "README.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", readme, re.DOTALL)
    (tmp_path / "five.py").write_text(code)
    command = [sys.executable, "five.py"]
    run = subprocess.run(
        command, capture_output=True, text=True, cwd=tmp_path, check=True
    )
    assert uncompiled(run.stderr) == []
    assert len(run.stdout.splitlines()) == 300


def test_walk(output):
    # m: 9 s at 50 mm/s, less the start
    assert numbers(r"x +(-?[\d.]+) m", output("walk.py"))[-1] > 0.4


def test_own_controller(output):
    own, alone = numbers(r"([\d.]+) mm high", output("own_controller.py"))
    assert alone < 37.0  # mm, of 40
    assert own > alone + 2.0


def test_learning_begins_with_the_walk_of_the_gait_alone(
    tmp_path, monkeypatch, output
):
    """On one of its floors, for a second after its warm-up: equal walks are equal everywhere."""
    monkeypatch.setattr("slot_lab.learning.learned_walk.SEEDS", (1,))
    monkeypatch.setattr("slot_lab.learning.learned_walk.FRICTION", (0.4,))
    monkeypatch.setattr("slot_lab.learning.learned_walk.DURATION", 5.0)
    text = output("learn_to_walk.py", "--generations", "0")
    walks = re.findall(r"(?:onnx:walk.onnx|gait_alone) +(.*)", text)
    assert len(walks) == 2
    assert walks[0] == walks[1]
    assert (tmp_path / "learning.png").read_bytes().startswith(b"\x89PNG")


def test_rod_bends(output):
    text = output("rod_bends.py")
    small, smallest, *large = re.findall(r"([\d.]+) mm +([\d.]+) mm", text)
    for rod, beam in (small, smallest):
        assert float(rod) == pytest.approx(float(beam), rel=1e-3)
    for rod, beam in large:
        assert float(rod) < 0.96 * float(beam)
    # 1/s, sqrt(E I / (rho A)) / L^2
    strip = math.sqrt(1e7 * 4e-3**2 / 12 / 1200) / 0.2**2
    assert numbers(r"rest, Hz: \[([\d.]+)", text) == [
        pytest.approx(0.5596 * strip, rel=0.01)
    ]


def test_rod_finger(output):
    text = output("rod_finger.py")
    for rod, theory in re.findall(r"([\d.]+) deg +([\d.]+) deg", text):
        assert float(rod) == pytest.approx(float(theory), abs=0.02)
    assert numbers(r"held at ([\d.]+)", text)[0] == pytest.approx(92.0, abs=0.2)
    assert numbers(r"hangs at (-[\d.]+)", text)[0] < -10.0


def test_rod_trunk(output):
    text = output("rod_trunk.py")
    free, held = numbers(r"tip, mm: \[.* ([\d.]+) *\]", text)
    (wall,) = numbers(r"wall: ([\d.]+)", text)
    assert wall < held < wall + 2.0 < free - 20.0


def test_servo_bus_moves_one_tendon_to_its_goal_and_ends_with_torque_off(
    capsys,
):
    end = runpy.run_path(str(EXAMPLES / "servo_bus.py"))
    text = capsys.readouterr().out
    first, *_, last = numbers(r"([\d.]+) rad", text)
    assert first == pytest.approx(0.2, abs=0.002)  # one count of the encoder
    # below the goal by the droop of a proportional controller under load
    assert last == pytest.approx(1.0, abs=0.03)
    assert end["servos"].angles()[1:] == pytest.approx(0.2, abs=0.03)
    assert text.endswith("torque off\n")
    assert end["servos"].powered() == ()


def test_read_a_bag(tmp_path, output):
    assert "/joint_states  sensor_msgs/msg/JointState" in output(
        "read_a_bag.py"
    )
    assert (tmp_path / "walk.png").read_bytes().startswith(b"\x89PNG")


def test_the_graph_walks_with_a_controller_of_ones_own_and_its_bag_replays(
    tmp_path,
):
    options = ("--lockstep", "--composed", "--policy", OWN, "--duration", "2")
    recorded = Bag(record(tmp_path / "bag", *options))
    assert recorded.origin.files["policy.py"] == Path(OWN).read_bytes()
    compared = {c.topic: c for c in check_bag(recorded, 0.0, OWN)}
    assert compared["/tendon_plan"].compared > 50
    assert [c.largest for c in compared.values()] == [0.0] * 4


def test_gait_and_scene_of_the_page_run_as_its_commands_say(
    own_config, monkeypatch
):
    listing = r"`config/(\S+\.yaml)`:\n\n```yaml\n(.*?)```"
    for name, text in re.findall(listing, EXTEND, re.DOTALL):
        (own_config / name).write_text(text)
    monkeypatch.chdir(ROOT)
    commands = re.findall(r"^scripts/run (.*)", EXTEND, re.MULTILINE)
    given = [parse(words.split()) for words in commands]
    for options in given:
        check_options(options)
    _, low, mine, *_ = given
    stands = SupervisedLoop(low.scene, low.gait, None, 0)
    *_, last = stands.run(2.0)
    assert last.state is State.WALKING  # in the gait that is a posture
    assert stands.plant.robot.position[2] == pytest.approx(0.035, abs=2e-3)
    walks = SupervisedLoop(mine.scene, mine.gait, None, 0)
    *_, last = walks.run(3.0)
    assert last.state is State.WALKING
    assert walks.plant.robot.position[0] > 0.05


@pytest.mark.parametrize(
    "own",
    [
        {
            "mpc_controller": "my_controller.py",
            "state_estimator": "my_estimator.py",
        },
        {"sim_robot": "my_simulator.py"},
    ],
)
def test_the_graph_walks_with_the_nodes_of_the_page(tmp_path, own):
    listings = re.findall(
        r"`(my_\w+\.py)`, in place.*?```python\n(.*?)```", EXTEND, re.DOTALL
    )
    for name, code in listings:
        (tmp_path / name).write_text(code)
    commands = [[sys.executable, tmp_path / name] for name in own.values()]
    nodes = [subprocess.Popen(command) for command in commands]
    options = ("--lockstep", "--composed", "--duration", "2.5", "--without")
    try:
        bag = Bag(record(tmp_path / "bag", *options, ",".join(own)))
    finally:
        for node in nodes:
            node.send_signal(signal.SIGINT)
    assert not any(node.wait(60) for node in nodes)
    # the robot begins at zero, which the bag need not hold: this simulator waits for no recorder
    assert read_motion(bag, *MOTION_TOPICS).position[-1, 0] > 0.04
