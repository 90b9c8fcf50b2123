"""Access to the page of scripts/play: this machine alone, or whoever has the token."""

import urllib.error
import urllib.request

import psutil
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from slot_bringup.playing.main_page import main
from slot_bringup.playing.page_server import (
    COOKIE,
    Access,
    is_this_machine,
    start_server,
)

HERE = "127.0.0.1:8080"


@pytest.mark.parametrize(
    ("host", "origin", "refusal"),
    [
        (HERE, None, ""),
        ("localhost:8080", "http://localhost:8080", ""),
        ("elsewhere.org:8080", None, "unknown host"),
        ("", None, "unknown host"),
        (HERE, "http://elsewhere.org", "another page"),
        (HERE, "http://127.0.0.1:9090", "another page"),
        (HERE, "null", "another page"),
    ],
)
def test_other_names_and_other_pages_are_refused(host, origin, refusal):
    assert Access().refusal("/", host, origin, "") == refusal


@pytest.mark.parametrize(
    ("path", "cookie", "allowed"),
    [
        ("/", "", False),
        ("/?token=abc", "", True),
        ("/?token=abcd", "", False),
        ("/x.js", f"a=b; {COOKIE}=abc", True),
        ("/", f"{COOKIE}=ab", False),
        ("/", f"{COOKIE}=\u00e9", False),
    ],
)
def test_other_machines_need_the_token_in_the_address_or_the_cookie(
    path, cookie, allowed
):
    refusal = Access("abc").refusal(path, "robot:8080", None, cookie)
    assert (refusal == "") == allowed


@pytest.mark.parametrize(
    ("host", "here"),
    [
        ("127.0.0.1", True),
        ("localhost", True),
        ("::1", True),
        ("0.0.0.0", False),
        ("10.0.0.2", False),
        ("robot", False),
    ],
)
def test_only_the_loopback_needs_no_token(host, here):
    assert is_this_machine(host) == here


@pytest.fixture
def server():
    server = start_server("127.0.0.1", 0, "abc")
    yield server
    server.stop()


def test_the_server_checks_pages_and_websockets_and_remembers_the_token(server):
    place = f"127.0.0.1:{server.get_port()}"
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(f"http://{place}/")
    with urllib.request.urlopen(f"http://{place}/?token=abc") as answer:
        cookie = answer.headers["Set-Cookie"]
    assert "HttpOnly" in cookie
    known = {"Cookie": cookie.partition(";")[0]}
    for origin, headers in (
        (f"http://{place}", {}),
        ("http://elsewhere.org", known),
    ):
        with pytest.raises(InvalidStatus, match="403"):
            connect(
                f"ws://{place}",
                origin=origin,
                additional_headers=headers,
                proxy=None,
            )
    connect(
        f"ws://{place}",
        origin=f"http://{place}",
        additional_headers=known,
        proxy=None,
    ).close()


def test_no_socket_listens_beyond_this_machine_nor_connects_it_to_a_server_elsewhere(
    server, monkeypatch
):
    monkeypatch.setattr("viser._tunnel.ViserTunnel", None)
    assert server.request_share_url() is None
    sockets = psutil.Process().net_connections()
    listening = {
        each.laddr for each in sockets if each.status == psutil.CONN_LISTEN
    }
    assert ("127.0.0.1", server.get_port()) in listening
    assert {place.ip for place in listening} == {"127.0.0.1"}


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--port", "{}"], "127.0.0.1:{}: Address already in use"),
        (["--host", "no.such.host.invalid"], "no.such.host"),
        (["--scene", "none"], "none"),
        (["--scene", "paper"], "rods"),
        (["--policy", "none"], "none"),
        (["--graph", "--wait", "0"], "does scripts/run run?"),
    ],
)
def test_a_page_that_cannot_be_served_is_refused_in_one_line(
    server, refusal, arguments, reason
):
    port = server.get_port()
    line = refusal(main, *(word.format(port) for word in arguments))
    assert reason.format(port) in line
