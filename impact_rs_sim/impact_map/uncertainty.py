# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of a prediction: intervals of every velocity from stated uncertainties, and the budget by source.

With independent uncertainties of the standard deviations sigma_k and the Jacobian J of the prediction
(:mod:`impact_rs_sim.impact_map.derivatives`), as long as no contact changes its state,

    var(u^+_i) = sum_k (J_ik sigma_k)^2,       interval u^+_i -+ 1.96 sqrt(var),      budget (J_ik sigma_k)^2 / var

Draws from the stated uncertainties check the linearisation. If more than the share ``SWITCHES`` of them end in other
contact states (or with other contact points), or leave the range of a parameter (restitution below 0) and are moved to
its end, the draws give the interval; the budget is then the variance of draws from one source alone, over the sum of
these variances. If most draws end in another contact state than the prediction, it can lie outside of their quantiles;
the interval is then extended to it, and ``switches`` names the other contact states.

In a draw, every pad that touches in the prediction moves on until it touches: the impact comes later or sooner, but it
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
from impact_rs_sim.impact_map.contacts import OBJECT, SUPPORT
from impact_rs_sim.impact_map.derivatives import all_velocities, change, differentiate, parameters_of, velocity_names
from impact_rs_sim.impact_map.laws import solve_contacts, states
from impact_rs_sim.impact_map.problem import ImpactMapError, ImpactProblem, check_problem
from impact_rs_sim.numbers import CONFIDENCE_LEVEL, NORMAL_95
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.rotations import AXES
from impact_rs_sim.scenarios.trial_settings import Uncertainties

# Largest share of draws in other contact states, or beyond the range of a parameter, with a linear interval [-]
SWITCHES = 0.02
SEED = 0  # of the draws
DRAWS = 200  # the ends of an interval scatter by about a tenth of its width
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
_LAWFUL = 1e-5  # m/s, largest residual of an accepted draw
_ContactState = tuple[str, str, str]  # body and partner of a contact point, and its state


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
        draws: Number of draws with an answer.
        without_answer: Number of draws without an answer.
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

    def separate_parts(names: Sequence[str], sigma: float) -> list[Mapping[str, float]]:
        return [{name: sigma} for name in names]

    parts: dict[str, list[Mapping[str, float]]] = {name: [] for name in SOURCES}
    for name in problem.arms:
        joints = range(1, problem.motor_inertia[name].size + 1)
        parts["motor_inertia"] += [
            {f"{name}.motor_inertia.{joint}": stated.motor_inertia * float(problem.motor_inertia[name][joint - 1])}
            for joint in joints
        ]
        parts["link_inertia"] += [{f"{name}.link_inertia": stated.link_inertia}]
        parts["joint_position"] += separate_parts(
            [f"{name}.position.{joint}" for joint in joints], stated.joint_position
        )
        parts["joint_velocity"] += separate_parts(
            [f"{name}.velocity.{joint}" for joint in joints], stated.joint_velocity
        )
    for name in physics.pads:
        parts["contact_point"] += separate_parts(
            [f"{name}.contact_point.{axis}" for axis in "xy"], stated.contact_point
        )
    moments = {f"object.inertia.{axis}": float(value) for axis, value in zip(AXES, object_.inertia, strict=True)}
    scaled = {"object.mass": object_.mass} | moments
    parts["object_mass"] = [{name: stated.object_mass * value for name, value in scaled.items()}]
    parts["object_inertia"] = [{name: stated.object_inertia * value} for name, value in moments.items()]
    parts["object_com_offset"] = separate_parts(
        [f"object.com_offset.{axis}" for axis in AXES], stated.object_com_offset
    )
    parts["object_pose"] = separate_parts(["object.position.x", "object.position.y"], stated.object_position)
    parts["object_pose"] += separate_parts(["object.rotation.z"], stated.object_yaw)
    parts["pad_friction"] = [{"pad_friction": stated.pad_friction * physics.pad_friction}]
    parts["support_friction"] = [{"support_friction": stated.support_friction * physics.support_friction}]
    parts["restitution"] = [{"restitution": stated.restitution}]
    names = {parameter.name for parameter in parameters_of(problem)}  # a fixed object has no mass

    def uncertain(part: Mapping[str, float]) -> bool:
        return names >= set(part) and any(sigma > 0.0 for sigma in part.values())

    return tuple(UncertaintySource(name, tuple(filter(uncertain, deviations))) for name, deviations in parts.items())


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
        draws: Number of draws from all sources; a quarter as many from each source if the draws give the interval.
        stopped: Callback before every draw; True ends the prediction.

    Raises:
        Stopped: ``stopped`` returned True.
        InputError: The problem is refused, or its law of restitution is Poisson's.
        ImpactMapError: No answer was found.
    """
    if problem.restitution_law != "newton":
        raise InputError(
            "expected 'newton', the only law with intervals", key="restitution_law", value=problem.restitution_law
        )
    if models is None:
        models = problem.physics.robot_models()
    check_problem(problem, models)
    sources = sources_of(problem, stated)
    derivatives = differentiate(problem, models)
    nominal, nominal_contacts = answer_of(problem, models, {})
    slopes = dict(zip((parameter.name for parameter in derivatives.parameters), derivatives.jacobian.T, strict=True))
    rng = np.random.default_rng(SEED)
    drawn_changes = [draw(sources, rng) for _ in range(draws)]
    sample, contacts_of_draws, unanswered = _sample(problem, models, drawn_changes, stopped)
    _check_answered(sample, unanswered)
    switched = float(np.mean([contacts != nominal_contacts for contacts in contacts_of_draws]))
    parts = {
        source.name: np.array([sum(slopes[name] * sigma for name, sigma in part.items()) for part in source.deviations])
        for source in sources
    }
    variances = {name: np.sum(np.square(rows.reshape(-1, nominal.size)), axis=0) for name, rows in parts.items()}
    out_of_range = float(np.mean([possible(problem, amounts) != amounts for amounts in drawn_changes]))
    smooth = derivatives.smooth and max(switched, out_of_range) <= SWITCHES
    method = "linear" if smooth else "monte_carlo"
    if method == "linear":
        deviation = np.sqrt(np.sum(list(variances.values()), axis=0))
        low, high = nominal - NORMAL_95 * deviation, nominal + NORMAL_95 * deviation
    else:
        low, high = _ends(sample, nominal)
        deviation = np.std(sample, axis=0)
        for source in sources:
            source_draws = [draw((source,), rng) for _ in range(max(draws // 4, 2))]
            source_sample, _, _ = _sample(problem, models, source_draws, stopped)
            variances[source.name] = np.var(source_sample, axis=0) if len(source_sample) > 1 else np.zeros_like(nominal)
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
        switches=_switches(nominal_contacts, contacts_of_draws),
        draws=len(sample),
        without_answer=unanswered,
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

    The ends are quantiles of the draws, extended to the prediction; from few draws they are somewhat too narrow.

    Args:
        problem: The problem; Newton's law of restitution.
        stated: Uncertainties of the scenario.
        models: Rigid-body models by arm.
        draws: Number of draws from all sources.

    Raises:
        ImpactMapError: Fewer than two draws have an answer.
    """
    rng = np.random.default_rng(SEED)
    nominal, _ = answer_of(problem, models, {})
    sources = sources_of(problem, stated)
    sample, _, unanswered = _sample(problem, models, [draw(sources, rng) for _ in range(draws)])
    _check_answered(sample, unanswered)
    low, high = _ends(sample, nominal)
    return velocity_names(problem), low, high


def touching_pads(problem: ImpactProblem, models: Mapping[str, RobotModel]) -> frozenset[str]:
    """Pads that touch in the prediction, without changed parameters."""
    return frozenset({point.partner for point in change(problem, {}).contacts(models)} & problem.physics.pads.keys())


def answer_of(
    problem: ImpactProblem,
    models: Mapping[str, RobotModel],
    amounts: Mapping[str, float],
    pads: frozenset[str] | None = None,
) -> tuple[Array, tuple[_ContactState, ...]]:
    """All velocities ``(k,)`` with changed parameters, and body, partner and state of every contact point.

    Pads that touch in the prediction move on until they touch.

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
    contacts = zip(terms.contacts, states(terms, impulses), strict=True)
    return all_velocities(system, velocity), tuple((point.body, point.partner, state) for point, state in contacts)


def _sample(
    problem: ImpactProblem,
    models: Mapping[str, RobotModel],
    drawn_changes: Sequence[Mapping[str, float]],
    stopped: Callable[[], bool] = lambda: False,
) -> tuple[Array, list[tuple[_ContactState, ...]], int]:
    """Velocities of draws ``(n, k)``, states of their contact points, number of draws without answer."""
    sample, contacts_of_draws = [], []
    pads = touching_pads(problem, models)
    for amounts in drawn_changes:
        if stopped():
            raise Stopped
        try:
            velocities, contacts = answer_of(problem, models, amounts, pads)
        except ImpactMapError:
            continue
        sample.append(velocities)
        contacts_of_draws.append(contacts)
    return np.array(sample), contacts_of_draws, len(drawn_changes) - len(sample)


def _check_answered(sample: Array, unanswered: int) -> None:
    """Refuse an interval from fewer than two draws."""
    if len(sample) < 2:
        raise ImpactMapError(
            f"{unanswered} of {len(sample) + unanswered} draws from the stated uncertainties have no answer"
        )


def _ends(sample: Array, nominal: Array) -> tuple[Array, Array]:
    """Ends of the interval of draws at ``CONFIDENCE_LEVEL``, extended to the prediction where that lies outside."""
    low, high = np.quantile(sample, _TAILS, axis=0)
    return np.minimum(low, nominal), np.maximum(high, nominal)


def _switches(
    nominal_contacts: tuple[_ContactState, ...], draws: Sequence[tuple[_ContactState, ...]]
) -> dict[str, float]:
    """Differences of contact states between draws and prediction, in words, with their share, most frequent first."""
    words = Counter(text for contacts in draws for text in _differences(nominal_contacts, contacts))
    return {text: count / len(draws) for text, count in words.most_common()}


def _differences(nominal_contacts: tuple[_ContactState, ...], contacts: tuple[_ContactState, ...]) -> list[str]:
    """Differences of the contacts of one draw, in words; an open point transmits no impulse."""
    differences = []
    pairs = dict.fromkeys((body, partner) for body, partner, _ in (*nominal_contacts, *contacts))
    for pair in pairs:
        before, after = (
            [state for *bodies, state in states if tuple(bodies) == pair] for states in (nominal_contacts, contacts)
        )
        loaded_before, loaded_now = (
            [state for state in contact_states if state != "open"] for contact_states in (before, after)
        )
        body, partner = (f"the {name}" if name == OBJECT else name for name in pair)
        if partner == SUPPORT:
            meets, not_meets = f"{body} presses on its support", f"{body} does not press on its support"
        else:
            meets, not_meets = f"{partner} hits {body}", f"{partner} does not hit {body}"
        if loaded_before and not loaded_now:
            differences.append(f"{not_meets}, in the prediction it does")
        elif loaded_now and not loaded_before:
            differences.append(f"{meets}, in the prediction not")
        elif len(loaded_before) != len(loaded_now):
            points = "1 point" if len(loaded_now) == 1 else f"{len(loaded_now)} points"
            differences.append(f"{meets} at {points}, in the prediction at {len(loaded_before)}")
        elif loaded_before != loaded_now:
            differences.append(f"{meets} and sticks or slides otherwise than in the prediction")
        elif loaded_before and before != after:
            differences.append(f"{meets} at other points than in the prediction")
    return differences


def possible(problem: ImpactProblem, amounts: Mapping[str, float]) -> dict[str, float]:
    """Amounts that leave masses, inertias and friction positive, and restitution between 0 and 1.

    At least a tenth of a motor inertia remains: simulators with springs in the joints divide by it.
    """
    physics, object_ = problem.physics, problem.physics.object
    lower = {"object.mass": -0.99 * object_.mass, "pad_friction": -physics.pad_friction}
    lower |= {"support_friction": -physics.support_friction, "restitution": -problem.restitution}
    lower |= {f"object.inertia.{axis}": -0.99 * value for axis, value in zip(AXES, object_.inertia, strict=True)}
    for name, motor in problem.motor_inertia.items():
        lower |= {f"{name}.motor_inertia.{joint + 1}": -0.9 * value for joint, value in enumerate(motor)}
        lower[f"{name}.link_inertia"] = -0.99
    limited = {name: max(amount, float(lower.get(name, -np.inf))) for name, amount in amounts.items()}
    if "restitution" in limited:
        limited["restitution"] = min(limited["restitution"], 1.0 - problem.restitution)
    return limited
