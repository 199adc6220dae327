# SPDX-License-Identifier: Apache-2.0
"""A verdict and its text are the same, so that files of earlier versions stay what they were."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from impact_rs_analysis.diagnosis.document import ViewDocument
from impact_rs_analysis.diagnosis.verdict import NOTHING, WITHOUT_NAMES, DiagnosisVerdict, Kind

PACKAGES = sorted(Path(__file__).resolve().parents[3].glob("impact_rs_*/**/*.py"))
TAKES_APART = {"startswith", "endswith", "split", "rsplit", "partition", "rpartition", "removeprefix", "removesuffix"}

names = st.lists(
    st.from_regex(r"[a-z][a-z0-9_]*( (by level of|along) [a-z]+)?", fullmatch=True), min_size=1, max_size=4
)
verdicts = st.sampled_from(sorted(WITHOUT_NAMES)).map(DiagnosisVerdict) | st.builds(
    DiagnosisVerdict, st.sampled_from(sorted(set(Kind) - WITHOUT_NAMES)), names.map(tuple)
)


@given(verdicts)
def test_a_verdict_is_read_from_its_text(verdict: DiagnosisVerdict) -> None:
    """Kills: a kind whose text is read as another one, or as the name of an effect."""
    assert DiagnosisVerdict.parse(str(verdict)) == verdict


@given(st.text() | st.builds("{}{{{}}}".format, st.sampled_from(sorted(Kind)), st.text()))
def test_whatever_a_file_says_is_written_as_it_was_read(text: str) -> None:
    """Also words of no version. Kills: names sorted, or blanks dropped, on the way."""
    assert str(DiagnosisVerdict.parse(text)) == text


@pytest.mark.parametrize(
    ("text", "kind", "own"),
    [
        ("object_mass+pad_friction", Kind.NAMED, ("object_mass", "pad_friction")),
        ("PARTLY{object_mass, pad_friction}", Kind.PARTLY, ("object_mass", "pad_friction")),
        ("CONFUSABLE-WITH{object_mass}", Kind.CONFUSABLE, ("object_mass",)),
        ("NOT-IDENTIFIABLE", Kind.UNIDENTIFIABLE, ()),
    ],
)
def test_verdicts_of_version_0_2_0_are_read(text: str, kind: Kind, own: tuple[str, ...]) -> None:
    """Kills: another word or separator in files that are on disk."""
    assert DiagnosisVerdict.parse(text) == DiagnosisVerdict(kind, own) and str(DiagnosisVerdict(kind, own)) == text


def test_a_document_has_the_text_of_a_verdict() -> None:
    """Kills: a document that writes the fields of the type."""
    view = ViewDocument(name="joints", verdict=NOTHING, named=(), held_out_error_before=1.0, held_out_error_after=1.0)
    assert '"verdict":"NOTHING-MISSING"' in view.model_dump_json()
    assert ViewDocument.model_validate_json(view.model_dump_json()) == view
    with pytest.raises(ValueError, match="expected a verdict"):
        ViewDocument.model_validate(view.model_dump() | {"verdict": 3})


def is_verdict(node: ast.expr) -> bool:
    """Whether an expression is a verdict or its text by its name: ``verdict``, ``x.verdict``, ``str(x.verdict)``."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "str" and node.args:
        return is_verdict(node.args[0])
    return (isinstance(node, ast.Name) and node.id == "verdict") or (
        isinstance(node, ast.Attribute) and node.attr == "verdict"
    )


def taken_apart(code: str) -> list[int]:
    """Lines that take the text of a verdict apart."""
    return [
        node.lineno
        for node in ast.walk(ast.parse(code))
        if (isinstance(node, ast.Subscript) and is_verdict(node.value))
        or (isinstance(node, ast.Attribute) and node.attr in TAKES_APART and is_verdict(node.value))
    ]


def test_no_verdict_is_taken_apart() -> None:
    """Its kind and names say all. Kills: ``startswith``, ``split`` or a slice of a verdict."""
    assert taken_apart("a.verdict.startswith(b); verdict[1:]; str(c.verdict).split('+')") == [1, 1, 1]
    assert [str(path) for path in PACKAGES if taken_apart(path.read_text(encoding="utf-8"))] == []
