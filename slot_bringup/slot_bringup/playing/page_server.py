"""Server of the page: this machine alone may open it, or, of other machines, who has the token.

viser serves page and websocket on one port. Every request is checked: a websocket's Origin has to
be its Host, so that no other page in the browser connects. On this machine the Host has to be this
machine, so that no name of another site leads here. Where other machines can reach the port, the
token has to be in the address, or in the cookie that the page has set.
"""

import hmac
import http
import io
import ipaddress
import json
import logging
import secrets
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any, TypeAlias
from urllib.parse import parse_qs, urlsplit

import viser
from viser import _messages  # viser has no other way to a script
from websockets.asyncio import server as websocket_server

from slot_bringup.playing.scene_view import legend

COOKIE = "slot_token"
Answer: TypeAlias = Callable[[Any, Any], Any]
"""Response to a request on a connection; None: the websocket is opened."""

# What was clicked gives the keys back, unless text is typed there; a dropdown, too, once an option is chosen.
# SPACE is a key of the page wherever the focus is. The camera, which viser moves by keys, is the mouse's.
KEYBOARD = """
document.addEventListener("click", event => {
  const active = document.activeElement;
  if (event.target.closest("[role=option]") || !active.matches("input, textarea")) active.blur();
});
for (const kind of ["keydown", "keyup"]) window.addEventListener(kind, event => {
  if (event.code != "Space" || !event.isTrusted || event.target.closest("[class*=Spotlight]")) return;
  event.preventDefault();
  event.stopImmediatePropagation();
  if (kind == "keydown") document.body.dispatchEvent(new KeyboardEvent(kind, {key: " ", code: "Space", bubbles: true}));
}, true);
document.documentElement.addEventListener("keydown", event => event.stopPropagation());
"""
# On a page as narrow as a phone (36 em) viser's panel is 20 em wide, at its right side.
WIDE_ON_A_PHONE = """
document.head.insertAdjacentHTML("beforeend", `<style>@media (max-width: 36em) {
  [style*="width: 20em"] { width: 100% !important; }
}</style>`);
"""
LEGEND = f"""
document.getElementById("slot_legend")?.remove();
document.body.insertAdjacentHTML("beforeend", {json.dumps(legend())});
"""
# A stick beyond its half repeats a key, and presses 0 when it is let go; a button acts once.
# Numbers of axes and buttons: https://w3c.github.io/gamepad/#remapping
GAMEPAD = """
window.slot_gamepad ??= setInterval((state => () => {
  const sticks = [[1, -1, "ArrowUp"], [1, 1, "ArrowDown"], [0, -1, ","], [0, 1, "."],
    [2, -1, "ArrowLeft"], [2, 1, "ArrowRight"]];
  const buttons = [[0, "w"], [3, "s"], [1, " "]];
  const press = key => document.body.dispatchEvent(new KeyboardEvent("keydown", {key, code: key, bubbles: true}));
  const pad = navigator.getGamepads().find(p => p?.connected && p.mapping == "standard");
  const held = pad ? sticks.filter(([axis, sign]) => sign * pad.axes[axis] > 0.5) : [];
  const pressed = pad ? buttons.filter(([button]) => pad.buttons[button]?.pressed) : [];
  held.forEach(([,, key]) => press(key));
  if (state.held.length && !held.length) press("0");
  pressed.filter(([, key]) => !state.keys.includes(key)).forEach(([, key]) => press(key));
  Object.assign(state, {held, keys: pressed.map(([, key]) => key)});
})({held: [], keys: []}), 200);
"""


class LocalServer(viser.ViserServer):
    """Server of viser that opens no tunnel to a server elsewhere."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """No address; viser itself would open a tunnel."""
        return None


@contextmanager
def served(host: str, port: int) -> Iterator[tuple[viser.ViserServer, str]]:
    """Server of a page while the block runs, and the page's address; raises OSError."""
    token = "" if is_this_machine(host) else secrets.token_urlsafe(24)
    server = start_server(host, port, token)
    try:
        yield server, address(host, server.get_port(), token)
    finally:
        with redirect_stdout(io.StringIO()):
            server.stop()


def start_server(host: str, port: int, token: str) -> viser.ViserServer:
    """Server of the page; raises OSError if the port is taken."""
    with socket.create_server((host, port), reuse_port=False):
        pass  # viser would take the next port
    # broken connections
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
    with guarded(Access(token)), redirect_stdout(io.StringIO()):
        server = LocalServer(host=host, port=port, label="SLOT", verbose=False)
    server.gui.configure_theme(
        show_share_button=False, show_logo=False, control_width="large"
    )
    for script in (KEYBOARD, GAMEPAD, WIDE_ON_A_PHONE, LEGEND):
        server._websock_server.queue_message(
            _messages.RunJavascriptMessage(source=script)
        )
    return server


def address(host: str, port: int, token: str) -> str:
    """Address of the page; a host that stands for all addresses is replaced by its name."""
    if host in {"", "0.0.0.0", "::"}:
        host = socket.gethostname()
    return f"http://{host}:{port}/" + (f"?token={token}" if token else "")


class Access:
    """Checks the requests of a page, with a token or, on this machine, with none."""

    def __init__(self, token: str = "") -> None:
        self._token = token

    def refusal(
        self, path: str, host: str, origin: str | None, cookie: str
    ) -> str:
        """Why a request is refused, or "".

        path: with its query; host, origin, cookie: headers, origin None where there is none.
        """
        if not self._token and not is_this_machine(
            urlsplit(f"//{host}").hostname or ""
        ):
            return "unknown host"
        if origin is not None and urlsplit(origin).netloc != host:
            return "another page"
        if self._token and not self._has_token(path, cookie):
            return "the token is missing: open the address that scripts/play has printed"
        return ""

    def is_named(self, path: str) -> bool:
        """Whether the token is in the address."""
        token = parse_qs(urlsplit(path).query).get("token", [""])[0]
        return bool(self._token) and self._is_token(token)

    def cookie(self) -> str:
        """Header that lets the browser send the token from now on."""
        return f"{COOKIE}={self._token}; HttpOnly; SameSite=Strict; Path=/"

    def _has_token(self, path: str, cookie: str) -> bool:
        values = dict(
            part.strip().partition("=")[::2] for part in cookie.split(";")
        )
        return self.is_named(path) or self._is_token(values.get(COOKIE, ""))

    def _is_token(self, text: str) -> bool:
        return hmac.compare_digest(text.encode(), self._token.encode())


def is_this_machine(host: str) -> bool:
    """Whether a host to listen on is reached from this machine alone."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


@contextmanager
def guarded(access: Access) -> Iterator[None]:
    """Let a server of websockets that is started within the block check its requests.

    viser passes its own check of a request to `serve` and takes none of another, so that within the
    block `serve` is a class which makes one of both.
    """
    module: Any = websocket_server
    serve: Any = module.serve

    class Guarded(serve):
        """A server that refuses the requests that `access` refuses."""

        def __init__(
            self, *args: Any, process_request: Answer, **options: Any
        ) -> None:
            super().__init__(
                *args,
                process_request=checked(access, process_request),
                **options,
            )

    module.serve = Guarded
    try:
        yield
    finally:
        module.serve = serve


def checked(access: Access, answer: Answer) -> Answer:
    """Answer requests by `answer`, unless `access` refuses them."""

    def check(connection: Any, request: Any) -> Any:
        headers = request.headers
        refusal = access.refusal(
            request.path,
            headers.get("Host", ""),
            headers.get("Origin"),
            headers.get("Cookie", ""),
        )
        if refusal:
            return connection.respond(http.HTTPStatus.FORBIDDEN, refusal + "\n")
        response = answer(connection, request)
        if response is not None and access.is_named(request.path):
            response.headers["Set-Cookie"] = access.cookie()
        return response

    return check
