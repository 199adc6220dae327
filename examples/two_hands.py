# SPDX-License-Identifier: Apache-2.0
"""Two arms on one torso grab a box: jumps of both hands in a hit, with a torso that turns and with a locked one.

./run python examples/two_hands.py
"""

import json
from typing import Any

from impact_rs_analysis.application.nominal_impact import velocities_before
from impact_rs_sim import ImpactProblem, compute_impact_map, load_scenario
from impact_rs_sim.robots.robot import load_facts
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scene import Scene
from impact_rs_sim.schema import validate

SIDES = {"left": 0.35, "right": -0.35}  # m, where the arms stand on the torso
TORSO = {"mass": 12.0, "com": [0.0, 0.0, -0.2], "inertia": [0.8, 0.0, 0.0, 0.2, 0.0, 0.8]}  # kg, m, kg m^2
PER_JOINT = ("motor_inertia_rotor", "motor_inertia_reduced", "stiffness", "damping")  # in drive
LOCKED = 1e6  # kg m^2, motor inertia of a brake


def two_armed_robot(arm: str) -> dict[str, Any]:
    """Facts of a torso that turns about z and carries an arm of some robot on either side."""
    arm_facts = json.loads(load_facts(arm).model_dump_json())
    joints = [{"name": "waist", "xyz": [0.0, 0.0, 0.0], "rpy": [0.0, 0.0, 0.0]}]
    links, limits = [{**TORSO, "name": "torso"}], arm_facts["limits"]
    for side, lateral in SIDES.items():
        for number, (joint, link) in enumerate(zip(arm_facts["joints"], arm_facts["links"], strict=True), start=1):
            first = {"parent": "torso", "xyz": [0.0, lateral, joint["xyz"][2]]} if number == 1 else {}
            joints.append({**joint, "name": f"{side}_{number}", **first})
            links.append({**link, "name": f"{side}_link_{number}"})
    of_waist = {"position_min_rad": -2.0, "position_max_rad": 2.0, "velocity_rad_s": 2.0, "torque_Nm": 200.0}
    return {
        "source": f"a torso with two arms {arm}", "joints": joints, "links": links,
        "flange": {**arm_facts["flange"], "link": "left_link_7"},
        "hands": [{**arm_facts["flange"], "name": "right", "link": "right_link_7"}],
        "limits": {name: [value, *(2 * limits[name])] for name, value in of_waist.items()},
    }  # fmt: skip


def scenario() -> Scenario:
    """The scenario grab, whose two robots become one with two hands."""
    data = json.loads(load_scenario("grab").model_dump_json())
    left, right = data["robots"].values()
    motors = {key: [0.3, *(2 * left["drive"][key])] for key in PER_JOINT}
    guess = [0.0, *left["impact"].pop("joint_guess"), *right["impact"].pop("joint_guess")]
    robot = {
        "facts": two_armed_robot("franka_fer"), "base": {"position": [0.0, 0.0, 0.0]},
        "end_effector": left["end_effector"],
        "drive": {**left["drive"], **motors},
        "impact": {**left["impact"], "joint_guess": guess},
        "hands": {"right": {"end_effector": right["end_effector"], "impact": right["impact"]}},
    }  # fmt: skip
    hit = {"ante_velocity": [0.0, -0.4, 0.0], "joint_1": 0.0, "joint_1_velocity": 0.0, "hands": {"right": [0.0] * 3}}
    cases = {"case_1": {"label": "the left hand hits, the right one waits", "robots": {"robot": hit}}}
    return validate(Scenario, {**data, "robots": {"robot": robot}, "cases": cases}, "two hands")


def main() -> dict[str, tuple[float, float]]:
    """Change of velocity of left and right hand along y [m/s], with a torso that turns and a locked one."""
    scene = Scene.resolve(scenario(), "cat_food", "case_1")
    problem, before, changes = ImpactProblem.at_nominal_impact(scene), velocities_before(scene), {}
    for name, waist in (("turns", problem.motor_inertia["robot"][0]), ("locked", LOCKED)):
        problem.motor_inertia["robot"][0] = waist
        result = compute_impact_map(problem)
        left, right = (float(result.end_effector_twist[hand][1] - before[hand][1]) for hand in ("robot", "right"))
        print(f"torso {name}: left hand {left:+.4f} m/s, right hand {right:+.4f} m/s, ", end="")
        print(f"torso {result.joint_velocity['robot'][0]:+.4f} rad/s, box {result.object_twist[1]:+.4f} m/s")
        changes[name] = (left, right)
    return changes


if __name__ == "__main__":
    main()
