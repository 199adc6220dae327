# SPDX-License-Identifier: Apache-2.0
"""Lifecycle (managed) nodes: a program is configured, activated, deactivated and cleaned up from outside.

A transition that the program refuses leaves the node in the state before, with the reason in the log. After an error of
the program it is deactivated and unconfigured.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Protocol

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from impact_rs_sim.errors import InputError, full_traceback

SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE
ERROR = TransitionCallbackReturn.ERROR


class Managed(Protocol):
    """A program in a lifecycle node."""

    kind: ClassVar[str]

    def configure(self) -> None:
        """Read scenario and parameters; raises ``InputError`` for wrong ones."""

    def activate(self) -> None:
        """Connect, and serve trials."""

    def deactivate(self) -> None:
        """End what runs, brake or stop, and serve no trial."""

    def cleanup(self) -> None:
        """Forget what :meth:`configure` read."""

    def finish(self) -> None:
        """End the process."""


class ManagedNode(LifecycleNode):
    """The lifecycle node of a program.

    Args:
        program: Called by the transitions.
    """

    def __init__(self, program: Managed) -> None:
        self._program = program
        self._refusal: Exception = InputError("the transition was refused")
        super().__init__(program.kind)

    def start(self) -> None:
        """Configure and activate; raises the reason of a refusal."""
        for transition in (self.trigger_configure, self.trigger_activate):
            if transition() != SUCCESS:
                raise self._refusal

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._do(self._program.configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._do(self._program.activate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._do(self._program.deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._do(self._program.cleanup)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._do(self._program.deactivate)
        return self._do(self._program.finish)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._do(self._program.deactivate)
        return self._do(self._program.cleanup)

    def _do(self, action: Callable[[], None]) -> TransitionCallbackReturn:
        try:
            action()
        except InputError as error:
            self.get_logger().error(str(error))
            self._refusal = error
            return FAILURE
        except Exception as error:  # no transition ends a node
            self.get_logger().error(full_traceback(error))
            self._refusal = error
            return ERROR
        return SUCCESS
