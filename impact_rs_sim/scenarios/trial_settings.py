# SPDX-License-Identifier: Apache-2.0
"""Settings of the trials of a scenario: cases, times, controller, sensors, scatter and uncertainties."""

from __future__ import annotations

import re
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from impact_rs_sim.schema import NonNegative, Positive, Schema, Vector3, omitted

# Relative half width of the 95 % interval of an assumed motor inertia: from 0 to three times the assumed value. Three
# times an assumed B_theta is B_rho, the inertia if the torque loop has no effect. Known values of B_rho, over the value
# scaled from a Franka arm by the torque limit: 0.8 to 2.5 in a Franka arm, 1.1 to 3.1 in a UR10e, 0.05 to 0.4 in a
# Stäubli TX40 (docs/real_data.md). 18 of 19 joints lie below three.
ASSUMED_MOTOR_INERTIA = 2.0


class CaseRobot(Schema):
    """Motion of one arm in one case."""

    ante_velocity: Vector3 = Field(description="end-effector velocity just before impact [m/s]")
    joint_1: float | None = Field(
        None,
        description="position of joint 1 at impact (seven joints) [rad], prismatic [m]; absent: free",
    )
    joint_1_velocity: float | None = Field(
        None, description="velocity of joint 1 at impact [rad/s], prismatic [m/s]; absent: least-norm joint velocity"
    )
    hands: dict[str, Vector3] = omitted(
        {}, description="velocity of each further hand just before impact, by name [m/s]"
    )
    posture: dict[str, float] = omitted(
        {},
        description="positions of other joints at impact, such as joint_3: 0.2 [rad], prismatic [m]",
    )

    @model_validator(mode="after")
    def _a_posture_of_joints(self) -> Self:
        for name in self.posture:
            if re.fullmatch(r"joint_[1-9]\d*", name) is None:
                raise ValueError(f"posture names {name!r}, expected joint_N with N counted from 1 at the base")
        if self.joint_1 is not None and "joint_1" in self.posture:
            raise ValueError("joint_1 stands in posture as well; give it once [rad]")
        if self.joint_1_velocity is not None and 0 not in self.posture_joints:
            raise ValueError("joint_1_velocity needs a position joint_1 [rad]")
        return self

    @property
    def posture_joints(self) -> dict[int, float]:
        """Joints of the posture task, counted from 0, in order, with their positions at impact [rad]."""
        positions = {int(name.removeprefix("joint_")) - 1: value for name, value in self.posture.items()}
        if self.joint_1 is not None:
            positions[0] = self.joint_1
        return dict(sorted(positions.items()))


class Case(Schema):
    """One ante-impact state."""

    label: str = Field(description="name for tables and figures")
    robots: dict[str, CaseRobot] = Field(description="what each arm does")


class Excursion(Schema):
    """A motion there and back without contact; its peak speed is the magnitude of the case's ante_velocity."""

    start: Vector3 = Field(description="start of frame E from its pose at impact [m]")
    end: Vector3 = Field(description="turning point of frame E from its pose at impact [m]")
    joint_1: float = Field(
        0.0,
        description="change of joint 1 to the turning point, if the posture task holds it [rad], prismatic [m]",
    )
    twist: float = Field(description="rotation of E about the pad's normal to the turning point [rad]")
    begin: Positive = Field(description="when the motion begins [s]")
    rest: Annotated[float, Field(ge=0.0, description="rest at the turning point [s]")]


class Timing(Schema):
    """Times of a trial."""

    nominal_impact: Positive = Field(description="T_nom, nominal impact time [s]")
    approach: Positive = Field(description="duration of the motion that ends at T_nom [s]")
    overrun: Positive = Field(description="the ante-impact reference keeps its velocity past T_nom for this long [s]")
    stop: Positive = Field(description="time in which it then stops [s]")
    push: Positive = Field(description="duration of the post-impact reference until rest [s]")
    slide: Positive = Field(description="time in which the pad stops sliding on the object [s]")
    duration: Positive = Field(description="length of a trial [s]")
    window_before: Positive = Field(description="net feedback starts at T_nom minus this [s]")
    window_after: Positive = Field(description="net feedback ends at T_nom plus this [s]")
    control_period: Positive = Field(0.001, description="period of the controller [s]")
    drive_period: Positive = Field(0.00025, description="period of the torque loop [s]")

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.approach > self.nominal_impact:
            raise ValueError("timing.approach must not be longer than timing.nominal_impact [s]")
        if self.nominal_impact + self.window_after > self.duration:
            raise ValueError("the window ends after the trial: nominal_impact + window_after > duration [s]")
        ratio = self.control_period / self.drive_period
        if abs(ratio - round(ratio)) > 1e-9 or ratio < 1:
            raise ValueError("control_period must be a whole multiple of drive_period [s]")
        return self

    @property
    def window(self) -> tuple[float, float]:
        """``(t1, t2)`` of paper eq. a_fb_net [s]."""
        return self.nominal_impact - self.window_before, self.nominal_impact + self.window_after

    @property
    def substeps(self) -> int:
        """Drive periods in one control period."""
        return round(self.control_period / self.drive_period)

    @property
    def ticks(self) -> int:
        """Control periods in one trial."""
        return round(self.duration / self.control_period)


class Gains(Schema):
    """Task gains and weights of the QP (paper eqs. e_pos_ante, e_theta_ante, QP_ante)."""

    position: Positive = Field(description="k_p [1/s^2]")
    orientation: Positive = Field(description="k_theta before impact [1/s^2]")
    orientation_post: Positive = Field(description="k_theta after impact [1/s^2]")
    posture: Positive = Field(description="k_q [1/s^2]")
    position_weight: Positive = Field(description="w_p [s^4/m^2]")
    orientation_weight: Positive = Field(description="w_theta [s^4/rad^2]")
    posture_weight: Positive = Field(description="w_q [s^4/rad^2]")


class Detection(Schema):
    """Impact detection from measured signals."""

    observer_gain: Positive = Field(description="gain of the momentum observer [1/s]")
    threshold: Positive = Field(description="force against the motion at an impact [N]")
    arm_before: Positive = Field(description="detection starts this long before T_nom [s]")


class Control(Schema):
    """Controller settings."""

    gains: Gains = Field(description="task gains")
    interim_duration: Positive = Field(description="Delta t_int, length of the interim mode [s]")
    clamp_force: NonNegative = Field(
        0.0, description="force of every pad after the impact [N]; 0: the object is pushed, not held"
    )
    detection: Detection = Field(description="impact detection")
    reference_contact: Literal["first", "settled"] = omitted(
        "first",
        description="velocity that the post-impact references follow: after the first simultaneous impact, or of the "
        "settled contact",
    )


class Sensors(Schema):
    """Errors of the measurement."""

    joint_position_resolution: NonNegative = Field(description="encoder step [rad], prismatic [m]")
    joint_velocity_noise: NonNegative = Field(description="standard deviation [rad/s], prismatic [m/s]")
    joint_torque_noise: NonNegative = Field(description="standard deviation [N m], prismatic [N]")
    object_position_noise: NonNegative = Field(description="standard deviation [m]")
    object_orientation_noise: NonNegative = Field(description="standard deviation [rad]")
    object_period: Positive = Field(0.004, description="period of the object tracker [s]")


class Scatter(Schema):
    """Scatter from trial to trial, standard deviations."""

    object_position: NonNegative = Field(description="object position in the plane [m]")
    object_yaw: NonNegative = Field(description="object orientation about z [rad]")
    joint_position: NonNegative = Field(description="initial joint positions [rad], prismatic [m]")
    support_friction: NonNegative = Field(description="relative change of the support's friction [-]")


class Uncertainties(Schema):
    """Uncertainty of the numbers of a prediction: half the width of a 95 % interval, and its source."""

    motor_inertia: NonNegative = Field(
        0.10,
        description="B_theta, or B_rho of a rigid drive, relative, each joint by itself; the paper: known to 10 %; "
        f"assumed: {ASSUMED_MOTOR_INERTIA:g}, from none to three times the number [-]",
    )
    link_inertia: NonNegative = Field(
        0.05, description="M of the arm, relative; difference of published parameter sets [-]"
    )
    object_mass: NonNegative = Field(0.005, description="mass with its moments, relative; kitchen scales [-]")
    object_inertia: NonNegative = Field(0.10, description="each moment, relative; assumed [-]")
    object_com_offset: NonNegative = Field(0.005, description="centre of mass, each axis; assumed, as above [m]")
    object_position: NonNegative = Field(
        0.003,
        description="object in the plane, each axis; twice scatter.object_position of push [m]",
    )
    object_yaw: NonNegative = Field(0.012, description="object about z; twice scatter.object_yaw of push [rad]")
    joint_position: NonNegative = Field(
        4e-4, description="each joint; twice scatter.joint_position of push [rad], prismatic [m]"
    )
    joint_velocity: NonNegative = Field(
        4e-3,
        description="each joint; twice sensors.joint_velocity_noise of push [rad/s], prismatic [m/s]",
    )
    contact_point: NonNegative = Field(
        0.002, description="contact points along the pad, each axis; assumed: rounded edges [m]"
    )
    pad_friction: NonNegative = Field(0.20, description="Coulomb coefficient, relative; assumed [-]")
    support_friction: NonNegative = Field(0.20, description="Coulomb coefficient, relative; assumed [-]")
    restitution: NonNegative = Field(0.0, description="restitution [-]")
