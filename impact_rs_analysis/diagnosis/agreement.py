# SPDX-License-Identifier: Apache-2.0
"""Agreement of readings: which of them are consistent, and which contradict each other.

Every group of features is a relation between readings. It holds if the readings are right and the physics between them
is as in the model (:mod:`impact_rs_analysis.evidence.replays.features`):

    motor torque balance      tau_d - tau_J - B ddtheta        command, torque sensor, velocities of motor and link
    link torque balance       tau_J - M(q) ddq - h(q, dq)      torque sensor, encoder, velocity
    elastic deflection        (theta - q) - tau_J / K          motor encoder, encoder, torque sensor
    velocity of positions     mean of dq - change of q / T     velocity, encoder; independent of the model
    object and end effector   v_object - v_E                   tracker, encoder; while the pad pushes the object

The residual of each relation at each joint is tested against repeatability and model discrepancy by the lack-of-fit
test (:meth:`~impact_rs_analysis.diagnosis.search.null_distribution.NullDistribution.lack_of_fit`), adjusted for the
number of joints. Readings disagree if the residual is significant and above the relevance limit; without repeats, if
it exceeds ``MAX_NOISE_RATIO`` times the known noise.

A wrong reading takes part in every relation that disagrees. A relation that agrees clears the readings to whose faults
it is sensitive (``clears``). A torque balance, for example, is hardly sensitive to the zero of an encoder, which
changes gravity only, and the derivative of positions is insensitive to it. Readings that take part in all disagreeing
relations and are not cleared are *in common*. A single disagreeing relation may also be explained by the physics that
it assumes.
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
SERVO = "servo (desired position and gains)"  # from which an unrecorded torque is computed
MOTOR_ENCODER, MOTOR_VELOCITY, TRACKER = "motor encoder", "motor velocity", "tracker"
PUSH_SIGNALS = ("object velocity", "end-effector velocity")


@dataclass(frozen=True)
class Relation:
    """A relation between readings.

    Attributes:
        name: Its name.
        signals: Signals of the features with its residual; for two signals their difference.
        readings: Readings that take part.
        clears: Readings to whose faults it is sensitive; they are right if it agrees.
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
    clears: tuple[str, ...] = Field((), description="readings that are right if the relation agrees")
    assumes: str = Field("", description="physics that it assumes; empty: none")
    times_noise: float = Field(description="residual in multiples of repeatability, or of noise")
    p_value: float | None = Field(None, description="p-value of lack of fit, adjusted; null: no repeats")
    agrees: bool = Field(description="whether the readings agree")


class InCommon(Schema):
    """Common readings of the relations that disagree at one joint or axis."""

    place: str = Field(description="joints or axes, as a list")
    relations: tuple[str, ...] = Field(description="relations that disagree")
    readings: tuple[str, ...] = Field((), description="readings in all of them that no relation clears")
    assumes: str = Field("", description="physics as another explanation; empty: several relations disagree")

    @property
    def in_words(self) -> str:
        """One sentence."""
        joints, relations = (
            joints_in_words(self.place.split(", ")),
            " and ".join(f"the {relation}" for relation in self.relations),
        )
        if len(self.relations) > 1:
            common = (
                f"in common: {' or '.join(self.readings)}" if self.readings else "no single reading is in all of them"
            )
            return f"{joints}: {relations} do not hold; {common}"
        causes = [*self.readings, *([f"the physics ({self.assumes})"] if self.assumes else [])]
        possible = " or ".join(causes) or "a reading of another joint"
        return f"{joints}: {relations} does not hold; possible causes: {possible}"


class AgreementDocument(Schema):
    """Agreement of the readings, relation by relation."""

    relations: tuple[RelationDocument, ...] = Field((), description="relations, joint by joint")
    in_common: tuple[InCommon, ...] = Field((), description="joints and axes with disagreeing relations")

    @property
    def by_joint(self) -> dict[str, dict[str, RelationDocument]]:
        """Relations by joint or axis, and by name."""
        relations: dict[str, dict[str, RelationDocument]] = {}
        for relation in self.relations:
            relations.setdefault(relation.place, {})[relation.relation] = relation
        return relations

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the relations that were measured."""
        return tuple(dict.fromkeys(relation.relation for relation in self.relations))

    def readings_of(self, name: str) -> tuple[str, ...]:
        """Readings that take part in a relation."""
        return next(relation.readings for relation in self.relations if relation.relation == name)

    def against(self, name: str) -> tuple[str, ...]:
        """Joints and axes at which a relation does not hold."""
        return tuple(relation.place for relation in self.relations if relation.relation == name and not relation.agrees)


def joints_in_words(places: Sequence[str]) -> str:
    """Joints and axes in a few words, as "joints 1 to 4, 7"; those of several arms by their names."""
    numbers = [int(match[1]) for place in places if (match := re.fullmatch(r"joint(\d+)", place))]
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
        tested += [(relation, *entry) for entry in _by_index(source.clusters, partial(_belongs_to, relation))]
    if source.runs is not None:
        tested += [
            (POSITION_SLOPE, *entry) for entry in _by_index(slope_clusters(source.runs.runs), lambda feature: True)
        ]
        tested += [
            (OBJECT_TRACKING, *entry) for entry in _by_index(tracking_clusters(source.clusters), lambda feature: True)
        ]
    limited = source.noise_size() is None
    raw = {
        number: RotationNull(clusters).lack_of_fit([item.mean for item in clusters])
        for number, (_, _, clusters) in enumerate(tested if source.repeated else ())
    }
    p_values: dict[str, float] = {}
    for relation in dict.fromkeys(relation for relation, _, _ in tested):  # each is a question of its own
        of_relation = {str(n): p for n, p in raw.items() if p is not None and tested[n][0] is relation}
        p_values |= benjamini_hochberg(of_relation)
    motor = any(relation is ELASTIC_DEFLECTION for relation, _, _ in tested)
    computed = source.recording is not None and "torque" not in source.recording.signals
    documents = []
    for number, (relation, place, clusters) in enumerate(tested):
        p = p_values.get(str(number))
        noise, relevant = (_size(clusters, scale, limited) for scale in (expected_of, relevant_of))
        agrees = relevant < MAX_NOISE_RATIO if p is None else p >= SIGNIFICANCE_LEVEL or relevant < 1.0
        documents.append(
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
    documents.sort(key=lambda relation: _order(relation.place))
    document = AgreementDocument(relations=tuple(documents))
    return document.model_copy(update={"in_common": tuple(_in_common(document))})


def _belongs_to(relation: Relation, feature: Feature) -> bool:
    return feature.signal in relation.signals and feature.phase in FREE_MOTION_PHASES


def _renamed(readings: Sequence[str], motor: bool, computed: bool) -> list[str]:
    """Readings of a relation, without the velocity of a motor without encoder, with servos in place of sensors."""
    names = [SERVO if computed and name == TORQUE else name for name in readings]
    return [name for name in names if motor or name != MOTOR_VELOCITY]


def _by_index(clusters: Sequence[Cluster], belongs: Callable[[Feature], bool]) -> list[tuple[str, list[Cluster]]]:
    """Clusters by joint or axis, restricted to its features that belong to a relation."""
    indices = dict.fromkeys(f.index for item in clusters for f in item.features if belongs(f))
    clusters_by_index = []
    for index in indices:
        masks = [[belongs(f) and f.index == index for f in item.features] for item in clusters]
        restricted = [item.only(mask, False) for item, mask in zip(clusters, masks, strict=True) if any(mask)]
        clusters_by_index.append((index, restricted))
    return clusters_by_index


def _size(clusters: Sequence[Cluster], scale: Callable[[Cluster, bool], Array], limited: bool) -> float:
    """Root mean square of the mean residuals in multiples of ``scale``."""
    return root_mean_square(np.concatenate([item.mean / scale(item, limited) for item in clusters]))


def _in_common(document: AgreementDocument) -> list[InCommon]:
    """Common readings of the disagreeing relations; joints with equal results share an entry."""
    places_by_result: dict[tuple[tuple[str, ...], tuple[str, ...], str], list[str]] = {}
    for place, relations in document.by_joint.items():
        disagreeing = [relation for relation in relations.values() if not relation.agrees]
        if not disagreeing:
            continue
        cleared = {name for relation in relations.values() if relation.agrees for name in relation.clears}
        common = [
            name for name in disagreeing[0].readings if all(name in relation.readings for relation in disagreeing)
        ]
        readings = tuple(name for name in common if name not in cleared)
        assumes = disagreeing[0].assumes if len(disagreeing) == 1 else ""
        places_by_result.setdefault(
            (tuple(relation.relation for relation in disagreeing), readings, assumes), []
        ).append(place)
    return [
        InCommon(place=", ".join(places), relations=relations, readings=readings, assumes=assumes)
        for (relations, readings, assumes), places in places_by_result.items()
    ]


def _order(place: str) -> tuple[str, int, str]:
    """Sort key: by arm, joints in their order before axes."""
    arm, _, index = place.rpartition(".")
    number = re.fullmatch(r"joint(\d+)", index)
    return (arm, int(number[1]), "") if number else (arm, 10**6, index)


def slope_clusters(runs: Sequence[MeasuredRun]) -> list[Cluster]:
    """Mean velocity minus difference quotient of the position, in windows of free motion, by condition.

    Args:
        runs: Runs; those without signals are left out.
    """
    rows: dict[str, list[Array]] = {}
    features: dict[str, tuple[Feature, ...]] = {}
    first_runs: dict[str, MeasuredRun] = {}
    for run in runs:
        if run.signals.time.size < 2:
            continue
        several, values, run_features = len(run.setup.physics.arms) > 1, [], []
        limit = VELOCITY_LIMIT_RAD_S * Proportion.of(run.physics).factor("rad/s")
        for number, (window, signals) in enumerate(zip(run.setup.windows, run.windowed, strict=True)):
            for name, arm in () if window.contact else signals.arms.items():
                duration = float(signals.time[-1] - signals.time[0])
                mean = np.trapezoid(arm.velocity, signals.time, axis=0) / duration
                values.append(mean - (arm.position[-1] - arm.position[0]) / duration)
                label = f"{name}." if several else ""
                run_features += [
                    Feature("free", POSITION_SLOPE.name, f"{label}joint{joint + 1}", number, "rad/s", limit, name)
                    for joint in range(arm.velocity.shape[1])
                ]
        if values and features.setdefault(run.condition, tuple(run_features)) == tuple(run_features):
            rows.setdefault(run.condition, []).append(np.concatenate(values))
            first_runs.setdefault(run.condition, run)
    keys_and_features = {name: (first_runs[name].condition_key, features[name]) for name in rows}
    return _clusters({name: np.array(residuals) for name, residuals in rows.items()}, keys_and_features)


def tracking_clusters(clusters: Sequence[Cluster]) -> list[Cluster]:
    """Residual of the object velocity minus residual of the end-effector velocity during the push, by condition.

    Args:
        clusters: Conditions of trials; conditions without an object are skipped.
    """
    rows: dict[str, Array] = {}
    keys_and_features: dict[str, tuple[tuple[str, str, str], tuple[Feature, ...]]] = {}
    patterns: dict[str, tuple[str, Array]] = {}
    for item in clusters:
        positions = {(f.signal, f.index, f.bin): n for n, f in enumerate(item.features) if f.phase == "push"}
        arms = {f.arm for f in item.features if f.arm}
        pairs = [
            (object_feature, positions[PUSH_SIGNALS[1], index, number])
            for (signal, index, number), object_feature in positions.items()
            if signal == PUSH_SIGNALS[0] and (PUSH_SIGNALS[1], index, number) in positions
        ]
        if not pairs or len(arms) > 1:  # either of two arms may push
            continue
        first, second = (list(column) for column in zip(*pairs, strict=True))
        scaled = item.residuals * item.sigma
        discrepancy = item.discrepancy_factor * item.sigma
        rows[item.name] = scaled[:, first] - scaled[:, second]
        patterns[item.name] = item.discrepancy_group, discrepancy[:, first] - discrepancy[:, second]
        keys_and_features[item.name] = (
            item.condition_key,
            tuple(replace(item.features[n], signal=OBJECT_TRACKING.name) for n in first),
        )
    return _clusters(rows, keys_and_features, patterns)


def _clusters(
    rows: dict[str, Array],
    keys_and_features: dict[str, tuple[tuple[str, str, str], tuple[Feature, ...]]],
    patterns: dict[str, tuple[str, Array]] | None = None,
) -> list[Cluster]:
    """Clusters from residuals of repeats ``(n, F)`` by condition, with key and features.

    ``patterns``: by condition, key of the clusters that share amplitudes, and patterns of the discrepancy ``(k, F)``.
    """
    names_by_features: dict[tuple[Feature, ...], list[str]] = {}
    for name, (_, features) in keys_and_features.items():
        names_by_features.setdefault(features, []).append(name)
    pooled = {features: pooled_error([rows[name] for name in names]) for features, names in names_by_features.items()}
    clusters = []
    for name, (key, features) in keys_and_features.items():
        pooled_of_layout = pooled[features]
        pure = np.zeros(len(features)) if pooled_of_layout is None else pooled_of_layout
        limit = np.array([feature.relevance_limit for feature in features]) / 2.0
        group, discrepancy = (None, np.zeros((0, len(features)))) if patterns is None else patterns[name]
        discrepancy_sigma = np.sqrt(np.sum(np.square(discrepancy), axis=0))
        sigma = np.maximum(np.sqrt(pure**2 + limit**2 + discrepancy_sigma**2), 1e-12)
        clusters.append(
            Cluster(
                name=name,
                condition_key=key,
                layout=f"{len(names_by_features)}: {list(names_by_features).index(features)}",
                unit=name,
                contact=False,
                features=features,
                residuals=rows[name] / sigma,
                sigma=sigma,
                pure_error=pure / sigma,
                discrepancy=discrepancy_sigma / sigma,
                patterns=discrepancy / sigma if discrepancy.size else None,
                discrepancy_key=group,
            )
        )
    return clusters
