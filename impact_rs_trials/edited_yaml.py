# SPDX-License-Identifier: Apache-2.0
"""YAML files that are edited or written with comments (ruamel.yaml, round trip).

Comments, order and spelling of unchanged parts stay. New values are written so that PyYAML, which reads these files as
YAML 1.1 (:mod:`impact_rs_sim.schema`), reads the same values.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import YAMLError
from ruamel.yaml.nodes import ScalarNode
from ruamel.yaml.representer import RoundTripRepresenter
from ruamel.yaml.scalarstring import DoubleQuotedScalarString

from impact_rs_sim.errors import InputError
from impact_rs_sim.schema import parse_value, read_text

COMMENT_COLUMN = 48  # of comments behind short values, as in the shipped scenarios
YAML_DIGITS = 6  # significant ones, of newly written numbers


class Noted(NamedTuple):
    """A value with the comment behind it.

    Attributes:
        value: The value.
        comment: The comment, without #; may be empty.
    """

    value: Any
    comment: str


class _Representer(RoundTripRepresenter):
    """Writes floats with a decimal point: YAML 1.1 reads 1e-3 as a text, and 1.0e-3 as a number."""

    def represent_number(self, number: float) -> ScalarNode:
        """A float that was not read from a file."""
        text = repr(number)
        text = text.replace("e", ".0e", 1) if "e" in text and "." not in text else text
        return self.represent_scalar("tag:yaml.org,2002:float", text)


_Representer.add_representer(float, _Representer.represent_number)


def read_edited(path: Path) -> CommentedMap:
    """The mapping in a file that :func:`impact_rs_sim.schema.load` reads, with its comments.

    Raises:
        InputError: It cannot be read, or not edited: not valid YAML 1.2.
    """
    reader = YAML()
    reader.preserve_quotes = True
    try:
        content: CommentedMap = reader.load(read_text(path))
    except YAMLError as error:
        raise InputError(f"cannot be edited: {' '.join(str(error).split())}", file=path) from None
    return content


def edited_text(content: CommentedMap) -> str:
    """Text of an edited file."""
    writer, text = YAML(), io.StringIO()
    writer.Representer = _Representer
    writer.width = 2**16  # lines are not broken
    writer.dump(content, text)
    return text.getvalue()


def scalar(text: str) -> str:
    """A text for a file, in quotation marks if YAML reads another type without them: on, 3 or null."""
    try:
        plain = parse_value(text, "") == text
    except InputError:
        plain = False
    return text if plain else DoubleQuotedScalarString(text)


def section(entries: Mapping[str, Any]) -> CommentedMap:
    """A mapping of values or sections, each perhaps :class:`Noted`."""
    mapping = CommentedMap()
    for key, entry in entries.items():
        value, comment = entry if isinstance(entry, Noted) else (entry, "")
        mapping[key] = value
        if comment:
            mapping.yaml_add_eol_comment(comment, key, column=COMMENT_COLUMN)
    return mapping


def row(values: Iterable[Any]) -> CommentedSeq:
    """A list in one line, numbers with :data:`YAML_DIGITS` significant digits."""
    sequence = CommentedSeq(rounded(value) if isinstance(value, float) else value for value in values)
    sequence.fa.set_flow_style()
    return sequence


def in_one_line(content: Mapping[str, Any]) -> CommentedMap:
    """A mapping in one line."""
    mapping = section(content)
    mapping.fa.set_flow_style()
    return mapping


def rounded(value: float) -> float:
    """A float with :data:`YAML_DIGITS` significant digits, without the sign of -0."""
    return float(f"{value:.{YAML_DIGITS}g}") + 0.0


def separate(content: CommentedMap, *keys: str) -> None:
    """Leave an empty line before sections whose predecessors were written anew."""
    for key in keys:
        content.yaml_set_comment_before_after_key(key, before="\n")
