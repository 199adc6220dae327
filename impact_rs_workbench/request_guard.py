# SPDX-License-Identifier: Apache-2.0
"""Access control of a local page: only the browser that opened the printed address, and no page of another site.

The first request carries a token in the address; later ones carry a cookie, which browsers do not send with requests of
other sites (``SameSite=Strict``). ``Host`` must be a name of this machine (against DNS rebinding), and requests that
change state must come from our own page (``Origin``).
"""

from __future__ import annotations

import secrets
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "connect-src 'self'; frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
# Reports contain data of foreign bags: they are sandboxed as if they came from another site.
FILE_POLICY = "sandbox allow-scripts allow-popups allow-downloads; frame-ancestors 'self'"
SAFE_METHODS = ("GET", "HEAD")


class Guard:
    """Passes on requests that carry the token and come from our own page.

    Args:
        app: The guarded application.
        token: Access token of the address.
        port: Port of the server, as in ``Host``.
        command: Command of ``impact-rs`` that serves it.
    """

    def __init__(self, app: ASGIApp, token: str, port: int, command: str) -> None:
        self._app, self._token, self._command = app, token, f"impact-rs {command}"
        self._hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}
        self.cookie = f"impact_rs_{command}_{port}"  # cookies know no ports; two of a kind must not share one

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or pass on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        answer = self._refused(scope, Headers(scope=scope))
        if answer is not None:
            await answer(scope, receive, send)
            return

        async def sent(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = dict(message["headers"])
                for name, value in _HEADERS.items():
                    headers.setdefault(name, value)
                message["headers"] = list(headers.items())
            await send(message)

        await self._app(scope, receive, sent)

    def _refused(self, scope: Scope, headers: Headers) -> Response | None:
        """The refusal of a request; None: it may pass."""
        host = headers.get("host", "")
        if host not in self._hosts:
            return PlainTextResponse(f"{self._command} serves its own machine only.", 403)
        if scope["method"] not in SAFE_METHODS and headers.get("origin") != f"http://{host}":
            return PlainTextResponse(f"Requests that change state must come from the page of {self._command}.", 403)
        token = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[-1]
        if scope["path"] == "/" and self._is_token(token):
            answer = RedirectResponse("/", 303)
            answer.set_cookie(self.cookie, self._token, httponly=True, samesite="strict")
            return answer
        if not self._is_token(_cookie(headers.get("cookie", ""), self.cookie)):
            return PlainTextResponse(
                f"Open the address that {self._command} has printed: it contains the access key.", 403
            )
        return None

    def _is_token(self, text: str) -> bool:
        return secrets.compare_digest(text.encode(), self._token.encode())


_HEADERS = {
    b"content-security-policy": PAGE_POLICY.encode(),
    b"x-content-type-options": b"nosniff",
    b"referrer-policy": b"no-referrer",
    b"cache-control": b"no-store",
}


def _cookie(text: str, name: str) -> str:
    """Value of a cookie; empty: it is not there."""
    try:
        morsel = SimpleCookie(text).get(name)
    except CookieError:
        return ""
    return "" if morsel is None else morsel.value
