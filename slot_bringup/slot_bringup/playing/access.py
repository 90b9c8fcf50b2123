"""Who may open the page: this machine alone, or, of other machines, who has the token.

viser serves page and websocket on one port. Every request is checked: a websocket's Origin has to
be its Host, so that no other page in the browser connects. On this machine the Host has to be this
machine, so that no name of another site leads here. Where other machines can reach the port, the
token has to be in the address, or in the cookie that the page has set.
"""

from __future__ import annotations

import hmac
import http
import ipaddress
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeAlias
from urllib.parse import parse_qs, urlsplit

COOKIE = "slot_token"
Answer: TypeAlias = Callable[[Any, Any], Any]
"""Response to a request on a connection; None: the websocket is opened."""


class Access:
    """Checks the requests of a page, with a token or, on this machine, with none."""

    def __init__(self, token: str = "") -> None:
        self._token = token

    def refusal(self, path: str, host: str, origin: str | None, cookie: str) -> str:
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
            return (
                "the token is missing: open the address that scripts/play has printed"
            )
        return ""

    def is_named(self, path: str) -> bool:
        """Whether the token is in the address."""
        return bool(self._token) and self._is_token(_query(path))

    def cookie(self) -> str:
        """Header that lets the browser send the token from now on."""
        return f"{COOKIE}={self._token}; HttpOnly; SameSite=Strict; Path=/"

    def _has_token(self, path: str, cookie: str) -> bool:
        values = dict(part.strip().partition("=")[::2] for part in cookie.split(";"))
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
    from websockets.asyncio import server  # noqa: PLC0415 - optional

    module: Any = server
    serve: Any = module.serve

    class Guarded(serve):
        """A server that refuses the requests that `access` refuses."""

        def __init__(self, *args: Any, process_request: Answer, **options: Any) -> None:
            super().__init__(
                *args, process_request=checked(access, process_request), **options
            )

    module.serve = Guarded
    try:
        yield
    finally:
        module.serve = serve


def checked(access: Access, answer: Answer) -> Answer:
    """Answer requests by `answer`, but those that `access` refuses."""

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


def _query(path: str) -> str:
    return parse_qs(urlsplit(path).query).get("token", [""])[0]
