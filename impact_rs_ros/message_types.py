"""ROS message classes for :class:`~impact_rs_trials.bags.messages.MessageMaker`."""

from __future__ import annotations

import functools
import importlib
from array import array
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

from impact_rs_sim.robot import Array


@functools.cache
def available(name: str) -> bool:
    """Whether the message ``package/msg/Name`` is installed; ``tf2_msgs`` is not on PyPI."""
    return find_spec(name.split("/")[0]) is not None


@functools.cache
def message_type(name: str) -> Any:
    """Class of the message ``package/msg/Name``."""
    package, kind, message = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), message)


class Uninstalled:
    """Stands for a message whose type is not installed; nobody can publish it."""

    def __init__(self, **fields: Any) -> None:
        del fields


@functools.cache
def _maker(name: str) -> Callable[..., Any]:
    """Makes messages of a type out of all their fields, about five times as fast as the constructor.

    The constructor fills every field with a default message before it takes what it is given.
    """
    kind = message_type(name)
    new = kind.__new__
    fill = {field: getattr(kind, f"_{field}").__set__ for field in kind.get_fields_and_field_types()}
    unchecked = kind._check_fields.__set__

    def make(**fields: Any) -> Any:
        if len(fields) != len(fill):
            return kind(**fields)
        message = new(kind)
        unchecked(message, False)
        for field, value in fields.items():
            fill[field](message, value)
        return message

    return make


class RosidlTypes:
    """Message classes of the installed ROS interfaces."""

    def type(self, name: str) -> Any:
        """What makes the message ``package/msg/Name`` out of its fields."""
        return _maker(name) if available(name) else Uninstalled

    def floats(self, values: Array) -> array[float]:
        """Rosidl takes ``array.array``; from bytes it is made about ten times faster than element by element."""
        return array("d", values.tobytes())
