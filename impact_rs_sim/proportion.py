# SPDX-License-Identifier: Apache-2.0
"""Scaling of absolute limits to the size of a robot, by dimensional analysis.

Ranges of parameters, noticeable changes and relevance limits are stated for a Franka arm. For another robot they are
scaled by dimensional analysis (Buckingham 1914), with the mass of its links, its reach, and the time of fall over the
reach, all relative to the Franka arm:

    m,    l,    t = sqrt(l / |g|);    a quantity in kg^a m^b s^c is multiplied by m^a l^b t^c

So torques are relative to the robot's gravity torque, and verdicts do not depend on the units of mass. An arm whose
drives are strong for its mass is scaled as a heavier arm. For free bodies the limits are stated for a cube of 1 kg and
0.1 m at 1 m/s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_rs_sim.physics import ObjectPhysics, Physics
from impact_rs_sim.robots.robot import Array, Inertial, RobotFacts
from impact_rs_sim.robots.robot_model import GRAVITY_M_S2
from impact_rs_sim.shapes import BOX
from impact_rs_sim.units import dimension_of

FRANKA_MASS_KG = 16.062132  # links 1 to 7
FRANKA_REACH_M = 0.98626233  # from joint 2 along all joints to the flange
FRANKA_TORQUE_NM = 87.0  # limit of its strongest joints
CUBE_GYRATION_RADIUS_M = 0.1 / 6.0**0.5  # of the cube of 0.1 m


@dataclass(frozen=True)
class Proportion:
    """Scale of a robot relative to the Franka arm, or of a free body relative to the cube above.

    Attributes:
        mass: Ratio of the masses of the links, or of the bodies [-].
        length: Ratio of the reaches (:func:`reach_of`), or of the radii of gyration [-].
        time: Ratio of the times of fall over the reach, or of motion over the radius of gyration [-].
    """

    mass: float = 1.0
    length: float = 1.0
    time: float = 1.0

    @staticmethod
    def of(physics: Physics) -> Proportion:
        """Proportion of the arms of a scene (mean over arms); 1 without an arm."""
        if not physics.arms:
            return Proportion()
        return Proportion.of_robots([arm.facts for arm in physics.arms.values()], np.asarray(physics.gravity))

    @staticmethod
    def of_robots(robots: Sequence[RobotFacts], gravity: Array) -> Proportion:
        """Mean proportion of robots (at least one) under a gravity, ``(3,)`` [m/s^2]."""
        mass = float(np.mean([_mass(facts) for facts in robots])) / FRANKA_MASS_KG
        length = float(np.mean([reach_of(facts) for facts in robots])) / FRANKA_REACH_M
        size = float(np.linalg.norm(gravity)) or GRAVITY_M_S2
        return Proportion(mass, length, float(np.sqrt(length * GRAVITY_M_S2 / size)))

    @staticmethod
    def of_body(body: ObjectPhysics, speed: float) -> Proportion:
        """Proportion of a free body with a closing speed [m/s]."""
        length = gyration_of(body) / CUBE_GYRATION_RADIUS_M
        return Proportion(body.mass, length, length / speed)

    def driven_by(self, torque: float) -> Proportion:
        """The robot with a mass increased so that scaled limits reach its largest torque [N m]."""
        limit = FRANKA_TORQUE_NM * self.factor("N m")
        return replace(self, mass=self.mass * max(1.0, torque / limit))

    def factor(self, unit: str) -> float:
        """Factor of a quantity with this unit, ``N m`` for example.

        Raises:
            InputError: The unit is not understood.
        """
        kg, m, s = (float(power) for power in dimension_of(unit))
        return float(self.mass**kg * self.length**m * self.time**s)


def gyration_of(body: ObjectPhysics) -> float:
    """Radius of gyration of a body, rms over its axes [m]; a fixed body counts as a homogeneous box of its size."""
    per_mass = BOX.moments(1.0, body.size) if body.fixed else body.inertia / body.mass
    return float(np.sqrt(np.mean(per_mass)))


def _mass(facts: RobotFacts) -> float:
    return sum(link.mass for link in _bodies(facts))


def _bodies(facts: RobotFacts) -> list[Inertial]:
    """A floating base and the links from it to the flange."""
    base: list[Inertial] = [] if facts.floating_base is None else [facts.floating_base]
    return [*base, *(facts.links[number] for number in facts.path)]


def reach_of(facts: RobotFacts) -> float:
    """Reach of an arm: length of the chain from its second joint, or its floating base, to the flange [m].

    If axes and flange meet in one point, as in a pan-tilt unit, the chain has no length, but the links have: the reach
    is at least the rms distance of their mass from that joint, along the chain,

        sum m_i (d_i + r_i)^2 / sum m_i,    r_i^2 = |c_i|^2 + tr(I_i) / (2 m_i)

    with d_i the length of the chain to joint i, c_i the centre of mass of link i and I_i its inertia about it.
    """
    links, start = _bodies(facts), facts.floating_base is None
    origins = [facts.joints[number].xyz for number in facts.path][start:]
    steps = np.linalg.norm([(0.0, 0.0, 0.0), *origins, facts.flange.xyz], axis=1)
    *lengths, chain = np.cumsum(steps)
    mass = np.array([link.mass for link in links])
    squared_radii = [np.sum(np.square(link.com)) + np.trace(link.inertia_matrix) / (2.0 * link.mass) for link in links]
    spread = float(mass @ np.square(np.array(lengths) + np.sqrt(squared_radii)) / np.sum(mass))
    return max(float(chain), float(np.sqrt(spread)))
