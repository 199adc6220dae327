# SPDX-License-Identifier: Apache-2.0
"""Yes/no questions of a command to the user of the page that started it, over a private socket.

With ``IMPACT_RS_QUESTIONS=N`` in its environment, file descriptor N of a command is one end of that socket. A question
is one line of JSON, ``{"number": 1, "text": "May it run?"}``, and so is its answer, ``{"number": 1, "yes": true}``. Any
other answer means no: another number, another text, or the end of the other process.
"""

from __future__ import annotations

import json
import os
import socket
from typing import Any

VARIABLE = "IMPACT_RS_QUESTIONS"


class PageQuestions:
    """The command's end of the socket; the variable is removed from the environment, so child processes cannot ask.

    Args:
        descriptor: File descriptor of a connected socket.
    """

    def __init__(self, descriptor: int) -> None:
        self._socket = socket.socket(fileno=descriptor)
        self._socket.set_inheritable(False)
        self._answers = self._socket.makefile("r", encoding="utf-8", errors="replace")
        self._asked = 0

    @classmethod
    def of_environment(cls) -> PageQuestions | None:
        """The question channel of this process; None if no page started it."""
        descriptor = os.environ.pop(VARIABLE, "")
        try:
            return cls(int(descriptor)) if descriptor else None
        except (ValueError, OSError):  # no number, or no socket
            return None

    def ask(self, text: str) -> bool:
        """Ask, and wait for the answer; True only for a valid yes to this question."""
        self._asked += 1
        try:
            self._socket.sendall((json.dumps({"number": self._asked, "text": text}) + "\n").encode())
            line = self._answers.readline()
        except OSError:
            return False
        return message_of(line) == {"number": self._asked, "yes": True}


def message_of(line: str) -> dict[str, Any] | None:
    """Content of a line; None if it is invalid."""
    try:
        content = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None
