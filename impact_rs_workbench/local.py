# SPDX-License-Identifier: Apache-2.0
"""Web applications on this machine alone: a port of 127.0.0.1, a key in the address, and Ctrl-C as the end."""

from __future__ import annotations

import secrets
import socket
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import uvicorn
from starlette.types import ASGIApp

from impact_rs_sim.errors import InputError

Ended = Callable[[], bool]
MakeApplication = Callable[[str, int, Ended], ASGIApp]


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
        application: Makes the application from its token, its port, and a function that says whether streams must end.
        browser: Whether to open a browser.
        say: Prints the address.
    """
    number = listener.getsockname()[1]
    token = secrets.token_urlsafe(24)
    address = f"http://127.0.0.1:{number}/?token={token}"
    server: uvicorn.Server | None = None

    def ended() -> bool:
        return server is not None and server.should_exit

    server = uvicorn.Server(
        uvicorn.Config(
            application(token, number, ended), log_level="warning", access_log=False, timeout_graceful_shutdown=1
        )
    )
    say(address)
    if browser:
        webbrowser.open(address)
    with suppress(KeyboardInterrupt):  # which uvicorn passes on when it has ended
        server.run(sockets=[listener])
