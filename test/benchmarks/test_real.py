# SPDX-License-Identifier: Apache-2.0
"""The board of real data: its files are whole, and its runner judges a set whose truth is known."""

from __future__ import annotations

import importlib
import re
import struct
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from ball_impacts import Racket, ball_table

from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.diagnosis.grammar import laws_of, load_grammar
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import load_model

RESTITUTION, FRICTION = 0.53, 0.212


@pytest.fixture(scope="module")
def real() -> ModuleType:
    return importlib.import_module("benchmarks.real.__main__")


def bouncing(real: ModuleType, **expected: object) -> object:
    """A set of balls on a face that is believed to have e = 0.45 and mu = 0.3."""
    return real.RealSet.model_validate(
        {
            "what": "balls on a face",
            "source": "closed forms",
            "licence": "ours",
            "get": "git clone nowhere",
            "collect": {"tables": "*.csv"},
            "steps": ["impact-rs diagnose --impacts {out}/tables/data_balls.csv -o {out}/diagnosis.json"],
            "expected": {"source": "closed forms", **expected},
        }
    )


@pytest.fixture(scope="module")
def bounced(real: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> DiagnosisDocument:
    data = tmp_path_factory.mktemp("clone") / "data"
    data.mkdir()
    racket = Racket(lambda _: RESTITUTION, FRICTION)
    ball_table(data / "balls.csv", racket, rows=96, friction=0.3, restitution=0.45)
    one = bouncing(real).model_copy(update={"collect": {"tables": "data/*.csv"}})
    return real.run_set(one, data.parent, data.parent / "out")


def test_a_known_truth_is_found_inside_its_interval_and_a_false_one_is_not(
    real: ModuleType, bounced: DiagnosisDocument
) -> None:
    restitution, friction = "restitution.restitution", "support_friction.friction"
    expected = bouncing(
        real,
        effects=["restitution", "support_friction"],
        absent=["drilling_friction"],
        known={restitution: RESTITUTION - 0.45, friction: FRICTION - 0.3},
        published={restitution: 0.3},
    ).expected
    judged = real.judge(bounced, expected)
    assert (judged.missed, judged.contradicted, judged.doubted) == ((), (), ())
    assert judged.known == (True, True)
    assert judged.published == (False,)
    assert judged.words == "names yes; 2 of 2 known values; 0 of 1 published values"
    assert "inside their intervals are 2 of 2 known values and 0 of 1 published" in real.total([judged])
    cells = real.row("balls", expected, (), bounced)
    assert "`restitution`" in cells[2] and "(-0.088)" in cells[3]
    assert len(real.table([cells]).splitlines()) == 3


def test_an_effect_that_does_not_act_or_was_not_named_is_no_success(
    real: ModuleType, bounced: DiagnosisDocument
) -> None:
    expected = bouncing(real, effects=["drilling_friction"], absent=["restitution"]).expected
    judged = real.judge(bounced, expected)
    assert judged.words == "wrong: restitution; missed: drilling_friction"
    assert real.total([judged]).startswith("1 sets: names as expected in 0, wrong names in 1")


def test_a_picture_shows_what_the_effects_explain(real: ModuleType, bounced: DiagnosisDocument, tmp_path: Path) -> None:
    """Measured over predicted velocities: those with the effects found lie nearer to the line, noise is left."""
    table = tmp_path / "balls.csv"
    ball_table(table, Racket(lambda _: RESTITUTION, FRICTION), rows=96, friction=0.3, restitution=0.45)
    model, found = real.tracks_of(table, bounced)
    off, left = (
        max(np.std(signal.measured - signal.predicted) for signal in track.curves if signal.unit == "m/s")
        for track in (model, found)
    )
    assert left < 0.7 * off
    png = real.draw((model, found), tmp_path / "real_balls.png").read_bytes()
    width, height = struct.unpack(">II", png[16:24])
    assert width > height > 300


def test_every_picture_of_the_page_is_one_that_the_board_draws(real: ModuleType) -> None:
    page = (Path(real.ROOT) / "docs" / "real_data.md").read_text(encoding="utf-8")
    drawn = {f"images/real_{name}.png" for name, one in real.sets().items() if one.picture}
    assert set(re.findall(r"images/[\w.]+", page)) == drawn


def test_every_set_is_a_row_of_the_page(real: ModuleType) -> None:
    page = (Path(real.ROOT) / "docs" / "real_data.md").read_text(encoding="utf-8")
    rows = {line.split("|")[1].strip(): line for line in page.splitlines() if line.startswith("| ")}
    for name, one in real.sets().items():
        assert not one.not_taken or f"not taken yet: {one.not_taken}" in rows[name], name
        assert one.not_taken or "not run" not in rows[name], name


def test_what_cannot_run_says_why(real: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="get the data with: git clone nowhere"):
        real.run_set(bouncing(real), tmp_path, tmp_path / "out")
    one = bouncing(real).model_copy(update={"collect": {}})
    with pytest.raises(InputError, match="impact-rs diagnose"):
        real.run_set(one, tmp_path, tmp_path / "out")


def test_every_set_is_whole(real: ModuleType) -> None:
    """Expected or not taken; steps for the one, a reason for the other; effects of the library, laws of the grammar."""
    effects = set(load_model(Path("nominal")).known_effects)
    effects |= {law.spec.name for law in laws_of(load_grammar(), {}, 7)}
    assert len(real.sets()) >= 8
    for name, one in real.sets().items():
        assert one.get.startswith("git clone https://"), name
        assert (one.expected is not None) == bool(one.steps) == (not one.not_taken), name
        if one.expected is not None:
            keys = [*one.expected.known, *one.expected.published, *one.shown]
            assert {*one.expected.effects, *one.expected.absent, *(key.split(".")[0] for key in keys)} <= effects, name
