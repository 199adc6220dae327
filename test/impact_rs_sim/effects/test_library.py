# SPDX-License-Identifier: Apache-2.0
"""Effects: nothing at their nominal values, their own signature otherwise, and found again by a fit."""

import dataclasses
import pickle
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun
from impact_rs_analysis.evidence.replays.replay_cache import Replay, run_replay
from impact_rs_analysis.evidence.replays.simulated_trials import simulated
from impact_rs_sim import effects
from impact_rs_sim.effects import BUILT_IN, ArmEffect, Effect, Parameter, library
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_sim.physics import JointFriction, Physics
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.spec import TrialSpec

NAMES = [effect.name for effect in BUILT_IN]


def simulated_run(scenario, thing, case):
    spec = TrialSpec.of(load_scenario(scenario), thing, case)
    return MeasuredRun.of(simulated(spec, spec.scene.physics, "bullet"))


@pytest.fixture(scope="module")
def runs():
    return {
        "free": simulated_run("excite", "none", "fast"),
        "contact": simulated_run("push", "juice", "case_2"),
        "neighbour": simulated_run("push_two_boxes", "box", "case_2"),
    }


@pytest.fixture(scope="module")
def nominal_features(runs):
    return {kind: run_replay(Replay(run.setup, Model(name="nominal"))) for kind, run in runs.items()}


def unlike(before, after, path=""):
    """Where two descriptions differ, bit by bit."""
    if dataclasses.is_dataclass(before):
        pairs = [
            (getattr(before, f.name), getattr(after, f.name), f"{path}.{f.name}") for f in dataclasses.fields(before)
        ]
    elif isinstance(before, (dict, tuple)):
        if len(before) != len(after):
            return [path]
        keys = before if isinstance(before, dict) else range(len(before))
        pairs = [(before[key], after[key], f"{path}[{key}]") for key in keys]
    else:
        return [] if np.array_equal(np.asarray(before), np.asarray(after)) else [path]
    return [place for one, other, where in pairs for place in unlike(one, other, where)]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("scenario", ["push", "grab"])
def test_effect_at_its_nominal_values_changes_nothing_at_all(name, scenario):
    loaded = load_scenario(scenario)
    physics = Physics.nominal(loaded, next(iter(loaded.objects)))
    friction = JointFriction(np.full(7, 0.2), np.full(7, 0.1), np.full(7, 0.3), np.full(7, 0.08))
    physics = replace(physics, arms={key: replace(arm, friction=friction) for key, arm in physics.arms.items()})
    effect = library()[name]
    assert unlike(physics, effect.apply_vector(physics, effect.nominal(7))) == []


CHANGED = {  # what of the physics, or of an arm, an effect is on
    "friction": (
        "joint_reversal_width",
        *(name for name in NAMES if name.endswith("_friction") and "joint" in name),
    ),
    "motor_inertia_reduced": ("motor_inertia_scale", "added_motor_inertia", "stiff_control"),
    "facts": ("link_mass", "link_com", "link_inertia"),
    "contact_laws": (
        "restitution_fall",
        "contact_dissipation",
        "restitution_threshold",
        "tangential_restitution",
        "drilling_friction",
    ),
    "end_effector": ("end_effector_payload", "pad_tilt", "pad_position"),
    "object": ("object_mass", "object_com_offset"),
    "neighbours": ("neighbour_mass",),
    "damping stiffness": ("joint_elasticity",),
    "stiffness": ("joint_stiffness",),
    "bounce pad_damping": ("restitution",),
    "pad_stiffness": ("pad_compliance",),
    "pad_shear_compliance": ("pad_shear",),
    "rolling_arm": ("rolling_resistance",),
    "gravity": ("base_tilt",),
    "loads": ("external_spring",),
    "twist_readings": ("spin_axes", "mirrored_spins", "twist_axes", "tracked_point_of_impact"),
    "tracker": ("tracker_frame", "tracked_point", "tracker_delay", "tracker_lag", "tracker_butterworth"),
    "readings": tuple(
        name for name, effect in library().items() if effect.acts_on == "sensing" and isinstance(effect, ArmEffect)
    ),
}  # others: what is called as they are


@pytest.mark.parametrize("name", NAMES)
def test_effect_away_from_its_nominal_values_changes_what_it_acts_on_and_nothing_else(name, physics):
    """Kills a law that writes to the field of another effect; in motion most are seen alike in some way."""
    effect = library()[name]
    if effect.acts_on == "neighbour":
        physics = Physics.nominal(load_scenario("push_two_boxes"), "box")
    found = unlike(physics, effect.apply_vector(physics, effect.nominal(7) + effect.steps(7, effect.nominal(7))))
    places = {re.sub(r"^\.arms\[\w+\]", "", place).split(".")[1].split("[")[0] for place in found}
    assert " ".join(sorted(places)) == next((key for key, names in CHANGED.items() if name in names), name)


@pytest.mark.parametrize("name", NAMES)
def test_effect_says_what_it_is_in_words_units_and_bounds(name):
    effect = library()[name]
    assert effect.sentence.endswith(".") and effect.acts_on
    for scalar in effect.scalars(7):
        assert scalar.lower <= scalar.nominal <= scalar.upper
        assert scalar.scale > 0.0 and scalar.unit and scalar.meaning


# A drift is seen from run to run, and not in one; boxes that are pushed squarely do not slide along each other.
UNSEEN = ("torque_sensor_drift", "object_friction")


@pytest.mark.parametrize("name", [name for name in effects.of_trials() if name not in UNSEEN])
def test_planted_effect_is_recovered_through_the_replay(name, runs, nominal_features):
    """A size is planted along a direction; the features of the replay lead back to it."""
    effect: Effect = library()[name]
    kind = "contact" if effect.phases == ("contact",) else "free"
    kind = "neighbour" if effect.acts_on == "neighbour" else kind
    direction = np.array([scalar.scale for scalar in effect.scalars(7)])
    if name == "joint_stribeck_friction":
        direction[-1] = 0.0
    if name == "end_effector_payload":
        direction[1:] = 0.0
    if name == "tracked_point":
        direction *= 5.0  # 2 mm turn the path of the object by less than the limits
    if name == "pad_friction":
        direction[:] = -0.2  # more friction on a pad that sticks anyway cannot be seen; less makes it slide
    floor = np.array([feature.relevance_limit for feature in runs[kind].features])

    def features(size):
        values = effect.nominal(7) + size * direction
        vector = tuple(float(value) for value in values)
        return run_replay(Replay(runs[kind].setup, Model(name="nominal"), ((name, vector),)))

    planted = 2.0
    rng = np.random.default_rng(0)
    base = nominal_features[kind]
    measured = features(planted) + 0.3 * floor * rng.standard_normal(floor.size)
    # It begins to slide, to bounce, to carry the box, or to hold it back altogether: no slope to follow, but a minimum.
    if name in ("pad_friction", "restitution", "pad_tilt", "rolling_resistance"):
        found = minimize_scalar(
            lambda size: np.sum(np.square((features(size) - measured) / floor)),
            bounds=(0.0, 2.45),
            method="bounded",
            options={"maxiter": 12, "xatol": 0.02},
        ).x
        assert found == pytest.approx(planted, rel=0.1)
        return
    slope = (features(1.5) - base) / floor / 1.5
    assert np.abs(slope).max() > 1.0, "one scale of the effect must be seen in at least one feature"
    found = float(slope @ ((measured - base) / floor) / (slope @ slope))
    secant = (features(found) - base) / floor / found
    found = float(secant @ ((measured - base) / floor) / (secant @ secant))
    assert found == pytest.approx(planted, rel=0.1)


def test_wrong_number_of_parameters_is_refused(physics):
    with pytest.raises(InputError, match="7 finite numbers"):
        library()["torque_offset"].apply_vector(physics, np.zeros(6))
    with pytest.raises(InputError, match="7 finite numbers"):
        library()["torque_offset"].apply_vector(physics, np.full(7, np.nan))


class Wobble(Effect):
    """An effect of somebody's own."""

    name = "wobble"
    acts_on = "scene"
    sentence = "It wobbles."
    parameters = (Parameter("size", "m", 0.0, 0.0, 1.0, 0.1, "size"),)

    def apply(self, physics, values):
        return replace(physics, pad_friction=physics.pad_friction + values["size"][0])


class Entry:
    """An entry point of a package that is not installed."""

    value = "wobbling:thing"

    def __init__(self, thing):
        self._thing = thing

    def load(self):
        return self._thing


@pytest.fixture
def installed(monkeypatch):
    """A fresh library that finds the given things at its entry points."""

    def with_entries(*things):
        monkeypatch.setattr(effects, "entry_points", lambda group: [Entry(thing) for thing in things])
        return effects.library.__wrapped__()

    return with_entries


@pytest.mark.parametrize("thing", [Wobble, Wobble()])
def test_an_effect_of_ones_own_comes_as_a_class_or_as_an_instance(thing, installed, physics):
    found = installed(thing)
    assert [*found] == [*NAMES, "wobble"]
    changed = found["wobble"].apply_vector(physics, np.array([0.25]))
    assert changed.pad_friction == physics.pad_friction + 0.25


@pytest.mark.parametrize(
    ("things", "complaint"),
    [
        ((3,), "no subclass or instance of Effect"),
        ((Effect,), "cannot be loaded"),
        ((Wobble, Wobble()), "already an effect called 'wobble'"),
        ((BUILT_IN[0],), "already an effect called 'joint_coulomb_friction'"),
    ],
)
def test_an_entry_point_that_is_no_effect_of_its_own_is_refused(things, complaint, installed):
    with pytest.raises(InputError, match=complaint):
        installed(*things)


@pytest.mark.parametrize("name", NAMES)
def test_effect_reaches_a_worker_as_it_is(name, physics):
    """Kills a law that is a closure, which no other process can load."""
    effect = library()[name]
    there = pickle.loads(pickle.dumps(effect))
    vector = effect.nominal(7) + effect.steps(7, effect.nominal(7))
    assert unlike(effect.apply_vector(physics, vector), there.apply_vector(physics, vector)) == []
