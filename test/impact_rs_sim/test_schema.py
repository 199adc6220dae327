# SPDX-License-Identifier: Apache-2.0
"""Files of users: what is read, and how a mistake is told."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import pytest
import yaml
from pydantic import Field

from impact_rs_sim import schema
from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.schema import (
    RECORDED,
    Name,
    PositiveVector,
    Schema,
    Vector3,
    load,
    parse_value,
    parse_yaml,
    validate,
)


class Inner(Schema):
    """A part of a file."""

    mass: Annotated[float, Field(gt=0.0, description="mass [kg]")]
    place: Vector3 = Field((0.0, 0.0, 0.0), description="where [m]")


class Outer(Schema):
    """A file."""

    parts: dict[str, Inner] = Field(description="parts by name")
    gains: PositiveVector = Field((), description="gains [1/s]")
    spare: Inner | None = Field(None, description="another part")


def complaint(data: dict) -> str:
    with pytest.raises(InputError) as caught:
        validate(Outer, data, "mine.yaml")
    return str(caught.value)


@pytest.mark.parametrize(
    ("data", "parts"),
    [
        ({"parts": {"a": {"mass": -1.0}}}, ["parts.a.mass = -1.0", "mass [kg]"]),
        ({"parts": {"a": {}}}, ["parts.a.mass", "[kg]"]),
        ({"parts": {"a": {"mass": 1.0, "mas": 2.0}}}, ["parts.a.mas", "unknown key", "did you mean 'mass'"]),
        ({"parts": {"a": {"mass": 1.0, "place": [0, 1]}}}, ["parts.a.place", "[m]"]),
        ({"parts": {}, "gains": [1.0, 0.0]}, ["gains", "[1/s]"]),
        ({"parts": {}, "spare": {"mass": float("inf")}}, ["spare.mass", "[kg]"]),
        ({"parts": {}, "xyz": 1}, ["xyz", "unknown key", "known keys: parts, gains, spare"]),
    ],
)
def test_a_mistake_names_file_key_value_expectation_and_unit(data: dict, parts: list[str]) -> None:
    message = complaint(data)
    assert message.startswith("mine.yaml: ")
    for part in parts:
        assert part in message
    assert "\n" not in message


def test_a_misspelt_key_is_told_before_the_one_that_is_missing_for_it() -> None:
    message = complaint({"parts": {"a": {"masss": 1.0}}})
    assert "parts.a.masss" in message
    assert "and 1 more" in message


def test_what_was_read_cannot_be_changed() -> None:
    found = validate(Outer, {"parts": {"a": {"mass": 1.0, "place": [1, 2, 3]}}}, "mine.yaml")
    assert found.parts["a"].place == (1.0, 2.0, 3.0)
    with pytest.raises(ValueError, match="frozen"):
        found.parts["a"].mass = 2.0


def test_a_guess_is_made_for_a_slip_of_the_pen_alone() -> None:
    assert did_you_mean("frictoin", ["friction", "mass"]) == "; did you mean 'friction'?"
    assert did_you_mean("xyz", ["friction", "mass"]) == ""


NESTED = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 9)}]\n"
    for before, name in zip("abcdefghi", "bcdefghij", strict=True)
)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        pytest.param(NESTED, ["line 2", "*name"], id="billions of nodes in 600 characters"),
        pytest.param("a: 1\n? [a, b]\n: 2", ["line 2", "a key must be a word"], id="key that is a list"),
        pytest.param("parts:\n  a: 2026-13-45", ["line 2", "parts.a", "no timestamp"], id="date that there is not"),
        pytest.param(f"a: {'9' * 5000}", ["line 1", "a: ", "5000 characters", "int"], id="number of 5000 digits"),
        pytest.param(f"a: 0x{'f' * 5000}", ["line 1", "int"], id="the same in hexadecimal"),
        pytest.param("a:\n- !!int abc", ["line 2", "a.0", "'abc' is no int"], id="no int"),
        pytest.param("a: !!bool maybe", ["a", "'maybe' is no bool"], id="no bool"),
        pytest.param("a: !!python/name:os.system x", ["a", "not understood"], id="foreign type"),
        pytest.param(f"{'k' * 500}: 1", ["line 1", "key of 500 characters"], id="key without end"),
        pytest.param("[" * 500, ["nested deeper than 40"], id="depth"),
        pytest.param("a: " + "[x," * 210_000, ["nested deeper"], id="depth and size"),
        pytest.param("a: {b: 1, b: 2}", ["a: ", "'b' stands here twice"], id="twice"),
        pytest.param("%YAML 1.x\n---\na: 1", ["not valid YAML"], id="version that is none"),
        pytest.param("a: \x00", ["not valid YAML"], id="unprintable"),
        pytest.param("a: 1\n---\nb: 2", ["line 2"], id="two documents"),
        pytest.param("", ["expected a YAML mapping"], id="empty"),
        pytest.param("[1, 2]", ["found list"], id="a list"),
    ],
)
def test_whatever_is_wrong_with_a_text_is_one_short_line_with_its_place(text: str, parts: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        parse_yaml(text, "mine.yaml")
    message = str(caught.value)
    assert message.startswith("mine.yaml: ")
    assert "\n" not in message
    assert len(message) < 500
    for part in parts:
        assert part in message


def test_a_text_of_too_many_entries_is_one_short_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(schema, "MAX_NODES", 2000)
    parse_yaml("a: [" + "1," * 1990 + "]", "mine.yaml")
    with pytest.raises(InputError, match="^mine.yaml: .*more than 2000 entries") as caught:
        parse_yaml("a: [" + "1," * 2000 + "]", "mine.yaml")
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 500


def test_what_a_file_may_say_is_read_as_ever() -> None:
    text = "a: 1\nb: [1.5, .nan, true, null, text, 2026-01-02]\nc: {d: {e: '*f'}}\n2: |\n  two\n  lines\n"
    data = parse_yaml(text, "mine.yaml")
    assert str(data) == str(yaml.safe_load(text))
    assert parse_value("3.5", "x") == 3.5


def test_a_value_without_end_is_repeated_in_part(tmp_path: Path) -> None:
    message = complaint({"parts": {"a": {"mass": "x" * 100_000}}})
    assert len(message) < 500
    assert "..." in message
    assert len(complaint({"parts": {"k" * 5000: {}}})) < 500
    assert len(complaint({"parts": {"a": {"mass": 10**5000}}})) < 500


def test_a_file_that_is_too_large_no_text_or_no_file_is_told(tmp_path: Path) -> None:
    for path, reason in [
        (Path("/dev/zero"), "larger than"),
        (tmp_path, "Is a directory"),
        (tmp_path / "none", "No such file"),
        ("no\0path", "null"),
    ]:
        with pytest.raises(InputError, match=reason):
            load(Outer, path)
    (tmp_path / "odd").write_bytes(b"a: \xff")
    with pytest.raises(InputError, match="no UTF-8 text, from byte 3 on"):
        load(Outer, tmp_path / "odd")


class Named(Schema):
    """Things by name."""

    things: dict[Name, int] = Field(description="by name")


@pytest.mark.parametrize("name", ["../../escaped/o", ".hidden", "", "a b", "a/b", "<script>", "a" * 101, "ä", "a\n"])
def test_a_name_is_a_word_because_folders_are_called_like_it(name: str) -> None:
    with pytest.raises(InputError, match="expected a name of letters"):
        validate(Named, {"things": {name: 1}}, "mine.yaml")
    assert validate(Named, {"things": {"Cat-food_2": 1}}, "mine.yaml")


def test_a_recorded_name_may_be_an_old_one_and_no_path() -> None:
    assert validate(Named, {"things": {"cat food (old)": 1}}, "bag", RECORDED)
    for name in ("../../escaped/o", ".hidden", "a/b", "a\\b", "a\0"):
        with pytest.raises(InputError, match="not a path"):
            validate(Named, {"things": {name: 1}}, "bag", RECORDED)
