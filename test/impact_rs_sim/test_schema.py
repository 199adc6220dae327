"""Files of users: what is read, and how a mistake is told."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import pytest
from pydantic import Field

from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.schema import PositiveVector, Schema, Vector3, load, parse_yaml, validate


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
        ({"parts": {"a": {"mass": -1.0}}}, ["parts.a.mass = -1.0", "greater than 0", "mass [kg]"]),
        ({"parts": {"a": {}}}, ["parts.a.mass", "missing", "[kg]"]),
        ({"parts": {"a": {"mass": 1.0, "mas": 2.0}}}, ["parts.a.mas", "unknown key", "did you mean 'mass'"]),
        ({"parts": {"a": {"mass": 1.0, "place": [0, 1]}}}, ["parts.a.place", "[m]"]),
        ({"parts": {}, "gains": [1.0, 0.0]}, ["gains", "every entry must be > 0", "[1/s]"]),
        ({"parts": {}, "spare": {"mass": float("inf")}}, ["spare.mass", "finite", "[kg]"]),
        ({"parts": {}, "xyz": 1}, ["xyz", "unknown key", "known keys: parts, gains, spare"]),
    ],
)
def test_a_mistake_names_file_key_value_and_what_was_expected_with_its_unit(data: dict, parts: list[str]) -> None:
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


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a: 1\nb: 2\na: 3", "'a' stands here twice"),
        ("a: [1", "line 1"),
        ("[1, 2]", "found list"),
        ("", "found NoneType"),
    ],
)
def test_what_is_no_mapping_of_keys_is_refused(text: str, told: str) -> None:
    with pytest.raises(InputError, match="mine.yaml") as caught:
        parse_yaml(text, "mine.yaml")
    assert told in str(caught.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="none.yaml"):
        load(Outer, tmp_path / "none.yaml")
    (tmp_path / "bytes.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="bytes.yaml"):
        load(Outer, tmp_path / "bytes.yaml")


def test_a_guess_is_made_for_a_slip_of_the_pen_alone() -> None:
    assert did_you_mean("frictoin", ["friction", "mass"]) == "; did you mean 'friction'?"
    assert did_you_mean("xyz", ["friction", "mass"]) == ""
