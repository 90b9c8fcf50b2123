"""The command line tools refuse what they cannot do in one line, with exit code 2."""

import os
import random
import sys
from pathlib import Path

import pytest
from damage import require_short

from documentation import pictures
from slot_bringup import operate_command, play_command, run, view
from slot_bringup.arguments import parse
from slot_bringup.playing import main_page
from slot_core import config
from slot_core.command_line import EXTRAS, command_parser
from slot_lab.bags import replay_command as replay
from slot_lab.calibration import command as calibrate
from slot_lab.desk_command import run_command
from slot_lab.film import calibrate_camera, print_command, track_command
from slot_lab.report import compare, map_command
from slot_lab.tuning import tune_command
from slot_lab.twin import twin_command
from slot_lab.validation import validate

HERE = Path(__file__).parent
WALK = str(HERE / "bags" / "walk")
EXAMPLE = HERE.parent / "slot_bringup" / "example"
LEG_RUN = str(EXAMPLE / "single_leg_run.csv")
MEASURED = str(config.config_dir() / "parameters" / "paper_single_leg.csv")
PATH = HERE / "bags" / "path.csv"


def check_run(words):
    """Check the options of scripts/run, which starts nothing before."""
    return run.check_options(parse(words))


# Arguments and what the line says, by tool; {} stands for an empty directory.
REFUSED = {
    "run": (
        check_run,
        [
            (["--vx", "3"], "v_x = 3: gait walk reaches [-0.0"),
            (["--vx", "fast"], "argument --vx: invalid float value: 'fast'"),
            (["--gait", "trot"], "no gait 'trot' (known: "),
            (["--scene", "moon"], "scene/moon' (known: fast_odometry"),
            (["--scene", "slope"], "(nearest: slope5, slope20, slope10)"),
            (
                ["--duration", "-1"],
                "argument --duration: -1 s: outside [0.5, 86400] s",
            ),
            (
                ["--hardware", "wheels"],
                "argument --hardware: invalid choice: 'wheels'",
            ),
            (["--seed", "1.5"], "argument --seed: invalid int value: '1.5'"),
            (["--bag", "x", "--no-bag"], "not allowed with argument"),
            (["--bag", "."], "bag .: exists already"),
            (["--seed", "-1"], "seed = -1: outside [0, 9223372036854775807]"),
            (
                ["--lockstep", "--attended"],
                "lockstep: an operator and the e-stop's source live in real",
            ),
            (
                ["--lockstep", "--hardware", "real"],
                "lockstep: servos of hardware real move in real time",
            ),
            (
                ["--lockstep", "--hardware", "fake_bus", "--port", "/tmp/x"],
                "port: emulated servos have none in lock",
            ),
            (
                f"--gait sit --path {PATH}".split(),
                "path: gait sit with this velocity stays in its",
            ),
            (
                ["--odometry", "none", "--policy", "place"],
                "policy = 'place': odometry none leaves gait_alone alone",
            ),
            (
                f"--odometry none --path {PATH}".split(),
                "path: needs odometry, which is none",
            ),
            (["--bench"], "bench: needs odometry none"),
            (
                ["--without", "mpc,recorder"],
                "without = 'mpc': expected names among recorder, sim_robot,",
            ),
            (["--namespace", "a$b"], "namespace = 'a$b': Invalid namespace: "),
            (
                ["--frame-prefix", "/a/"],
                "frame_prefix = '/a/': tf2 knows no frames that begin with",
            ),
            (
                ["--frame-prefix", "fred"],
                "frame_prefix = 'fred': expected one that ends with a slash, fred/",
            ),
            (
                ["--hardware", "fake_bus", "--port", "/nowhere/x"],
                "port /nowhere/x: not in an existing directory",
            ),
            (
                ["--path", "/dev/zero"],
                "/dev/zero: no path with columns x, y: not a regular file",
            ),
            (
                ["--calibration", "/dev/zero"],
                "calibration /dev/zero: not a regular file",
            ),
            (
                ["--policy", "/dev/zero.py"],
                "policy /dev/zero.py: FileNotFoundError",
            ),
            (["--view"], "viser is missing; run scripts/setup --play"),
            (["--bag", "x" * 300], "bag: File name too long"),
        ],
    ),
    "tune": (
        tune_command.main,
        [
            (
                ["walk", "fly"],
                "STAGE: 'fly': expected one of forward, turn, steering, identify",
            ),
            (["stand"], "gait 'stand' is a posture, not a stride"),
            (["trot"], "no gait 'trot' (known: "),
            (
                ["walk", "--friction", "-1"],
                "friction[0] = -1.0: outside [0.01, 2]",
            ),
            (["walk", "--seed", "0"], "argument --seed: 0 is below 1"),
            (["leg", "/dev/null"], "/dev/null: no robot.yaml there"),
        ],
    ),
    "view --map": (
        map_command.main,
        [
            (["{}"], "holds no metadata.yaml, .mcap or .db3 file"),
            (["x" * 300], "xxx ... xxx"),
            (["a\0b"], "embedded null byte"),
            (
                [WALK, "--out", "{}/map.foo"],
                "/map.foo: the name of a plot ends in .png",
            ),
        ],
    ),
    "twin": (
        twin_command.main,
        [
            (["{}"], "holds no metadata.yaml, .mcap or .db3 file: not a bag"),
            ([WALK], "strides of 0.62 s after a run-in of 2, less than 5"),
            (
                [WALK, "--fit", "colour"],
                "--fit colour: expected one of friction",
            ),
            (
                [WALK, "--fit", "friction,friction"],
                "a parameter is named twice",
            ),
            ([WALK, "--set", "calibrated"], "it stays as it is"),
            ([WALK, "--set", "../x"], "expected letters, digits, _ and -"),
            ([WALK, "--scene", "moon"], "no configuration 'scene/moon'"),
            (
                [WALK, "--parameters", "moon"],
                "no configuration 'parameters/moon'",
            ),
            ([WALK, "--namespace", "fred"], "holds none of /joint_states"),
        ],
    ),
    "validate": (
        validate.main,
        [
            ([LEG_RUN, "{}/nothing.csv"], "nothing.csv"),
            ([LEG_RUN, "{}"], "holds no metadata.yaml, .mcap or .db3 file"),
            ([LEG_RUN, __file__], "test_command_lines.py"),
        ],
    ),
    "calibrate": (
        calibrate.main,
        [
            (["{}/absent.csv"], "absent.csv"),
            ([MEASURED, "--start", "x"], "no configuration 'parameters/x'"),
            (
                [MEASURED, "--free", "leg.colour"],
                "leg.colour is not a number of the robot",
            ),
            ([MEASURED, "--starts", "0"], "0 is below 1"),
            (
                [MEASURED, "--plot", "{}/fit.txt"],
                "the name of a plot ends in .png",
            ),
        ],
    ),
    "calibrate --print": (
        print_command.main,
        [
            (
                ["door", "--out", "{}/x.png"],
                "'door': expected one of wall, film, torso, points",
            ),
            (["torso", "--out", "{}/x.gif"], "ends in .png or .pdf"),
            (
                ["torso", "--out", "{}/nowhere/x.png"],
                "No such file or directory",
            ),
            (
                ["torso", "--out", "{}/x.png", "--dpi", "9"],
                "outside [50, 1200]",
            ),
        ],
    ),
    "compare": (
        compare.main,
        [
            ([WALK, "{}/nowhere"], "nowhere: does not exist"),
            ([WALK], "the following arguments are required: BAG"),
            ([WALK, WALK], "holds 1.5 s, the warm-up leaves out 2.0 s"),
            ([WALK, WALK, "--warm-up", "nan"], "outside ["),
            (
                [WALK, WALK, "--plot", "{}/c.gif"],
                "the name of a plot ends in .png",
            ),
            ([WALK, WALK, "--tolerance", "0.1"], "expected FIGURE=N"),
            (
                [WALK, WALK, "--tolerance", "height_mean=nan"],
                "expected FIGURE=N",
            ),
            (
                [WALK, WALK, "--tolerance", "height_mean=-1"],
                "expected FIGURE=N",
            ),
            (
                [WALK, WALK, "--warm-up", "0", "--tolerance", "mass=1"],
                "hold no such figure of dur",
            ),
            (
                [WALK, WALK, "--warm-up", "0", "--tolerance", "saturated*=1"],
                "hold no such figure",
            ),
        ],
    ),
    "docs --pictures": (
        pictures.main,
        [
            (["moon.png"], "no picture 'moon.png' (see --list)"),
            (["leg.png", "--out", "{}/nowhere"], "/nowhere: not a directory"),
            (
                ["--results", "{}", "--out", "{}"],
                "locomotion.json: missing; scripts/bench locomotion",
            ),
            (
                ["locomotion_top.png", "--results", "{}", "--out", "{}"],
                "courses.npz: missing",
            ),
        ],
    ),
    "replay": (
        replay.main,
        [
            (["{}/nothing"], "nothing: does not exist"),
            (
                [WALK, "--tolerance", "nan"],
                "argument --tolerance: nan: outside [0, 1e+06]",
            ),
            (
                [WALK, "--tolerance", "-1"],
                "argument --tolerance: -1: outside [0, 1e+06]",
            ),
            ([WALK, "--remap", "/odom"], "expected OLD:=NEW, names of topics"),
            (
                [WALK, "--remap", ":=/odom"],
                "expected OLD:=NEW, names of topics",
            ),
            (
                [WALK, "--remap", "/odom=/imu"],
                "expected OLD:=NEW, names of topics",
            ),
        ],
    ),
    "replay --live": (
        lambda arguments: play_command.main(["--live", *arguments]),
        [
            (["{}/nowhere"], "nowhere: does not exist"),
            ([WALK, "--namespace", "a b"], "namespace = 'a b'"),
            ([WALK, "--remap", "/odom:=/camera"], "holds no /odom"),
            ([WALK, "--rate", "0"], "outside ["),
            ([WALK, "--rate", "nan"], "outside ["),
            ([WALK, "--start", "-1"], "outside ["),
        ],
    ),
    "view": (
        view.main,
        [
            (["{}/nowhere"], "nowhere: does not exist"),
            (
                [WALK, "--animate", "{}/walk.mp4"],
                "walk.mp4: expected a name that ends in .gif",
            ),
            (
                [WALK, "--animate", "{}/nowhere/walk.gif"],
                "walk.gif: No such file",
            ),
            (
                [WALK, "--html", "{}/walk.htm"],
                "walk.htm: expected a name that ends in .html",
            ),
            (
                [WALK, "--html", "{}/nowhere/walk.html"],
                "walk.html: No such file",
            ),
            (
                [WALK, "{}/nothing", "--html", "{}/walk.html"],
                "nothing: does not exist",
            ),
            (
                [WALK, WALK, WALK, "--html", "{}/walk.html"],
                "3 bags: expected one, or two",
            ),
            ([WALK, "--namespace", "a b"], "namespace = 'a b'"),
            (
                [WALK, "--html", "{}/x.html", "--animate", "{}/x.gif"],
                "not allowed with argument",
            ),
            (["one", "two"], "2 bags: expected one, or two with --html"),
        ],
    ),
    "play": (
        main_page.main,
        [
            (
                ["--graph", "--scene", "flat"],
                "--graph: its scene and policy are those",
            ),
            (
                ["--graph", "--policy", "force_mpc"],
                "--graph: its scene and policy are",
            ),
            (["--namespace", "a"], "--namespace: only with --graph"),
            (["--port", "70000"], "outside"),
        ],
    ),
    "operate": (
        operate_command.main,
        [
            (["zero"], ""),
            (["reboot", "tail"], ""),
            (["dance"], ""),
            (["inject"], ""),
            (
                ["--namespace", "a b", "state"],
                "namespace = 'a b': Invalid namespace",
            ),
        ],
    ),
}
CASES = [
    (name, *case) for name, (_, cases) in REFUSED.items() for case in cases
]


@pytest.fixture
def place(tmp_path, monkeypatch):
    """The empty directory in which a tool is called, on a machine without viser."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "viser", None)
    return tmp_path


@pytest.mark.parametrize(("tool", "arguments", "reason"), CASES)
def test_what_a_tool_cannot_do_is_refused_before_the_work(
    place, refusal, tool, arguments, reason
):
    main, _ = REFUSED[tool]
    line = refusal(main, *(word.format(place) for word in arguments))
    assert line.startswith(f"scripts/{tool.split()[0]}")
    assert reason in line
    assert list(place.iterdir()) == []


@pytest.mark.parametrize("extra", EXTRAS)
def test_a_missing_module_is_refused_with_the_option_that_installs_it(
    extra, refusal
):
    listed = HERE.parent / "scripts" / "requirements" / f"{extra}.in"
    packages = listed.read_text().split()
    named = {"elastica": "pyelastica"}  # else as the module

    def main(arguments):
        def work(options, progress):
            raise ModuleNotFoundError(name=f"{arguments[0]}.part")

        parser = command_parser("x", "")
        return run_command(parser, parser.parse_args([]), work)

    for module in EXTRAS[extra]:
        assert named.get(module, module).replace("_", "-") in packages
        line = f"{module}.part is missing; run scripts/setup --{extra}"
        assert refusal(main, module) == f"scripts/x: {line}"
    line = "scripts/x: numba.part is missing; run scripts/setup"
    assert refusal(main, "numba") == line


PIPES = ["pipe.mcap", "pipe.csv", "pipe.mp4", "piped/metadata.yaml"]
NO_FILES = ["/dev/zero", "piped", *PIPES]
NOISE = ["n.csv", "n.mcap", "n.db3", "n.yaml", "n.mp4", "n.py", "\x1b[2J"]
WORDS = {
    "PATH": [
        "/dev/full",
        "/dev/stdin",
        "/proc/self/mem",
        "/nowhere/\x1b[2J",
        "empty",
        "x" * 5000,
        "a\0b",
        "..",
        "\udcff",
        *NO_FILES,
        *NOISE,
    ],
    "NAME": [
        "",
        "moon",
        "\x1b]0;x\x07",
        "x" * 5000,
        "..",
        "a b",
        "\u202e",
        "\udcff",
        "[1]",
        "/dev/zero",
    ],
    "NUMBER": [
        "nan",
        "inf",
        "-inf",
        "1e400",
        "x",
        "",
        "\x1b[2J",
        "1" * 5000,
        "-1e9",
        "0x10",
    ],
}
"""Words that cannot be used, by the place that they take in a command line."""


SOUND = {"WALK": WALK, "RUN": LEG_RUN, "MEASURED": MEASURED}
COMMANDS = {
    "run": (
        check_run,
        [
            "--path PATH",
            "--calibration PATH",
            "--gait NAME",
            "--scene NAME",
            "--policy NAME",
            "--vx NUMBER",
            "--yaw-rate NUMBER",
            "--duration NUMBER",
            "--seed NUMBER",
            "--namespace \x1b" + "x" * 400,
            "--frame-prefix fred",
            "--hardware NAME",
        ],
    ),
    "replay": (
        replay.main,
        [
            "PATH",
            "PATH --tolerance 1",
            "WALK --tolerance NUMBER",
            "WALK --remap NAME",
            "WALK --" + "y" * 3000,
        ],
    ),
    "compare": (
        compare.main,
        [
            "PATH PATH",
            "WALK PATH",
            "WALK WALK --tolerance NAME",
            "WALK WALK --warm-up NUMBER",
            "WALK WALK --plot NAME",
        ],
    ),
    "view --map": (map_command.main, ["PATH", "WALK --out NAME"]),
    "validate": (
        validate.main,
        [
            "PATH RUN",
            "RUN PATH",
            "RUN RUN --frame NAME",
            "RUN RUN --offset NUMBER",
            "RUN RUN --block NUMBER",
        ],
    ),
    "twin": (
        twin_command.main,
        [
            "PATH",
            "WALK --scene NAME",
            "WALK --period NUMBER",
            "WALK --fit NAMEy",
            "WALK --parameters moonNAME",
        ],
    ),
    "calibrate": (
        calibrate.main,
        [
            "PATH",
            "MEASURED --start NAME",
            "MEASURED --free NAME",
            "MEASURED --starts NUMBER",
        ],
    ),
    "validate --track": (
        track_command.main,
        [
            "PATH --out t.csv",
            "PATH --out t.csv --camera PATH",
            "x --out t.csv --rate NUMBER",
        ],
    ),
    "calibrate --camera": (
        calibrate_camera.main,
        ["PATH --out c.yaml", "x --out c.yaml --every NUMBER"],
    ),
    "calibrate --print": (
        print_command.main,
        ["NAME --out x.png", "torso --out x.png --dpi NUMBER"],
    ),
    "view": (
        view.main,
        [
            "PATH --animate x.gif",
            "WALK --animate NAME",
            "PATH --html x.html",
            "WALK --html NAME",
        ],
    ),
}
"""Function of every tool that needs no graph, and its command lines with such places."""


@pytest.fixture
def unusable(place):
    """The directory, with pipes, noise and an empty directory in it."""
    for name in ("empty", "piped"):
        Path(name).mkdir()
    for name in PIPES:
        os.mkfifo(name)
    for name in NOISE:
        Path(name).write_bytes(random.Random(1).randbytes(3000))


@pytest.mark.parametrize("tool", COMMANDS)
def test_a_path_a_name_and_a_number_that_cannot_be_used_are_refused(
    unusable, refusal, tool
):
    """Without reading a device, which has no end, or a pipe, to which nobody writes."""
    main, forms = COMMANDS[tool]
    for form in forms:
        place = next((kind for kind in WORDS if kind in form), "")
        parts = [SOUND.get(part, part) for part in form.split()]
        for word in WORDS.get(place, [""]):
            line = refusal(main, *(part.replace(place, word) for part in parts))
            require_short(line)
            assert line.startswith(f"scripts/{tool}: "), (form, word)
            assert (
                word not in NO_FILES
                or place != "PATH"
                or "not a regular file" in line
            )
