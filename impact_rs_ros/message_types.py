# SPDX-License-Identifier: Apache-2.0
"""ROS message classes for :class:`~impact_rs_trials.bags.messages.MessageMaker`."""

from __future__ import annotations

import functools
import importlib
import math
import re
from array import array
from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message
from std_msgs.msg import Float64MultiArray

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


def torques_of(data: bytes) -> Array | None:
    """Numbers of a serialized ``std_msgs/Float64MultiArray``; None if the bytes are not one."""
    message = decoded(data, Float64MultiArray)
    return None if message is None else np.array(message.data)


def filled(kind: Any, document: Mapping[str, Any]) -> Any:
    """A message of ``impact_rs`` with the fields of a document; None is NaN.

    As ``rosidl_runtime_py.set_message_fields``, which pip does not install.
    """
    message = kind()
    for name, field in kind.get_fields_and_field_types().items():
        value: Any = math.nan if document[name] is None else document[name]
        if nested := re.fullmatch(r"sequence<impact_rs/(\w+)>", field):
            value = [filled(message_type(f"impact_rs/msg/{nested[1]}"), nested_document) for nested_document in value]
        setattr(message, name, value)
    return message


def document_of(message: Any) -> Any:
    """The document of a message of ``impact_rs``, for JSON: the inverse of :func:`filled`."""
    if hasattr(message, "get_fields_and_field_types"):
        return {name: document_of(getattr(message, name)) for name in message.get_fields_and_field_types()}
    if isinstance(message, (list, np.ndarray)):
        return [document_of(element) for element in message]
    return None if isinstance(message, float) and not math.isfinite(message) else message


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
