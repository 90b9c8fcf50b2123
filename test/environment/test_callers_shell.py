"""Programs of scripts/ in a caller's folder and shell: neither changes what they do.

DDS stays on the loopback interface, checked in the system calls of two processes.
"""

import os
import re
import signal
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from ipaddress import ip_address
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROGRAMS = [
    path
    for path in (ROOT / "scripts").iterdir()
    if path.is_file() and path.read_text().startswith("#!/usr/bin/env bash")
]
MODULES = (
    "argparse",
    "json",
    "multiprocessing",
    "numpy",
    "os",
    "random",
    "re",
    "rclpy",
    "signal",
    "slot_core",
    "yaml",
)


def environment(mode="", given=None, times=1):
    """Variables in a shell that has only `given` ones and sources scripts/env in a mode.

    mode: "": as in a shell of the caller.
    """
    shell = subprocess.run(
        ["bash", "-c", f". scripts/env {mode} && " * times + "env -0"],
        cwd=ROOT,
        env={"PATH": os.defpath} | (given or {}),
        capture_output=True,
        text=True,
        check=True,
    )
    return dict(
        entry.split("=", 1) for entry in shell.stdout.split("\0") if entry
    )


@pytest.fixture
def own(tmp_path):
    """A folder with modules of the caller's own, which write `ran` there."""
    for name in MODULES:
        (tmp_path / f"{name}.py").write_text(
            f"open({str(tmp_path / 'ran')!r}, 'a')\nprint('my own script')\n"
        )
    return tmp_path


@pytest.fixture
def python(own):
    """Variables of the caller's Python."""
    return {
        "MPLBACKEND": "module://own",
        "PYTHONDEVMODE": "1",
        "PYTHONHASHSEED": "own",
        "PYTHONHOME": "/nowhere",
        "PYTHONINSPECT": "1",
        "PYTHONOPTIMIZE": "2",
        "PYTHONPATH": f"{own}:",
        "PYTHONSTARTUP": str(own / "random.py"),
        "PYTHONWARNINGS": "error",
    }


def test_a_program_takes_no_settings_and_no_packages_of_the_callers_python(
    own, python
):
    isolated = environment("--isolated")
    # no current directory, in children too
    assert isolated["PYTHONSAFEPATH"] == "1"
    assert environment("--isolated", python) == isolated
    after = environment("", python)  # a shell of the caller's own keeps them
    assert "PYTHONSAFEPATH" not in after
    assert str(own) in after["PYTHONPATH"].split(":")
    kept = {
        name: value for name, value in python.items() if name != "PYTHONPATH"
    }
    assert after | kept == after


def test_a_program_runs_the_python_of_the_repository_with_packages_of_ros_workspaces():
    """Whatever was activated since scripts/env was sourced."""
    kept = [
        "/ws/install/own_msgs/lib/python3/site-packages",
        "/ws/build/own_nodes",
    ]
    given = {
        "AMENT_PREFIX_PATH": "/ws/install/own_nodes:/ws/install/own_msgs",
        "PATH": f"/own/conda/bin:{environment()['PATH']}",
        "PYTHONPATH": ":".join([kept[0], "/home/own", kept[1]]),
    }
    variables = environment("--isolated", given)
    assert variables["PATH"].startswith(f"{ROOT}/.slot/venv/bin:")
    path = variables["PYTHONPATH"].split(":")
    assert [entry for entry in path if not entry.startswith(f"{ROOT}/")] == kept


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda path: path.name)
def test_every_program_is_isolated_and_explains_itself_without_an_environment(
    program,
):
    lines = map(str.strip, program.read_text().splitlines())
    ends = "scripts/env --underlay", 'env" --isolated', "env --isolated"
    assert all(
        line.endswith(ends)
        for line in lines
        if line.startswith(". ") and "/scripts/help" not in line
    )
    done = subprocess.run(
        [program, "--help"], env={}, capture_output=True, check=False
    )
    assert (done.returncode, b"usage: " in done.stdout) == (0, True)


def test_a_graph_walks_in_a_folder_with_modules_of_the_callers_own(own, python):
    """Its processes are the runner and the nodes; the bag's name has quotes and spaces."""
    name = 'it\'s a "bag" of ü: 1'
    program = os.path.relpath(ROOT / "scripts/run", own)
    # with the kernels of the caller's home
    kept = {"PATH", "HOME", "XDG_CACHE_HOME"} & set(os.environ)
    given = python | {
        **{name: os.environ[name] for name in kept},
        "ROS_DOMAIN_ID": os.environ["ROS_DOMAIN_ID"],
        "ROS_SECURITY_ENABLE": "true",
        "CDPATH": "/",
    }
    done = subprocess.run(
        [program, "--lockstep", "--duration", "0.5", "--bag", name],
        cwd=own,
        env=given,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert not (own / "ran").exists()
    assert "my own script" not in done.stdout + done.stderr
    assert (own / name / "metadata.yaml").exists()


def test_a_relative_path_is_not_looked_up_in_cdpath(tmp_path):
    (tmp_path / "scripts").mkdir()
    assert environment(given={"CDPATH": str(tmp_path)})["SLOT_ROOT"] == str(
        ROOT
    )


@pytest.mark.parametrize(
    "name", ["ROS_LOG_DIR", "MPLCONFIGDIR", "COLCON_LOG_PATH", "XDG_CACHE_HOME"]
)
def test_logs_and_caches_go_below_the_repository_where_the_home_cannot_be_written(
    name,
):
    path = environment(given={"HOME": "/proc/nowhere"})[name]
    assert path.startswith(f"{ROOT}/.slot/")


def test_sourcing_the_environment_twice_changes_nothing():
    changes = environment().items() ^ environment(times=2).items()
    assert {name for name, _ in changes} <= {"_"}


# Program that publishes questions over DDS, or answers until it is ended.
PEER = """
import sys
from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException
from std_msgs.msg import String

PERIOD = 0.02  # s between two questions
rclpy.init()
role = sys.argv[1]
node, heard = rclpy.create_node(role), []
told, other = (
    ("question", "answer") if role == "ask" else ("answer", "question")
)
publisher = node.create_publisher(String, told, 10)
node.create_subscription(String, other, heard.append, 10)
if role == "ask":
    node.create_timer(
        PERIOD, lambda: publisher.publish(String(data="are you there?"))
    )
with suppress(KeyboardInterrupt, ExternalShutdownException):
    while role == "answer" or not heard:
        rclpy.spin_once(node)
        if role == "answer" and heard:
            publisher.publish(String(data="yes"))
    print(heard[0].data)
rclpy.try_shutdown()
"""

# Variables of a caller, each of which would let DDS use other interfaces or transports.
HOSTILE = {
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
    "ROS_STATIC_PEERS": "192.0.2.1",
    "ROS_DISCOVERY_SERVER": "192.0.2.1:11811",
    "ROS_LOCALHOST_ONLY": "0",
    "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp",
    "FASTRTPS_DEFAULT_PROFILES_FILE": "/nowhere.xml",
    "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
    "ROS_SECURITY_ENABLE": "true",
    "ROS_SECURITY_KEYSTORE": "/nowhere",
}

# strace -yy prints the socket in angle brackets, with the address that it is bound to.
SENT = re.compile(r"^(?:sendto|sendmsg|sendmmsg|connect)\(.*")
RECEIVED = re.compile(
    r"^(?:recvfrom|recvmsg|recvmmsg|accept4?)\(\d+<(?:UDP|TCP)[^:]*:\[(\S+):\d+"
)
BOUND = re.compile(r"^bind\(.*")
SHARED = re.compile(r'^openat\(.*"/dev/shm/([\w.]*fast\w*)"')  # of Fast DDS
# bytes
BUFFER = re.compile(
    r"^setsockopt\(\d+<UDP\S+, SOL_SOCKET, SO_RCVBUF, \[(\d+)\]"
)
ADDRESS = re.compile(r'inet_addr\("([^"]+)"\)|inet_pton\(AF_INET6, "([^"]+)"')
FAMILY = re.compile(r"sa_family=(\w+)")
# the last two stay on the machine
FAMILIES = {"AF_INET", "AF_INET6", "AF_UNIX", "AF_NETLINK"}


def named_in(calls: re.Pattern[str], trace: str) -> Iterator[str]:
    """Every address named in some calls of a trace, and every address family not in FAMILIES."""
    for line in filter(calls.match, trace.splitlines()):
        yield from (
            family for family in FAMILY.findall(line) if family not in FAMILIES
        )
        yield from (four or six for four, six in ADDRESS.findall(line))


@pytest.fixture(scope="module")
def trace(tmp_path_factory: pytest.TempPathFactory) -> str:
    """System calls (all threads) of two processes that exchange question and answer.

    Those of the network, and those that open a file, as shared memory is.
    """
    folder = tmp_path_factory.mktemp("trace")
    variables = environment() | {"ROS_DOMAIN_ID": os.environ["ROS_DOMAIN_ID"]}

    def start(role: str) -> subprocess.Popen[str]:
        tracer = ["strace", "-ff", "-yy", "-e", "trace=network,openat", "-o"]
        return subprocess.Popen(
            [*tracer, str(folder / role), "python", "-c", PEER, role],
            env=variables,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    answer, ask = start("answer"), start("ask")
    try:
        assert ask.communicate()[0] == "yes\n"
    finally:
        for process in (ask, answer):
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGTERM)  # strace and the process
            process.wait()
    return "".join(path.read_text() for path in folder.iterdir())


def test_two_communicating_processes_send_receive_and_bind_on_the_loopback_only(
    trace,
):
    sent, bound = (list(named_in(calls, trace)) for calls in (SENT, BOUND))
    received = [
        m[1].strip("[]") for m in map(RECEIVED.match, trace.splitlines()) if m
    ]
    # they did use the network
    assert any(address.startswith("127.") for address in sent)
    assert bound
    assert received
    for address in sent + bound + received:  # a family that is none raises
        assert ip_address(address).is_loopback


def test_two_communicating_processes_share_no_memory_and_have_large_buffers(
    trace,
):
    """With shared memory a process that joins lets others sleep for 333 ms, and one that is killed
    leaves its segments behind. The default buffer of 200 kB lost messages within 40 ms while a
    process waited for a processor, on a topic with a history of one for good.
    """
    assert SHARED.match(
        'openat(AT_FDCWD, "/dev/shm/fastrtps_008e51d8", O_RDWR) = 9'
    )
    lines = trace.splitlines()
    assert any(line.startswith("openat(") for line in lines)
    assert not any(map(SHARED.match, lines))
    sizes = [int(match[1]) for match in map(BUFFER.match, lines) if match]
    assert max(sizes) >= 4 << 20  # the kernel grants net.core.rmem_max


@pytest.mark.parametrize("network", ["0", "yes"])
def test_the_environment_keeps_dds_on_the_loopback_whatever_the_caller_has_set(
    network,
):
    variables = environment(given=HOSTILE | {"SLOT_NETWORK": network})
    profile = ROOT / "slot_bringup/dds/loopback_only.xml"
    assert profile.exists()
    assert {
        name: variables[name] for name in HOSTILE.keys() & variables.keys()
    } == {
        "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(profile),
    }


def test_slot_network_leaves_the_callers_dds_variables_as_they_are():
    """Also after an earlier sourcing, which has set those of the loopback."""
    network = {"SLOT_NETWORK": "1"}
    variables = environment(given=HOSTILE | network)
    assert variables | HOSTILE == variables
    again = environment(given=environment() | network)
    assert {
        "ROS_AUTOMATIC_DISCOVERY_RANGE",
        "FASTRTPS_DEFAULT_PROFILES_FILE",
    }.isdisjoint(again)
