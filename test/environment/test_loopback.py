"""DDS stays on the loopback interface, checked in the system calls of two processes."""

import os
import re
import shutil
import signal
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from ipaddress import ip_address
from pathlib import Path

import pytest
from real_graph import process_domain
from sourced import ROOT, environment

PEER = Path(__file__).with_name("loopback_peer.py")

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
BUFFER = re.compile(
    r"^setsockopt\(\d+<UDP\S+, SOL_SOCKET, SO_RCVBUF, \[(\d+)\]"
)  # bytes
ADDRESS = re.compile(r'inet_addr\("([^"]+)"\)|inet_pton\(AF_INET6, "([^"]+)"')
FAMILY = re.compile(r"sa_family=(\w+)")
FAMILIES = {
    "AF_INET",
    "AF_INET6",
    "AF_UNIX",
    "AF_NETLINK",
}  # the last two stay on the machine


def named_in(calls: re.Pattern[str], trace: str) -> Iterator[str]:
    """Every address named in some calls of a trace, and every address family not in FAMILIES."""
    for line in filter(calls.match, trace.splitlines()):
        yield from (family for family in FAMILY.findall(line) if family not in FAMILIES)
        yield from (four or six for four, six in ADDRESS.findall(line))


def is_loopback(address: str) -> bool:
    try:
        return ip_address(address).is_loopback
    except ValueError:  # another address family
        return False


@pytest.fixture(scope="module")
def trace(tmp_path_factory: pytest.TempPathFactory) -> str:
    """System calls (all threads) of two processes that exchange question and answer.

    Those of the network, and those that open a file, as shared memory is.
    """
    strace = shutil.which("strace")
    assert strace, "strace is missing: scripts/setup --test installs it"
    folder = tmp_path_factory.mktemp("trace")
    variables = environment() | {"ROS_DOMAIN_ID": process_domain()}
    python = shutil.which("python", path=variables["PATH"])
    assert python

    def start(role: str) -> subprocess.Popen[str]:
        tracer = [
            strace,
            "-ff",
            "-yy",
            "-e",
            "trace=network,openat",
            "-o",
            str(folder / role),
        ]
        return subprocess.Popen(
            [*tracer, python, str(PEER), role],
            env=variables,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    answer = start("answer")
    ask = start("ask")
    try:
        assert ask.communicate()[0] == "yes\n"
    finally:
        for process in (ask, answer):
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGTERM)  # strace and the process
            process.wait()
    return "".join(path.read_text() for path in folder.iterdir())


def test_two_communicating_processes_send_receive_and_bind_on_the_loopback_only(trace):
    sent, bound = (list(named_in(calls, trace)) for calls in (SENT, BOUND))
    received = [m[1].strip("[]") for m in map(RECEIVED.match, trace.splitlines()) if m]
    assert any(
        address.startswith("127.") for address in sent
    )  # they did use the network
    assert bound
    assert received
    assert not [
        address for address in sent + bound + received if not is_loopback(address)
    ]


def test_two_communicating_processes_open_no_segment_of_shared_memory(trace):
    # With shared memory a process that joins lets others sleep for 333 ms, and one that is killed
    # leaves its segments behind.
    assert SHARED.match('openat(AT_FDCWD, "/dev/shm/fastrtps_008e51d8", O_RDWR) = 9')
    lines = trace.splitlines()
    assert any(line.startswith("openat(") for line in lines)
    assert not any(map(SHARED.match, lines))


def test_the_sockets_hold_what_arrives_while_a_process_waits_for_a_processor(trace):
    # The default of 200 kB lost messages within 40 ms, on a topic with a history of one for good.
    sizes = [
        int(match.group(1)) for match in map(BUFFER.match, trace.splitlines()) if match
    ]
    assert max(sizes) >= 4 << 20  # the kernel grants net.core.rmem_max


@pytest.mark.parametrize("network", ["0", "yes"])
def test_the_environment_keeps_dds_on_the_loopback_whatever_the_caller_has_set(network):
    variables = environment(given=HOSTILE | {"SLOT_NETWORK": network})
    assert variables["RMW_IMPLEMENTATION"] == "rmw_fastrtps_cpp"
    assert variables["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SYSTEM_DEFAULT"
    profile = ROOT / "slot_bringup/dds/loopback_only.xml"
    assert Path(variables["FASTRTPS_DEFAULT_PROFILES_FILE"]) == profile
    assert profile.exists()
    assert HOSTILE.keys() & variables.keys() == {
        "RMW_IMPLEMENTATION",
        "ROS_AUTOMATIC_DISCOVERY_RANGE",
        "FASTRTPS_DEFAULT_PROFILES_FILE",
    }


def test_slot_network_leaves_the_callers_dds_variables_as_they_are():
    """Also after an earlier sourcing, which has set those of the loopback."""
    network = {"SLOT_NETWORK": "1"}
    variables = environment(given=HOSTILE | network)
    assert {name: variables[name] for name in HOSTILE} == HOSTILE
    again = environment(given=environment() | network)
    assert "ROS_AUTOMATIC_DISCOVERY_RANGE" not in again
    assert "FASTRTPS_DEFAULT_PROFILES_FILE" not in again
