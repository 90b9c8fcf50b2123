"""What scripts/setup, its pinned requirements and scripts/env promise.

Setup runs on copies of the packaging files, against a stand-in for a ROS 2 installation and with
empty requirements: nothing is fetched, and the phases are those of a real run.
"""

import os
import re
import resource
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
REQUIREMENTS = ROOT / "scripts/requirements"
REQUIREMENT_FILES = ("build", "ros", "runtime", "test", "bench")
PINNED = re.compile(r"^([A-Za-z0-9._-]+)==(\S+) \\$")
HASH = re.compile(r"^    --hash=sha256:[0-9a-f]{64}( \\)?$")
ENOUGH = 60  # s for one setup of a copy; it takes some 3 s

# Builds nothing; where a file `hold` stands it waits, to be interrupted.
COLCON = """#!/bin/bash
echo build >> "$STANDIN/calls"
while [ -e "$STANDIN/hold" ]; do sleep 0.05; done
mkdir -p "$SLOT_ROOT/.slot/install"
"""
# "Installs" cmake as a real apt-get would.
APT_GET = """#!/bin/bash
echo "apt-get $*" >> "$STANDIN/calls"
case " $* " in *" install "*" cmake"*) ln -sf /bin/true "$STANDIN/bin/cmake" ;; esac
"""
NO_ROOT = "#!/bin/bash\necho 1000\n"
SUDO = '#!/bin/bash\n[ -e "$STANDIN/sudoer" ] || exit 1\nshift\nexec "$@"\n'


def pins(name: str) -> dict[str, str]:
    """Package and version of every pin in a requirements file."""
    lines = (REQUIREMENTS / f"{name}.txt").read_text().splitlines()
    return {match[1]: match[2] for match in map(PINNED.match, lines) if match}


def executable(path: Path, text: str) -> None:
    path.write_text(text)
    path.chmod(0o755)


class Copy:
    """A copy of the packaging files, with tools that stand in for those of the machine."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "slot"
        self.standin = folder / "standin"
        self.home = self.root / ".slot"
        skip = shutil.ignore_patterns(".slot", "__pycache__", "*.egg-info")
        for part in ("scripts", "config", "src", "slot_bringup", "slot_msgs"):
            shutil.copytree(ROOT / part, self.root / part, ignore=skip, symlinks=True)
        for path in (self.root / "scripts/requirements").glob("*.txt"):
            path.write_text("")
        bin_ = self.standin / "bin"
        bin_.mkdir(parents=True)
        (self.standin / "setup.bash").write_text('export PYTHONPATH="$STANDIN"\n')
        for part in ("dynamics", "control"):
            warm_up = self.standin / f"slot_core/{part}/warm_up.py"
            warm_up.parent.mkdir(parents=True)
            warm_up.write_text("")
        executable(bin_ / "colcon", COLCON)
        for tool in ("cmake", "g++", "git", "make", "strace"):
            (bin_ / tool).symlink_to("/bin/true")
        self.variables = {
            "PATH": f"{bin_}:{os.defpath}",
            "STANDIN": str(self.standin),
            "SLOT_ROS": str(self.standin),
        }

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [str(self.root / "scripts/setup"), *arguments],
            cwd="/",
            env=self.variables,
            stdin=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def setup(self, *arguments: str) -> tuple[int, str]:
        process = self.start(*arguments)
        said = process.communicate(timeout=ENOUGH)[1]
        return process.returncode, said

    @property
    def calls(self) -> list[str]:
        path = self.standin / "calls"
        return path.read_text().splitlines() if path.exists() else []

    def only_own_tools(self) -> None:
        """Let setup see the tools it uses itself, but no compiler, and no root's rights."""
        bin_ = self.standin / "bin"
        (bin_ / "cmake").unlink()
        used = (
            "bash cat cut dirname env find flock id ln mkdir python3 rm sed sha256sum sort tail tr "
            "true xargs"
        )
        for tool in used.split():
            (bin_ / tool).symlink_to(shutil.which(tool, path=os.defpath) or tool)
        for name, text in {"id": NO_ROOT, "sudo": SUDO, "apt-get": APT_GET}.items():
            (bin_ / name).unlink(missing_ok=True)
            executable(bin_ / name, text)
        self.variables["PATH"] = str(bin_)


@pytest.fixture
def copy(tmp_path: Path) -> Copy:
    return Copy(tmp_path)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Copy:
    """A copy that has been set up."""
    copy = Copy(tmp_path_factory.mktemp("done"))
    status, said = copy.setup()
    assert status == 0, said
    return copy


def until(condition: Callable[[], bool]) -> None:
    """Wait until a condition holds, with a bound."""
    deadline = time.monotonic() + ENOUGH
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_a_second_setup_says_and_does_nothing_within_a_second(done: Copy) -> None:
    builds = done.calls
    stamps = {path: path.stat().st_mtime_ns for path in done.home.glob("*/.stamp")}
    assert len(stamps) == 2  # the venv and the workspace
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert done.setup() == (0, "")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert done.calls == builds
    assert {path: path.stat().st_mtime_ns for path in stamps} == stamps
    # CPU time, for wall time is the neighbours' too; about 0.2 s.
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 1.0


def test_an_interrupted_setup_goes_on_where_it_was(copy: Copy) -> None:
    hold = copy.standin / "hold"
    hold.touch()
    process = copy.start()
    until(lambda: copy.calls == ["build"])
    os.killpg(process.pid, signal.SIGINT)
    said = process.communicate(timeout=ENOUGH)[1]
    assert process.returncode == 130
    assert "interrupted" in said.splitlines()[-1]
    venv = (copy.home / "venv/.stamp").stat().st_mtime_ns

    hold.unlink()
    assert copy.setup()[0] == 0
    assert copy.calls == ["build", "build"]  # the interrupted phase again,
    assert (copy.home / "venv/.stamp").stat().st_mtime_ns == venv  # the finished one not
    assert copy.setup() == (0, "")


@pytest.mark.parametrize("loss", ["venv/bin/python", "venv/.stamp"])
def test_a_broken_or_unfinished_venv_is_built_anew(done: Copy, loss: str) -> None:
    (done.home / loss).unlink()
    leftover = done.home / "venv/leftover"
    leftover.touch()
    assert done.setup()[0] == 0
    assert not leftover.exists()
    subprocess.run([done.home / "venv/bin/python", "-c", "import pip"], check=True)


def test_a_failing_build_is_reported_with_its_log_and_tried_again(done: Copy) -> None:
    colcon = done.standin / "bin/colcon"
    executable(colcon, "#!/bin/bash\necho no such message\nexit 3\n")
    (done.root / "slot_msgs/msg/New.msg").write_text("float64 x\n")
    for _ in range(2):
        status, said = done.setup()
        assert status == 1
        assert "no such message" in said
        assert str(done.home / "log/setup-colcon.log") in said
    executable(colcon, COLCON)
    assert done.setup()[0] == 0


@pytest.mark.parametrize(
    ("path", "rebuilt"),
    [
        ("slot_msgs/msg/MpcState.msg", True),
        ("src/slot_nodes/setup.py", True),
        ("slot_bringup/rviz/new.rviz", True),
        ("src/slot_core/slot_core/new_module.py", False),  # found through the symbolic link
    ],
)
def test_the_workspace_is_built_again_only_where_links_do_not_do(
    done: Copy, path: str, rebuilt: bool
) -> None:
    assert done.setup()[0] == 0
    builds = len(done.calls)
    with (done.root / path).open("a") as file:
        file.write("\n")
    assert done.setup()[0] == 0
    assert len(done.calls) == builds + rebuilt


def test_two_setups_at_once_build_once(done: Copy) -> None:
    builds = len(done.calls)
    (done.home / "install/.stamp").unlink()
    processes = [done.start() for _ in range(2)]
    assert [process.wait(ENOUGH) for process in processes] == [0, 0]
    assert len(done.calls) == builds + 1


@pytest.mark.parametrize("extra", ["test", "bench"])
def test_extra_packages_are_installed_once_and_again_when_their_pins_change(
    done: Copy, extra: str
) -> None:
    said = f"setup: installing the packages for --{extra}\n"
    assert done.setup(f"--{extra}") == (0, said)
    assert done.setup(f"--{extra}") == (0, "")
    (done.root / f"scripts/requirements/{extra}.txt").write_text("# changed\n")
    assert done.setup(f"--{extra}") == (0, said)


def test_extra_packages_that_cannot_be_installed_are_an_error_each_time(copy: Copy) -> None:
    bench = copy.root / "scripts/requirements/bench.txt"
    bench.write_text(f"no-such-package==1.0 --hash=sha256:{'0' * 64}\n")
    copy.variables["PIP_NO_INDEX"] = "1"
    for _ in range(2):
        status, said = copy.setup("--bench")
        assert status == 1
        assert "no-such-package" in said
        assert str(copy.home / "log/setup-bench.log") in said.splitlines()[-1]


def test_without_rights_setup_prints_the_line_to_run(copy: Copy) -> None:
    copy.only_own_tools()
    status, said = copy.setup()
    assert status == 1
    assert said.splitlines() == [
        "setup: Debian packages are missing; run: sudo apt-get install -y cmake"
    ]
    assert not copy.calls


def test_with_sudo_setup_installs_what_is_missing_itself(copy: Copy) -> None:
    copy.only_own_tools()
    (copy.standin / "sudoer").touch()
    status, said = copy.setup()
    assert status == 0, said
    assert copy.calls[0] == "apt-get -q update"
    assert copy.calls[1] == "apt-get -q -y install --no-install-recommends cmake"


def test_a_wrong_argument_gets_one_line_and_status_2(copy: Copy) -> None:
    status, said = copy.setup("--tests")
    assert status == 2
    assert said == "setup: unknown arguments: --tests; known: --test, --bench\n"


@pytest.mark.parametrize("name", REQUIREMENT_FILES)
def test_every_requirement_is_one_version_with_its_hashes(name: str) -> None:
    lines = (REQUIREMENTS / f"{name}.txt").read_text().splitlines()
    assert lines
    for line, following in zip(lines, [*lines[1:], "end"], strict=True):
        assert PINNED.match(line) or HASH.match(line), line  # so no address either
        if PINNED.match(line):
            assert HASH.match(following), line


@pytest.mark.parametrize("name", REQUIREMENT_FILES)
def test_everything_asked_for_is_pinned(name: str) -> None:
    asked = re.findall(r"^([A-Za-z][\w.-]*)", (REQUIREMENTS / f"{name}.in").read_text(), re.M)
    assert asked
    assert {package.lower() for package in asked} <= {package.lower() for package in pins(name)}


def test_no_two_requirement_files_differ_in_a_version() -> None:
    every: dict[str, str] = {}
    for name in REQUIREMENT_FILES:
        for package, version in pins(name).items():
            assert every.setdefault(package, version) == version, package


def test_every_file_of_ours_goes_below_the_repository(done: Copy) -> None:
    shell = ". scripts/env; echo $ROS_LOG_DIR $NUMBA_CACHE_DIR $MPLCONFIGDIR $COLCON_LOG_PATH"
    paths = subprocess.check_output(["bash", "-c", shell], cwd=done.root, env={}, text=True).split()
    assert len(paths) == 4
    assert all(Path(path).is_relative_to(done.home) for path in paths)


def test_sourcing_the_environment_twice_adds_nothing() -> None:
    def variables(script: str) -> set[str]:
        shell = ["bash", "-c", f"{script}; env"]
        lines = subprocess.check_output(shell, cwd=ROOT, env={}, text=True).splitlines()
        return {line for line in lines if not line.startswith("_=")}

    once = ". scripts/env"
    assert variables(f"{once}; {once}") == variables(once)
