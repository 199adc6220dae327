# SPDX-License-Identifier: Apache-2.0
"""Messages without ROS: what is not stated of them is zero or empty."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from rosbags.typesys.store import Typestore

from impact_rs_trials.bags.types import typestore


def message(kind: str, content: Mapping[str, Any] | None = None, store: Typestore | None = None) -> Any:
    """A message; ``content`` has values by field, with dots for fields of fields: ``{"header.frame_id": "world"}``.

    A field that is a message takes its own fields in their order: a vector (x, y, z), a stamp (seconds, nanoseconds).
    """
    store = store or typestore()
    made = _blank(store, kind)
    for name, value in (content or {}).items():
        *path, last = name.split(".")
        place = made
        for part in path:
            place = getattr(place, part)
        inner = getattr(place, last)
        if hasattr(inner, "__dataclass_fields__") and not hasattr(value, "__dataclass_fields__"):
            names = [field.name for field in fields(inner) if field.name != "__msgtype__"]
            for field, number in zip(names, value, strict=True):
                setattr(inner, field, number)
        else:
            setattr(place, last, value)
    return made


def _blank(store: Typestore, kind: str) -> Any:
    values: dict[str, Any] = {}
    for field, (node, what) in store.fielddefs[kind][1]:
        number = int(node)
        if number == 2:
            values[field] = _blank(store, str(what))
        elif number == 1:
            values[field] = {"string": "", "bool": False}.get(what[0], 0)
        elif number == 3:
            values[field] = np.zeros(what[1])
        else:
            values[field] = np.zeros(0) if int(what[0][0]) == 1 and what[0][1][0] != "string" else []
    return store.types[kind](**values)
