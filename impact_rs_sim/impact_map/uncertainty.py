# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of a prediction: intervals of every velocity from stated uncertainties, and the budget by source.

With independent uncertainties of the standard deviations sigma_k and the Jacobian J of the prediction
(:mod:`impact_rs_sim.impact_map.derivatives`), as long as no contact changes its state,

    var(u^+_i) = sum_k (J_ik sigma_k)^2,       interval u^+_i -+ 1.96 sqrt(var),      budget (J_ik sigma_k)^2 / var

Draws from the stated uncertainties check the linearisation. Where more than ``SWITCHES`` of them end in other contact
states (or other contact points), or leave the range of a parameter (restitution below 0) and are moved to its end, the
interval is taken from the draws, and the budget is the variance when one source alone is drawn, over the sum of these.
Where most draws end in another contact state than the prediction, their quantiles can leave the prediction out; the
interval is then extended to it, and ``switches`` says what else happens.

In the draws a pad that touches in the prediction comes on until it touches: an impact comes later or sooner, but it
comes. A pad that touches nothing in the prediction stays where the draw puts it.

A scenario states half the width of a 95 % interval, 1.96 sigma. A source may have independent parts, such as the joints
of B, or move several parameters together, such as a mass with its moments.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map.contacts import SUPPORT
from impact_rs_sim.impact_map.derivatives import all_velocities, change, differentiate, parameters_of, velocity_names
from impact_rs_sim.impact_map.laws import solve_contacts, states
from impact_rs_sim.impact_map.problem import ImpactMapError, ImpactProblem, check_problem
from impact_rs_sim.numbers import CONFIDENCE_LEVEL, NORMAL_95
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.rotations import AXES
from impact_rs_sim.scenarios.scenario import Uncertainties

# Share of draws in other contact states, or beyond the range of a parameter, from which the interval is not linear [-]
SWITCHES = 0.02
SEED = 0  # of the draws
DRAWS = 200  # the ends of an interval scatter by about a tenth of its width
HITS = ("hits the object", "does not hit the object")
MEETS_SUPPORT = ("the object presses on its support", "the object does not press on its support")
SOURCES = (
    "motor_inertia",
    "link_inertia",
    "object_mass",
    "object_inertia",
    "object_com_offset",
    "object_pose",
    "joint_position",
    "joint_velocity",
    "contact_point",
    "pad_friction",
    "support_friction",
    "restitution",
)
_TAILS = ((1.0 - CONFIDENCE_LEVEL) / 2.0, (1.0 + CONFIDENCE_LEVEL) / 2.0)
_LAWFUL = 1e-5  # m/s, residual of a draw that counts


class Stopped(Exception):
    """The caller no longer wants the prediction."""


@dataclass(frozen=True)
class UncertaintySource:
    """One uncertain quantity.

    Attributes:
        name: Name of the source, a key of the scenario's ``uncertainty``.
        deviations: Change by one standard deviation of each independent part, by parameter.
    """

    name: str
    deviations: tuple[Mapping[str, float], ...]


@dataclass(frozen=True)
class UncertainPrediction:
    """Velocities with their intervals.

    Attributes:
        names: Names of the velocities: joint velocities, ``ARM.velocity.x`` ... of frame E, and the object's twist.
        nominal: Predicted values, ``(k,)`` [rad/s, m/s].
        low: Lower ends at ``CONFIDENCE_LEVEL``, ``(k,)``.
        high: Upper ends, ``(k,)``.
        deviation: Standard deviations, ``(k,)``.
        budget: Share of the variance by source, ``(k,)`` each [-].
        method: ``linear`` or ``monte_carlo``.
        switched: Share of draws in other contact states [-].
        switches: Differences of contact states from the prediction, in words, with their share of the draws [-].
        draws: Draws that have an answer.
        without_answer: Draws without an answer.
        factors: Change by one standard deviation of every independent part, ``(k, p)``.
        sample: Velocities of the draws, ``(draws, k)``.
    """

    names: tuple[str, ...]
    nominal: Array
    low: Array
    high: Array
    deviation: Array
    budget: Mapping[str, Array]
    method: str
    switched: float
    switches: Mapping[str, float]
    draws: int
    without_answer: int
    factors: Array
    sample: Array

    def interval_of(self, weights: Mapping[str, float]) -> tuple[float, float]:
        """Interval at ``CONFIDENCE_LEVEL`` of a weighted sum of velocities, by their names."""
        weight = np.array([weights.get(name, 0.0) for name in self.names])
        if self.method == "linear":
            half = NORMAL_95 * float(np.linalg.norm(weight @ self.factors))
            value = float(weight @ self.nominal)
            return value - half, value + half
        low, high = _ends(self.sample @ weight, weight @ self.nominal)
        return float(low), float(high)


def sources_of(problem: ImpactProblem, stated: Uncertainties) -> tuple[UncertaintySource, ...]:
    """All uncertainties stated in a scenario, as changes of the parameters of a problem."""
    object_, physics = problem.physics.object, problem.physics
    stated = Uncertainties(**{name: width / NORMAL_95 for name, width in stated})

    def apart(names: Sequence[str], sigma: float) -> list[Mapping[str, float]]:
        return [{name: sigma} for name in names]

    parts: dict[str, list[Mapping[str, float]]] = {name: [] for name in SOURCES}
    for name in problem.arms:
        joints = range(1, problem.motor_inertia[name].size + 1)
        parts["motor_inertia"] += [
            {f"{name}.motor_inertia.{joint}": stated.motor_inertia * float(problem.motor_inertia[name][joint - 1])}
            for joint in joints
        ]
        parts["link_inertia"] += [{f"{name}.link_inertia": stated.link_inertia}]
        parts["joint_position"] += apart([f"{name}.position.{joint}" for joint in joints], stated.joint_position)
        parts["joint_velocity"] += apart([f"{name}.velocity.{joint}" for joint in joints], stated.joint_velocity)
    for name in physics.pads:
        parts["contact_point"] += apart([f"{name}.contact_point.{axis}" for axis in "xy"], stated.contact_point)
    moments = {f"object.inertia.{axis}": float(value) for axis, value in zip(AXES, object_.inertia, strict=True)}
    scaled = {"object.mass": object_.mass} | moments
    parts["object_mass"] = [{name: stated.object_mass * value for name, value in scaled.items()}]
    parts["object_inertia"] = [{name: stated.object_inertia * value} for name, value in moments.items()]
    parts["object_com_offset"] = apart([f"object.com_offset.{axis}" for axis in AXES], stated.object_com_offset)
    parts["object_pose"] = apart(["object.position.x", "object.position.y"], stated.object_position)
    parts["object_pose"] += apart(["object.rotation.z"], stated.object_yaw)
    parts["pad_friction"] = [{"pad_friction": stated.pad_friction * physics.pad_friction}]
    parts["support_friction"] = [{"support_friction": stated.support_friction * physics.support_friction}]
    parts["restitution"] = [{"restitution": stated.restitution}]
    known = {parameter.name for parameter in parameters_of(problem)}  # a fixed object has no mass
    return tuple(
        UncertaintySource(
            name, tuple(part for part in own if known >= set(part) and any(sigma > 0.0 for sigma in part.values()))
        )
        for name, own in parts.items()
    )


def draw(sources: Sequence[UncertaintySource], rng: np.random.Generator) -> dict[str, float]:
    """One draw of all parameters: normal, independent from source to source and part to part."""
    amounts: dict[str, float] = {}
    for source in sources:
        for part in source.deviations:
            size = float(rng.standard_normal())
            for name, sigma in part.items():
                amounts[name] = amounts.get(name, 0.0) + sigma * size
    return amounts


def predict(
    problem: ImpactProblem,
    stated: Uncertainties,
    models: Mapping[str, RobotModel] | None = None,
    draws: int = DRAWS,
    stopped: Callable[[], bool] = lambda: False,
) -> UncertainPrediction:
    """Predict with intervals.

    Args:
        problem: The problem; Newton's law of restitution.
        stated: Uncertainties of the scenario.
        models: Rigid-body models by arm, where the caller has them already.
        draws: From all uncertainties; a quarter as many of every source where the draws give the interval.
        stopped: Callback before every draw; True ends the prediction.

    Raises:
        Stopped: ``stopped`` said so.
        InputError: The problem is refused, or its law of restitution is Poisson's.
        ImpactMapError: No answer was found.
    """
    if problem.restitution_law != "newton":
        raise InputError("intervals are those of Newton's law", key="restitution_law", value=problem.restitution_law)
    if models is None:
        models = problem.physics.robot_models()
    check_problem(problem, models)
    sources = sources_of(problem, stated)
    found = differentiate(problem, models)
    nominal, usual = answer_of(problem, models, {})
    slopes = dict(zip((one.name for one in found.parameters), found.jacobian.T, strict=True))
    rng = np.random.default_rng(SEED)
    drawn = [draw(sources, rng) for _ in range(draws)]
    sample, states_of, lost = _sample(problem, models, drawn, stopped)
    _check_answered(sample, lost)
    switched = float(np.mean([one != usual for one in states_of]))
    parts = {
        source.name: np.array([sum(slopes[name] * sigma for name, sigma in part.items()) for part in source.deviations])
        for source in sources
    }
    variances = {name: np.sum(np.square(rows.reshape(-1, nominal.size)), axis=0) for name, rows in parts.items()}
    beyond = float(np.mean([possible(problem, amounts) != amounts for amounts in drawn]))
    smooth = found.smooth and max(switched, beyond) <= SWITCHES
    method = "linear" if smooth else "monte_carlo"
    if method == "linear":
        deviation = np.sqrt(np.sum(list(variances.values()), axis=0))
        low, high = nominal - NORMAL_95 * deviation, nominal + NORMAL_95 * deviation
    else:
        low, high = _ends(sample, nominal)
        deviation = np.std(sample, axis=0)
        for source in sources:
            own = [draw((source,), rng) for _ in range(max(draws // 4, 2))]
            alone, _, _ = _sample(problem, models, own, stopped)
            variances[source.name] = np.var(alone, axis=0) if len(alone) > 1 else np.zeros_like(nominal)
    total = np.maximum(np.sum(list(variances.values()), axis=0), 1e-300)
    return UncertainPrediction(
        names=velocity_names(problem),
        nominal=nominal,
        low=low,
        high=high,
        deviation=deviation,
        budget={name: variance / total for name, variance in variances.items()},
        method=method,
        switched=switched,
        switches=_switches(usual, states_of),
        draws=len(sample),
        without_answer=lost,
        factors=np.concatenate([rows.reshape(-1, nominal.size) for rows in parts.values()]).T,
        sample=sample,
    )


def interval_of_draws(
    problem: ImpactProblem,
    stated: Uncertainties,
    models: Mapping[str, RobotModel],
    draws: int,
) -> tuple[tuple[str, ...], Array, Array]:
    """Names and ends of intervals from few draws, faster than :func:`predict`.

    Quantiles of the draws, extended to the prediction: as skew as by :func:`predict`, and from a few draws somewhat
    too narrow.

    Args:
        problem: The problem; Newton's law of restitution.
        stated: Uncertainties of the scenario.
        models: Rigid-body models by arm.
        draws: From all uncertainties.

    Raises:
        ImpactMapError: Fewer than two draws have an answer.
    """
    rng = np.random.default_rng(SEED)
    nominal, _ = answer_of(problem, models, {})
    sources = sources_of(problem, stated)
    sample, _, lost = _sample(problem, models, [draw(sources, rng) for _ in range(draws)])
    _check_answered(sample, lost)
    low, high = _ends(sample, nominal)
    return velocity_names(problem), low, high


def touching_pads(problem: ImpactProblem, models: Mapping[str, RobotModel]) -> frozenset[str]:
    """Pads that touch where nothing is changed."""
    return frozenset({one.partner for one in change(problem, {}).contacts(models)} & problem.physics.pads.keys())


def answer_of(
    problem: ImpactProblem,
    models: Mapping[str, RobotModel],
    amounts: Mapping[str, float],
    pads: frozenset[str] | None = None,
) -> tuple[Array, tuple[str, ...]]:
    """All velocities ``(k,)`` with parameters changed, and the partner and state of every contact point.

    Pads that touch where nothing is changed come on until they touch, wherever the changed poses leave them.

    Args:
        problem: The problem.
        models: Rigid-body models by arm.
        amounts: Changes by name of the parameter.
        pads: :func:`touching_pads`, where the caller has them already.

    Raises:
        ImpactMapError: No answer was found.
    """
    if pads is None:
        pads = touching_pads(problem, models)
    system, terms = change(problem, possible(problem, amounts)).touching_terms(models, pads)
    impulses, _ = solve_contacts(terms)
    velocity = system.velocity + terms.response @ impulses.ravel()
    if not terms.residual(impulses, velocity).largest <= _LAWFUL:
        raise ImpactMapError("no answer obeys the laws")
    states_ = zip((contact.partner for contact in terms.contacts), states(terms, impulses), strict=True)
    return all_velocities(system, velocity), tuple(" ".join(one) for one in states_)


def _sample(
    problem: ImpactProblem,
    models: Mapping[str, RobotModel],
    drawn: Sequence[Mapping[str, float]],
    stopped: Callable[[], bool] = lambda: False,
) -> tuple[Array, list[tuple[str, ...]], int]:
    """Velocities of draws ``(n, k)``, partner and state of their contact points, and how many draws have no answer."""
    sample, found = [], []
    pads = touching_pads(problem, models)
    for amounts in drawn:
        if stopped():
            raise Stopped
        try:
            velocities, there = answer_of(problem, models, amounts, pads)
        except ImpactMapError:
            continue
        sample.append(velocities)
        found.append(there)
    return np.array(sample), found, len(drawn) - len(sample)


def _check_answered(sample: Array, lost: int) -> None:
    """Refuse an interval from fewer than two draws."""
    if len(sample) < 2:
        raise ImpactMapError(f"of {len(sample) + lost} draws from the stated uncertainties {lost} have no answer")


def _ends(sample: Array, nominal: Array) -> tuple[Array, Array]:
    """Ends of the interval of draws at ``CONFIDENCE_LEVEL``, extended to the prediction where that lies outside."""
    low, high = np.quantile(sample, _TAILS, axis=0)
    return np.minimum(low, nominal), np.maximum(high, nominal)


def _switches(usual: tuple[str, ...], draws: Sequence[tuple[str, ...]]) -> dict[str, float]:
    """Differences of contact states between draws and prediction, in words, with their share, most frequent first."""
    words = Counter(text for there in draws for text in _differences(usual, there))
    return {text: count / len(draws) for text, count in words.most_common()}


def _differences(usual: tuple[str, ...], there: tuple[str, ...]) -> list[str]:
    """Differences of the contacts of one draw, in words; an open point transmits no impulse."""
    found = []
    for partner in dict.fromkeys(state.split()[0] for state in (*usual, *there)):
        before, after = ([s.split()[1] for s in states_ if s.split()[0] == partner] for states_ in (usual, there))
        loaded, now_loaded = ([state for state in one if state != "open"] for one in (before, after))
        meets, not_meets = MEETS_SUPPORT if partner == SUPPORT else (f"{partner} {text}" for text in HITS)
        if loaded and not now_loaded:
            found.append(f"{not_meets}, in the prediction it does")
        elif now_loaded and not loaded:
            found.append(f"{meets}, in the prediction not")
        elif len(loaded) != len(now_loaded):
            points = "1 point" if len(now_loaded) == 1 else f"{len(now_loaded)} points"
            found.append(f"{meets} at {points}, in the prediction at {len(loaded)}")
        elif loaded != now_loaded:
            found.append(f"{meets} and sticks or slides otherwise than in the prediction")
        elif loaded and before != after:
            found.append(f"{meets} at other points than in the prediction")
    return found


def possible(problem: ImpactProblem, amounts: Mapping[str, float]) -> dict[str, float]:
    """Amounts that leave masses, inertias and friction positive, and restitution between 0 and 1.

    A tenth of a motor inertia is left: simulators with springs in the joints divide by it.
    """
    physics, object_ = problem.physics, problem.physics.object
    least = {"object.mass": -0.99 * object_.mass, "pad_friction": -physics.pad_friction}
    least |= {"support_friction": -physics.support_friction, "restitution": -problem.restitution}
    least |= {f"object.inertia.{axis}": -0.99 * value for axis, value in zip(AXES, object_.inertia, strict=True)}
    for name, motor in problem.motor_inertia.items():
        least |= {f"{name}.motor_inertia.{joint + 1}": -0.9 * value for joint, value in enumerate(motor)}
        least[f"{name}.link_inertia"] = -0.99
    possible = {name: max(amount, float(least.get(name, -np.inf))) for name, amount in amounts.items()}
    if "restitution" in possible:
        possible["restitution"] = min(possible["restitution"], 1.0 - problem.restitution)
    return possible
