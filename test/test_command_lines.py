"""The command line tools refuse what they cannot do in one line, with exit code 2."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import __main__ as command_line
from documentation import pictures
from slot_bringup import operate, play, run, view
from slot_bringup.graph import read_graph
from slot_core import config
from slot_core.config import ConfigError
from slot_core.legs import leg_map
from slot_core.mpc.settings import read_mpc
from slot_lab.bags import check_bag as replay
from slot_lab.calibration import command as calibrate
from slot_lab.film import print_markers
from slot_lab.report import compare, constraint_map
from slot_lab.tuning import tune
from slot_lab.twin import twin
from slot_lab.validation import validate

HERE = Path(__file__).parent
ROOT = HERE.parent
WALK = str(HERE / "bags" / "walk")
EXAMPLE = HERE.parent / "slot_bringup" / "example"
LEG_RUN = str(EXAMPLE / "single_leg_run.csv")
MEASURED = str(config.config_dir() / "parameters" / "paper_single_leg.csv")
# Arguments and what the line says, by tool; {} stands for an empty directory.
REFUSED = {
    "tabulate_leg": (leg_map.main, [
        (["--out", "{}/nowhere/map.csv"], "/map.csv: not a file in an existing directory"),
    ]),
    "tune": (tune.main, [
        (["walk", "fly"], "STAGE: 'fly': expected one of forward, turn, steering, identify"),
        (["stand"], "gait 'stand' is a posture, not a stride"),
        (["trot"], "no gait 'trot' (known: "),
        (["walk", "--friction", "-1"], "friction[0] = -1.0: outside [0.01, 2]"),
        (["walk", "--seed", "0"], "argument --seed: 0 is below 1"),
    ]),
    "constraint_map": (constraint_map.main, [
        (["{}"], "holds no metadata.yaml, .mcap or .db3 file"),
        (["x" * 300], "xxx ... xxx"),
        (["a\0b"], "embedded null byte"),
        ([WALK, "--out", "{}/map.foo"], "/map.foo: the name of a plot ends in .png"),
    ]),
    "twin": (twin.main, [
        (["{}"], "holds no metadata.yaml, .mcap or .db3 file: not a bag"),
        ([WALK], "strides of 0.62 s after a run-in of 2, less than 5"),
        ([WALK, "--fit", "colour"], "--fit colour: expected one of friction"),
        ([WALK, "--fit", "friction,friction"], "a parameter is named twice"),
        ([WALK, "--set", "calibrated"], "it stays as it is"),
        ([WALK, "--set", "../x"], "expected letters, digits, _ and -"),
        ([WALK, "--scene", "moon"], "no configuration 'scene/moon'"),
        ([WALK, "--parameters", "moon"], "no configuration 'parameters/moon'"),
        ([WALK, "--namespace", "fred"], "holds none of /joint_states"),
    ]),
    "validate": (validate.main, [
        ([LEG_RUN, "{}/nothing.csv"], "nothing.csv"),
        ([LEG_RUN, "{}"], "holds no metadata.yaml, .mcap or .db3 file"),
        ([LEG_RUN, __file__], "test_command_lines.py"),
    ]),
    "calibrate": (calibrate.main, [
        (["{}/absent.csv"], "absent.csv"),
        ([MEASURED, "--start", "x"], "no configuration 'parameters/x'"),
        ([MEASURED, "--free", "leg.colour"], "leg.colour is not a number of the robot"),
        ([MEASURED, "--starts", "0"], "0 is below 1"),
        ([MEASURED, "--plot", "{}/fit.txt"], "the name of a plot ends in .png"),
    ]),
    "print_markers": (print_markers.main, [
        (["door", "--out", "{}/x.png"], "'door': expected one of wall, film, torso, points"),
        (["torso", "--out", "{}/x.gif"], "ends in .png or .pdf"),
        (["torso", "--out", "{}/nowhere/x.png"], "No such file or directory"),
        (["torso", "--out", "{}/x.png", "--dpi", "9"], "outside [50, 1200]"),
    ]),
    "compare": (compare.main, [
        ([WALK, "{}/nowhere"], "nowhere: does not exist"),
        ([WALK], "the following arguments are required: BAG"),
        ([WALK, WALK], "holds 1.4 s, the warm-up leaves out 2.0 s"),
        ([WALK, WALK, "--warm-up", "nan"], "outside ["),
        ([WALK, WALK, "--plot", "{}/c.gif"], "the name of a plot ends in .png"),
        ([WALK, WALK, "--tolerance", "0.1"], "expected FIGURE=N"),
        ([WALK, WALK, "--tolerance", "height_mean=nan"], "expected FIGURE=N"),
        ([WALK, WALK, "--tolerance", "height_mean=-1"], "expected FIGURE=N"),
        ([WALK, WALK, "--warm-up", "0", "--tolerance", "mass=1"], "hold no such figure of dur"),
        ([WALK, WALK, "--warm-up", "0", "--tolerance", "saturated*=1"], "hold no such figure"),
    ]),
    "pictures": (pictures.main, [
        (["moon.png"], "no picture 'moon.png' (see --list)"),
        (["leg.png", "--out", "{}/nowhere"], "/nowhere: not a directory"),
        (["--results", "{}", "--out", "{}"], "locomotion.json: missing; scripts/bench locomotion"),
        (["locomotion_top.png", "--results", "{}", "--out", "{}"], "courses.npz: missing"),
    ]),
    "replay": (replay.main, [
        (["{}/nothing"], "nothing: does not exist"),
        ([WALK, "--tolerance", "nan"], "argument --tolerance: nan: outside [0, inf)"),
        ([WALK, "--tolerance", "-1"], "argument --tolerance: -1: outside [0, inf)"),
        ([WALK, "--remap", "/odom"], "expected OLD:=NEW, names of topics"),
        ([WALK, "--remap", ":=/odom"], "expected OLD:=NEW, names of topics"),
        ([WALK, "--remap", "/odom=/imu"], "expected OLD:=NEW, names of topics"),
    ]),
    "replay --live": (lambda arguments: play.main(["--live", *arguments]), [
        (["{}/nowhere"], "nowhere: does not exist"),
        ([WALK, "--namespace", "a b"], "namespace = 'a b'"),
        ([WALK, "--remap", "/odom:=/camera"], "holds no /odom"),
        ([WALK, "--rate", "0"], "outside ["),
        ([WALK, "--rate", "nan"], "outside ["),
        ([WALK, "--start", "-1"], "outside ["),
    ]),
    "view": (view.main, [
        (["{}/nowhere"], "nowhere: does not exist"),
        ([WALK, "--animate", "{}/walk.mp4"], "walk.mp4: expected a name that ends in .gif"),
        ([WALK, "--animate", "{}/nowhere/walk.gif"], "walk.gif: No such file"),
        ([WALK, "--html", "{}/walk.htm"], "walk.htm: expected a name that ends in .html"),
        ([WALK, "--html", "{}/nowhere/walk.html"], "walk.html: No such file"),
        ([WALK, "{}/nothing", "--html", "{}/walk.html"], "nothing: does not exist"),
        ([WALK, WALK, WALK, "--html", "{}/walk.html"], "3 bags: expected one, or two"),
        (["--live", "--html", "{}/walk.html"], "shows a running graph, not a bag"),
        (["--live", "--namespace", "a b"], "namespace = 'a b'"),
        (["--live", "bag"], ""),
        (["--live", "--animate", "x.gif"], ""),
        (["--no-browser"], ""),
        (["--web", "--save", "x.rrd"], ""),
        (["one", "two"], "2 bags: expected one, or two with --html"),
    ]),
    "operate": (operate.main, [
        (["zero"], ""),
        (["reboot", "tail"], ""),
        (["dance"], ""),
        (["inject"], ""),
        (["--namespace", "a b", "state"], "namespace = 'a b': Invalid namespace"),
    ]),
}  # fmt: skip
CASES = [(name, *case) for name, (_, cases) in REFUSED.items() for case in cases]


@pytest.fixture
def place(tmp_path, monkeypatch):
    """The empty directory in which a tool is called."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


WITHOUT_EXTRAS = """
import runpy, sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in %r:
            raise ModuleNotFoundError(f"No module named {name!r}")
sys.meta_path.insert(0, Missing())
sys.argv = ["", "--help"]
runpy.run_module(%r, run_name="__main__", alter_sys=True)
"""
MODULE = r"^(?:exec python -m |module=)([\w.]+)"  # that a script runs
EXTRAS = ("cma", "cvxpy", "distributed", "elastica", "mujoco", "pytest", "quadprog", "rerun",
          "viser", "websockets")  # fmt: skip


def programs():
    """Python modules by the command of scripts/ that runs them."""
    for script in sorted((ROOT / "scripts").iterdir()):
        if script.is_file() and not script.suffix:
            for module in re.findall(MODULE, script.read_text(), re.MULTILINE):
                yield script.name, module


@pytest.mark.parametrize(("script", "module"), list(programs()))
def test_every_help_works_without_the_packages_of_an_extra(script, module):
    path = os.pathsep.join([str(ROOT / "scripts"), os.environ.get("PYTHONPATH", "")])
    run = subprocess.run(
        [sys.executable, "-c", WITHOUT_EXTRAS % (EXTRAS, module)],
        capture_output=True, text=True, env=os.environ | {"PYTHONPATH": path}, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    assert run.stdout.startswith(f"usage: scripts/{script} ")


@pytest.mark.parametrize(("tool", "arguments", "reason"), CASES)
def test_what_a_tool_cannot_do_is_refused_before_the_work(place, refusal, tool, arguments, reason):
    main, _ = REFUSED[tool]
    line = refusal(main, *(word.format(place) for word in arguments))
    assert line.startswith(f"scripts/{tool.split()[0]}")
    assert reason in line
    assert list(place.iterdir()) == []


FILE = "FILE"  # place of a recording
READERS = {
    "calibrate": (calibrate.main, [FILE]),
    "compare": (compare.main, [WALK, FILE]),
    "constraint_map": (constraint_map.main, [FILE]),
    "replay": (replay.main, [FILE]),
    "twin": (twin.main, [FILE]),
    "validate": (validate.main, [FILE, LEG_RUN]),
    "view": (view.main, [FILE, "--html", "walk.html"]),
}


@pytest.mark.parametrize("file", ["/dev/zero", "pipe.csv", "pipe.mcap", "piped"])
@pytest.mark.parametrize("tool", READERS)
def test_a_device_and_a_pipe_are_refused_without_reading(place, refusal, tool, file):
    """The one has no end, and nobody writes to the other."""
    Path("piped").mkdir()
    for pipe in ("pipe.csv", "pipe.mcap", "piped/metadata.yaml"):
        os.mkfifo(pipe)
    main, words = READERS[tool]
    line = refusal(main, *(file if word == FILE else word for word in words))
    assert line.startswith(f"scripts/{tool}: ")
    assert "not a regular file" in line


@pytest.mark.parametrize("text", [None, "", "nodes: many\n"])
def test_a_leg_map_without_its_configuration_is_refused(tmp_path, monkeypatch, refusal, text):
    monkeypatch.setenv("SLOT_CONFIG", str(tmp_path))
    if text is not None:
        (tmp_path / "leg_map.yaml").write_text(text)
    out = tmp_path / "map.csv"
    line = refusal(leg_map.main, "--out", out)
    assert line.startswith("scripts/tabulate_leg: ")
    assert not out.exists()


def test_results_of_a_benchmark_into_a_file_are_refused(tmp_path, refusal):
    (tmp_path / "tiny").mkdir()
    source = '"""Tiny."""\n\ndef run(quick, out, progress):\n    return [], []\n'
    (tmp_path / "tiny" / "benchmark.py").write_text(source)
    (tmp_path / "file").write_text("")
    place = ["--benchmarks", tmp_path, "--out", tmp_path / "file"]
    line = refusal(command_line.main, "tiny", *place)
    assert line == f"scripts/bench: --out {tmp_path / 'file'}: File exists"


def test_a_bag_with_a_name_too_long_is_refused(refusal):
    line = refusal(lambda arguments: run.parse(arguments, read_graph()), "--bag", "x" * 300)
    assert line == "scripts/run: bag: File name too long"


def test_a_replay_whose_output_cannot_be_written_says_so():
    command = [sys.executable, "-m", "slot_lab.bags.check_bag", WALK]
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert ended.returncode == 2
    assert ended.stderr == "scripts/replay: output: No space left on device\n"


@pytest.mark.parametrize("text", ["", "[1]\n", "horizon\n"])
def test_a_profile_of_the_mpc_that_is_no_mapping_is_refused(own_config, text):
    (own_config / "mpc" / "own.yaml").write_text(text)
    with pytest.raises(ConfigError, match=r"mpc/own\.yaml: terms: expected a mapping"):
        read_mpc("own")
