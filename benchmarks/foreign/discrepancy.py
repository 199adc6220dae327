"""The model discrepancy: how far equally valid simulations of the same parameters lie apart, feature by feature.

``./run python -m benchmarks.foreign.discrepancy -o config/discrepancy.yaml`` (needs the extra ``peers``). Every
condition is run without noise and scatter: by the twin itself and by variants that nobody could call worse. With f the
features of :mod:`impact_rs_analysis.evidence.features`, and rms taken over conditions and the time bins of a signal,

    discrepancy = max over variants of rms (f_variant - f_twin).

The largest and not the mean: variants are no sample of simulators. A further one that happens to agree with the twin
says nothing about those that do not, and must not make the number smaller. A variant that reads a parameter otherwise
is listed beside them and does not count: what it shows is an effect, in one direction, and no spread.
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
import yaml

from benchmarks.foreign.cell import LAYER, ContactSettings, MujocoCell
from impact_rs_analysis.evidence.features import Feature, extract, layout
from impact_rs_analysis.evidence.signals import SignalCollector
from impact_rs_analysis.evidence.twin import MARGIN, Start, observed_until, quiet, run_twin
from impact_rs_control.closed_loop import RobotCell, run_closed_loop, without_garbage_collection
from impact_rs_control.plan import TrialPlan, plan_trial
from impact_rs_sim.plant import Plant
from impact_rs_sim.robot import Array
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.scene import Scene
from impact_rs_trials.bags.trial_info import git_revision

CONDITIONS = (
    *(("push", name, case) for name in ("parcel", "cat_food", "juice") for case in ("case_1", "case_2", "case_3")),
    *(("excite", "none", case) for case in ("slow", "fast")),
)

Maker = Callable[[TrialPlan], RobotCell]


@dataclass(frozen=True)
class Variant:
    """Another valid simulation of the same parameters.

    Attributes:
        name: Short name.
        sentence: What it does otherwise than the twin.
        make: Makes its plant for a trial.
        counts: Whether every parameter means the same as in the twin.
    """

    name: str
    sentence: str
    make: Maker
    counts: bool = True


def _plant(plan: TrialPlan, drive_period: float | None = None) -> Plant:
    """Our plant, as the twin runs it."""
    scene, start = plan.scene, Start.nominal(plan)
    scenario = quiet(scene.scenario)
    if drive_period is not None:
        scenario = scenario.model_copy(
            update={"timing": scenario.timing.model_copy(update={"drive_period": drive_period})}
        )
    return Plant(scenario, scene.physics, start.joints, scene.object, seed=0)


def _half_step(plan: TrialPlan) -> RobotCell:
    return _plant(plan, plan.scene.scenario.timing.drive_period / 2.0)


def _other_contacts(plan: TrialPlan) -> RobotCell:
    plant = _plant(plan)
    world = plant.world
    world.client.setPhysicsEngineParameter(contactERP=0.05, erp=0.05, globalCFM=1e-7, numSolverIterations=300)
    world.client.changeDynamics(world.support, -1, contactStiffness=5e5, contactDamping=500.0)  # N/m, N s/m a corner
    return plant


def _mujoco(plan: TrialPlan, settings: ContactSettings | None = None) -> RobotCell:
    scene, start = plan.scene, Start.nominal(plan)
    settings = settings or ContactSettings()
    return MujocoCell(quiet(scene.scenario), scene.physics, start.joints, scene.object, 0, contacts=settings)


VARIANTS = (
    Variant("bullet_half_step", "Our plant, torque loop and Bullet with half the step.", _half_step),
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
        "as stiff as four contact points in its corners.",
        lambda plan: _mujoco(plan, ContactSettings(pad_spread=LAYER)),
        counts=False,
    ),
)


def features_of(plan: TrialPlan, plant: RobotCell) -> Array:
    """Features of a trial on a plant, ``(k,)``; closes the plant."""
    collector, until = SignalCollector(plan), observed_until(plan) + MARGIN
    try:
        with without_garbage_collection():
            for tick in run_closed_loop(plan, plant):
                collector.add(tick.number, tick.measurement, tick.commands)
                if tick.measurement.time >= until:
                    break
    finally:
        plant.close()
    features = extract(collector.signals(), plan)
    assert features is not None, "nothing was hit"
    return features


@dataclass(frozen=True)
class Group:
    """Features that share a discrepancy: one signal of one phase, one joint or axis.

    Attributes:
        hit: Whether the trials hit the object.
        feature: Its first feature, for names and unit.
        differences: By variant, ``(conditions, bins)``, in the unit.
    """

    hit: bool
    feature: Feature
    differences: dict[str, Array]

    @property
    def by_variant(self) -> dict[str, float]:
        """Rms over conditions and bins."""
        return {name: float(np.sqrt(np.mean(np.square(rows)))) for name, rows in self.differences.items()}

    @property
    def largest(self) -> str:
        """Name of the variant that counts and lies furthest from the twin."""
        sizes = self.by_variant
        return max((variant.name for variant in VARIANTS if variant.counts), key=lambda name: sizes[name])

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


def measure() -> list[Group]:
    """Run everything and group the differences."""
    groups = []
    for hit in (True, False):
        plans = [
            plan_trial(Scene.resolve(load_scenario(scenario), thing, case))
            for scenario, thing, case in CONDITIONS
            if (scenario == "push") is hit
        ]
        twins = [extract(run_twin(p, p.scene.physics, Start.nominal(p), observed_until(p)), p) for p in plans]
        differences = {
            variant.name: np.array(
                [features_of(p, variant.make(p)) - twin for p, twin in zip(plans, twins, strict=True)]
            )
            for variant in VARIANTS
        }
        arms = plans[0].scene.physics.arms
        joint_count = next(iter(arms.values())).facts.joint_count
        rows: dict[tuple[str, str, str], list[int]] = {}
        features = layout(tuple(arms), joint_count, hit)
        for number, feature in enumerate(features):
            rows.setdefault((feature.phase, feature.signal, feature.index), []).append(number)
        groups += [
            Group(hit, features[numbers[0]], {name: all_of[:, numbers] for name, all_of in differences.items()})
            for numbers in rows.values()
        ]
    return groups


def _round(number: float, floor: float) -> float:
    """Three digits; 0 where it is rounding error of the simulations."""
    return float(f"{number:.3g}") if number > 1e-6 * floor else 0.0


def document(groups: list[Group], seconds: float) -> dict[str, Any]:
    """Content of the file."""
    conditions = [f"{scenario}: {thing}, {case}" for scenario, thing, case in CONDITIONS]
    return {
        "provenance": {
            "date": datetime.date.today().isoformat(),
            "command": "./run python -m benchmarks.foreign.discrepancy -o config/discrepancy.yaml",
            "revision": git_revision(),
            "versions": {name: version(name) for name in ("impact-rs", "pybullet", "mujoco", "pin", "numpy")},
            "seconds": round(seconds),
            "conditions": conditions,
            "combined": "max over variants with the same parameters of the rms over conditions and time bins",
        },
        "variants": {
            variant.name: variant.sentence + ("" if variant.counts else " Not in value.") for variant in VARIANTS
        },
        "entries": [
            {
                "hit": group.hit,
                "phase": group.feature.phase,
                "signal": group.feature.signal,
                "index": group.feature.index,
                "unit": group.feature.unit,
                "value": _round(group.value, group.feature.floor),
                "largest": group.largest,
                "shared_over_conditions": _share(group.shared_over_conditions),
                "shared_over_bins": _share(group.shared_over_bins),
                "by_bin": [_round(value, group.feature.floor) for value in group.by_bin],
                "by_variant": {name: _round(value, group.feature.floor) for name, value in group.by_variant.items()},
            }
            for group in groups
        ],
    }


HEADER = """\
# Model discrepancy: how far equally valid simulations of the same parameters lie apart, for every feature that the
# diagnosis looks at. Made by benchmarks/foreign/discrepancy.py, which says how; do not edit by hand.
#
# hit: whether the trial hits an object. phase, signal, index: the feature, in unit. value: rms of variant minus twin
# over conditions and time bins, of the variant that lies furthest off (largest). by_bin: the same, bin by bin.
# by_variant: rms of every variant, also of those not in value. shared_over_conditions: share of the square that one
# pattern over the bins explains in all conditions; shared_over_bins: share that one number for all bins of a condition
# explains; both of the largest variant, 0 where independent, null where there is one bin or nothing.
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
    """The discrepancies, joints and axes of a signal together, in its unit and over the floor of its feature."""
    merged: dict[tuple[bool, str, str, str], list[Group]] = {}
    for group in groups:
        feature = group.feature
        kind = "joints" if "joint" in feature.index else feature.index
        merged.setdefault((group.hit, feature.phase, feature.signal, kind), []).append(group)
    names = [variant.name for variant in VARIANTS]
    lines = [
        " ".join([f"{'':46s} {'unit':>6s} {'value':>9s} {'/floor':>6s}", *(f"{name[:16]:>16s}" for name in names)])
    ]
    lines[0] += "  shared: conditions, bins"
    for (hit, phase, signal, kind), members in merged.items():

        def mean(values: list[float]) -> float:
            return float(np.sqrt(np.mean(np.square(values))))

        value, feature = mean([group.value for group in members]), members[0].feature
        label = f"{'hit' if hit else 'free trial'}, {phase}: {signal} {kind}"
        cells = [f"{mean([group.by_variant[name] for group in members]) / feature.floor:16.2f}" for name in names]
        shares = [
            np.average([getattr(group, which) for group in members], weights=[group.value**2 for group in members])
            for which in ("shared_over_conditions", "shared_over_bins")
        ]
        lines.append(
            f"{label:46s} {feature.unit:>6s} {value:9.3g} {value / feature.floor:6.2f} {' '.join(cells)}"
            f"  {shares[0]:8.2f} {shares[1]:8.2f}"
        )
    return "\n".join(lines)


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, help="file to write, YAML")
    arguments = parser.parse_args()
    began = time.perf_counter()
    groups = measure()
    seconds = time.perf_counter() - began
    print(table(groups))
    if arguments.output is not None:
        write(document(groups, seconds), arguments.output)


if __name__ == "__main__":
    main()
