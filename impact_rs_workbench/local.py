# SPDX-License-Identifier: Apache-2.0
"""Web applications on this machine alone: a port of 127.0.0.1, a key in the address, and Ctrl-C as the end."""

from __future__ import annotations

import asyncio
import secrets
import socket
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType

import uvicorn
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from impact_rs_sim.errors import InputError

MakeApplication = Callable[[str, int], ASGIApp]
SERVER_POLL_S = 0.05  # between two checks whether the server ends


@contextmanager
def listening(port: int) -> Iterator[socket.socket]:
    """A port that only this machine can reach.

    Args:
        port: Its number; 0: any that is free.

    Raises:
        InputError: The port number is out of range, or the port is taken.
    """
    if not 0 <= port <= 65535:
        raise InputError(f"port {port}: expected 0 (a free one) to 65535")
    try:
        listener = socket.create_server(("127.0.0.1", port))
    except OSError as error:
        raise InputError(
            f"port {port} cannot be opened: {error.strerror}; choose another one, or leave --port out"
        ) from None
    with listener:
        yield listener


def serve_locally(
    listener: socket.socket, application: MakeApplication, browser: bool, say: Callable[[str], None]
) -> None:
    """Serve an application until Ctrl-C.

    Args:
        listener: Socket of the server (:func:`listening`).
        application: Makes the application from its token and its port.
        browser: Whether to open a browser.
        say: Prints the address.
    """
    number = listener.getsockname()[1]
    token = secrets.token_urlsafe(24)
    address = f"http://127.0.0.1:{number}/?token={token}"
    guarded = _UntilTheEnd(application(token, number))
    server = _Server(uvicorn.Config(guarded, log_level="warning", access_log=False, timeout_graceful_shutdown=1))
    guarded.ended = lambda: server.should_exit
    say(address)
    if browser:
        webbrowser.open(address)
    with suppress(KeyboardInterrupt):  # before uvicorn has taken the signals
        server.run(sockets=[listener])


class _Server(uvicorn.Server):
    """A server that ends in order, however often Ctrl-C is pressed."""

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Begin to end."""
        self.should_exit = True


class _UntilTheEnd:
    """Ends every request with the server: a stream is complete, and a request that waits for work is refused.

    Args:
        app: The application.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self.ended: Callable[[], bool] = lambda: False

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        sent = {"started": False, "complete": False}

        async def passed(message: Message) -> None:
            sent["started"] = True
            sent["complete"] = message["type"] == "http.response.body" and not message.get("more_body", False)
            await send(message)

        answer = asyncio.ensure_future(self._app(scope, receive, passed))
        while not (answer.done() or self.ended()):
            await asyncio.wait({answer}, timeout=SERVER_POLL_S)
        if not answer.done():
            answer.cancel()
            await asyncio.wait({answer})
        if not answer.cancelled():
            answer.result()
        elif not sent["started"]:
            await JSONResponse({"error": "the program that serves this page has ended"}, 503)(scope, receive, send)
        elif not sent["complete"]:
            await send({"type": "http.response.body", "body": b""})
