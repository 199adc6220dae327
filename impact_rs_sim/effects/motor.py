# SPDX-License-Identifier: Apache-2.0
"""Effects on the motor side of the joints: friction, and the inertia that the torque loop leaves.

Friction is stated in terms of the desired torque (tau_fric of paper eq. EOM_motor_mod); the whole law is
:class:`~impact_rs_sim.physics.JointFriction`. Its terms are separate effects that add up:

* Coulomb and viscous friction, and the breakaway torque above sliding friction (Stribeck curve, Armstrong-Hélouvry et
  al. 1994, Automatica 30).
* ``-k |tau_J| sign(dtheta)``: friction of gear teeth grows with the load. Bittencourt and Gunnarsson (2012, J. Dyn.
  Sys. Meas. Control 134) measured it on an industrial arm, with its dependence on temperature; servo models have it as
  the load-dependent term (Duclusaud et al. 2025, ICRA: BAM, models M3 to M6). If |tau_J| hardly varies along a motion
  it resembles Coulomb friction, and if the motion reverses with the torque it resembles a torque gain. The same motion
  with and without a load separates them: only this friction grows. A load drives a joint back with (1 - k) of its
  torque; with k >= 1 the gear is self-locking, like a worm. A joint that moves both ways has k < 1.
* ``-a |sign(dtheta)|``: friction that differs by direction, F_c + a forward and F_c - a backward, as of screws and of
  belts under tension. In motion it equals a torque offset; under closed brakes only the offset remains.
* At a reversal, friction does not jump: lubricated teeth and bearings yield before they slide, and friction changes its
  sign over a range of velocities, ``s = tanh(dtheta / v_r)`` (Andersson, Söderberg and Björklund 2007, Tribology
  International 40). The effect adds a width per joint to the v_r of the model, which is small against the speeds of a
  motion; so a search finds only wider reversals. It acts on all dry friction of the joint, whatever its source.
* Joints under stiff control resist an impact with more than their inertia (Wang, Dehio and Kheddar 2022,
  arXiv:2202.12646, who model them as locked). Under a half-sine force of duration T, a joint of inertia M with
  stiffness K and damping D moves, to first order in K and D, like an uncontrolled joint of inertia

      M + c,    c = (1/4 - 1/pi^2) K T^2 + D T / 2

  Stiff joints differ little in K, so one c holds for all joints: c = 0 is a free arm, a large c a locked one.
* Friction of a shaft that turns with two joints, as in a wrist whose last motor drives through the axis before it (fvm6
  and fsm6 of a Staubli TX40 in FIGAROH's examples): both joints feel it, against ``dtheta_i + r dtheta_i+1`` with
  r = 1, or r = -1 if the axes of the model have opposite directions.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from impact_rs_sim.effects.base import SINGLE_IMPACT, ArmEffect, Parameter, Values, number
from impact_rs_sim.effects.quantity_laws import Added, Multiplied
from impact_rs_sim.physics import ArmPhysics, ShaftFriction
from impact_rs_sim.robots.robot import PINION_RADIUS_M, travel_per_rad


def _stribeck(arm: ArmPhysics, values: Values) -> ArmPhysics:
    if not np.any(values["breakaway"]):
        return arm  # keep the Stribeck velocity that the arm may have: without breakaway a new one has no meaning
    friction = replace(
        arm.friction,
        stribeck=arm.friction.stribeck + values["breakaway"],
        stribeck_velocity=number(values, "stribeck_velocity") * travel_per_rad(arm.facts.joint_types),
    )
    return replace(arm, friction=friction)


def _with_shafts(arm: ArmPhysics, values: Values, ratio: float) -> ArmPhysics:
    if not (np.any(values["coulomb"]) or np.any(values["viscous"])):
        return arm
    shafts = (*arm.friction.shafts, ShaftFriction(values["coulomb"], values["viscous"], ratio))
    return replace(arm, friction=replace(arm.friction, shafts=shafts))


def _of_sums(arm: ArmPhysics, values: Values) -> ArmPhysics:
    return _with_shafts(arm, values, 1.0)


def _of_differences(arm: ArmPhysics, values: Values) -> ArmPhysics:
    return _with_shafts(arm, values, -1.0)


def _stiff_control(arm: ArmPhysics, values: Values) -> ArmPhysics:
    turns = np.array([kind == "revolute" for kind in arm.facts.joint_types])
    return replace(arm, motor_inertia_reduced=arm.motor_inertia_reduced + number(values, "inertia") * turns)


COULOMB_FRICTION = ArmEffect(
    name="joint_coulomb_friction",
    acts_on="motor side",
    sentence="Each joint resists motion with a constant torque that flips sign with the direction of motion.",
    parameters=(Parameter("coulomb", "N m", 0.0, 0.0, 5.0, 0.1, "Coulomb friction torque", per_joint=True),),
    law=Added("friction.coulomb", ("coulomb",), per_joint=True),
)

VISCOUS_FRICTION = ArmEffect(
    name="joint_viscous_friction",
    acts_on="motor side",
    sentence="Each joint resists motion with a torque that grows with its speed.",
    parameters=(Parameter("viscous", "N m s/rad", 0.0, 0.0, 5.0, 0.1, "viscous friction", per_joint=True),),
    law=Added("friction.viscous", ("viscous",), per_joint=True),
)

STRIBECK_FRICTION = ArmEffect(
    name="joint_stribeck_friction",
    acts_on="motor side",
    sentence="Each joint sticks a little: it resists more at low speed than when it moves fast.",
    parameters=(
        Parameter("breakaway", "N m", 0.0, 0.0, 5.0, 0.2, "torque above Coulomb at rest", per_joint=True),
        Parameter(
            "stribeck_velocity",
            "rad/s",
            0.05,
            0.01,
            0.5,
            0.02,
            f"speed at which the excess has fallen to 1/e; prismatic: behind a pinion of {PINION_RADIUS_M:g} m",
            shape=True,
            grid=(0.01, 0.02, 0.035, 0.05, 0.08, 0.12, 0.2, 0.35, 0.5),
            hidden=(0.03, 0.15),
        ),
    ),
    law=_stribeck,
)

LOAD_DEPENDENT_FRICTION = ArmEffect(
    name="joint_load_dependent_friction",
    acts_on="motor side",
    sentence=(
        "Each joint resists motion with a share of the torque that it transmits; with one load it resembles constant "
        "friction or a gain of the torque, and the same motion with another load separates them."
    ),
    parameters=(
        Parameter(
            "coefficient",
            "-",
            0.0,
            0.0,
            1.0,
            0.01,
            "friction torque over transmitted torque",
            per_joint=True,
            firm=True,
        ),
    ),
    law=Added("friction.load", ("coefficient",), per_joint=True),
    lasting=True,
    shown_by_load=True,
    drawn=False,
    calibration="record one motion without and with a known load, and compare both (diagnose --minus)",
)

ASYMMETRIC_FRICTION = ArmEffect(
    name="joint_asymmetric_friction",
    acts_on="motor side",
    sentence=(
        "The dry friction of a joint differs between its two directions; in motion it resembles an offset of the "
        "torque, which is there under closed brakes as well."
    ),
    parameters=(
        Parameter(
            "difference",
            "N m",
            0.0,
            -5.0,
            5.0,
            0.1,
            "Coulomb friction more forward than in the mean, and less backward",
            per_joint=True,
        ),
    ),
    law=Added("friction.asymmetry", ("difference",), per_joint=True),
    calibration="read the torque with the brakes on and the drives idle: an offset remains, friction does not",
    drawn=False,
)

REVERSAL_WIDTH = ArmEffect(
    name="joint_reversal_width",
    acts_on="motor side",
    sentence="The dry friction of a joint turns over a wider range of velocities where the joint reverses.",
    parameters=(
        Parameter(
            "width",
            "rad/s",
            0.0,
            0.0,
            0.1,
            0.005,
            "velocity at which dry friction has turned by 76 %, beyond that of the model",
            per_joint=True,
        ),
    ),
    law=Added("friction.smoothing", ("width",), per_joint=True),
    calibrates=True,
    calibration="move every joint slowly there and back, at a tenth of its usual speed",
)

SHAFT_FRICTION = (
    Parameter(
        "coulomb",
        "N m",
        0.0,
        0.0,
        5.0,
        0.1,
        "Coulomb friction of the shaft of this joint and the next one",
        per_joint=True,
        except_joint=-1,
    ),
    Parameter(
        "viscous",
        "N m s/rad",
        0.0,
        0.0,
        5.0,
        0.1,
        "viscous friction of the shaft of this joint and the next one",
        per_joint=True,
        except_joint=-1,
    ),
)
SHAFT_EXPERIMENT = "move each of two neighbouring joints alone, then both in the same and in opposite directions"

JOINT_SUM_FRICTION = ArmEffect(
    name="joint_sum_friction",
    acts_on="motor side",
    sentence=(
        "A shaft that turns with the sum of two neighbouring joint angles, as in a wrist, resists motion, and both "
        "joints feel it."
    ),
    parameters=SHAFT_FRICTION,
    law=_of_sums,
    calibrates=True,
    calibration=SHAFT_EXPERIMENT,
)

JOINT_DIFFERENCE_FRICTION = ArmEffect(
    name="joint_difference_friction",
    acts_on="motor side",
    sentence=(
        "A shaft that turns with the difference of two neighbouring joint angles, as in a wrist, resists motion, and "
        "both joints feel it."
    ),
    parameters=SHAFT_FRICTION,
    law=_of_differences,
    calibrates=True,
    calibration=SHAFT_EXPERIMENT,
)

MOTOR_INERTIA_SCALE = ArmEffect(
    name="motor_inertia_scale",
    acts_on="motor side",
    sentence="The motor inertia that the torque loop leaves is a multiple of the assumed one.",
    parameters=(Parameter("scale", "-", 1.0, 0.1, 3.0, 0.1, "B_theta over its assumed value"),),
    law=Multiplied("motor_inertia_reduced", "scale"),
)

ADDED_MOTOR_INERTIA = ArmEffect(
    name="added_motor_inertia",
    acts_on="motor side",
    sentence="The motor of a joint has more inertia than the model says.",
    parameters=(
        Parameter("inertia", "kg m^2", 0.0, 0.0, 5.0, 0.05, "added motor inertia, seen at the joint", per_joint=True),
    ),
    law=Added("motor_inertia_reduced", ("inertia",), per_joint=True),
    calibrates=True,
)

STIFF_CONTROL = ArmEffect(
    name="stiff_control",
    acts_on="motor side",
    sentence="A stiff controller holds the joints in an impact: all resist with more than their inertia.",
    parameters=(
        Parameter("inertia", "kg m^2", 0.0, 0.0, 20.0, 0.05, "inertia that control adds to every revolute joint"),
    ),
    law=_stiff_control,
    phases=SINGLE_IMPACT,
    drawn=False,
)
