"""``impact-rs map``: one prediction of the impact map."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from impact_rs_cli.arguments import add_contact
from impact_rs_cli.terminal import Terminal, add_json, declare
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import ImpactProblem, predict_impact
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.scene import Scene

TEXT = """\
Predict the velocities after the nominal impact of a scenario.

Solves the rigid impact map: ante-impact configuration and velocities in, post-impact velocities of all joints and
bodies and the contact impulses out. --motor-inertia says which inertia the motors have during the impact: 'reduced'
(B_theta, what the robot's torque loop leaves of it), 'rotor' (B_rho, all of it) or 'zero'. --contact says when:
'first', just after the first simultaneous impact, or 'settled', when pads that keep pushing have aligned and go on with
the object.

example:
  impact-rs map push cat_food case_2
  impact-rs map push cat_food 2 --motor-inertia rotor --json
  impact-rs map grab cat_food 2 --contact settled

Units: m/s and rad/s, impulses in N s, vectors in the axes of the world frame, SI throughout."""


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the command."""
    declare(parser, run, TEXT)
    parser.add_argument("scenario", metavar="SCENARIO", help="name of a scenario, or path of its YAML file")
    parser.add_argument("object", metavar="OBJECT", help="name of an object of the scenario")
    parser.add_argument("case", metavar="CASE", help="name of a case of the scenario; 2 is short for case_2")
    parser.add_argument(
        "--motor-inertia", choices=("reduced", "rotor", "zero"), default="reduced", help="default: %(default)s"
    )
    add_contact(parser, "how far the impact is carried on")
    parser.add_argument(
        "--engine", choices=("bullet", "pinocchio"), help="solver of the first contact; default: pinocchio"
    )
    add_json(parser)


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    scenario = load_scenario(args.scenario)
    scenario.object(args.object)
    scene = Scene.resolve(scenario, args.object, args.case)
    problem = ImpactProblem.at_nominal_impact(scene, args.motor_inertia)
    if args.contact == "settled" and args.engine == "bullet":
        raise InputError("--engine bullet answers for the first contact only; leave it out with --contact settled")
    result = predict_impact(problem, args.contact, args.engine or "pinocchio")
    before = {name: scene.models[name].jacobian(arm.position) @ arm.velocity for name, arm in scene.arms.items()}
    terminal.result(
        {
            "scenario": scenario.name,
            "object": args.object,
            "case": scene.case_name,
            "motor_inertia": args.motor_inertia,
            "contact": args.contact,
            "ante": {
                "end_effector_twist": {name: twist.tolist() for name, twist in before.items()},
                "joint_position": {name: arm.position.tolist() for name, arm in scene.arms.items()},
                "joint_velocity": {name: arm.velocity.tolist() for name, arm in scene.arms.items()},
            },
            "post": {
                "end_effector_twist": {name: twist.tolist() for name, twist in result.end_effector_twist.items()},
                "joint_velocity": {name: velocity.tolist() for name, velocity in result.joint_velocity.items()},
                "object_twist": result.object_twist.tolist(),
            },
            "contacts": [
                {
                    "body_a": contact.body_a,
                    "body_b": contact.body_b,
                    "position": contact.position.tolist(),
                    "normal": contact.normal.tolist(),
                    "impulse": contact.impulse.tolist(),
                }
                for contact in result.contacts
            ],
            "residual": {name: float(value) for name, value in vars(result.residual).items()},
            "engine": result.engine,
            "iterations": result.iterations,
            "elapsed_ms": 1e3 * result.elapsed,
        }
    )
    labels = f"{scenario.object(args.object).label}, {scenario.case(args.case).label}"
    terminal.say(f"{scenario.name}: {labels}, motor inertia '{args.motor_inertia}', contact '{args.contact}'")
    for name, twist in result.end_effector_twist.items():
        terminal.say(f"  {name:<8} v before {_vector(before[name][:3])} m/s, after {_vector(twist[:3])} m/s")
    terminal.say(f"  {'object':<8} v after  {_vector(result.object_twist[:3])} m/s")
    total = sum((c.impulse for c in result.contacts if c.body_b != "support"), np.zeros(3))
    terminal.say(
        f"  impulse of the pads on the object {_vector(total)} N s; {result.engine}, "
        f"residual {result.residual.largest:.1e}, {1e3 * result.elapsed:.1f} ms"
    )
    return 0


def _vector(values: Any) -> str:
    return "[" + ", ".join(f"{value + 0.0:.3f}" for value in values) + "]"
