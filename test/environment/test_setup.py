"""scripts/setup, its pinned requirements, and scripts/env.

Setup runs on copies of the packaging files, with a stub of a ROS 2 installation and empty
requirements: all phases run, and nothing is downloaded.
"""

import hashlib
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
Process = subprocess.Popen[str]

# Builds nothing; waits while the file `hold` exists, so that a test can interrupt it.
COLCON = """trap 'exit 130' INT  # else bash goes on if the signal comes between two of its children
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
APT_GET = """echo "apt-get $*" >> "$STUBS/calls"
case " $* " in *" install "*" cmake"*) ln -sf /bin/true "$STUBS/bin/cmake" ;; esac
"""
# Stands for uv: names itself, logs what it installs, and installs a pip.
UV = """#!/bin/bash
case $* in --version) echo uv; exit ;; esac
echo "uv $UV_DEFAULT_INDEX $SSL_CERT_FILE $HTTPS_PROXY $*" >> "$STUBS/installs"
all=$* python=${all#*--python }
"${python%% *}" -I -c 'import os, sysconfig
os.makedirs(sysconfig.get_path("purelib") + "/pip", exist_ok=True)'
"""
SUDO = '[ -e "$STUBS/sudoer" ] || exit 1\nshift\nexec "$@"\n'


def executable(path: Path, text: str) -> None:
    path.write_text(text)
    path.chmod(0o755)


class Copy:
    """Copy of the packaging files, with stubs of the machine's tools."""

    def __init__(self, folder: Path) -> None:
        self.root, self.stubs = folder / "slot", folder / "stubs"
        self.home, self.bin = self.root / ".slot", self.stubs / "bin"
        self.log = self.stubs / "calls"
        skip = shutil.ignore_patterns(".slot", "__pycache__", "*.egg-info")
        for part in ("scripts", "config", "src", "slot_bringup", "slot_msgs"):
            shutil.copytree(
                ROOT / part, self.root / part, ignore=skip, symlinks=True
            )
        for path in (self.root / "scripts/requirements").glob("*.txt"):
            path.write_text("")
        self.bin.mkdir(parents=True)
        self.log.touch()
        (self.stubs / "setup.bash").write_text('export PYTHONPATH="$STUBS"\n')
        core = self.root / "src/slot_core/slot_core"
        (core / "simulation/warm_up.py").write_text(WARM_UP)
        self.tool("colcon", COLCON)
        for tool in ("cmake", "g++", "git", "make", "strace", "chromium"):
            (self.bin / tool).symlink_to("/bin/true")
        self.variables = {
            "PATH": f"{self.bin}:{os.defpath}",
            "STUBS": str(self.stubs),
            "SLOT_ROS": str(self.stubs),
            "XDG_CACHE_HOME": str(folder / "cache"),
        }
        digest = hashlib.sha256(b"").hexdigest()  # of uv's pins
        uv = folder / "cache" / "slot" / f"uv-{digest[:16]}" / "uv"
        uv.parent.mkdir(parents=True)
        executable(uv, UV)

    def tool(self, name: str, text: str) -> None:
        """Replace a tool by a program."""
        (self.bin / name).unlink(missing_ok=True)
        executable(self.bin / name, f"#!/bin/bash\n{text}")

    def start(self, *arguments: str, stderr: int = subprocess.PIPE) -> Process:
        return subprocess.Popen(
            [
                # tests under nohup ignore hangups, and a shell cannot trap a signal that it was started to ignore
                "env",
                "--default-signal=HUP",
                str(self.root / "scripts/setup"),
                *arguments,
            ],
            cwd="/",
            env=self.variables,
            stdin=subprocess.DEVNULL,
            stderr=stderr,
            text=True,
            start_new_session=True,
        )

    def setup(self, *arguments: str) -> tuple[int, str]:
        process = self.start(*arguments)
        output = process.communicate()[1]
        return process.returncode, output

    @property
    def calls(self) -> list[str]:
        return self.log.read_text().splitlines()

    def restrict_tools(self) -> None:
        """Leave setup its own tools only: no compiler, no root rights."""
        (self.bin / "cmake").unlink()
        used = (
            "bash cat cut df dirname env find flock grep head ln ls mkdir mv python3 rm sed sha256sum sleep sort "
            "tail tr true uname xargs"
        )
        for tool in used.split():
            (self.bin / tool).symlink_to(
                shutil.which(tool, path=os.defpath) or tool
            )
        for name, text in {
            "id": "echo 1000\n",  # no root
            "sudo": SUDO,
            "apt-get": APT_GET,
        }.items():
            self.tool(name, text)
        self.variables["PATH"] = str(self.bin)


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


@pytest.fixture
def unbuilt(ready: Copy) -> Iterator[Copy]:
    """The ready copy, but for its workspace, whose build a test may spoil."""
    stamp = ready.home / "install/.stamp"
    stamp.unlink()
    yield ready
    for left in (stamp, ready.stubs / "hold"):
        left.unlink(missing_ok=True)
    ready.tool("colcon", COLCON)
    assert ready.setup()[0] == 0


def until_build(copy: Copy, builds: int = 0) -> None:
    """Wait until the workspace is being built, after so many builds."""
    while len(copy.calls) == builds:
        time.sleep(0.02)


def test_an_interrupted_setup_continues_with_the_interrupted_phase(copy):
    hold, stamp = copy.stubs / "hold", copy.home / "venv/.stamp"
    hold.touch()
    process = copy.start()
    until_build(copy)
    os.killpg(process.pid, signal.SIGINT)
    output = process.communicate()[1]
    assert process.returncode == 130
    assert "interrupted" in output.splitlines()[-1]
    venv = stamp.stat().st_mtime_ns
    hold.unlink()
    assert copy.setup()[0] == 0
    # the interrupted phase is repeated,
    assert copy.calls == ["build", "build"]
    assert stamp.stat().st_mtime_ns == venv  # the finished one is not
    assert copy.setup() == (0, "")


@pytest.mark.parametrize("loss", ["venv/bin/python", "venv/.stamp"])
def test_a_broken_or_unfinished_venv_is_rebuilt(ready, loss):
    (ready.home / loss).unlink()
    leftover = ready.home / "venv/leftover"
    leftover.touch()
    assert ready.setup()[0] == 0
    assert not leftover.exists()
    subprocess.run(
        [ready.home / "venv/bin/python", "-c", "import pip"], check=True
    )


def test_a_failing_build_is_reported_with_its_log_and_repeated_at_the_next_setup(
    ready,
):
    ready.tool("colcon", "echo no such message\nexit 3\n")
    (ready.root / "slot_msgs/msg/New.msg").write_text("float64 x\n")
    for _ in range(2):
        status, output = ready.setup()
        assert status == 1
        assert "no such message" in output
        assert str(ready.home / "log/setup-workspace.log") in output
    ready.tool("colcon", COLCON)
    assert ready.setup()[0] == 0


@pytest.mark.parametrize(
    ("path", "rebuilt"),
    [
        ("slot_msgs/msg/MpcState.msg", True),
        ("src/slot_nodes/setup.py", True),
        ("slot_bringup/rviz/new.rviz", True),
        # installed by symbolic link
        (
            "src/slot_core/slot_core/new_module.py",
            False,
        ),
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


def test_missing_packages_are_installed_with_sudo_and_else_named_with_the_command(
    copy,
):
    """Without the right to install, the set-up for tests asks for no browser."""
    copy.restrict_tools()
    (copy.bin / "chromium").unlink()
    command = "Debian packages are missing; run: sudo apt-get install -y cmake"
    assert copy.setup("--test") == (1, f"setup: {command}\n")
    assert not copy.calls
    (copy.stubs / "sudoer").touch()
    status, output = copy.setup()
    assert status == 0, output
    assert copy.calls[:2] == [
        "apt-get -q update",
        "apt-get -q -y install --no-install-recommends cmake",
    ]


def test_only_names_of_debian_packages_reach_apt_get(copy):
    copy.restrict_tools()
    (copy.stubs / "sudoer").touch()
    # a Python that says more than it is asked
    copy.tool("talking", "echo 'my own; script'\n[[ $* = *version_info* ]]\n")
    copy.tool("python3", f"echo {copy.bin}/talking\n")
    refusal = "setup: 'my own; script' is no name of a Debian package\n"
    assert copy.setup() == (1, refusal)
    assert not copy.calls


def test_uv_of_another_clone_installs_with_hashes_over_the_network_that_pip_would_use(
    copy,
):
    settings = copy.root / "pip.conf"
    settings.write_text(
        "[global]\ntimeout = 9\nindex-url = https://mirror.example/simple\n"
        "cert = /our/certificates.pem\nproxy = http://proxy.example:3128\n"
    )
    copy.variables["PIP_CONFIG_FILE"] = str(settings)
    assert copy.setup("--test")[0] == 0
    network = "/our/certificates.pem http://proxy.example:3128"
    start = f"uv https://mirror.example/simple {network} "
    calls = (copy.stubs / "installs").read_text().splitlines()
    files = [Path(call.split()[-1]).name for call in calls]
    assert files == ["build.txt", "runtime.txt", "test.txt"]
    for call in calls:
        assert call.startswith(start)
        assert "--require-hashes" in call
        assert f"--python {copy.home}/venv/bin/python" in call


def test_pip_installs_where_uv_cannot_be_had(copy):
    absent = f"no-such-uv==1.0 --hash=sha256:{'0' * 64}\n"
    (copy.root / "scripts/requirements/uv.txt").write_text(absent)
    copy.variables["PIP_NO_INDEX"] = "1"
    status, output = copy.setup()
    assert status == 0
    assert "uv cannot be had" in output
    subprocess.run(
        [copy.home / "venv/bin/python", "-c", "import pip"], check=True
    )


FULL = {
    "device": "echo 'write: No space left on device'; exit 1",
    "quota": "echo 'write: Disk quota exceeded'; exit 1",
    # the last write of a phase had a line of the shell's own
    "stamp": "cd $SLOT_ROOT/.slot; mkdir -p install/lib; ln -s /dev/full install/.stamp",
}


@pytest.mark.parametrize("place", FULL)
def test_full_disk_is_named_in_the_last_line(unbuilt, place):
    unbuilt.tool("colcon", FULL[place])
    status, output = unbuilt.setup()
    assert status == 1
    *phases, last = output.splitlines()
    assert last.startswith(f"setup: no space left in {unbuilt.home}")
    assert all(phase.endswith(" s)") for phase in phases)


@pytest.mark.parametrize(
    "cut", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL]
)
def test_no_process_goes_on_after_a_signal_on_a_terminal(unbuilt, cut):
    """Nor the bar's: the terminal is free and the lock, else this would not end."""
    (unbuilt.stubs / "hold").touch()
    builds = len(unbuilt.calls)
    terminal, other = os.openpty()
    process, text = unbuilt.start(stderr=other), ""
    os.close(other)
    until_build(unbuilt, builds)
    while "building" not in text:  # the bar, which ends the job, is there
        text += os.read(terminal, 4096).decode()
    process.send_signal(cut)
    assert process.wait() == (130 if cut != signal.SIGKILL else -cut)
    subprocess.run(
        ["flock", "-w", "10", unbuilt.home / "lock", "true"], check=True
    )
    with suppress(OSError):  # until no process has it any more
        while data := os.read(terminal, 4096):
            text += data.decode()
    assert "about " in text
    assert "\n" not in text.rstrip()
    assert ("interrupted" in text) == (cut != signal.SIGKILL)


def test_with_a_ros_installation_python_outside_of_the_venv_keeps_its_own_packages(
    ready,
):
    """The nodes get those of the venv by its Python, which is the first on the path."""
    given = {
        name: ready.variables[name] for name in ("STUBS", "SLOT_ROS", "PATH")
    }
    shell = subprocess.run(
        ["bash", "-c", '. scripts/env && echo "$PATH" && echo "$PYTHONPATH"'],
        cwd=ready.root,
        env=given,
        capture_output=True,
        text=True,
        check=True,
    )
    programs, packages = shell.stdout.splitlines()
    assert programs.startswith(f"{ready.home}/venv/bin:")
    assert str(ready.stubs) in packages.split(":")
    assert "venv" not in packages
    program = ready.home / "install/lib/slot_nodes/supervisor"
    assert program.read_text() == "#!/usr/bin/env python3\nimport sys\n"


def test_what_versions_before_have_left_is_removed(ready):
    left = ("cache/pip", "cache/numba", "underlay")
    for name in left:
        (ready.home / name).mkdir()
    assert ready.setup() == (0, "")
    assert not any((ready.home / name).exists() for name in left)
