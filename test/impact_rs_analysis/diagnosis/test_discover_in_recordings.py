# SPDX-License-Identifier: Apache-2.0
"""Laws and curves that are planted in recordings of free motion are found, become models, and say where they end.

Torques are those of Pinocchio's recursive algorithm with friction and a law in plain NumPy; the search predicts them
by regressors and formulas.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
import scipy
from intervals import assert_covers
from joint_recordings import write_npz
from slender_arm import ARM, UPRIGHT, mapping_of, slender_arm, swung, with_effects
from slender_arm import RATE as SAMPLED

from impact_rs_analysis.diagnosis.compare import ComparisonDocument, compare
from impact_rs_analysis.diagnosis.laws.discover import discover
from impact_rs_analysis.diagnosis.laws.discovery_document import (
    DESCRIBED,
    FOUND,
    LIBRARY,
    NO_LAW,
    DiscoveryDocument,
    write_discovery,
)
from impact_rs_analysis.diagnosis.laws.grammar import load_grammar
from impact_rs_analysis.diagnosis.verdict import DiagnosisVerdict, Kind
from impact_rs_analysis.evidence.sources.recording_source import RecordingSource
from impact_rs_cli.main import main
from impact_rs_sim.model import Model, ModelEffect, ParameterValue, load_model, save_model
from impact_rs_trials.recordings.mapping import Mapping
from impact_rs_trials.recordings.recording import read_recordings

NOISE = 0.02  # N m
COULOMB = (0.6, 0.4)  # N m
LIBRARY_EFFECTS = ["joint_coulomb_friction", "joint_viscous_friction", "torque_offset"]
Torque = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]

RIPPLE, RATE = 0.4, 5.0  # N m, 1/rad
OF_LOAD = 0.06  # of the transmitted torque
ANCHOR, LENGTH, PULL = np.array([0.9, 0.0, 0.9]), 0.7, 20.0  # m, m, N/m
STEP, AT, WIDTH = 0.5, 0.15, 0.08  # N m, rad, rad
DAMPER, RELAXATION = 1.0, 0.14  # N m s/rad, s
SLIDING, BREAKAWAY = 0.6, 0.04  # N m, rad
FADING, WARMING = 0.6, 3.0  # N m s/rad, s
ECCENTRIC = 0.4  # N m/rad
SHAFT = 0.7  # N m s/rad


def ripple(q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
    return -RIPPLE * np.sin(RATE * q)


def friction_of_load(q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
    return OF_LOAD * np.abs(tau) * np.tanh(dq / 0.02)


def step(q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """A cable that tips over: no form of the grammar has a step away from 0."""
    return -STEP * np.tanh((q - AT) / WIDTH)


def integrated(rate: Callable[[float, float], float], dq: np.ndarray) -> np.ndarray:
    """A force from 0 with a rate that depends on velocity and force, by SciPy's Runge-Kutta method."""
    time = np.arange(dq.size) / SAMPLED
    velocity = scipy.interpolate.CubicSpline(time, dq)
    way = scipy.integrate.solve_ivp(
        lambda t, f: rate(velocity(t), f), (0.0, time[-1]), [0.0], t_eval=time, max_step=0.01, rtol=1e-8
    )
    return np.asarray(way.y[0])


def maxwell(q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """A spring of DAMPER / RELAXATION in series with a damper."""
    return integrated(lambda v, f: (DAMPER * v - f) / RELAXATION, dq)


def dahl(q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Friction that begins elastically (Dahl 1968): loading and unloading differ, at any speed."""
    return integrated(lambda v, f: (SLIDING * v - np.abs(v) * f) / BREAKAWAY, dq)


def fading(q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Friction that falls as the joint warms up."""
    warmth = integrated(lambda v, w: (np.abs(v) - w) / WARMING, dq)
    return -FADING * warmth * np.tanh(dq / 0.02)


def eccentric(q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Friction that depends on the position."""
    return ECCENTRIC * q * np.tanh(dq / 0.02)


def driven(q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """A Maxwell element of the wrong sign, which gives more than it takes."""
    return -maxwell(q, dq, tau)


def from_outside(q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """What no state of the arm tells: somebody pushes now and then."""
    return 0.8 * np.sin(2.0 * np.pi * 0.83 * np.arange(q.size) / SAMPLED)


def nothing(q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
    return np.zeros_like(q)


def recorded(folder: Path, law: Torque) -> tuple[Path, Mapping]:
    """A pendulum of two joints, both with friction, the second with a law."""
    mapping = mapping_of(folder, slender_arm(("revolute",) * 2, UPRIGHT))
    columns = swung(mapping, {}, NOISE)
    clean = swung(mapping, {}, 0.0)["effort"]
    columns["effort"] += np.array(COULOMB) * np.tanh(columns["velocity"] / 0.005)
    columns["effort"][:, 1] += law(columns["position"][:, 1], columns["velocity"][:, 1], clean[:, 1])
    return write_npz(folder / "run.npz", columns), mapping


def recorded_with_cable(folder: Path) -> tuple[Path, Mapping]:
    """The same pendulum, its end tied to a point by a cable that is taut two thirds of the time."""
    mapping = mapping_of(folder, slender_arm(("revolute",) * 2, UPRIGHT))
    columns, model = swung(mapping, {}, NOISE), with_effects(mapping, {}).robot_model(ARM)
    for row, q in enumerate(columns["position"]):
        away = model.placement(q).translation - ANCHOR
        distance = np.linalg.norm(away)
        force = -PULL * max(distance - LENGTH, 0.0) * away / distance
        columns["effort"][row] -= model.jacobian(q)[:3].T @ force
    return write_npz(folder / "run.npz", columns), mapping


def recorded_with_shaft(folder: Path) -> tuple[Path, Mapping]:
    """The same pendulum with a damped shaft that turns with the difference of both joints."""
    path, mapping = recorded(folder, nothing)
    columns = dict(np.load(path))
    torque = SHAFT * (columns["velocity"] @ [1.0, -1.0])
    columns["effort"] += torque[:, None] * [1.0, -1.0]
    return write_npz(folder / "run.npz", columns), mapping


def found_in(
    folder: Path, law: Torque, model: Model | None = None, effects: Sequence[str] = LIBRARY_EFFECTS
) -> DiscoveryDocument:
    path, mapping = recorded(folder, law)
    recordings, grammar = read_recordings(path, mapping), load_grammar()
    return discover(
        lambda changed: RecordingSource.of(recordings, mapping, changed),
        model or load_model("nominal"),
        grammar.model_copy(update={"places": {"motor": grammar.places["motor"]}}),
        effects,
    )


def with_friction(file: Path) -> Path:
    """A model that has the friction already, as after a diagnosis."""
    values = {f"coulomb_joint{n}": ParameterValue(estimate=value, unit="N m") for n, value in enumerate(COULOMB, 1)}
    item = ModelEffect(name="joint_coulomb_friction", parameters=values)
    save_model(Model(name=file.stem, effects=(item,)), file)
    return file


@pytest.mark.slow
def test_a_ripple_is_found_with_amplitude_and_wave_number(tmp_path: Path) -> None:
    document = found_in(tmp_path, ripple)
    assert document.verdict == FOUND
    law = document.laws[0]
    assert law.name == "motor2_position_ripple" and not law.curved
    numbers = {name: value.estimate for name, value in law.parameters.items()}
    assert np.hypot(numbers["a"], numbers["b"]) == pytest.approx(RIPPLE, rel=0.05)
    assert_covers(law.parameters["k"].ci95, RATE, 0.015)
    assert law.held_out_error_after < 0.2 * law.held_out_error_before


@pytest.mark.slow
def test_what_no_law_explains_is_left_and_the_library_does_not_explain_it(tmp_path: Path) -> None:
    """Friction is named and 0.6 N m stay, thirty times the noise."""
    document = found_in(tmp_path, from_outside)
    assert document.verdict == NO_LAW
    assert "joint_coulomb_friction" in document.diagnosis.named
    assert document.diagnosis.verdict == DiagnosisVerdict(Kind.PARTLY, document.diagnosis.named)
    assert "joint_coulomb_friction" in document.summary and "at least one more" in document.summary
    assert document.diagnosis.unexplained.where[0].value > 0.3


@pytest.mark.slow
def test_friction_of_the_load_is_found_alone(tmp_path: Path) -> None:
    """Its coefficient lies in its interval; the recorded torque, with friction and noise in it, would leave a rest."""
    document = found_in(tmp_path, friction_of_load)
    assert (document.verdict, document.laws[0].name) == (FOUND, "motor2_load_on_friction_linear")
    assert_covers(document.laws[0].parameters["c"].ci95, OF_LOAD, 0.25 * OF_LOAD)
    assert document.diagnosis.named == ("joint_coulomb_friction", "motor2_load_on_friction_linear")


def test_a_cable_to_a_point_is_found_with_its_end_and_its_length(tmp_path: Path) -> None:
    """The arm moves in a plane: how far across it the end lies is not determined, nor, by that, its length."""
    path, mapping = recorded_with_cable(tmp_path)
    recordings, grammar = read_recordings(path, mapping), load_grammar()
    places = {name: grammar.places[name] for name in ("end_effector_cable", "end_effector_drag")}
    document = discover(
        lambda changed: RecordingSource.of(recordings, mapping, changed),
        load_model("nominal"),
        grammar.model_copy(update={"places": places}),
        ["joint_coulomb_friction"],
    )
    law = document.laws[0]
    assert (document.verdict, law.name) == (FOUND, "end_effector_cable_above")
    assert law.formula == ("-(c * max(|(x, y, z) - anchor| - start, 0) / |(x, y, z) - anchor|) * ((x, y, z) - anchor)")
    assert law.parameters["c"].estimate == pytest.approx(PULL, rel=0.05)
    assert law.parameters["anchor_x"].estimate == pytest.approx(ANCHOR[0], abs=0.05)
    # The valley of the error is curved: an end of an interval lies along it, and the truth between them.
    truth = dict(zip(("c", "start", "anchor_x", "anchor_y", "anchor_z"), (PULL, LENGTH, *ANCHOR), strict=True))
    for name, value in law.parameters.items():
        assert value.ci95 is not None and value.ci95[0] <= truth[name] <= value.ci95[1], name
    low, high = law.parameters["start"].ci95
    assert high - low < 0.25
    assert law.held_out_error_after < 0.1 * law.held_out_error_before


@pytest.mark.slow
def test_a_shaft_that_two_joints_share_is_found_with_its_damping(tmp_path: Path) -> None:
    """As in coupled wrists and parallelograms; the power that it takes is c (dq1 - dq2)^2."""
    name = "motors_opposed1_2_velocity_difference_linear"
    path, mapping = recorded_with_shaft(tmp_path)
    recordings, grammar = read_recordings(path, mapping), load_grammar()
    places = {name: grammar.places[name] for name in ("motor", "motors", "motors_opposed")}
    document = discover(
        lambda changed: RecordingSource.of(recordings, mapping, changed),
        load_model("nominal"),
        grammar.model_copy(update={"places": places}),
        LIBRARY_EFFECTS,
    )
    assert document.diagnosis is not None
    assert (document.verdict, document.diagnosis.named) == (FOUND, ("joint_coulomb_friction", name))
    law = document.laws[0]
    assert law.place == "torque on motors 1 and 2"
    assert_covers(law.parameters["c"].ci95, SHAFT, 0.03 * SHAFT)
    assert law.held_out_error_after < 0.2 * law.held_out_error_before
    # The free curve over the velocity of the shaft, beside friction of both joints.
    assert law.valid is not None and law.valid.quantity == "dq1 - dq2"
    assert law.valid.low < -0.5 and law.valid.high > 0.5
    assert law.curve is not None and len(law.curve.points) >= 3
    inside = [point.ci95[0] <= -SHAFT * point.at <= point.ci95[1] for point in law.curve.points]
    assert sum(inside) >= len(inside) - 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "name", "numbers", "width"),
    [
        (maxwell, "motor2_relaxing_velocity_linear", {"c": DAMPER, "relaxation": RELAXATION}, 0.025),
        (dahl, "motor2_presliding_linear", {"c": SLIDING, "breakaway": BREAKAWAY}, 0.018),
        (fading, "motor2_recent_motion_linear", {"c": FADING, "warming": WARMING}, 0.2),
        (eccentric, "motor2_position_while_moving_linear", {"c": -ECCENTRIC}, 0.03),
    ],
)
def test_a_law_with_memory_or_of_a_product_is_found_alone_with_its_numbers(
    tmp_path: Path, law: Torque, name: str, numbers: dict[str, float], width: float
) -> None:
    """Truths are integrated by another method, and none of them is a start of the fits."""
    document = found_in(tmp_path, law)
    assert (document.verdict, document.laws[0].name) == (FOUND, name)
    assert document.diagnosis.named == ("joint_coulomb_friction", name)
    for key, truth in numbers.items():
        assert_covers(document.laws[0].parameters[key].ci95, truth, width * abs(truth))
    assert document.laws[0].held_out_error_after < 0.5 * document.laws[0].held_out_error_before


@pytest.mark.slow
def test_a_maxwell_element_of_the_wrong_sign_is_none(tmp_path: Path) -> None:
    """Such a force is close to one of position and velocity at the speeds of the motion: curves may describe it."""
    document = found_in(tmp_path, driven)
    assert "motor2_relaxing_velocity_linear" not in document.diagnosis.named
    assert document.verdict in (DESCRIBED, NO_LAW)
    assert document.diagnosis.held_out_error_after > 1.2 * NOISE


def test_nothing_is_proposed_where_only_friction_acts(tmp_path: Path) -> None:
    document = found_in(tmp_path, nothing)
    assert (document.verdict, document.laws) == (LIBRARY, ())


@pytest.fixture(scope="module")
def stepped(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, DiscoveryDocument]:
    folder = tmp_path_factory.mktemp("stepped")
    model = load_model(with_friction(folder / "friction.yaml"))
    return folder, found_in(folder, step, model, ["joint_viscous_friction"])


def test_what_no_form_explains_is_a_curve_within_its_band(stepped: tuple[Path, DiscoveryDocument]) -> None:
    """Up to the straight pieces between its knots."""
    document = stepped[1]
    assert document.verdict == DESCRIBED
    law = document.laws[0]
    assert law.name == "motor2_position_curve_9" and law.curved and law.curve is not None
    assert law.held_out_error_after < 0.3 * law.held_out_error_before
    at, said = np.array(law.curve.at), np.array(law.curve.law)
    off = said - STEP * np.tanh((at - AT) / WIDTH)
    assert np.sqrt(np.mean(np.square(off))) < 0.12 * STEP
    assert law.valid is not None and (law.valid.low, law.valid.high) == pytest.approx((-0.74, 0.74), abs=0.05)


@pytest.mark.slow
def test_a_curve_becomes_part_of_a_model_that_says_where_it_ends(
    stepped: tuple[Path, DiscoveryDocument], tmp_path: Path
) -> None:
    folder, document = stepped
    file, child, parent = tmp_path / "discovery.json", tmp_path / "model_2.yaml", folder / "friction.yaml"
    write_discovery(document, file)
    name = document.laws[0].name
    assert main(["add", name, "--model", str(parent), "--from", str(file), "-o", str(child)]) == 0
    mapping = mapping_of(folder, slender_arm(("revolute",) * 2, UPRIGHT))
    recordings = read_recordings(folder / "run.npz", mapping)

    def compared(model: Model) -> ComparisonDocument:
        return compare(RecordingSource.of(recordings, mapping, model))

    model = load_model(child)
    before, after = compared(load_model(parent)), compared(model)
    assert after.score < 0.3 * before.score
    assert not [remark for remark in after.remarks if "was seen for" in remark]
    narrow = model.formulas[-1].model_copy(update={"valid": {"q2": (-0.3, 0.3)}})
    beyond = compared(model.model_copy(update={"formulas": (narrow,)})).remarks
    (said,) = [remark for remark in beyond if "was seen for" in remark]
    assert said.startswith(f"{name} was seen for q2 from -0.3 to 0.3, and these measurements reach from -0.7")
