# SPDX-License-Identifier: Apache-2.0
"""The configuration is found wherever the package is."""

import sys
from pathlib import Path

import pytest

from impact_rs_sim import paths


@pytest.fixture
def nowhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A module, an environment and an ament prefix without configuration."""
    monkeypatch.delenv("IMPACT_RS_CONFIG", raising=False)
    monkeypatch.setattr(paths, "__file__", str(tmp_path / "source" / "impact_rs_sim" / "paths.py"))
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "venv"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'first'}:{tmp_path / 'second'}")
    return tmp_path


def make(folder: Path) -> Path:
    folder.mkdir(parents=True)
    return folder


def test_places_are_tried_in_order(nowhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    second = make(nowhere / "second/share/impact_rs/config")
    assert paths.config_directory() == second
    first = make(nowhere / "first/share/impact_rs/config")
    assert paths.config_directory() == first
    environment = make(nowhere / "venv/share/impact_rs/config")
    assert paths.config_directory() == environment
    source = make(nowhere / "source/config")
    assert paths.config_directory() == source
    override = make(nowhere / "mine")
    monkeypatch.setenv("IMPACT_RS_CONFIG", str(override))
    assert paths.config_directory() == override


def test_the_error_lists_every_place(nowhere: Path) -> None:
    with pytest.raises(FileNotFoundError) as error:
        paths.config_directory()
    for place in ("source/config", "venv/share", "first/share", "second/share"):
        assert str(nowhere / place) in str(error.value)


def test_a_wrong_override_is_an_error(nowhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make(nowhere / "source/config")
    monkeypatch.setenv("IMPACT_RS_CONFIG", str(nowhere / "missing"))
    with pytest.raises(FileNotFoundError, match="missing"):
        paths.config_directory()
