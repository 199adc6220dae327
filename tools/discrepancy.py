# SPDX-License-Identifier: Apache-2.0
"""The model discrepancy: how far equally valid simulations of the same parameters lie apart, feature by feature.

``./run python -m tools.discrepancy -o config/discrepancy.yaml`` (needs the extra ``peers``). Every
condition is run without noise and scatter by three simulators (Bullet, MuJoCo, and the twin with finer steps), and
replayed by the twin as if it had been measured. With f the features of
:mod:`impact_rs_analysis.evidence.replays.features`, and rms taken over conditions and the time bins of a signal,

    discrepancy = max over variants of rms (f_variant - f_replay).

It is the largest and not the mean, because variants are no sample of simulators: a further one that agrees with the
twin must not make the number smaller. A variant that interprets a parameter differently enters the discrepancy only for
kinds of trials in which the parameter is ambiguous; elsewhere it is only listed.
"""

from __future__ import annotations

import argparse
import datetime
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml
from mujoco_cell import LAYER, ContactSettings, MujocoCell

from impact_rs_analysis.evidence.cluster import Feature
from impact_rs_analysis.evidence.discrepancy import PATTERNS_FILE, Kind, write_patterns
from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun
from impact_rs_analysis.evidence.replays.simulated_trials import observed, quiet
from impact_rs_control.closed_loop import RobotCell
from impact_rs_control.plan import TrialPlan
from impact_rs_sim.plant.mechanics import Simulator
from impact_rs_sim.plant.plant import Plant
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags.trial_info import git_revision
from impact_rs_trials.spec import TrialSpec

OBJECTS = ("parcel", "cat_food", "juice")
SQUARE = [("push", name, case) for name in OBJECTS for case in ("case_1", "case_2", "case_3")]
FREE = [("excite", "none", case) for case in ("slow", "fast")]
TILTS = ((0.05, 0.02), (-0.05, 0.0), (0.0, -0.03))  # rad, of the pad about the vertical and about x
DRIFTS = ((0.15, 0.08), (-0.10, -0.05), (0.05, 0.10))  # of the velocity along x and z, over that along the normal
OBLIQUE = [
    ("push", name, case, tilt, drift)
    for name in OBJECTS
    for case, tilt, drift in zip(("case_1", "case_2", "case_3"), TILTS, DRIFTS, strict=True)
]

KINDS: tuple[Kind, ...] = ("free", "square", "oblique")

Maker = Callable[[TrialPlan], RobotCell]


@dataclass(frozen=True)
class Variant:
    """Another valid simulation of the same parameters.

    Attributes:
        name: Short name.
        sentence: Its difference from the twin that replays.
        make: Makes its plant for a trial.
        counts: Kinds of trials in whose discrepancy it is included.
    """

    name: str
    sentence: str
    make: Maker
    counts: tuple[Kind, ...] = KINDS


def _plant(plan: TrialPlan, simulator: Simulator = "bullet", finer: int = 1) -> Plant:
    """Our plant, or the twin in its place, with a torque loop that is ``finer`` times as fast."""
    scene, scenario = plan.scene, quiet(plan.scene.scenario)
    timing = scenario.timing.model_copy(update={"drive_period": scenario.timing.drive_period / finer})
    scenario = scenario.model_copy(update={"timing": timing})
    return Plant.for_trial(scenario, scene.physics, _initial(plan), scene.object, seed=0, simulator=simulator)


def _other_contacts(plan: TrialPlan) -> RobotCell:
    plant = _plant(plan)
    world = plant.world
    world.client.setPhysicsEngineParameter(contactERP=0.05, erp=0.05, globalCFM=1e-7, numSolverIterations=300)
    world.client.changeDynamics(world.support, -1, contactStiffness=5e5, contactDamping=500.0)  # N/m, N s/m a corner
    return plant


def _mujoco(plan: TrialPlan, settings: ContactSettings | None = None) -> RobotCell:
    scene = plan.scene
    settings = settings or ContactSettings()
    return MujocoCell(quiet(scene.scenario), scene.physics, _initial(plan), scene.object, 0, contacts=settings)


def _initial(plan: TrialPlan) -> dict[str, Array]:
    return {name: arm.initial for name, arm in plan.arms.items()}


VARIANTS = (
    Variant(
        "twin_quarter_step",
        "The twin, torque loop and all, with a quarter of the step.",
        lambda plan: _plant(plan, "twin", finer=4),
    ),
    Variant("bullet", "Our plant: contacts and links of Bullet.", _plant),
    Variant(
        "bullet_half_step",
        "Our plant, torque loop and Bullet with half the step.",
        lambda plan: _plant(plan, finer=2),
    ),
    Variant(
        "bullet_contacts",
        "Our plant with other solver settings: a support of finite stiffness, a quarter of the error reduction, "
        "regularised friction, five times the iterations.",
        _other_contacts,
    ),
    Variant("mujoco", "The MuJoCo cell: other links, drives, contacts and solver, steps of 1/8000 s.", _mujoco),
    Variant(
        "mujoco_soft_friction",
        "The same with friction that creeps: three times slower and a hundred times softer where it sticks.",
        lambda plan: _mujoco(
            plan, ContactSettings(pad_friction_rate=333.0, support_friction_rate=100.0, friction_stiffness_ratio=100.0)
        ),
    ),
    Variant(
        "mujoco_layer",
        "The MuJoCo cell with a pad that is a homogeneous layer of the same stiffness: against tilting it is a third "
        "as stiff as four contact points in its corners. A stiffness of the whole face does not say which is meant.",
        lambda plan: _mujoco(plan, ContactSettings(pad_spread=LAYER)),
        counts=("oblique",),
    ),
)


def difference(spec: TrialSpec, plant: RobotCell) -> tuple[tuple[Feature, ...], Array]:
    """Features of a trial on a plant minus those of its replay, ``(F,)``; closes the plant."""
    run = MeasuredRun.of(observed(spec, plant))
    predicted = run.setup.features_of(run.setup.replayed(run.setup.physics))
    assert predicted is not None, "the replay hits nothing"
    return run.features, run.measured - predicted


@dataclass(frozen=True)
class Group:
    """Features that share a discrepancy: one signal of one phase, one joint or axis.

    Attributes:
        kind: Of the trials: free, square or oblique.
        feature: Its first feature, for names and unit.
        differences: By variant, ``(conditions, bins)``, in the unit.
    """

    kind: Kind
    feature: Feature
    differences: dict[str, Array]

    @property
    def by_variant(self) -> dict[str, float]:
        """Rms over conditions and bins."""
        return {name: float(np.sqrt(np.mean(np.square(rows)))) for name, rows in self.differences.items()}

    @property
    def largest(self) -> str:
        """Name of the variant furthest from the twin, of those that are included for this kind."""
        sizes = self.by_variant
        counted = (variant.name for variant in VARIANTS if self.kind in variant.counts)
        return max(counted, key=lambda name: sizes[name])

    @property
    def value(self) -> float:
        """The discrepancy."""
        return self.by_variant[self.largest]

    @property
    def by_bin(self) -> list[float]:
        """Rms of the largest variant over the conditions, bin by bin."""
        return list(np.sqrt(np.mean(np.square(self.differences[self.largest]), axis=0)))

    @property
    def shared_over_conditions(self) -> float:
        """Share of the largest variant's square that one pattern over the bins explains in all conditions alike."""
        return _shared(self.differences[self.largest])

    @property
    def shared_over_bins(self) -> float:
        """Share of the largest variant's square that one number for all bins of a condition explains."""
        return _shared(self.differences[self.largest].T)


def _shared(rows: Array) -> float:
    """Share of the square of ``(k, m)`` that the mean over k explains; 0 is what independent rows give on average."""
    count, total = rows.shape[0], float(np.sum(np.square(rows)))
    if count < 2 or total < 1e-30:
        return float("nan")
    raw = count * float(np.sum(np.square(rows.mean(axis=0)))) / total
    return (raw - 1.0 / count) / (1.0 - 1.0 / count)


def _share(value: float) -> float | None:
    """Two digits; None where there is nothing to share."""
    return None if np.isnan(value) else round(value, 2)


def specs_by_kind() -> dict[Kind, list[TrialSpec]]:
    """Trials to run, by kind."""
    return {
        "square": [TrialSpec.of(load_scenario(scenario), object_name, case) for scenario, object_name, case in SQUARE],
        "oblique": [
            TrialSpec.of(oblique(load_scenario(s), c, *angles), object_name, c)
            for s, object_name, c, *angles in OBLIQUE
        ],
        "free": [TrialSpec.of(load_scenario(scenario), object_name, case) for scenario, object_name, case in FREE],
    }


def oblique(scenario: Scenario, case: str, tilt: tuple[float, float], drift: tuple[float, float]) -> Scenario:
    """A push whose pad is tilted and whose velocity is not along the normal.

    Args:
        scenario: With one arm.
        case: Full name of the case that is changed.
        tilt: Of the pad about the vertical and about x [rad].
        drift: Velocity along x and z over that along the normal [-].
    """
    (name, robot), spec = next(iter(scenario.robots.items())), scenario.cases[case]
    tilt_rotation = pin.rpy.rpyToMatrix(tilt[1], 0.0, tilt[0])
    impact = robot.impact.model_copy(
        update={key: tuple(tilt_rotation @ np.array(getattr(robot.impact, key))) for key in ("pad_normal", "pad_up")}
    )
    robot_case = spec.robots[name]
    normal_speed = -robot_case.ante_velocity[1]
    velocity = (drift[0] * normal_speed, robot_case.ante_velocity[1], drift[1] * normal_speed)
    drifting_case = spec.model_copy(
        update={"robots": {name: robot_case.model_copy(update={"ante_velocity": velocity})}}
    )
    return scenario.model_copy(
        update={
            "robots": {name: robot.model_copy(update={"impact": impact})},
            "cases": {**scenario.cases, case: drifting_case},
        }
    )


Differences = tuple[list[Feature], list[tuple[str, str, list[float]]]]


def measure() -> tuple[list[Group], dict[Kind, Differences]]:
    """Run everything; returns the differences in groups, and row by row."""
    groups, tables = [], {}
    for kind, specs in specs_by_kind().items():
        results = {variant.name: [difference(spec, variant.make(spec.plan)) for spec in specs] for variant in VARIANTS}
        common = set.intersection(*(set(features) for rows in results.values() for features, _ in rows))
        features = [feature for feature in next(iter(results.values()))[0][0] if feature in common]
        differences = {
            name: np.array(
                [
                    [dict(zip(row_features, values, strict=True))[feature] for feature in features]
                    for row_features, values in rows
                ]
            )
            for name, rows in results.items()
        }
        tables[kind] = (
            features,
            [
                (variant.name, f"{spec.object} {spec.case}", row.tolist())
                for variant in VARIANTS
                if kind in variant.counts
                for spec, row in zip(specs, differences[variant.name], strict=True)
            ],
        )
        members: dict[tuple[str, str, str], list[int]] = {}
        for number, feature in enumerate(features):
            members.setdefault(feature.group, []).append(number)
        groups += [
            Group(
                kind,
                features[numbers[0]],
                {name: rows_of_variant[:, numbers] for name, rows_of_variant in differences.items()},
            )
            for numbers in members.values()
        ]
    return groups, tables


def _round(number: float, limit: float) -> float:
    """Three digits; 0 where it is rounding error of the simulations."""
    return float(f"{number:.3g}") if number > 1e-6 * limit else 0.0


def document(groups: list[Group], seconds: float) -> dict[str, Any]:
    """Content of the file."""
    conditions = [f"{scenario}: {object_name}, {case}" for scenario, object_name, case in (*SQUARE, *FREE)] + [
        f"{scenario}: {object_name}, {case}, pad tilted by {tilt} rad, velocity {drift} off the normal"
        for scenario, object_name, case, tilt, drift in OBLIQUE
    ]
    return {
        "provenance": {
            "date": datetime.date.today().isoformat(),
            "command": "./run python -m tools.discrepancy -o config/discrepancy.yaml",
            "revision": git_revision(),
            "versions": {name: version(name) for name in ("impact-rs", "pybullet", "mujoco", "pin", "numpy")},
            "seconds": round(seconds),
            "conditions": conditions,
            "combined": "max over variants with the same parameters of the rms over conditions and time bins",
        },
        "variants": {
            variant.name: variant.sentence
            + ("" if variant.counts == KINDS else f" In value of {', '.join(variant.counts)} only.")
            for variant in VARIANTS
        },
        "entries": [
            {
                "kind": group.kind,
                "phase": group.feature.phase,
                "signal": group.feature.signal,
                "index": group.feature.index,
                "unit": group.feature.unit,
                "value": _round(group.value, group.feature.relevance_limit),
                "largest": group.largest,
                "shared_over_conditions": _share(group.shared_over_conditions),
                "shared_over_bins": _share(group.shared_over_bins),
                "by_bin": [_round(value, group.feature.relevance_limit) for value in group.by_bin],
                "by_variant": {
                    name: _round(value, group.feature.relevance_limit) for name, value in group.by_variant.items()
                },
            }
            for group in groups
        ],
    }


HEADER = """\
# Model discrepancy: how far equally valid simulations of the same parameters lie apart, for every feature that the
# diagnosis looks at. Made by tools/discrepancy.py, which says how; do not edit by hand.
#
# kind: free (nothing is hit), square (face on face, along the normal) or oblique hit. phase, signal, index: what the
# feature is, in unit. value: rms of variant minus replay over conditions and time bins, of the variant that lies
# furthest off (largest). by_bin: the same, bin by bin. by_variant: rms of every variant, also of those not in value.
# shared_over_conditions: share of the square that one pattern over the bins explains in all conditions;
# shared_over_bins: share that one number for all bins of a condition explains; both of the largest variant, 0 where
# independent, null where there is one bin or nothing. How features move together: the table beside this file.
"""


class _Dumper(yaml.SafeDumper):
    """Entries in one line each."""


def _represent(dumper: yaml.SafeDumper, data: dict[str, Any]) -> yaml.Node:
    return dumper.represent_mapping("tag:yaml.org,2002:map", data, flow_style="phase" in data or "by_variant" in data)


_Dumper.add_representer(dict, _represent)


def write(content: dict[str, Any], path: Path) -> None:
    """Write the file."""
    text = yaml.dump(content, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=400)
    path.write_text(HEADER + text, encoding="utf-8")


def table(groups: list[Group]) -> str:
    """The discrepancies, joints and axes of a signal together, in its unit and over its relevance limit."""
    merged: dict[tuple[str, str, str, str], list[Group]] = {}
    for group in groups:
        feature = group.feature
        index = "joints" if "joint" in feature.index else feature.index
        merged.setdefault((group.kind, feature.phase, feature.signal, index), []).append(group)
    names = [variant.name for variant in VARIANTS]
    lines = [
        " ".join([f"{'':46s} {'unit':>6s} {'value':>9s} {'/limit':>6s}", *(f"{name[:16]:>16s}" for name in names)])
    ]
    lines[0] += "  shared: conditions, bins"
    for (trials, phase, signal, index), members in merged.items():

        def mean(values: list[float]) -> float:
            return float(np.sqrt(np.mean(np.square(values))))

        value, feature = mean([group.value for group in members]), members[0].feature
        label = f"{trials}, {phase}: {signal} {index}"
        limit = feature.relevance_limit
        cells = [f"{mean([group.by_variant[name] for group in members]) / limit:16.2f}" for name in names]
        shares = [
            np.average([getattr(group, share) for group in members], weights=[group.value**2 for group in members])
            for share in ("shared_over_conditions", "shared_over_bins")
        ]
        lines.append(
            f"{label:46s} {feature.unit:>6s} {value:9.3g} {value / limit:6.2f} {' '.join(cells)}"
            f"  {shares[0]:8.2f} {shares[1]:8.2f}"
        )
    return "\n".join(lines)


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "-o", "--output", type=Path, help="file to write, YAML; a table of how features move together goes beside it"
    )
    arguments = parser.parse_args()
    began = time.perf_counter()
    groups, tables = measure()
    seconds = time.perf_counter() - began
    print(table(groups))
    if arguments.output is not None:
        write(document(groups, seconds), arguments.output)
        write_patterns(arguments.output.with_name(PATTERNS_FILE), tables)


if __name__ == "__main__":
    main()
