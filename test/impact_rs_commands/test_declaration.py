# SPDX-License-Identifier: Apache-2.0
"""A command line made from values of options is read back as the same values, whatever they are."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from impact_rs_cli.main import parser
from impact_rs_cli.parser import PROGRAM, command_line
from impact_rs_commands import COMMANDS, command_named
from impact_rs_commands.declaration import Option

WORDS = st.from_regex(
    r"[A-Za-z0-9_.ä][-A-Za-z0-9_./ä '\"$&;*]{0,12}", fullmatch=True
)  # what begins with - is an option


RUN = [action for command in COMMANDS.values() for action in command.actions or (command,)]


def values_of(option: Option) -> st.SearchStrategy[Any]:
    """Values that a terminal accepts for an option."""
    if option.kind in ("switch", "json"):
        return st.booleans()
    low = 0.0 if option.many else -1000.0 if option.least is None else option.least  # argparse reads no list of -1e-9
    one: st.SearchStrategy[Any] = WORDS
    if option.kind == "whole":
        one = st.integers(int(low), int(low) + 2000)
    if option.kind == "number":
        one = st.floats(low, low + 2000.0, allow_subnormal=False)
    if option.choices:
        one = st.sampled_from(option.choices)
    return st.lists(one, min_size=1, max_size=3) if option.many else one


def parsed(line: str) -> dict[str, Any]:
    return vars(parser().parse_args(shlex.split(line)[len(shlex.split(PROGRAM)) :]))


@pytest.mark.parametrize("name", [command.name for command in RUN])
@settings(max_examples=10, deadline=None)
@given(data=st.data())
def test_a_command_line_is_read_back_as_the_values_it_was_made_of(name: str, data: st.DataObject) -> None:
    command = command_named(name)
    wanted: dict[str, Any] = {}
    for option in command.options:
        left_out = [one for one in command.options if not one.flags and not one.required and one.name not in wanted]
        after = not option.flags and left_out[:1] not in ([], [option])  # a position comes after those before it
        if option.required or (not after and data.draw(st.booleans(), label=f"{option.name} is given")):
            wanted[option.name] = data.draw(values_of(option), label=option.name)
    found = parsed(command_line(name, wanted))
    for key, value in wanted.items():
        assert found[key] == (_paths(value) if _paths(found[key]) == found[key] else value), key
    again = parsed(command_line(name, found))
    assert {one.name: again[one.name] for one in command.options} == {
        one.name: found[one.name] for one in command.options
    }


def _paths(value: Any) -> Any:
    """A text or several as paths."""
    if isinstance(value, list):
        return [_paths(one) for one in value]
    return Path(value) if isinstance(value, (str, Path)) else None
