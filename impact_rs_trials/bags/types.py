# SPDX-License-Identifier: Apache-2.0
"""The typestore: ROS 2 Jazzy's messages and ours, without ROS."""

from __future__ import annotations

import functools
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

NS_PER_S = 1_000_000_000  # of ``builtin_interfaces/Time``
STAMP_ROUNDING_S = 1e-6  # closer timestamps are equal; far less than a period


@functools.cache
def typestore() -> Typestore:
    """Standard messages and the ``impact_rs`` ones, read from their definitions."""
    store = get_typestore(Stores.ROS2_JAZZY)
    spec = find_spec("impact_msgs_py")  # finds the package without importing it, and so without ROS
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError("impact_msgs_py, which holds the message definitions, is not installed")
    types: dict[str, Any] = {}
    for path in sorted((Path(spec.origin).parent / "msg").glob("*.msg")):
        types |= get_types_from_msg(path.read_text(encoding="utf-8"), f"impact_rs/msg/{path.stem}")
    store.register(types)
    return store


def typestore_of(connection: Connection) -> Typestore:
    """The typestore that reads a recorded topic; types of ``impact_rs`` are taken from the definitions in the bag.

    New versions add fields to these types, and a serialized message does not contain its definition.
    """
    definition = connection.msgdef
    is_ours = connection.msgtype.startswith("impact_rs/") and definition.format == MessageDefinitionFormat.MSG
    return _typestore_with(connection.msgtype, definition.data) if is_ours else typestore()


@functools.lru_cache(maxsize=64)
def _typestore_with(kind: str, definition: str) -> Typestore:
    """Standard messages, and a type with its nested types from a definition."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(definition, kind))
    return store
