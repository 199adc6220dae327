# SPDX-License-Identifier: Apache-2.0
"""The 18 velocity jumps of the study in exported models: MuJoCo and Drake against the impact map.

Every object and case of ``push`` and ``grab`` is exported with rigid pads, hit in the simulator with motors that carry
gravity and Coriolis forces, and compared 0.3 ms later with the impact map: velocity of the end effectors along the axis
of the scenario, over the velocity after the impact (the study's measure) and over the jump, and the largest error of a
joint over the largest jump of one. Drake (solver TAMSI) is optional: ``./run python -m pip install drake``.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from benchmarks.harness import Case, Row, Work
from benchmarks.results import Table
from impact_rs_sim.descriptions import FORMATS, ExportedScene
from impact_rs_sim.impact_map import ImpactProblem, compute_impact_map
from impact_rs_sim.model import load_model
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import Scene

DURATION = 3e-4  # s
DRAKE_STEP = 1e-5  # s
GOAL = 2.0  # %


def in_mujoco(scene: ExportedScene) -> dict[str, Array]:
    """Joint velocities after the impact."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(FORMATS["mjcf"].write(scene).text)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    ends = np.cumsum([state.position.size for state in scene.arms.values()])
    for _ in range(round(DURATION / model.opt.timestep)):
        mujoco.mj_forward(model, data)
        data.qfrc_applied[: ends[-1]] = data.qfrc_bias[: ends[-1]]
        mujoco.mj_step(model, data)
    return dict(zip(scene.arms, np.split(data.qvel[: ends[-1]].copy(), ends[:-1]), strict=True))


def in_drake(scene: ExportedScene) -> dict[str, Array]:
    """Joint velocities after the impact, without gravity on the arms."""
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, ContactModel, DiscreteContactApproximation
    from pydrake.systems.framework import DiagramBuilder

    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, DRAKE_STEP)
    plant.SetUseSampledOutputPorts(False)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.sdf"
        path.write_text(FORMATS["drake"].write(scene).text, encoding="utf-8")
        Parser(plant).AddModels(str(path))
    plant.set_contact_model(ContactModel.kPoint)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kTamsi)
    plant.set_stiction_tolerance(1e-4)
    models = {name: plant.GetModelInstanceByName(name) for name in scene.arms}
    for model in models.values():
        plant.set_gravity_enabled(model, False)
    plant.Finalize()
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    state = plant.GetMyMutableContextFromRoot(context)
    for name, model in models.items():
        plant.SetPositions(state, model, scene.arms[name].position)
        plant.SetVelocities(state, model, scene.arms[name].velocity)
    for _ in range(round(DURATION / DRAKE_STEP)):
        state.SetDiscreteState(plant.EvalUniquePeriodicDiscreteUpdate(state))
    return {name: np.asarray(plant.GetVelocities(state, model)) for name, model in models.items()}


def errors(scene: Scene, hit: Callable[[ExportedScene], dict[str, Array]]) -> tuple[float, float, float]:
    """Error over velocity, over jump, and largest of a joint over the largest jump of one [%]."""
    axis = "xyz".index(scene.scenario.axis)

    def along(velocities: dict[str, Array]) -> float:
        rows = [scene.models[name].jacobian(scene.arms[name].position)[axis] @ v for name, v in velocities.items()]
        return float(np.mean(rows))

    predicted = compute_impact_map(ImpactProblem.at_nominal_impact(scene)).joint_velocity
    simulated = hit(ExportedScene.of(scene, load_model("nominal")))
    before = {name: state.velocity for name, state in scene.arms.items()}
    error = along(simulated) - along(predicted)
    joint_error = max(float(np.abs(simulated[name] - predicted[name]).max()) for name in simulated)
    largest = max(float(np.abs(predicted[name] - before[name]).max()) for name in simulated)
    return tuple(
        100.0 * value
        for value in (error / along(predicted), error / (along(predicted) - along(before)), joint_error / largest)
    )  # type: ignore[return-value]


SIMULATORS: dict[str, Callable[[ExportedScene], dict[str, Array]]] = {"MuJoCo": in_mujoco, "Drake": in_drake}


def cases(options: argparse.Namespace) -> list[Case]:
    """Objects and cases of the study."""
    del options
    scenarios = [load_scenario(name) for name in ("push", "grab")]
    return [
        Case(f"{scenario.name} {item} {case}", (scenario.name, item, case))
        for scenario in scenarios
        for item in scenario.objects
        for case in scenario.cases
    ]


def run(case: Case, work: Work) -> Row:
    """Errors of one hit in every simulator that is installed."""
    del work
    name, *object_and_case = case.inputs
    scene = Scene.resolve(load_scenario(name), *object_and_case)
    packages = {"MuJoCo": "mujoco", "Drake": "pydrake"}
    return {
        "set": f"{name} {object_and_case[0]}",
        "errors": {
            simulator: errors(scene, hit)
            for simulator, hit in SIMULATORS.items()
            if find_spec(packages[simulator]) is not None
        },
    }


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """A row for each object."""
    del options
    simulators = [name for name in SIMULATORS if all(name in row["errors"] for row in rows)]
    lines = []
    for name in dict.fromkeys(row["set"] for row in rows):
        cells = []
        for simulator in simulators:
            errors_of_set = np.array([row["errors"][simulator] for row in rows if row["set"] == name])
            velocity, jump, joint = (sorted(column, key=abs) for column in errors_of_set.T)
            ends = f"{velocity[0]:+.2f} to {velocity[-1]:+.2f}"
            cells.append(f"{ends} ({abs(jump[0]):.1f} to {abs(jump[-1]):.1f}; {joint[-1]:.0f})")
        lines.append((name, *cells))
    within = [
        f"{sum(abs(row['errors'][simulator][0]) <= GOAL for row in rows)} of {len(rows)}" for simulator in simulators
    ]
    return Table(("Sets", *simulators), (*lines, (f"within {GOAL:g} % of the velocity", *within)))
