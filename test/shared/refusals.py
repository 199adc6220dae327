# SPDX-License-Identifier: Apache-2.0
"""Mistakes of the user are refused in one line."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from impact_rs_sim.errors import InputError


def refusal(ask: Callable[..., object], *arguments: object, **keys: object) -> str:
    """What is said where something is refused, which is one line."""
    with pytest.raises(InputError) as caught:
        ask(*arguments, **keys)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def lacking(said: str, words: str) -> list[str]:
    """Words, separated by |, that a message should have and lacks: file, key, value, unit, or the remedy."""
    return [word for word in words.split("|") if word not in said]
