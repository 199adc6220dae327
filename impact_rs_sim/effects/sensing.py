# SPDX-License-Identifier: Apache-2.0
"""Effects of sensors: encoders, torque sensors, velocities, object tracker, clocks (:mod:`impact_rs_sim.readings`).

They change the readings of a motion, not its physics; in closed loop the controller acts on the readings. Readings of
the twist at a single impact: :mod:`impact_rs_sim.twist_readings`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from impact_rs_sim.effects.base import SINGLE_IMPACT, ArmEffect, Parameter, SceneEffect, Values
from impact_rs_sim.effects.quantity_laws import Added, Multiplied
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.rotations import AXES

SENSING = "sensing"
CONTACT_PHASES = ("contact",)
# Ranges of encoders are firm: errors of 6 degrees in a zero or 10 % in a gear ratio are visible to the eye; zeros of
# industrial arms are accurate to some mrad.

BUTTERWORTH_LAG = Parameter(
    "lag", "s", 0.0, 0.0, 0.2, 0.002, "sqrt(2) / (2 pi f) with the cut-off f, its delay at low frequencies"
)


ENCODER_OFFSET = ArmEffect(
    name="encoder_offset",
    acts_on=SENSING,
    sentence="The zero of a joint's encoder is off: the joint stands elsewhere than it reads.",
    parameters=(
        Parameter("offset", "rad", 0.0, -0.1, 0.1, 0.002, "reading minus position of the link", True, firm=True),
    ),
    law=Added("readings.position_offset", ("offset",), per_joint=True),
    lasting=True,
    reading="{joint} reads {size} {more}",
    calibration="hold still in six poses far apart",
)


ENCODER_SCALE = ArmEffect(
    name="encoder_scale",
    acts_on=SENSING,
    sentence="A joint's encoder reads angles and velocities by a factor too large, as with a wrong gear ratio.",
    parameters=(Parameter("scale", "-", 1.0, 0.9, 1.1, 0.002, "reading over position of the link", True, firm=True),),
    law=Multiplied("readings.position_scale", "scale", per_joint=True),
    lasting=True,
    reading="{joint} reads angles {size} {more}",
    calibration="move every joint between two marks of known angle",
)


MOTOR_ENCODER_OFFSET = ArmEffect(
    name="motor_encoder_offset",
    acts_on=SENSING,
    sentence="The zero of the encoder of a motor is off.",
    parameters=(
        Parameter("offset", "rad", 0.0, -0.1, 0.1, 0.002, "reading minus position of the motor", True, firm=True),
    ),
    law=Added("readings.motor_offset", ("offset",), per_joint=True),
    lasting=True,
    reading="the motor of {joint} reads {size} {more}",
    calibration="hold still without a load, and compare motors with links",
)


TORQUE_SENSOR_GAIN = ArmEffect(
    name="torque_sensor_gain",
    acts_on=SENSING,
    sentence="A joint's torque sensor reads some percent too much or too little.",
    parameters=(Parameter("gain", "-", 1.0, 0.7, 1.3, 0.01, "reading over torque of the joint", per_joint=True),),
    law=Multiplied("readings.torque_gain", "gain", per_joint=True),
    lasting=True,
    reading="the torque of {joint} reads {size} {more}",
    calibration="hold a known weight still in several poses, and compare commanded with measured torques",
)


TORQUE_SENSOR_OFFSET = ArmEffect(
    name="torque_sensor_offset",
    acts_on=SENSING,
    sentence="A joint's torque sensor reads a torque where there is none.",
    parameters=(Parameter("offset", "N m", 0.0, -5.0, 5.0, 0.1, "reading without torque", per_joint=True),),
    law=Added("readings.torque_offset", ("offset",), per_joint=True),
    lasting=True,
    reading="the torque of {joint} reads {size} {more}",
    calibration="hold still in six poses, each reached from both sides",
)


TORQUE_SENSOR_DRIFT = ArmEffect(
    name="torque_sensor_drift",
    acts_on=SENSING,
    sentence="The zero of a joint's torque sensor drifts over the campaign, as it does while an arm warms up.",
    parameters=(Parameter("rate", "N m/s", 0.0, -5e-3, 5e-3, 1e-4, "growth since the first run", per_joint=True),),
    law=Added("readings.torque_drift", ("rate",), per_joint=True),
    lasting=True,
    reading="the torque of {joint} drifts by {size}",
    calibration="hold one pose still at the beginning, in the middle and at the end of the campaign",
)


def _torque_sensor_crosstalk(arm: ArmPhysics, v: Values) -> ArmPhysics:
    if not (np.any(v["from_previous"]) or np.any(v["from_next"])):
        return arm
    readings = replace(
        arm.readings,
        torque_from_previous=arm.readings.torque_from_previous + np.append(0.0, v["from_previous"]),
        torque_from_next=arm.readings.torque_from_next + np.append(v["from_next"], 0.0),
    )
    return replace(arm, readings=readings)


TORQUE_SENSOR_CROSSTALK = ArmEffect(
    name="torque_sensor_crosstalk",
    acts_on=SENSING,
    sentence="A joint's torque sensor reads a share of the torque of its neighbours.",
    parameters=(
        Parameter("from_previous", "-", 0.0, -0.3, 0.3, 0.01, "share of the joint before", True, 0),
        Parameter("from_next", "-", 0.0, -0.3, 0.3, 0.01, "share of the joint after", True, -1),
    ),
    law=_torque_sensor_crosstalk,
    lasting=True,
    reading="the torque of {joint} reads a share of its neighbours: {size}",
    calibration="hold a known weight still in several poses",
)


TORQUE_SENSOR_LAG = ArmEffect(
    name="torque_sensor_lag",
    acts_on=SENSING,
    sentence="Torques passed a low-pass filter before they were recorded.",
    parameters=(Parameter("lag", "s", 0.0, 0.0, 0.2, 0.002, "time constant of the filter of first order"),),
    law=Added("readings.torque_lag", ("lag",)),
    lasting=True,
    reading="torques pass a filter of {size}",
    calibration="move every joint there and back in free motion, fast",
)


TORQUE_SENSOR_BUTTERWORTH = ArmEffect(
    name="torque_sensor_butterworth",
    acts_on=SENSING,
    sentence="Torques passed a Butterworth filter of second order before they were recorded.",
    parameters=(BUTTERWORTH_LAG,),
    law=Added("readings.torque_butterworth", ("lag",)),
    lasting=True,
    reading="torques pass a Butterworth filter of {size}",
    calibration="move every joint there and back in free motion, fast",
)


TORQUE_DELAY = ArmEffect(
    name="torque_delay",
    acts_on=SENSING,
    sentence=(
        "The torque was recorded some milliseconds later than the positions (below 0: earlier); signals.torque.delay "
        "of the mapping takes it back."
    ),
    parameters=(Parameter("delay", "s", 0.0, -0.1, 0.1, 0.002, "delay of the torque after the positions"),),
    law=Added("readings.torque_delay", ("delay",)),
    phases=("free",),
    calibrates=True,
    reading="torques are recorded {size} {late}",
    calibration="move every joint there and back in free motion, fast",
)


COMMAND_CLOCK_OFFSET = ArmEffect(
    name="command_clock_offset",
    acts_on=SENSING,
    sentence="Commands carry the stamps of another clock: they act some milliseconds after or before them.",
    parameters=(Parameter("offset", "s", 0.0, -0.05, 0.03, 0.001, "from the stamp of a command until it acts"),),
    law=Added("readings.command_delay", ("offset",)),
    lasting=True,
    reading="commands act {size} {late}, by their stamps",
    calibration="command a step of the torque at rest, and see when the measured torque follows",
)


VELOCITY_LAG = ArmEffect(
    name="velocity_lag",
    acts_on=SENSING,
    sentence="Velocities of joints passed a low-pass filter before they were recorded.",
    parameters=(Parameter("lag", "s", 0.0, 0.0, 0.2, 0.002, "time constant of the filter of first order"),),
    law=Added("readings.velocity_lag", ("lag",)),
    lasting=True,
    reading="velocities pass a filter of {size}",
    calibration="move every joint there and back in free motion, fast",
)


VELOCITY_BUTTERWORTH = ArmEffect(
    name="velocity_butterworth",
    acts_on=SENSING,
    sentence="Velocities of joints passed a Butterworth filter of second order before they were recorded.",
    parameters=(BUTTERWORTH_LAG,),
    law=Added("readings.velocity_butterworth", ("lag",)),
    lasting=True,
    reading="velocities pass a Butterworth filter of {size}",
    calibration="move every joint there and back in free motion, fast",
)


VELOCITY_DELAY = ArmEffect(
    name="velocity_delay",
    acts_on=SENSING,
    sentence="Velocities of joints lag behind positions, as differences of positions over some samples do.",
    parameters=(Parameter("delay", "s", 0.0, -0.1, 0.1, 0.002, "delay of the velocities after the positions"),),
    law=Added("readings.velocity_delay", ("delay",)),
    lasting=True,
    reading="velocities are recorded {size} {late}",
    calibration="move every joint there and back in free motion, fast",
)


VELOCITY_GAIN = ArmEffect(
    name="velocity_gain",
    acts_on=SENSING,
    sentence="The velocity of a joint is recorded by a factor too large; its position is right.",
    parameters=(Parameter("gain", "-", 1.0, 0.8, 1.2, 0.01, "reading over velocity of the link", per_joint=True),),
    law=Multiplied("readings.velocity_gain", "gain", per_joint=True),
    lasting=True,
    reading="the velocity of {joint} reads {size} {more}",
    calibration="move every joint there and back in free motion, fast",
)


def _tracker_frame(physics: Physics, values: Values) -> Physics:
    moved = Added("tracker.position", ("x", "y"))(physics, values)
    turned: Physics = Added("tracker.yaw", ("yaw",))(moved, values)
    return turned


TRACKER_FRAME = SceneEffect(
    name="tracker_frame",
    acts_on=SENSING,
    sentence="The frame of the object tracker is shifted or turned against the base of the robot.",
    parameters=(
        Parameter("x", "m", 0.0, -0.2, 0.2, 0.002, "reading minus position along x, at the origin of A"),
        Parameter("y", "m", 0.0, -0.2, 0.2, 0.002, "reading minus position along y, at the origin of A"),
        Parameter("yaw", "rad", 0.0, -0.3, 0.3, 0.005, "rotation of readings about z of A"),
    ),
    law=_tracker_frame,
    phases=CONTACT_PHASES,
    lasting=True,
    reading="the frame of the object tracker is off by {size}",
    calibration="touch the object from three sides, or push it straight along two directions; motion_capture: "
    "{estimate: true} in the experiment file places the frame by the hits",
)


TRACKED_POINT = SceneEffect(
    name="tracked_point",
    acts_on=SENSING,
    sentence="The tracker follows a point beside the centre of the object.",
    parameters=(
        Parameter("x", "m", 0.0, -0.2, 0.2, 0.002, "tracked point from the centre, along x of the object"),
        Parameter("y", "m", 0.0, -0.2, 0.2, 0.002, "tracked point from the centre, along y of the object"),
    ),
    law=Added("tracker.point", ("x", "y")),
    phases=CONTACT_PHASES,
    lasting=True,
    reading="the tracked point is off the centre of the object by {size}",
    calibration="turn the object in place by quarters",
)


TRACKER_DELAY = SceneEffect(
    name="tracker_delay",
    acts_on=SENSING,
    sentence="Poses of the object carry stamps that are later than those of the joints.",
    parameters=(Parameter("delay", "s", 0.0, -0.1, 0.1, 0.002, "delay of the poses after the joints"),),
    law=Added("tracker.delay", ("delay",)),
    phases=CONTACT_PHASES,
    lasting=True,
    reading="poses of the object are recorded {size} {late}",
    calibration="push the object there and back, fast",
)


TRACKER_LAG = SceneEffect(
    name="tracker_lag",
    acts_on=SENSING,
    sentence="Poses of the object passed a low-pass filter before they were recorded.",
    parameters=(Parameter("lag", "s", 0.0, 0.0, 0.2, 0.002, "time constant of the filter of first order"),),
    law=Added("tracker.lag", ("lag",)),
    phases=CONTACT_PHASES,
    lasting=True,
    reading="poses of the object pass a filter of {size}",
    calibration="push the object there and back, fast",
)


TRACKER_BUTTERWORTH = SceneEffect(
    name="tracker_butterworth",
    acts_on=SENSING,
    sentence="Poses of the object passed a Butterworth filter of second order before they were recorded.",
    parameters=(BUTTERWORTH_LAG,),
    law=Added("tracker.butterworth", ("lag",)),
    phases=CONTACT_PHASES,
    lasting=True,
    reading="poses of the object pass a Butterworth filter of {size}",
    calibration="push the object there and back, fast",
)


def _rotation_vector(axes_text: str) -> tuple[Parameter, ...]:
    """Parameters of a rotation vector; the range exceeds pi, so that a fit can approach half a revolution.

    A rotation of 0.01 rad (0.6 deg) turns 1 % of a velocity into another component, about the calibration error of
    trackers.
    """
    meaning = f"of the rotation vector from {axes_text}"
    return tuple(Parameter(axis, "rad", 0.0, -4.0, 4.0, 0.01, f"component {axis} {meaning}") for axis in AXES)


SPIN_AXES = SceneEffect(
    name="spin_axes",
    acts_on=SENSING,
    sentence="Angular velocities were measured in axes that are turned against those of positions and velocities.",
    parameters=_rotation_vector("A to these axes"),
    law=Added("twist_readings.spin_axes", AXES),
    phases=SINGLE_IMPACT,
    reading="angular velocities are in axes turned by the rotation vector {size}",
    calibration="spin the body about three known axes in free flight",
)


def _mirrored_spins(physics: Physics, values: Values) -> Physics:
    turned = Added("twist_readings.spin_axes", AXES)(physics, values)
    mirrored: Physics = Multiplied("twist_readings.spin_factor", "factor")(turned, values)
    return mirrored


MIRRORED_SPINS = SceneEffect(
    name="mirrored_spins",
    acts_on=SENSING,
    sentence="Angular velocities were measured in left-handed axes, by a factor of -1, which may be turned as well.",
    parameters=(
        *_rotation_vector("A to these axes"),
        Parameter("factor", "-", 1.0, -1.5, 1.5, 0.02, "reading over angular velocity; -1: left-handed"),
    ),
    law=_mirrored_spins,
    phases=SINGLE_IMPACT,
    reading="angular velocities are in left-handed axes, with the rotation vector {size}",
    calibration="spin the body about three known axes in free flight",
)


TWIST_AXES = SceneEffect(
    name="twist_axes",
    acts_on=SENSING,
    sentence="Both velocities were measured in axes that are turned against those of the pose and of the contact.",
    parameters=_rotation_vector("A to these axes"),
    law=Added("twist_readings.axes", AXES),
    phases=SINGLE_IMPACT,
    reading="velocities and angular velocities are in axes turned against the pose by {size}",
    calibration="throw the body along three known axes without a spin",
)


TRACKED_POINT_OF_IMPACT = SceneEffect(
    name="tracked_point_of_impact",
    acts_on=SENSING,
    sentence="The velocity of a body is that of a tracked point beside its centre.",
    parameters=tuple(
        Parameter(axis, "m", 0.0, -0.05, 0.05, 0.001, f"tracked point from the centre, along {axis} of the body")
        for axis in AXES
    ),
    law=Added("twist_readings.point", AXES),
    phases=SINGLE_IMPACT,
    reading="the tracked point is off the centre of the body by {size}",
    calibration="spin the body about three axes in free flight, in which its centre moves straight on",
)

TWIST_EFFECTS = (SPIN_AXES, MIRRORED_SPINS, TWIST_AXES, TRACKED_POINT_OF_IMPACT)

SENSOR_EFFECTS = (
    ENCODER_OFFSET,
    ENCODER_SCALE,
    MOTOR_ENCODER_OFFSET,
    TORQUE_SENSOR_GAIN,
    TORQUE_SENSOR_OFFSET,
    TORQUE_SENSOR_DRIFT,
    TORQUE_SENSOR_CROSSTALK,
    TORQUE_SENSOR_LAG,
    TORQUE_SENSOR_BUTTERWORTH,
    COMMAND_CLOCK_OFFSET,
    VELOCITY_LAG,
    VELOCITY_BUTTERWORTH,
    VELOCITY_DELAY,
    VELOCITY_GAIN,
    TRACKER_FRAME,
    TRACKED_POINT,
    TRACKER_DELAY,
    TRACKER_LAG,
    TRACKER_BUTTERWORTH,
)
