# SPDX-License-Identifier: Apache-2.0
"""The compiled part (``src/``): the impact map from end to end, motors, and the arithmetic of a control tick."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RigidTerms

ACCEPTED: float
"""|g F| that is an answer of Newton's method [m/s]."""
MOVABLE: float
"""Least mobility of a row of J that counts in the observer, over the trace of the linear rows [-]."""
SEPARABLE: float
"""Least share of the mobility of a row that the rows before it do not explain [-]."""

class Shape:
    """A shape of :mod:`impact_rs_sim.shapes`.

    Args:
        kind: ``box``, ``sphere``, ``capsule``, ``cylinder`` or ``hull``.
        corners: Of a hull, from the middle of its bounding box, ``(k, 3)`` [m].
        faces: Of a hull, numbers of their corners in order, seen from outside anticlockwise.

    Raises:
        ValueError: No such kind, or the faces do not close around a body with its origin inside.
    """

    def __init__(self, kind: str, corners: Array | None = None, faces: Sequence[Sequence[int]] = ()) -> None: ...

_Body = tuple[Array, Array, Array, Shape | None]
"""Centre in A [m], axes in A, half extents [m], shape (None: a box)."""

def meet(partner: _Body, object: _Body, aligned: float) -> tuple[float, Array, bool, tuple[int, int] | None]:
    """Separating axis of two bodies; of face normals within ``aligned`` [m] that of the larger face.

    Returns:
        Separation along the direction that separates them best (negative: overlap) [m]; unit normal of the contact
        from ``partner`` into ``object``, ``(3,)``; whether it belongs to a face of ``object``; and, of two boxes, the
        axes of partner and object whose edges own it, None: a face does.
    """

def touching(
    partner: _Body, object: _Body, normal: Array, on_object: bool, edges: tuple[int, int] | None, tolerance: float
) -> tuple[Array, Array]:
    """Points on ``object`` ``(k, 3)`` and their gaps ``(k,)`` [m], up to ``tolerance``; the rest as above."""

class Terms:
    """A problem at its m contact points; vectors are in axes of A.

    Args:
        delassus: J_c H^-1 J_c^T, ``(3 m, 3 m)`` [1/kg].
        approach: J_c u^-, ``(3 m,)`` [m/s].
        normals: Into the object, ``(m, 3)``.
        friction: Coulomb coefficients, ``(m,)`` [-].
        rebound: e min(J_n u^-, 0), ``(m,)`` [m/s].
        inverse_mass: g, ``(m,)`` [1/kg].
        mobility: 1 / m of the object [1/kg].
    """

    def __init__(
        self,
        delassus: Array,
        approach: Array,
        normals: Array,
        friction: Array,
        rebound: Array,
        inverse_mass: Array,
        mobility: float,
    ) -> None: ...
    def linearise(
        self, impulses: Array, velocity: Array, least: Array | float
    ) -> tuple[Array, Array, Array, Array, tuple[str, ...], Array]:
        """The fields of :class:`impact_rs_sim.impact_map.laws.Linearisation`."""

    def newton(self, impulses: Array, least: Array | float, compliance: float) -> tuple[Array, bool]:
        """:func:`impact_rs_sim.impact_map.laws.newton`."""

    def harden(self, impulses: Array, least: Array | float, compliance: float) -> Array:
        """:func:`impact_rs_sim.impact_map.laws.harden`."""

    def solve(self, compliance: float) -> tuple[Array, bool, int]:
        """Impulses ``(m, 3)`` [N s] from nothing, whether they are an answer, and how many steps it took."""

    def judge(self, impulses: Array, after: Array, least: Array | float) -> tuple[float, float, float]:
        """Penetration, complementarity and friction of :class:`~impact_rs_sim.impact_map.problem.Residual` [m/s].

        Args:
            impulses: ``(m, 3)`` [N s].
            after: J_c u^+, ``(3 m,)`` [m/s].
            least: Lower bound of every normal impulse [N s].
        """

def solve_impacts(
    count: int,
    arms: Sequence[Sequence[Array | Shape | int | None]],
    object: Sequence[Array | float | Shape | None],
    contact: Sequence[Array | float],
    support: Array | None,
    rules: tuple[float, float, float, float],
    points: tuple[Sequence[int], Sequence[int], Array, Array, Array, Array] | None = None,
    near: Array | None = None,
    neighbours: Sequence[Sequence[Array | float | Shape | None]] = (),
) -> tuple[Array, Array, Array, Array, Array, Array, Array, Array, Array, Array, Array, Array, Array, Array]:
    """Solve ``count`` problems; arrays without such a first axis hold for all of them.

    Args:
        count: N.
        arms: By arm q, dq, B, least and largest q, largest speed, M (upper triangle), J of E in E[A], origin and axes
            of E in A, middle, axes and half extents of the pad in E; and, unless it is a box, its :class:`Shape`. A
            further pad of an arm follows it likewise, with its shape (None: a box) and the index of that arm, whose
            velocities it has.
        object: Position, axes, twist, mass, half extents, principal moments, centre of mass of the object; and, unless
            it is a box, its :class:`Shape`.
        contact: Friction of pads and of the support, restitution; with neighbours, friction between objects.
        support: Centre and half extents of the support in A, ``(6,)`` [m]; None: no support.
        rules: ``ALIGNED``, ``GAP_TOLERANCE``, ``PENETRATION_TOLERANCE`` [m] and ``COMPLIANCE`` [-].
        points: Contact points with their laws, in place of those where the bodies touch and of ``contact``: number of
            the first point of every problem, partner, position, normal and gap as they are returned, and the laws
            ``(M, 6)`` of :func:`impact_rs_sim.impact_map.contact_laws.table_of`.
        near: Impulses near the answer at these points, as those of other parameters, ``(M, 3)`` [N s]: a problem whose
            Newton's method does not converge from there is solved from nothing. None: all are.
        neighbours: Further objects, as ``object``; their twists follow its own in u.

    Returns:
        Status (0 solved, 1 invalid data, 2 not converged) ``(N,)``; u^+ ``(N, nv)``; twists of E
        ``(N, 6 k)``; residuals ``(N, 4)``; kinetic energy before and its gain ``(N, 2)``; steps ``(N,)``; number of the
        first contact point ``(N + 1,)``; and of all points partner (pad; the number of pads: the support; beyond it:
        the objects), state (0 open, 1 stick, 2 slide), position on the object, normal, gap, impulse, and number of the
        object.

    Raises:
        ValueError: An array has the wrong size.
    """

class Chain:
    """Rigid links of one arm in A (:mod:`impact_rs_sim.robots.robot_model`).

    Args:
        rotations: Axes of every joint in the link before, ``(n, 3, 3)``.
        origins: Position of every joint there, ``(n, 3)`` [m].
        slides: Whether it slides along its z instead of turning about it.
        masses: Of the links, ``(n,)`` [kg].
        coms: Centres of mass in the frames of their joints, ``(n, 3)`` [m].
        inertias: About the centres of mass, ``(n, 3, 3)`` [kg m^2].
        gravity: Acceleration of gravity in A, ``(3,)`` [m/s^2].
        tip: Origin of E in the last link, ``(3,)`` [m].
    """

    def __init__(
        self,
        rotations: Array,
        origins: Array,
        slides: Sequence[bool],
        masses: Array,
        coms: Array,
        inertias: Array,
        gravity: Array,
        tip: Array,
    ) -> None: ...
    def momentum(self, position: Array, velocity: Array) -> tuple[Array, Array, Array]:
        """M dq and C^T dq - g, ``(k, n)`` each, and J dq of frame E in E[A], ``(k, 6)``, at k states.

        Raises:
            ValueError: The shapes do not fit.
        """

Sigmoid = tuple[Array, Array, Array]
"""a, b, c ``(n,)``."""

Shafts = tuple[Array, Array, Array, Array]
"""F_c, F_v, r of the shafts of joints i and i + 1, ``(k (n - 1),)``, and B_rho B_theta^-1 of the joints ``(n,)``."""

Friction = tuple[Array, Array, Array, Array, Array, Array, Array, Sigmoid | None, Shafts | None]
"""F_c, F_v, F_s, v_s, v_r, asymmetry, share of the transmitted torque ``(n,)``, sigmoid, shafts."""

class Motors:
    """Motors and springs of one arm; equations in :mod:`impact_rs_sim.drive`.

    States are ``(n,)``. Reading one gives a copy; setting one copies.

    Args:
        stiffness: K, ``(n,)`` [N m/rad].
        damping: D, ``(n,)`` [N m s/rad].
        feedback: Diagonal of I - B_rho B_theta^-1, ``(n,)`` [-].
        rotor_inverse: Diagonal of B_rho^-1, ``(n,)`` [1/(kg m^2)].
        friction: tau_fric,m of the motors, the fields of :class:`impact_rs_sim.physics.JointFriction` times
            B_rho B_theta^-1; None: none.
        period: Period of the torque loop [s].
    """

    position: Array
    """theta [rad]."""
    velocity: Array
    """dtheta [rad/s]."""
    elastic_torque: Array
    """tau_J [N m]."""
    transmission_torque: Array
    """tau_J + D K^-1 dtau_J [N m]."""

    def __init__(
        self,
        stiffness: Array,
        damping: Array,
        feedback: Array,
        rotor_inverse: Array,
        friction: Friction | None,
        period: float,
    ) -> None: ...
    @property
    def actuation_torque(self) -> Array:
        """tau_act of the last step [N m]."""

    @property
    def friction_torque(self) -> Array:
        """tau_fric,m of the last step [N m]."""

    def place(self, position: Array, velocity: Array, elastic: Array, transmission: Array) -> None:
        """Set the whole state.

        Raises:
            ValueError: The shapes do not fit.
        """

    def sense(self, link_position: Sequence[float] | Array, link_velocity: Sequence[float] | Array) -> None:
        """Update the torques of spring and damper from the present motor and link state."""

    def integrate(self, shaped: Array) -> None:
        """One period of the torque loop with B_rho B_theta^-1 times the desired torque [N m]."""

class Observer:
    """Momentum observer of one arm; equations in :mod:`impact_rs_control.detection`.

    Args:
        joints: n.
        gain: K_o [1/s].
        period: Control period [s].
        threshold: Of the sudden force [N].
        forgetting: Share of the sudden force that the slow baseline takes over in a tick [-].
        direction: Of the ante-impact velocity, unit vector in A, ``(3,)``.
    """

    def __init__(
        self, joints: int, gain: float, period: float, threshold: float, forgetting: float, direction: Array
    ) -> None: ...
    @property
    def wrench(self) -> Array:
        """On E, in E[A], ``(6,)`` [N, N m]."""

    @property
    def force(self) -> float:
        """Sudden part against the direction [N]."""

    def update(self, velocity: Array, torque: Array, terms: RigidTerms, coriolis: Array, steps: int = 1) -> bool:
        """Take a measurement: dq, tau_J, and the terms and C there; whether the force is above the threshold.

        ``steps``: periods since the last one.
        """

_Phase = tuple[Array, Array, Array, Array]
"""References of E's position and the posture joints ``(ticks, 3 + k)``; velocities and accelerations of the tasks,
these with friction compensation, ``(ticks, 6 + k)`` each; gains k_p of the tasks ``(6 + k,)``."""

class TaskLaw:
    """Feedback and desired accelerations of the tasks of one arm; equations in :mod:`impact_rs_control.controller`.

    Args:
        motor_inertia: Diagonal of B_theta, ``(n,)`` [kg m^2].
        posture: Joints of the posture task, counted from 0; k of them.
        ante: References of the ante mode.
        post: References of interim and post mode.
        orientation: R_d, ``(ticks, 3, 3)``.
        wrench: f_d, fed forward after the ante mode, ``(ticks, 6)`` [N, N m].
        idle_rate: Damping of all joints in rows of their own [1/s].
        idle: Whether there are such rows.
    """

    def __init__(
        self,
        motor_inertia: Array,
        posture: Sequence[int],
        ante: _Phase,
        post: _Phase,
        orientation: Array,
        wrench: Array,
        idle_rate: float,
        idle: bool,
    ) -> None: ...
    def decide(
        self, tick: int, after: bool, gamma: float, position: Array, velocity: Array, terms: RigidTerms
    ) -> tuple[Array, Array, Array, Array]:
        """Tasks of one tick.

        Args:
            tick: Number of the tick, for the references.
            after: Whether the ante mode has ended.
            gamma: Weight of velocity feedback [-].
            position: q, ``(n,)`` [rad].
            velocity: dq, ``(n,)`` [rad/s].
            terms: Rigid-body terms there.

        Returns:
            Feedback ``(6 + k,)``; A ``(rows, n)`` and b ``(rows,)`` of the quadratic program; M + B_theta ``(n, n)``.

        Raises:
            IndexError: There is no such tick.
        """

class Program:
    """The quadratic program of a tick; equations in :mod:`impact_rs_control.qp`.

    Args:
        low: Lower joint limits, ``(n,)`` [rad].
        high: Upper joint limits, ``(n,)`` [rad].
        fastest: Velocity limits, ``(n,)`` [rad/s].
        strongest: Torque limits, ``(n,)`` [N m].
        period: Control period [s].
        regularisation: Added to the diagonal of the Hessian.
    """

    def __init__(
        self, low: Array, high: Array, fastest: Array, strongest: Array, period: float, regularisation: float
    ) -> None: ...
    def set(
        self,
        tasks: Array,
        targets: Array,
        weights: Array,
        inertia: Array,
        bias: Array,
        position: Array,
        velocity: Array,
    ) -> None:
        """Take the fields of an :class:`~impact_rs_control.qp.AccelerationProblem`."""

    def free(self) -> Array | None:
        """The minimiser without limits, ``(n,)`` [rad/s^2]; None: there is none, or it would break a limit."""

    def parts(self) -> tuple[Array, Array, Array, Array, Array, Array, Array]:
        """The fields of a :class:`~impact_rs_control.qp.QuadraticProgram`."""

SYMBOLS: Sequence[str]
"""Symbols of formulas that belong to no joint, by number; q, dq and tau of every joint follow them, all q first."""

OPERATIONS: Sequence[str]
"""What the code of a formula may contain, by number: ``Formula`` in src/twin_formula.hpp."""

TwinLoad = Callable[[Array, Array, Array, Array], tuple[Array, Array]]
"""Torques on links and motors, ``(n,)`` each [N m], from values of ``SYMBOLS``, q, dq and tau_J."""

TwinFormula = tuple[str, int, int, Sequence[int], Sequence[float]]
"""Name of the effect; what it acts on, ``Acts`` in src/twin_formula.hpp; joint or axis from 0; code, as there, and the
constants that it takes."""

_Pad = tuple[Array, Array, Array, float | None, float, float, float, Shape | None]

class TwinArm:
    """One arm of a :class:`Twin`; parameters of :class:`impact_rs_sim.physics.ArmPhysics`.

    Args:
        links: The links, with the end effector.
        motors: Motors and springs of its joints, in any state.
        shaping: B_rho B_theta^-1, ``(n,)`` [-].
        gain: The desired torque is multiplied by this, ``(n,)`` [-].
        offset: Added to it, ``(n,)`` [N m].
        stiffness: K, ``(n,)`` [N m/rad].
        damping: D, ``(n,)`` [N m s/rad].
        delay: Of the desired torque [s].
        joint_torque: Whether the torques are measured joint torques, without a motor.
        pad: Middle from the origin of E [m], axes, both in axes of the last joint; half extents [m]; stiffness [N/m]
            (None: rigid) and damping [N s/m] of the face; shear compliance [m/N] and creep [m/(s N)]; shape.
        tool: Motions that the tool's spring leaves the pad, scaled to unit compliance, linear then angular in axes of
            the last joint, ``(d, 6)`` [m/J^0.5, rad/J^0.5]; damping over stiffness [s]; None: it is rigid.
        pull: f_0 [N], k [N/m] and p_impact [m] of a spring on E; None: there is none.
        formulas: Loads of formulas.
        load: Loads of Python classes; None: there are none.

    Raises:
        ValueError: An array has the wrong size, or a formula is none for this arm.
    """

    def __init__(
        self,
        links: Chain,
        motors: Motors,
        shaping: Array,
        gain: Array,
        offset: Array,
        stiffness: Array,
        damping: Array,
        delay: float,
        joint_torque: bool,
        pad: _Pad,
        tool: tuple[Array, float] | None,
        pull: tuple[Array, float, Array] | None,
        formulas: Sequence[TwinFormula],
        load: TwinLoad | None,
    ) -> None: ...

class Twin:
    """A scene of :mod:`impact_rs_sim.twin`, without a state.

    Args:
        arms: The arms.
        boxes: Mass [kg], half extents [m], principal moments [kg m^2], centre of mass [m], shape, and, of one without
            neighbours, the twist of its middle in its own axes at unit speed of a hinge or slide, ``(6,)``; of the
            object and of its neighbours.
        support: Height, half extents along x and y [m], friction and compliance [m/N]; None: there is none.
        pad_friction: Coulomb coefficient of the pads [-].
        box_friction: Between objects [-].
        rolling_arm: Lever of the moment that resists rolling [m].
        gravity: Acceleration of gravity in A, ``(3,)`` [m/s^2].
        period: Period of the torque loop [s].
        refinement: Steps in a period in which a pad meets the object.
        formulas: On the object, and between it and the support.

    Raises:
        ValueError: An array has the wrong size, there is no step in a period, or an object on a hinge or slide has
            neighbours.
    """

    def __init__(
        self,
        arms: Sequence[TwinArm],
        boxes: Sequence[tuple[float, Array, Array, Array, Shape | None, Array | None]],
        support: tuple[float, float, float, float, float] | None,
        pad_friction: float,
        box_friction: float,
        rolling_arm: float,
        gravity: Array,
        period: float,
        refinement: int,
        formulas: Sequence[TwinFormula],
    ) -> None: ...

TwinArmStart = tuple[Array, Array, Array, Array, Array, Array, Array]
"""q, dq, tau_J, dtau_J, times [s] and values of earlier commands, and samples before the start: time, q, dq, tau_J."""
TwinBoxStart = tuple[Array, Array, Array]
"""Position, axes and twist of an object."""
TwinTask = tuple[
    Twin, Sequence[TwinArmStart], Sequence[TwinBoxStart], Array, int, Sequence[tuple[Array, NDArray[np.int32]]]
]
"""Scene; states of the arms and of the objects; ticks [s], and periods from one to the next; by
arm torques, and the row that acts in every period."""

class TwinRun:
    """A simulation that goes on tick by tick.

    Args:
        model: Scene.
        arms: States of the arms.
        boxes: States of the object and its neighbours; empty: the arms are alone.

    Raises:
        ValueError: An array has the wrong size.
    """

    state: Array
    """A row of :func:`run_twins`."""
    asleep: bool
    """Whether the object rests on its support until it is touched."""
    residual: float
    """Largest residual of a step so far [m/s]."""
    failed: Sequence[float]
    """Times of the steps that were not solved [s]."""

    def __init__(self, model: Twin, arms: Sequence[TwinArmStart], boxes: Sequence[TwinBoxStart]) -> None: ...
    def step(self, time: float, substeps: int, torques: Sequence[Array]) -> Array:
        """Advance by ``substeps`` periods of the torque loop from ``time`` [s], with a desired torque by arm.

        Returns:
            The state afterwards; NaN where it is not finite.

        Raises:
            RuntimeError: A formula is not finite.
            Exception: That of a load of a Python class.
        """

    def pad_force(self, arm: int) -> Array:
        """Force of the object on the pad of an arm in the last step, in A, ``(3,)`` [N]."""

def run_twins(
    jobs: Sequence[TwinTask], threads: int
) -> list[tuple[Array, int, int, int, int, float, Sequence[float], str]]:
    """Run jobs, several at a time.

    Returns:
        By job a row per tick: q, dq, tau_J, theta, dtheta of every arm, then, where there is an object, its middle,
        quaternion x y z w, velocity and angular velocity; and the last fields of
        :class:`impact_rs_sim.twin.Result`, from ``steps`` on.

    Raises:
        ValueError: An array has the wrong size.
        Exception: That of a load of a Python class.
    """
