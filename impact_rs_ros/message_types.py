# SPDX-License-Identifier: Apache-2.0
"""ROS message classes for :class:`~impact_rs_trials.bags.messages.MessageMaker`."""

from __future__ import annotations

import functools
import importlib
from array import array
from importlib.util import find_spec
from typing import Any

from rclpy.serialization import deserialize_message

from impact_rs_sim.robots.robot import Array


@functools.cache
def available(name: str) -> bool:
    """Whether the message ``package/msg/Name`` is installed; ``tf2_msgs`` is not on PyPI."""
    return find_spec(name.split("/")[0]) is not None


@functools.cache
def message_type(name: str) -> Any:
    """Class of the message ``package/msg/Name``."""
    package, kind, message = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), message)


def decoded(data: bytes, kind: Any) -> Any | None:
    """A serialized message as an object of the class ``kind``; None: the bytes are not such a message."""
    try:
        return deserialize_message(data, kind)
    except Exception:  # of rclpy or the middleware, depending on the bytes
        return None


class Uninstalled:
    """Placeholder for a message whose type is not installed; it cannot be published."""

    def __init__(self, **fields: Any) -> None:
        del fields


class RosidlTypes:
    """Message classes of the installed ROS interfaces."""

    def type(self, name: str) -> Any:
        """Class of the message ``package/msg/Name``."""
        return message_type(name) if available(name) else Uninstalled

    def floats(self, values: Array) -> array[float]:
        """Array that rosidl accepts; made from bytes, ten times as fast as element by element."""
        return array("d", values.tobytes())
