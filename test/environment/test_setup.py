"""scripts/setup, its pinned requirements, and scripts/env.

Setup runs on copies of the packaging files, with a stub of a ROS 2 installation and empty
requirements: all phases run, and nothing is downloaded.
"""

import hashlib
import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from sourced import ROOT, environment

REQUIREMENTS = ROOT / "scripts/requirements"
REQUIREMENT_FILES = (
    "uv",
    "build",
    "ros",
    "runtime",
    "test",
    "bench",
    "docs",
    "play",
    "learn",
)
PINNED = re.compile(r"^([A-Za-z0-9._-]+)==(\S+) \\$")
HASH = re.compile(r"^    --hash=sha256:[0-9a-f]{64}( \\)?$")

# Builds nothing; waits while the file `hold` exists, so that a test can interrupt it.
COLCON = """#!/bin/bash
trap 'exit 130' INT  # else bash goes on if the signal comes between two of its children
echo build >> "$STUBS/calls"
while [ -e "$STUBS/hold" ]; do sleep 0.05; done
mkdir -p "$SLOT_ROOT/.slot/install/lib/slot_nodes"
printf '#!/usr/bin/python3\nimport sys\n' > "$SLOT_ROOT/.slot/install/lib/slot_nodes/supervisor"
"""
WARM_UP = """import os, pathlib
folder = pathlib.Path(os.environ["XDG_CACHE_HOME"], "slot", "kernels")
folder.mkdir(parents=True, exist_ok=True)
(folder / "advance.kernel").touch()
"""
# Logs its call; "installs" cmake if that is asked for.
APT_GET = """#!/bin/bash
echo "apt-get $*" >> "$STUBS/calls"
case " $* " in *" install "*" cmake"*) ln -sf /bin/true "$STUBS/bin/cmake" ;; esac
"""
NO_ROOT = "#!/bin/bash\necho 1000\n"
SUDO = '#!/bin/bash\n[ -e "$STUBS/sudoer" ] || exit 1\nshift\nexec "$@"\n'


def pins(name: str) -> dict[str, str]:
    """Package and version of every pin in a requirements file."""
    lines = (REQUIREMENTS / f"{name}.txt").read_text().splitlines()
    return {match[1]: match[2] for match in map(PINNED.match, lines) if match}


def executable(path: Path, text: str) -> None:
    path.write_text(text)
    path.chmod(0o755)


class Copy:
    """Copy of the packaging files, with stubs of the machine's tools."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "slot"
        self.stubs = folder / "stubs"
        self.home = self.root / ".slot"
        skip = shutil.ignore_patterns(".slot", "__pycache__", "*.egg-info")
        for part in ("scripts", "config", "src", "slot_bringup", "slot_msgs"):
            shutil.copytree(ROOT / part, self.root / part, ignore=skip, symlinks=True)
        for path in (self.root / "scripts/requirements").glob("*.txt"):
            path.write_text("")
        bin_ = self.stubs / "bin"
        bin_.mkdir(parents=True)
        (self.stubs / "setup.bash").write_text('export PYTHONPATH="$STUBS"\n')
        (self.root / "src/slot_core/slot_core/simulation/warm_up.py").write_text(
            WARM_UP
        )
        executable(bin_ / "colcon", COLCON)
        for tool in ("cmake", "g++", "git", "make", "strace", "chromium"):
            (bin_ / tool).symlink_to("/bin/true")
        self.folder = "/"  # of the caller
        self.variables = {
            "PATH": f"{bin_}:{os.defpath}",
            "STUBS": str(self.stubs),
            "SLOT_ROS": str(self.stubs),
            "XDG_CACHE_HOME": str(folder / "cache"),
            "SLOT_PIP": "1",
        }

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [str(self.root / "scripts/setup"), *arguments],
            cwd=self.folder,
            env=self.variables,
            stdin=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def setup(self, *arguments: str) -> tuple[int, str]:
        process = self.start(*arguments)
        output = process.communicate()[1]
        return process.returncode, output

    @property
    def calls(self) -> list[str]:
        path = self.stubs / "calls"
        return path.read_text().splitlines() if path.exists() else []

    def restrict_tools(self) -> None:
        """Leave setup its own tools only: no compiler, no root rights."""
        bin_ = self.stubs / "bin"
        (bin_ / "cmake").unlink()
        used = (
            "bash cat cut df dirname env find flock head id ln ls mkdir mv python3 rm sed sha256sum sleep sort "
            "tail tr true uname xargs"
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
def ready(tmp_path_factory: pytest.TempPathFactory) -> Copy:
    """Copy after a complete setup."""
    copy = Copy(tmp_path_factory.mktemp("ready"))
    status, output = copy.setup()
    assert status == 0, output
    return copy


def until(condition: Callable[[], bool]) -> None:
    """Wait until a condition holds."""
    while not condition():
        time.sleep(0.02)


def test_a_second_setup_prints_and_does_nothing(ready):
    builds = ready.calls
    stamps = {path: path.stat().st_mtime_ns for path in ready.home.glob("*/.stamp")}
    assert len(stamps) == 2  # the venv and the workspace
    assert ready.setup() == (0, "")
    assert ready.calls == builds
    assert {path: path.stat().st_mtime_ns for path in stamps} == stamps


def test_an_interrupted_setup_continues_with_the_interrupted_phase(copy):
    hold = copy.stubs / "hold"
    hold.touch()
    process = copy.start()
    until(lambda: copy.calls == ["build"])
    os.killpg(process.pid, signal.SIGINT)
    output = process.communicate()[1]
    assert process.returncode == 130
    assert "interrupted" in output.splitlines()[-1]
    venv = (copy.home / "venv/.stamp").stat().st_mtime_ns

    hold.unlink()
    assert copy.setup()[0] == 0
    assert copy.calls == ["build", "build"]  # the interrupted phase is repeated,
    assert (
        copy.home / "venv/.stamp"
    ).stat().st_mtime_ns == venv  # the finished one is not
    assert copy.setup() == (0, "")


@pytest.mark.parametrize("loss", ["venv/bin/python", "venv/.stamp"])
def test_a_broken_or_unfinished_venv_is_rebuilt(ready, loss):
    (ready.home / loss).unlink()
    leftover = ready.home / "venv/leftover"
    leftover.touch()
    assert ready.setup()[0] == 0
    assert not leftover.exists()
    subprocess.run([ready.home / "venv/bin/python", "-c", "import pip"], check=True)


def test_a_failing_build_is_reported_with_its_log_and_repeated_at_the_next_setup(ready):
    colcon = ready.stubs / "bin/colcon"
    executable(colcon, "#!/bin/bash\necho no such message\nexit 3\n")
    (ready.root / "slot_msgs/msg/New.msg").write_text("float64 x\n")
    for _ in range(2):
        status, output = ready.setup()
        assert status == 1
        assert "no such message" in output
        assert str(ready.home / "log/setup-workspace.log") in output
    executable(colcon, COLCON)
    assert ready.setup()[0] == 0


@pytest.mark.parametrize(
    ("path", "rebuilt"),
    [
        ("slot_msgs/msg/MpcState.msg", True),
        ("src/slot_nodes/setup.py", True),
        ("slot_bringup/rviz/new.rviz", True),
        ("src/slot_core/slot_core/new_module.py", False),  # installed by symbolic link
        ("config/scene/new.yaml", False),
    ],
)
def test_the_workspace_is_rebuilt_only_for_files_that_are_not_linked(
    ready, path, rebuilt
):
    assert ready.setup()[0] == 0
    builds = len(ready.calls)
    with (ready.root / path).open("a") as file:
        file.write("\n")
    assert ready.setup()[0] == 0
    assert len(ready.calls) == builds + rebuilt


def test_two_concurrent_setups_build_once(ready):
    builds = len(ready.calls)
    (ready.home / "install/.stamp").unlink()
    processes = [ready.start() for _ in range(2)]
    assert [process.wait() for process in processes] == [0, 0]
    assert len(ready.calls) == builds + 1


@pytest.mark.parametrize("extra", ["test", "bench", "docs", "play", "learn"])
def test_extra_packages_are_installed_once_and_again_when_their_pins_change(
    ready, extra
):
    output = f"setup: installing the packages for --{extra} (about 10 s)\n"
    assert ready.setup(f"--{extra}") == (0, output)
    assert ready.setup(f"--{extra}") == (0, "")
    (ready.root / f"scripts/requirements/{extra}.txt").write_text("# changed\n")
    assert ready.setup(f"--{extra}") == (0, output)


COMMAND = "Debian packages are missing; run: sudo apt-get install -y cmake"


def test_missing_packages_are_installed_with_sudo_and_else_named_with_the_command(copy):
    """Without the right to install, the set-up for tests asks for no browser."""
    copy.restrict_tools()
    (copy.stubs / "bin/chromium").unlink()
    assert copy.setup("--test") == (1, f"setup: {COMMAND}\n")
    assert not copy.calls
    (copy.stubs / "sudoer").touch()
    status, output = copy.setup()
    assert status == 0, output
    assert copy.calls[:2] == [
        "apt-get -q update",
        "apt-get -q -y install --no-install-recommends cmake",
    ]


def test_modules_in_the_callers_folder_name_no_packages(copy, caller):
    """Their output was once taken for packages that apt-get installs as root."""
    copy.restrict_tools()
    copy.folder = str(caller.folder)
    copy.variables |= caller.python
    assert copy.setup() == (1, f"setup: {COMMAND}\n")
    assert not caller.ran


def test_only_names_of_debian_packages_reach_apt_get(copy):
    copy.restrict_tools()
    (copy.stubs / "sudoer").touch()
    talking = copy.stubs / "talking"  # a Python that says more than it is asked
    executable(
        talking, "#!/bin/bash\necho 'my own; script'\n[[ $* = *version_info* ]]\n"
    )
    (copy.stubs / "bin/python3").unlink()
    executable(copy.stubs / "bin/python3", f"#!/bin/bash\necho {talking}\n")
    refusal = "setup: 'my own; script' is no name of a Debian package\n"
    assert copy.setup() == (1, refusal)
    assert not copy.calls


# Stands for uv: names itself, and logs what it installs.
UV = """#!/bin/bash
case $* in --version) echo uv ;; *) echo "uv $UV_DEFAULT_INDEX $SSL_CERT_FILE $HTTPS_PROXY $*" >> "$STUBS/calls" ;; esac
"""


def with_uv(copy: Copy) -> None:
    """Another clone of the user has fetched uv."""
    del copy.variables["SLOT_PIP"]
    digest = hashlib.sha256(
        (copy.root / "scripts/requirements/uv.txt").read_bytes()
    ).hexdigest()
    folder = Path(copy.variables["XDG_CACHE_HOME"]) / "slot" / f"uv-{digest[:16]}"
    folder.mkdir(parents=True)
    executable(folder / "uv", UV)


def test_uv_of_another_clone_installs_with_hashes_over_the_network_that_pip_would_use(
    copy,
):
    with_uv(copy)
    settings = copy.root / "pip.conf"
    settings.write_text(
        "[global]\ntimeout = 9\nindex-url = https://mirror.example/simple\n"
        "cert = /our/certificates.pem\nproxy = http://proxy.example:3128\n"
    )
    for name in ("SSL_CERT_FILE", "HTTPS_PROXY", "PIP_CERT", "PIP_PROXY"):
        copy.variables.pop(name, None)
    copy.variables["PIP_CONFIG_FILE"] = str(settings)
    assert copy.setup("--test")[0] == 0
    installs = [call for call in copy.calls if call.startswith("uv")]
    files = [Path(call.split()[-1]).name for call in installs]
    assert files == ["build.txt", "runtime.txt", "test.txt"]
    for call in installs:
        network = "/our/certificates.pem http://proxy.example:3128"
        assert call.startswith(f"uv https://mirror.example/simple {network} ")
        assert "--require-hashes" in call
        assert f"--python {copy.home}/venv/bin/python" in call


def no_uv(copy: Copy) -> None:
    """It is looked for, and not found."""
    del copy.variables["SLOT_PIP"]
    (copy.root / "scripts/requirements/uv.txt").write_text(
        f"no-such-uv==1.0 --hash=sha256:{'0' * 64}\n"
    )
    copy.variables["PIP_NO_INDEX"] = "1"


def test_pip_installs_where_uv_cannot_be_had(copy):
    no_uv(copy)
    status, output = copy.setup()
    assert status == 0
    assert "uv cannot be had" in output
    subprocess.run([copy.home / "venv/bin/python", "-c", "import pip"], check=True)


def build_says(reason: str) -> Callable[[Copy], None]:
    """A build that ends with a line of a tool."""
    script = f"#!/bin/bash\necho 'write: {reason}'\nexit 1\n"
    return lambda copy: executable(copy.stubs / "bin/colcon", script)


def no_room_for_uv(copy: Copy) -> None:
    """With pip the set-up would go on, and keep no kernel."""
    no_uv(copy)
    executable(copy.stubs / "bin/df", "#!/bin/bash\nprintf 'Avail\\n0\\n'\n")


def no_log(copy: Copy) -> None:
    log = copy.home / "log/setup-venv.log"
    log.parent.mkdir(parents=True)
    log.symlink_to("/nowhere/log")


def no_stamp(copy: Copy) -> None:
    """The last write of a phase had a line of the shell's own."""
    stamp = copy.home / "install/.stamp"
    script = f"mkdir -p {stamp.parent}/lib\nln -s /dev/full {stamp}\n"
    executable(copy.stubs / "bin/colcon", f"#!/bin/bash\n{script}")


@pytest.mark.parametrize(
    "fill",
    [
        build_says("No space left on device"),
        build_says("Disk quota exceeded"),
        no_room_for_uv,
        no_log,
        no_stamp,
    ],
)
def test_full_disk_is_named_in_the_last_line(copy, fill):
    fill(copy)
    status, output = copy.setup()
    assert status == 1
    phases, last = output.splitlines()[:-1], output.splitlines()[-1]
    assert last.startswith(f"setup: no space left in {copy.home}")
    assert all(phase.endswith(" s)") for phase in phases)


def on_terminal(copy: Copy) -> tuple[subprocess.Popen[bytes], int]:
    """A setup that writes to a terminal, and the terminal's other end."""
    terminal, other = os.openpty()
    process = subprocess.Popen(
        [str(copy.root / "scripts/setup")],
        env=copy.variables,
        stdin=subprocess.DEVNULL,
        stderr=other,
    )
    os.close(other)
    return process, terminal


def shown(terminal: int) -> str:
    """Text of a terminal until no process has it any more."""
    text = ""
    with suppress(OSError):
        while data := os.read(terminal, 4096):
            text += data.decode()
    return text


def test_progress_on_a_terminal_is_one_line_with_a_bar(copy):
    process, terminal = on_terminal(copy)
    text = shown(terminal)
    assert process.wait() == 0
    assert "\n" not in text
    python = r"setup: \[#* *\] installing the Python packages for Python 3\.\d+\.\d+, about \d+ s left"
    assert re.search(python, text)
    build = r"setup: \[#+ *\] building the messages and compiling the kernels, about \d+ s left"
    assert re.search(build, text)


def lock_is_free(copy: Copy) -> bool:
    """No process of a setup holds its lock, soon at the latest."""
    command = ["flock", "-w", "10", copy.home / "lock", "true"]
    return subprocess.run(command, check=False).returncode == 0


CUTS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL]


@pytest.mark.parametrize("cut", CUTS)
def test_no_process_goes_on_after_a_signal_on_a_terminal(copy, cut):
    """Nor the bar's: the terminal is free, else this would not end."""
    (copy.stubs / "hold").touch()
    process, terminal = on_terminal(copy)
    until(lambda: copy.calls == ["build"])
    process.send_signal(cut)
    last = shown(terminal).splitlines()[-1]
    assert ("interrupted" in last) == (cut != signal.SIGKILL)
    assert process.wait() == (130 if cut != signal.SIGKILL else -cut)
    assert lock_is_free(copy)


def test_with_a_ros_installation_python_outside_of_the_venv_keeps_its_own_packages(
    ready,
):
    """The nodes get those of the venv by its Python, which is the first on the path."""
    given = {name: ready.variables[name] for name in ("STUBS", "SLOT_ROS", "PATH")}
    variables = environment(given=given, root=ready.root)
    assert str(ready.stubs) in variables["PYTHONPATH"].split(":")
    assert "venv" not in variables["PYTHONPATH"]
    assert variables["PATH"].startswith(f"{ready.home}/venv/bin:")
    program = ready.home / "install/lib/slot_nodes/supervisor"
    assert program.read_text() == "#!/usr/bin/env python3\nimport sys\n"


@pytest.mark.parametrize(
    "name", ["ROS_LOG_DIR", "MPLCONFIGDIR", "COLCON_LOG_PATH", "XDG_CACHE_HOME"]
)
def test_logs_and_caches_go_below_the_repository_where_the_home_cannot_be_written(name):
    path = environment(given={"HOME": "/proc/nowhere"})[name]
    assert path.startswith(f"{ROOT}/.slot/")


def test_sourcing_the_environment_twice_changes_nothing():
    changes = environment().items() ^ environment(times=2).items()
    assert {name for name, _ in changes} <= {"_"}
