# SPDX-License-Identifier: Apache-2.0
"""Laws of the grammar have the right units, dissipate where they should, and are read from YAML."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from impact_rs_analysis.diagnosis.document import DiagnosisDocument, EffectDocument, EstimateDocument
from impact_rs_analysis.diagnosis.laws import discover
from impact_rs_analysis.diagnosis.laws.discover import _tie
from impact_rs_analysis.diagnosis.laws.grammar import Law, curve_of, laws_of, load_grammar, unit_of
from impact_rs_analysis.diagnosis.search.null_distribution import p_value_with_pareto_tail
from impact_rs_sim.effects import Parameter
from impact_rs_sim.effects.dimensions import check_units
from impact_rs_sim.effects.formula import SYMBOLS, Formula, FormulaEffect
from impact_rs_sim.errors import InputError
from impact_rs_sim.memory import Memory

RANGES = {"dq4": (-0.6, 0.8), "q4": (-2.4, -1.6), "object_speed": (0.0, 0.5)}
SHIPPED = list(laws_of(load_grammar(), RANGES, 7))
RIGHT = {"joint_torque": "N m", "motor_torque": "N m", "contact": "-"}


def law(name: str) -> Law:
    return next(one for one in SHIPPED if one.spec.name == name)


def values(one: Law, amplitude: float, rng: np.random.Generator) -> dict[str, float]:
    """A random state with all amplitudes of a law."""
    state = {name: float(rng.uniform(-1.0, 1.0)) for name in SYMBOLS}
    state |= {f"{name}{joint}": float(rng.uniform(-1.0, 1.0)) for name in ("q", "dq", "tau") for joint in range(1, 8)}
    for body in ("", "object_"):
        state[f"{body}speed"] = float(np.linalg.norm([state[f"{body}v{axis}"] for axis in "xyz"]))
    for name in ("t", "normal_force", "penetration", "slip", "since_contact", "support_force", "support_slip"):
        state[name] = abs(state[name])
    numbers = {
        name: amplitude if not parameter.shape else one.starts[0][name]
        for name, parameter in one.spec.parameters.items()
    }
    return {**state, **numbers}


def evaluated(table: Mapping[str, str], state: dict[str, float]) -> dict[str, float]:
    return {key: Formula(text, state)(state, Memory()) for key, text in table.items()}


def test_every_law_has_the_unit_of_its_place_and_a_name_of_its_own() -> None:
    assert len({one.spec.name for one in SHIPPED}) == len(SHIPPED) > 200
    for one in SHIPPED:
        for place, unit in check_units(one.spec).items():
            assert unit in ("", RIGHT.get(place.partition(".")[0], "N")), one.spec.name


def test_amplitudes_of_a_law_have_room_and_those_of_a_formula_of_the_user_keep_their_range() -> None:
    """Also those of a stop, whose amplitude times the position would be a hundred times what is noticed."""
    law = next(one for one in SHIPPED if one.spec.name == "motor4_position_above")
    (effect, *_), own = law.effects, FormulaEffect(law.spec)
    wider, same = effect.with_parameters(Parameter.widened), own.with_parameters(Parameter.widened)
    amplitude, limit = effect.parameters
    assert [(p.lower, p.upper) for p in wider.parameters] == [(0.0, 2.0 * amplitude.upper), (limit.lower, limit.upper)]
    assert same is own


@pytest.mark.parametrize("seed", range(20))
def test_laws_of_a_velocity_take_energy_out(seed: int) -> None:
    """Torques times joint velocities, force times velocity: never positive, for any state and amplitude."""
    rng, seen = np.random.default_rng(seed), 0
    for one in SHIPPED:
        if not one.quantity.opposes or one.spec.contact_tangential or one.spec.support_tangential:
            continue
        assert all(parameter.shape or parameter.lower == 0.0 for parameter in one.spec.parameters.values())
        state, seen = values(one, 1.0, rng), seen + 1
        for table in (one.spec.motor_torque, one.spec.joint_torque):
            torques = evaluated(table, state).items()
            assert sum(torque * state[f"dq{joint.removeprefix('joint')}"] for joint, torque in torques) <= 0.0, one
        for table, body in ((one.spec.end_effector_force, ""), (one.spec.object_force, "object_")):
            power = sum(force * state[f"{body}v{axis}"] for axis, force in evaluated(table, state).items())
            assert power <= 0.0, one.spec.name
    assert seen > 50


@pytest.mark.parametrize("seed", range(5))
def test_laws_with_memory_take_energy_out_of_a_motion_from_rest(seed: int) -> None:
    """A spring inside may give back what it took and no more: a Maxwell element and friction of Dahl are passive."""
    rng, time, seen = np.random.default_rng(seed), np.arange(0.0, 8.0, 1e-3), 0
    tones = rng.uniform(1.0, 20.0, 4)[:, None]
    velocity = rng.uniform(-1.0, 1.0, 4) @ np.sin(tones * time)
    for one in SHIPPED:
        text = one.spec.motor_torque.get("joint4", one.spec.joint_torque.get("joint4", ""))
        if "lag(" not in text or not one.quantity.opposes:
            continue
        seen += 1
        for start in one.starts:
            values = {"t": time, "dq4": velocity, "c": 1.0, **start}
            work = np.cumsum(Formula(text, values)(values) * velocity) * 1e-3
            assert work.max() < 1e-3 and work[-1] < -0.01, one.spec.name
    assert seen == 3


def test_friction_at_a_surface_opposes_sliding() -> None:
    rng = np.random.default_rng(0)
    for one in SHIPPED:
        for text in filter(None, (one.spec.contact_tangential, one.spec.support_tangential)):
            state = values(one, 1.0, rng)
            assert Formula(text, state)(state) >= 0.0
            assert all(parameter.shape or parameter.lower == 0.0 for parameter in one.spec.parameters.values())


@pytest.mark.parametrize("body", ["", "object_"])
def test_a_cable_pulls_towards_its_end_beyond_its_length_alone(body: str) -> None:
    one = law(f"{body or 'end_effector_'}cable_above")
    end, away = np.array([0.3, -0.2, 0.5]), np.array([0.6, 0.0, 0.8])
    numbers = {"c": 30.0, "start": 0.4, **{f"anchor_{axis}": value for axis, value in zip("xyz", end, strict=True)}}
    for distance, pull in ((0.3, 0.0), (0.4, 0.0), (0.5, 3.0), (0.9, 15.0)):
        place = {f"{body}{axis}": value for axis, value in zip("xyz", end + distance * away, strict=True)}
        force = evaluated(one.formula[1], {**place, **numbers})
        assert list(force.values()) == pytest.approx(list(-pull * away))


def test_a_form_is_what_it_says() -> None:
    """Closed forms of some laws, and the units of their amplitudes."""
    cube, drag, cable = law("motor4_velocity_cube"), law("object_drag_square"), law("end_effector_y_y_above")
    assert cube.spec.motor_torque == {"joint4": "-(c * dq4 ** 3)"}
    assert cube.spec.parameters["c"].unit == "N m s^3/rad^3"
    assert cube.spec.parameters["c"].scale == pytest.approx(0.1 / 0.8**3)
    state = {"object_speed": 0.5, "object_vx": 0.3, "object_vy": -0.4, "object_vz": 0.0, "c": 8.0}
    np.testing.assert_allclose(list(evaluated(drag.spec.object_force, state).values()), [-1.2, 1.6, 0.0])
    assert evaluated(cable.spec.end_effector_force, {"y": 0.6, "start": 0.5, "c": 30.0}) == pytest.approx({"y": -3.0})
    np.testing.assert_allclose(drag.force(np.array([0.0, 0.5]), {"c": 8.0}), [0.0, 2.0])


def test_fits_of_a_ripple_start_a_quarter_of_a_turn_apart_over_the_range() -> None:
    starts = [start["k"] for start in law("motor4_position_ripple").starts]
    assert np.diff(starts) == pytest.approx(2.5 / 0.8)
    assert [effect.parameters[-1].nominal for effect in law("motor4_position_ripple").effects] == starts


@pytest.mark.parametrize("share", [1e-4, 1e-2, 1.0, 30.0])
def test_fits_of_shapes_start_within_their_bounds_however_little_was_moved(share: float) -> None:
    """A pad that gives by 4 mm has ripples of 694 radians a metre."""
    ranges = {name: (share * low, share * high) for name, (low, high) in RANGES.items()}
    for one in laws_of(load_grammar(), ranges, 7):
        for effect in one.effects:
            for parameter in effect.parameters:
                assert parameter.lower <= parameter.nominal <= parameter.upper, (one.name, parameter)


@pytest.mark.parametrize(
    ("place", "quantity", "power", "unit"),
    [
        ("N m", "rad/s", 3, "N m s^3/rad^3"),
        ("N", "m/s", 2, "N s^2/m^2"),
        ("N m", "N m", 1, "-"),
        ("-", "rad", 1, "1/rad"),
        ("N", "s", 0, "N"),
    ],
)
def test_the_unit_of_an_amplitude_follows_from_place_and_quantity(
    place: str, quantity: str, power: int, unit: str
) -> None:
    assert unit_of(place, quantity, power) == unit


def test_a_tie_with_a_law_that_was_not_kept_is_still_said() -> None:
    """Its estimate is not in the diagnosis, so no place is named at which the two differ."""
    laws, diagnosis = {one.spec.name: one for one in SHIPPED}, DiagnosisDocument.model_construct(effects=())
    said = _tie(diagnosis, law("motor4_velocity_cube"), ["motor4_velocity_square"], RANGES, laws)
    assert said.endswith(
        "motor4_velocity_square cannot be distinguished: in these measurements they are nearly the same."
    )


@pytest.mark.parametrize("count", [5, 9])
def test_a_curve_has_its_values_at_its_knots_and_is_straight_between_them(count: int) -> None:
    """Beside an offset it is 0 at the knot nearest to 0; beyond two knots it is 0."""
    low, high = RANGES["q4"]
    for absolute in (True, False):
        curve = curve_of(law("motor4_position_cube"), RANGES["q4"], count, absolute)
        assert len(curve.knots) == len(curve.spec.parameters) == count - (not absolute)
        values = {f"f{n}": float(n + 1) for n in range(len(curve.knots))}
        np.testing.assert_allclose(curve.force(np.array(curve.knots), values), list(values.values()), rtol=1e-3)
        half = np.array(curve.knots[:2]).mean(keepdims=True)
        np.testing.assert_allclose(curve.force(half, values), 1.5, rtol=1e-3)
        assert curve.force(np.array([low - (high - low)]), values) == 0.0
        assert curve.spec.valid == {"q4": RANGES["q4"]}


def test_a_user_adds_terms_in_yaml(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(
        """
quantities: {height: {formula: object_z, unit: m, typical: 0.1, words: its height}}
forms: {quartic: {law: c * u ** 4, numbers: {c: {power: 4}}, words: with the fourth power of}}
places: {lift: {formula: object_force, each: axis, unit: N, noticeable: 1, words: Lift along, contact: true,
                laws: {height: [quartic, linear]}}}
"""
    )
    grammar = load_grammar(file)
    own = {one.spec.name: one for one in laws_of(grammar, {}, 7)}
    assert own["lift_z_height_quartic"].spec.parameters["c"].unit == "N/m^4"
    assert len(own) == len(SHIPPED) + 6
    file.write_text(
        "places: {lift: {formula: object_force, unit: N, noticeable: 1, words: Lift, laws: {hight: [linear]}}}"
    )
    with pytest.raises(InputError, match="unknown quantity"):
        load_grammar(file)


@pytest.mark.parametrize(("freedom", "quantile"), [(1, 1e-5), (3, 1e-6)])
def test_a_p_value_beyond_all_draws_is_that_of_the_tail(freedom: int, quantile: float) -> None:
    """Of chi squared, to a factor of four with 4999 draws; the plain count stops at 2e-4."""
    import scipy

    found = []
    for seed in range(20):
        null = np.random.default_rng(seed).chisquare(freedom, 4999)
        found.append(p_value_with_pareto_tail(float(scipy.stats.chi2.isf(quantile, freedom)), null))
    assert quantile / 4.0 < np.exp(np.mean(np.log(found))) < 4.0 * quantile


def fitted_laws(**numbers: Mapping[str, float]) -> DiagnosisDocument:
    """A diagnosis with estimates of some laws."""
    effects = tuple(
        EffectDocument.model_construct(
            name=name,
            parameters={key: EstimateDocument.model_construct(estimate=value) for key, value in values.items()},
        )
        for name, values in numbers.items()
    )
    return DiagnosisDocument.model_construct(effects=effects)


def test_laws_of_the_same_torque_have_no_value_that_separates_them() -> None:
    """Kills: profiles before their signs, which are opposite if one law opposes its quantity."""
    domain = {"q4": (0.5, 1.0)}
    laws = {one.spec.name: one for one in laws_of(load_grammar(), domain, 7)}
    above, linear = "motor4_position_above", "motor4_position_linear"
    assert laws[above].opposes and not laws[linear].opposes
    diagnosis = fitted_laws(**{above: {"c": 1.0, "start": 0.0}, linear: {"c": -1.0}})
    assert "measure at" not in _tie(diagnosis, laws[above], [linear], domain, laws)
    opposite = fitted_laws(**{above: {"c": 1.0, "start": 0.0}, linear: {"c": 1.0}})
    assert "measure at 1 rad" in _tie(opposite, laws[above], [linear], domain, laws)


@pytest.mark.parametrize(("found", "text"), [((-2.2, -4.1), "at -4.1 rad"), ((2.2, 4.1), "at 4.1 rad")])
def test_the_value_that_separates_all_tied_laws_is_the_farthest(
    found: Sequence[float], text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kills: the largest of negative values, which separates the first rival only."""
    values, names = iter(found), ("motor4_position_linear", "motor4_position_cube")
    monkeypatch.setattr(discover, "_separating_value", lambda *_: next(values))
    laws = {one.spec.name: one for one in SHIPPED}
    assert text in _tie(fitted_laws(**dict.fromkeys(names, {})), law("motor4_position_above"), names, RANGES, laws)
