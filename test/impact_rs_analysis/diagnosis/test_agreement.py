# SPDX-License-Identifier: Apache-2.0
"""Which readings agree: signals of trials are made wrong here, and what contradicts them leads back to the reading."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from impact_rs_analysis.diagnosis.agreement import (
    AgreementDocument,
    RelationDocument,
    agreement_of,
    joints_in_words,
    tracking_clusters,
)
from impact_rs_analysis.diagnosis.compare import ComparisonDocument, compare
from impact_rs_analysis.diagnosis.search.null_distribution import RotationNull
from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun, Runs, read_runs
from impact_rs_analysis.evidence.replays.replay_cache import ReplayCache
from impact_rs_analysis.evidence.sources.run_source import ReplaySource
from impact_rs_analysis.report.agreement_graph import agreement_graph
from impact_rs_analysis.report.comparison import write_comparison
from impact_rs_sim.model import load_model
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.runs import ArmSignals, Run

Fault = Callable[[ArmSignals], ArmSignals]


@pytest.fixture(scope="module")
def runs(hidden_campaign: Path) -> Runs:
    """Two objects and a free motion, twice each; the support is rougher than stated, which no joint feels."""
    return read_runs(hidden_campaign, map)


def source_of(runs: Runs, fault: Fault = lambda arm: arm, moved: Array | float = 0.0) -> ReplaySource:
    """The runs with other readings of the arm, and objects that move by ``moved`` [m/s] more after the impact."""

    def wrong(run: MeasuredRun) -> MeasuredRun:
        own, signals = {field.name: getattr(run, field.name) for field in dataclasses.fields(Run)}, run.signals
        since = np.maximum(signals.object_time - min(run.impacts.values(), default=np.inf), 0.0)
        position = signals.object_position + since[:, None] * moved
        arms = {name: fault(arm) for name, arm in signals.arms.items()}
        return MeasuredRun.of(Run(**own | {"signals": replace(signals, arms=arms, object_position=position)}))

    model = load_model("nominal")
    return ReplaySource.of(replace(runs, runs=tuple(map(wrong, runs.runs))), model, ReplayCache(map))


def changed(values: Array, joint: int, scale: float = 1.0, offset: float = 0.0) -> Array:
    found = values.copy()
    found[:, joint - 1] = scale * found[:, joint - 1] + offset
    return found


def filtered(values: Array, lag: float) -> Array:
    """T dy/dt + y = u in steps of 1 ms."""
    found = values.copy()
    for k in range(1, len(values)):
        found[k] = ((lag - 5e-4) * found[k - 1] + 5e-4 * (values[k] + values[k - 1])) / (lag + 5e-4)
    return found


def at(document: AgreementDocument, joint: str) -> dict[tuple[str, ...], tuple[str, ...]]:
    """Readings in common by the relations that do not hold at a joint."""
    return {one.relations: one.readings for one in document.in_common if joint in one.place.split(", ")}


def test_readings_that_are_right_agree(runs: Runs) -> None:
    """Kills a test without its discrepancy, and velocities that are compared with positions over another time."""
    document = agreement_of(source_of(runs))
    assert document.in_common == () and all(one.agrees for one in document.relations)
    assert document.names == (
        "motor torque balance",
        "link torque balance",
        "elastic deflection",
        "velocity of positions",
        "object and end effector",
    )
    assert list(document.by_joint) == [*(f"joint{joint}" for joint in range(1, 8)), "x", "y"]


@pytest.mark.parametrize(
    ("fault", "joint", "readings"),
    [
        (lambda arm: replace(arm, position=changed(arm.position, 2, offset=0.01)), "joint2", ("encoder",)),
        (lambda arm: replace(arm, torque=changed(arm.torque, 4, 1.07)), "joint4", ("torque sensor",)),
        (lambda arm: replace(arm, velocity=changed(arm.velocity, 4, 1.05)), "joint4", ("velocity",)),
        (lambda arm: replace(arm, velocity=filtered(arm.velocity, 0.013)), "joint6", ("velocity",)),
    ],
    ids=["encoder", "torque sensor", "velocity", "velocity filter"],
)
def test_what_does_not_agree_has_the_wrong_reading_in_common(
    runs: Runs, fault: Fault, joint: str, readings: tuple[str, ...]
) -> None:
    """Kills a relation that clears what it does not feel, and readings that are listed at the wrong relation."""
    found = at(agreement_of(source_of(runs, fault)), joint)
    (relations,) = found
    assert len(relations) > 1 and found[relations] == readings


def test_the_stiffness_explains_a_deflection_as_well_as_an_encoder_does(runs: Runs) -> None:
    """One relation alone names no culprit."""
    document = agreement_of(
        source_of(runs, lambda arm: replace(arm, motor_position=changed(arm.motor_position, 3, offset=0.002)))
    )
    (one,) = document.in_common
    assert one.in_words == (
        "joint3: the elastic deflection does not hold; possible causes: motor encoder or encoder or "
        "the physics (stiffness of the joint)"
    )


def test_an_object_that_outruns_its_pad_contradicts_the_tracker(runs: Runs) -> None:
    """50 mm/s along y, along which it does not move; kills a difference with the velocity of another axis."""
    document = agreement_of(source_of(runs, moved=np.array([0.0, 0.05, 0.0])))
    assert document.against("object and end effector") == ("y",)


def test_an_oblique_hit_shares_no_amplitude_of_the_discrepancy_with_a_square_one(runs: Runs) -> None:
    """It has other patterns, more of them. Kills: clusters of the tracker that share amplitudes by their features."""
    clusters = [item for item in source_of(runs).clusters if item.contact]
    oblique, *square = clusters
    more = np.vstack((oblique.discrepancy_factor, oblique.discrepancy_factor[:2]))
    own = tracking_clusters([replace(oblique, patterns=more, discrepancy_key=oblique.name), *square])
    assert [item.discrepancy_group for item in own] == [oblique.name, *(item.discrepancy_group for item in square)]
    repeated = [replace(item, residuals=np.vstack((item.residuals, item.residuals))) for item in own]
    p_value = RotationNull(repeated).lack_of_fit([item.mean for item in own])
    assert p_value is not None and 0.0 < p_value <= 1.0


def test_terminal_page_and_file_show_the_same(runs: Runs, tmp_path: Path) -> None:
    """Kills a line of the graph that ends at another relation."""
    document = compare(source_of(runs, lambda arm: replace(arm, position=changed(arm.position, 2, offset=0.01))))
    write_comparison(document, (), None, tmp_path)
    assert ComparisonDocument.model_validate_json((tmp_path / "compare.json").read_text()) == document
    page = (tmp_path / "compare.html").read_text()
    assert "in common: encoder" in page and 'class="agreement" role="img"' in page
    graph = agreement_graph(document.agreement)
    assert graph is not None
    heights = {node.name: node.y for node in (*graph.readings, *graph.relations)}
    ends = {(line.start, line.end): line.holds for line in graph.lines}
    assert ends[heights["encoder"], heights["elastic deflection"]] is False
    assert ends[heights["encoder"], heights["velocity of positions"]] is True
    assert (heights["command"], heights["elastic deflection"]) not in ends
    assert {node.name: node.against for node in graph.readings if node.against} == {
        "encoder": "joint2, x",
        "tracker": "x",
    }


@pytest.mark.parametrize(
    ("places", "words"),
    [
        (["joint2", "joint3", "joint4", "joint7"], "joints 2 to 4, 7"),
        (["joint1", "joint2"], "joints 1, 2"),
        (["joint5"], "joint5"),
        (["joint6", "x"], "joint6, x"),
        ([], ""),
    ],
)
def test_joints_in_a_row_are_a_range(places: list[str], words: str) -> None:
    """Kills a range of two, and a joint that an axis hides."""
    assert joints_in_words(places) == words


def test_no_relation_was_measured() -> None:
    assert agreement_graph(AgreementDocument()) is None
    assert (
        RelationDocument(
            relation="elastic deflection", place="joint1", readings=("encoder",), times_noise=1.0, agrees=True
        ).assumes
        == ""
    )
