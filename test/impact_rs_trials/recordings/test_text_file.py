# SPDX-License-Identifier: Apache-2.0
"""Files of other programs: other characters, other ends of lines, capital suffixes; the same numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from impact_rs_sim.errors import InputError
from impact_rs_trials.recordings.readers.run_finder import find_recordings, name_of
from impact_rs_trials.recordings.readers.table_columns import read_columns
from impact_rs_trials.recordings.readers.text_file import read_text

TABLE = "t [s],φ [°],µ\n0.0,1.5,2.0\n0.1,2.5,3.0\n0.2,3.5,4.0\n"


@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_a_text_is_the_same_in_every_encoding_and_with_every_end_of_line(
    tmp_path: Path, encoding: str, ending: str
) -> None:
    """Kills: UTF-8 alone; a carriage return in the last cell."""
    path = tmp_path / "log.csv"
    path.write_bytes(TABLE.replace("\n", ending).encode(encoding))
    assert read_text(path) == TABLE


def test_a_degree_sign_of_an_older_program_does_not_refuse_the_log(tmp_path: Path) -> None:
    """Windows-1252, where ° and µ are bytes that UTF-8 has not; numbers as in UTF-8."""
    names = ("t", "q [°]", "µ")
    columns = []
    for encoding in ("cp1252", "utf-8"):
        path = tmp_path / f"{encoding}.csv"
        path.write_bytes(TABLE.replace("φ", "q").replace("t [s]", "t").encode(encoding))
        columns.append(read_columns(path).cells)
    for name in names:
        np.testing.assert_array_equal(columns[0][name], columns[1][name])


@pytest.mark.parametrize("data", [b"PK\x03\x04\0\0", b"\x81\x8d\x8f", b"t,q\0\n1,2\n"])
def test_what_is_no_text_is_refused_by_name(tmp_path: Path, data: bytes) -> None:
    """A zipped spreadsheet, bytes that no character has, and a zero byte."""
    path = tmp_path / "log.csv"
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"log\.csv.*not a text"):
        read_text(path)


@given(st.text(st.characters(codec="utf-8", exclude_characters="\r\0\ufeff")))
def test_every_text_in_utf_8_is_read_as_it_is(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = tmp_path_factory.mktemp("text") / "log.csv"
    path.write_bytes(text.encode("utf-8"))
    assert read_text(path) == text


def test_capital_suffixes_are_found_named_and_read(tmp_path: Path) -> None:
    """Kills: a folder of LOG.CSV is empty; the name of its run is LOG.CSV."""
    path = tmp_path / "LOG.CSV"
    path.write_text("t,q\n0.0,1.0\n0.1,2.0\n0.2,3.0\n")
    assert find_recordings(tmp_path) == [path] and name_of(path) == "LOG"
    np.testing.assert_array_equal(read_columns(path).cells["q"], ["1.0", "2.0", "3.0"])
