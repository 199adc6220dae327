# SPDX-License-Identifier: Apache-2.0
"""Which readings agree with each other, and which contradict each other.

Every group of features is a relation between readings, which holds if these are right and the physics between them is
that of the model (:mod:`impact_rs_analysis.evidence.replays.features`):

    motor torque balance      tau_d - tau_J - B ddtheta        command, torque sensor, velocities of motor and link
    link torque balance       tau_J - M(q) ddq - h(q, dq)      torque sensor, encoder, velocity
    elastic deflection        (theta - q) - tau_J / K          motor encoder, encoder, torque sensor
    velocity of positions     mean of dq - change of q / T     velocity, encoder; no model has a part in it
    object and end effector   v_object - v_E                   tracker, encoder; while the pad pushes the object

The residual of the model with each, joint by joint, is tested against repeatability and model discrepancy by the test
of lack of fit (:meth:`~impact_rs_analysis.diagnosis.search.null_distribution.NullDistribution.lack_of_fit`), adjusted
for the number of joints. Readings disagree where it is significant and above the relevance limit; without repeats,
where the residual exceeds ``MAX_NOISE_RATIO`` times the known noise.

A wrong reading takes part in every relation that disagrees. A relation that agrees clears the readings to whose faults
it is sensitive (``clears``): a torque balance is hardly sensitive to the zero of an encoder, on which gravity alone
depends, and the derivative of positions is not sensitive to it at all. The uncleared readings of all relations that
disagree are those *in common*. Where a single relation disagrees, the physics that it assumes is an explanation too.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from pydantic import Field

from impact_rs_analysis.diagnosis.search.null_distribution import RotationNull, benjamini_hochberg
from impact_rs_analysis.diagnosis.thresholds import MAX_NOISE_RATIO, SIGNIFICANCE_LEVEL
from impact_rs_analysis.evidence.cluster import Cluster, Feature, pooled_error
from impact_rs_analysis.evidence.levels import expected_of, relevant_of, root_mean_square, rounded
from impact_rs_analysis.evidence.replays.features import VELOCITY_LIMIT_RAD_S
from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun
from impact_rs_analysis.evidence.source import Source
from impact_rs_sim.proportion import Proportion
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.schema import Schema

COMMAND, TORQUE, ENCODER, VELOCITY = "command", "torque sensor", "encoder", "velocity"
SERVO = "servo (desired position and gains)"  # which the torque was computed of, where none was recorded
MOTOR_ENCODER, MOTOR_VELOCITY, TRACKER = "motor encoder", "motor velocity", "tracker"
PUSH_SIGNALS = ("object velocity", "end-effector velocity")


@dataclass(frozen=True)
class Relation:
    """A relation between readings.

    Attributes:
        name: Its name.
        signals: Signals of the features whose residual it is; for two signals their difference.
        readings: Readings that take part.
        clears: Readings to whose faults it is sensitive, which are right if it agrees.
        assumes: Physics that it assumes.
    """

    name: str
    signals: tuple[str, ...]
    readings: tuple[str, ...]
    clears: tuple[str, ...]
    assumes: str


MOTOR_BALANCE = Relation(
    "motor torque balance",
    ("motor torque balance",),
    (COMMAND, TORQUE, MOTOR_VELOCITY, VELOCITY),  # the motor of a replay starts with the velocity of the link
    (COMMAND, TORQUE),
    "friction, motor inertia and drive",
)
LINK_BALANCE = Relation(
    "link torque balance",
    ("link torque balance", "torque"),
    (TORQUE, ENCODER, VELOCITY),
    (TORQUE,),
    "masses, gravity and loads on the links, or positions of other joints",
)
ELASTIC_DEFLECTION = Relation(
    "elastic deflection",
    ("elastic deflection", "deflection"),
    (MOTOR_ENCODER, ENCODER, TORQUE),
    (MOTOR_ENCODER, ENCODER),
    "stiffness of the joint",
)
POSITION_SLOPE = Relation("velocity of positions", ("velocity of positions",), (VELOCITY, ENCODER), (VELOCITY,), "")
OBJECT_TRACKING = Relation(
    "object and end effector", PUSH_SIGNALS, (TRACKER, ENCODER), (TRACKER,), "how the object slips and turns on the pad"
)
FEATURE_RELATIONS = (MOTOR_BALANCE, LINK_BALANCE, ELASTIC_DEFLECTION, POSITION_SLOPE)
FREE_MOTION_PHASES = ("free", "moving up", "moving down", "slow")  # phases without contact


class RelationDocument(Schema):
    """One relation between readings, at one joint or axis."""

    relation: str = Field(description="name")
    place: str = Field(description="joint or axis, with the arm's name in front where there are several")
    readings: tuple[str, ...] = Field(description="readings that take part")
    clears: tuple[str, ...] = Field((), description="those of them that are right where it agrees")
    assumes: str = Field("", description="physics that it takes for granted; empty: none")
    times_noise: float = Field(description="residual in multiples of repeatability, or of noise")
    p_value: float | None = Field(None, description="of noise and discrepancy alone, adjusted; null: no repeats")
    agrees: bool = Field(description="whether the readings agree")


class InCommon(Schema):
    """Common readings of the relations that disagree at one joint or axis."""

    place: str = Field(description="joints or axes, as a list")
    relations: tuple[str, ...] = Field(description="relations that disagree")
    readings: tuple[str, ...] = Field((), description="readings in all of them that no relation clears")
    assumes: str = Field("", description="physics that explains it as well; empty: several relations disagree")

    @property
    def in_words(self) -> str:
        """One sentence."""
        where, relations = joints_in_words(self.place.split(", ")), " and ".join(f"the {one}" for one in self.relations)
        if len(self.relations) > 1:
            common = (
                f"in common: {' or '.join(self.readings)}" if self.readings else "no single reading is in all of them"
            )
            return f"{where}: {relations} do not hold; {common}"
        causes = [*self.readings, *([f"the physics ({self.assumes})"] if self.assumes else [])]
        possible = " or ".join(causes) or "a reading of another joint"
        return f"{where}: {relations} does not hold; possible causes: {possible}"


class AgreementDocument(Schema):
    """Agreement of the readings, relation by relation."""

    relations: tuple[RelationDocument, ...] = Field((), description="relations, joint by joint")
    in_common: tuple[InCommon, ...] = Field((), description="joints and axes at which some disagree")

    @property
    def by_joint(self) -> dict[str, dict[str, RelationDocument]]:
        """Relations by joint or axis, and by name."""
        found: dict[str, dict[str, RelationDocument]] = {}
        for one in self.relations:
            found.setdefault(one.place, {})[one.relation] = one
        return found

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the relations that were measured."""
        return tuple(dict.fromkeys(one.relation for one in self.relations))

    def readings_of(self, name: str) -> tuple[str, ...]:
        """Readings that take part in a relation."""
        return next(one.readings for one in self.relations if one.relation == name)

    def against(self, name: str) -> tuple[str, ...]:
        """Joints and axes at which a relation does not hold."""
        return tuple(one.place for one in self.relations if one.relation == name and not one.agrees)


def joints_in_words(places: Sequence[str]) -> str:
    """Joints and axes in a few words, as "joints 1 to 4, 7"; those of several arms by their names."""
    numbers = [int(one[1]) for place in places if (one := re.fullmatch(r"joint(\d+)", place))]
    if len(numbers) < max(len(places), 2):
        return ", ".join(places)
    starts = [n for n in numbers if n - 1 not in numbers]
    ends = [n for n in numbers if n + 1 not in numbers]
    runs = [
        f"{first} to {last}" if last > first + 1 else ", ".join(map(str, dict.fromkeys((first, last))))
        for first, last in zip(starts, ends, strict=True)
    ]
    return f"joints {', '.join(runs)}"


def agreement_of(source: Source) -> AgreementDocument:
    """Test the relations between the readings.

    Args:
        source: Trials or recordings with the model's predictions; tables of impacts have no such relations.
    """
    tested: list[tuple[Relation, str, list[Cluster]]] = []
    for relation in FEATURE_RELATIONS:
        tested += [(relation, *one) for one in _by_index(source.clusters, partial(_belongs_to, relation))]
    if source.runs is not None:
        tested += [(POSITION_SLOPE, *one) for one in _by_index(slope_clusters(source.runs.runs), lambda feature: True)]
        tested += [
            (OBJECT_TRACKING, *one) for one in _by_index(tracking_clusters(source.clusters), lambda feature: True)
        ]
    limited = source.noise_size() is None
    raw = {
        number: RotationNull(clusters).lack_of_fit([item.mean for item in clusters])
        for number, (_, _, clusters) in enumerate(tested if source.repeated else ())
    }
    p_values: dict[str, float] = {}
    for relation in dict.fromkeys(relation for relation, _, _ in tested):  # each is a question of its own
        own = {str(n): p for n, p in raw.items() if p is not None and tested[n][0] is relation}
        p_values |= benjamini_hochberg(own)
    motor = any(relation is ELASTIC_DEFLECTION for relation, _, _ in tested)
    computed = source.recording is not None and "torque" not in source.recording.signals
    found = []
    for number, (relation, place, clusters) in enumerate(tested):
        p = p_values.get(str(number))
        noise, relevant = (_size(clusters, of, limited) for of in (expected_of, relevant_of))
        agrees = relevant < MAX_NOISE_RATIO if p is None else p >= SIGNIFICANCE_LEVEL or relevant < 1.0
        found.append(
            RelationDocument(
                relation=relation.name,
                place=place,
                readings=tuple(_renamed(relation.readings, motor, computed)),
                clears=tuple(_renamed(relation.clears, motor, computed)),
                assumes=relation.assumes,
                times_noise=rounded(noise),
                p_value=None if p is None else rounded(p),
                agrees=agrees,
            )
        )
    found.sort(key=lambda one: _order(one.place))
    document = AgreementDocument(relations=tuple(found))
    return document.model_copy(update={"in_common": tuple(_in_common(document))})


def _belongs_to(relation: Relation, feature: Feature) -> bool:
    return feature.signal in relation.signals and feature.phase in FREE_MOTION_PHASES


def _renamed(readings: Sequence[str], motor: bool, computed: bool) -> list[str]:
    """Readings of a relation, without the motor's velocity if its motor has no encoder, and servos for sensors."""
    names = [SERVO if computed and name == TORQUE else name for name in readings]
    return [name for name in names if motor or name != MOTOR_VELOCITY]


def _by_index(clusters: Sequence[Cluster], wanted: Callable[[Feature], bool]) -> list[tuple[str, list[Cluster]]]:
    """Clusters by joint or axis, restricted to the wanted features of it."""
    places = dict.fromkeys(f.index for item in clusters for f in item.features if wanted(f))
    found = []
    for place in places:
        masks = [[wanted(f) and f.index == place for f in item.features] for item in clusters]
        own = [item.only(mask, False) for item, mask in zip(clusters, masks, strict=True) if any(mask)]
        found.append((place, own))
    return found


def _size(clusters: Sequence[Cluster], of: Callable[[Cluster, bool], Array], limited: bool) -> float:
    """Root mean square of the mean residuals in multiples of the scale ``of``."""
    return root_mean_square(np.concatenate([item.mean / of(item, limited) for item in clusters]))


def _in_common(document: AgreementDocument) -> list[InCommon]:
    """Common readings of the relations that disagree, with joints of equal result in one entry."""
    result: dict[tuple[tuple[str, ...], tuple[str, ...], str], list[str]] = {}
    for place, own in document.by_joint.items():
        against = [one for one in own.values() if not one.agrees]
        if not against:
            continue
        cleared = {name for one in own.values() if one.agrees for name in one.clears}
        shared = [name for name in against[0].readings if all(name in one.readings for one in against)]
        readings = tuple(name for name in shared if name not in cleared)
        assumes = against[0].assumes if len(against) == 1 else ""
        result.setdefault((tuple(one.relation for one in against), readings, assumes), []).append(place)
    return [
        InCommon(place=", ".join(places), relations=relations, readings=readings, assumes=assumes)
        for (relations, readings, assumes), places in result.items()
    ]


def _order(place: str) -> tuple[str, int, str]:
    """Sort key: by arm, joints in their order before axes."""
    arm, _, own = place.rpartition(".")
    number = re.fullmatch(r"joint(\d+)", own)
    return (arm, int(number[1]), "") if number else (arm, 10**6, own)


def slope_clusters(runs: Sequence[MeasuredRun]) -> list[Cluster]:
    """Mean velocity minus the difference quotient of the position in windows of free motion, condition by condition.

    Args:
        runs: Runs; those without signals are left out.
    """
    rows: dict[str, list[Array]] = {}
    features: dict[str, tuple[Feature, ...]] = {}
    firsts: dict[str, MeasuredRun] = {}
    for run in runs:
        if run.signals.time.size < 2:
            continue
        several, values, own = len(run.setup.physics.arms) > 1, [], []
        limit = VELOCITY_LIMIT_RAD_S * Proportion.of(run.physics).factor("rad/s")
        for number, (window, signals) in enumerate(zip(run.setup.windows, run.windowed, strict=True)):
            for name, arm in () if window.contact else signals.arms.items():
                last = float(signals.time[-1] - signals.time[0])
                mean = np.trapezoid(arm.velocity, signals.time, axis=0) / last
                values.append(mean - (arm.position[-1] - arm.position[0]) / last)
                label = f"{name}." if several else ""
                own += [
                    Feature("free", POSITION_SLOPE.name, f"{label}joint{joint + 1}", number, "rad/s", limit, name)
                    for joint in range(arm.velocity.shape[1])
                ]
        if values and features.setdefault(run.condition, tuple(own)) == tuple(own):
            rows.setdefault(run.condition, []).append(np.concatenate(values))
            firsts.setdefault(run.condition, run)
    named = {name: (firsts[name].condition_key, features[name]) for name in rows}
    return _clusters({name: np.array(own) for name, own in rows.items()}, named)


def tracking_clusters(clusters: Sequence[Cluster]) -> list[Cluster]:
    """Residual of the velocity of the object minus that of the end effector while it is pushed, condition by condition.

    Args:
        clusters: Conditions of trials; those without an object have none.
    """
    rows: dict[str, Array] = {}
    named: dict[str, tuple[tuple[str, str, str], tuple[Feature, ...]]] = {}
    patterns: dict[str, tuple[str, Array]] = {}
    for item in clusters:
        places = {(f.signal, f.index, f.bin): n for n, f in enumerate(item.features) if f.phase == "push"}
        arms = {f.arm for f in item.features if f.arm}
        pairs = [
            (own, places[PUSH_SIGNALS[1], index, number])
            for (signal, index, number), own in places.items()
            if signal == PUSH_SIGNALS[0] and (PUSH_SIGNALS[1], index, number) in places
        ]
        if not pairs or len(arms) > 1:  # either of two arms may push
            continue
        first, second = (list(column) for column in zip(*pairs, strict=True))
        scaled = item.residuals * item.sigma
        moved = item.discrepancy_factor * item.sigma
        rows[item.name] = scaled[:, first] - scaled[:, second]
        patterns[item.name] = item.discrepancy_group, moved[:, first] - moved[:, second]
        named[item.name] = (
            item.condition_key,
            tuple(replace(item.features[n], signal=OBJECT_TRACKING.name) for n in first),
        )
    return _clusters(rows, named, patterns)


def _clusters(
    rows: dict[str, Array],
    named: dict[str, tuple[tuple[str, str, str], tuple[Feature, ...]]],
    patterns: dict[str, tuple[str, Array]] | None = None,
) -> list[Cluster]:
    """Clusters from residuals of repeats ``(n, F)`` by condition, with key and features.

    The patterns ``(k, F)`` of their discrepancy, with the key of the clusters that share its amplitudes, may be absent.
    """
    alike: dict[tuple[Feature, ...], list[str]] = {}
    for name, (_, features) in named.items():
        alike.setdefault(features, []).append(name)
    pooled = {features: pooled_error([rows[name] for name in names]) for features, names in alike.items()}
    found = []
    for name, (key, features) in named.items():
        known = pooled[features]
        pure = np.zeros(len(features)) if known is None else known
        limit = np.array([feature.relevance_limit for feature in features]) / 2.0
        group, moved = (None, np.zeros((0, len(features)))) if patterns is None else patterns[name]
        differing = np.sqrt(np.sum(np.square(moved), axis=0))
        sigma = np.maximum(np.sqrt(pure**2 + limit**2 + differing**2), 1e-12)
        found.append(
            Cluster(
                name=name,
                condition_key=key,
                layout=f"{len(alike)}: {list(alike).index(features)}",
                unit=name,
                contact=False,
                features=features,
                residuals=rows[name] / sigma,
                sigma=sigma,
                pure_error=pure / sigma,
                discrepancy=differing / sigma,
                patterns=moved / sigma if moved.size else None,
                discrepancy_key=group,
            )
        )
    return found
