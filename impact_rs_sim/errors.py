# SPDX-License-Identifier: Apache-2.0
"""Exceptions for user errors; the message states the remedy.

    InputError
    +-- NotABody              physically inconsistent mass and inertia; a fit then tries a smaller step
    +-- Infeasible            an impossible state of arms or object; a search then tries another state
    |   +-- UnreachablePose   no joint positions within the limits reach the pose
    +-- MissingPackage        a package that few files need is not installed; the command line offers to install it

There is a class for every case that some caller handles separately.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Self

MAX_ECHO_LENGTH = 200  # characters of a value that an error message repeats


class InputError(ValueError):
    """A mistake in the input of the user: a file, a key, a command-line argument or a service request.

    The command line prints it as one line and exits with code 2; the impact-map service answers it as
    ``success: false``.

    Args:
        message: Description of the mistake, or, with ``key``, the expected value with its unit.
        file: The file the mistake is in, if any.
        key: Dotted path of the key, for example ``robots.arm.end_effector.mass``.
        value: The value found there.
    """

    def __init__(
        self,
        message: str,
        *,
        file: str | Path | None = None,
        key: str | None = None,
        value: object = None,
    ) -> None:
        self.message = message
        self.file = None if file is None else str(file)
        self.key = key
        self.value = value
        location = [] if self.file is None else [self.file]
        if key is not None:
            location.append(shortened(key) + ("" if value is None else f" = {_echo(value)}"))
        super().__init__(": ".join([*location, message]))

    def in_file(self, file: str | Path) -> Self:
        """The same error with the name of its file."""
        return type(self)(self.message, file=file, key=self.key, value=self.value)


class NotABody(InputError):
    """Mass and inertia that are not physically consistent, for example after a subtraction."""


class Infeasible(InputError):
    """An impossible state: beyond a joint limit, out of reach, or with overlapping bodies."""


class UnreachablePose(Infeasible):
    """A pose of the end effector that no joint positions within the limits reach."""


class MissingPackage(InputError):
    """A Python package that only some files need is not installed; the message has the command that installs it."""


def shortened(text: str, most: int = MAX_ECHO_LENGTH) -> str:
    """Foreign text in one line, truncated with ``...`` after ``most`` characters."""
    line = " ".join(text[: 2 * most].split())
    return line if len(text) <= most else f"{line[: most - 3]}..."


def _echo(value: object) -> str:
    try:
        return shortened(repr(value))
    except ValueError:  # a whole number of more digits than Python writes
        return f"{type(value).__name__} that cannot be shown"


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """``; did you mean 'x'?`` if ``name`` looks like a typing error of a known name, else empty."""
    close = get_close_matches(name, list(names), n=1)
    return f"; did you mean {close[0]!r}?" if close else ""


def full_traceback(error: BaseException) -> str:
    """Traceback of an error and of all its causes, also of those hidden by ``from None``."""
    cause: BaseException | None = error
    while cause is not None:
        cause.__suppress_context__ = False
        cause = cause.__cause__ or cause.__context__
    return "".join(traceback.format_exception(error)).rstrip()
