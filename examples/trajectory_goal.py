# SPDX-License-Identifier: Apache-2.0
"""The hit of a scenario as a goal for the robot's own joint trajectory controller, where the cell cannot command it.

The ante-impact reference of the scenario: from rest to the ante-impact velocity, at that velocity through the place of
the hit and on, and to rest. Prints the goal of control_msgs/action/FollowJointTrajectory; with ``--start`` the one that
moves the arm to where the hit begins, in ten seconds. It knows nothing but the arm: look at a simulated trial first.

    ./run python examples/trajectory_goal.py push_ur5e --start
    ./run python examples/trajectory_goal.py push_ur5e cat_food case_2
"""

import argparse
import json

import numpy as np
import pinocchio as pin

from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.cell.driver_profiles import profile_of
from impact_rs_trials.cell.robot_states import joint_names
from impact_rs_trials.spec import TrialSpec

PERIOD = 0.02  # s, between two points
SLOWLY = 10.0  # s, to the start


def goal(scenario_name: str, object_name: str | None = None, case: str | None = None, start: bool = False) -> dict:
    """The goal for the one arm of a scenario; without names its first object and case.

    Args:
        scenario_name: Name or path of the scenario.
        object_name: Name of the object.
        case: Name of the case.
        start: Only to where the hit begins.
    """
    scenario = load_scenario(scenario_name)
    spec = TrialSpec.of(scenario, object_name or next(iter(scenario.objects)), case or next(iter(scenario.cases)))
    ((name, arm),) = spec.plan.arms.items()
    model, path, period = spec.scene.models[name], arm.ante_position, scenario.timing.control_period
    names = joint_names(profile_of(scenario).joints_of([name]), {name: model.joint_count})[name]
    points = [_point(SLOWLY, arm.initial, 0.0 * arm.initial)]
    if not start:
        points, q = [], arm.initial
        step = round(PERIOD / period)
        for tick in range(step, scenario.timing.ticks + 1, step):
            posture = dict(zip(arm.posture, arm.ante_posture.position[tick].tolist(), strict=True))
            q = model.inverse_kinematics(pin.SE3(arm.orientation[tick], path.position[tick]), posture, q)
            tasks = np.vstack((model.jacobian(q), np.eye(q.size)[list(arm.posture)]))
            task_velocity = np.concatenate((path.velocity[tick], np.zeros(3), arm.ante_posture.velocity[tick]))
            points.append(_point(tick * period, q, np.linalg.lstsq(tasks, task_velocity)[0]))
    return {"trajectory": {"joint_names": names, "points": points}}


def _point(time: float, position: np.ndarray, velocity: np.ndarray) -> dict:
    """A point of the trajectory [s, rad, rad/s]."""
    seconds, nanoseconds = divmod(round(1e9 * time), 10**9)
    return {
        "positions": [round(float(value), 6) for value in position],
        "velocities": [round(float(value), 6) for value in velocity],
        "time_from_start": {"sec": seconds, "nanosec": nanoseconds},
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenario")
    parser.add_argument("object", nargs="?")
    parser.add_argument("case", nargs="?")
    parser.add_argument("--start", action="store_true", help="the goal that moves the arm to where the hit begins")
    arguments = parser.parse_args()
    print(json.dumps(goal(arguments.scenario, arguments.object, arguments.case, arguments.start)))
