"""Robots of users: facts from a URDF, and checks of them."""

from mutant import Mutant

IMPORT = "impact_rs_sim/robot_import.py"
IMPORT_TESTS = ("test/impact_rs_sim/test_robot_import.py",)
CHECK_TESTS = ("test/impact_rs_sim/test_robot_check.py",)
STABILITY = "impact_rs_sim/drive_stability.py"
STABILITY_TESTS = ("test/impact_rs_sim/test_drive_stability.py",)

MUTANTS = [
    Mutant(
        name="axis_frame_turned_the_other_way",
        file=IMPORT,
        original="return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + start @ end))",
        mutated="return np.asarray(np.eye(3) - cross + cross @ cross / (1.0 + start @ end))",
        wrong="The frame of a joint about y turns about -y.",
        tests=IMPORT_TESTS,
    ),
    Mutant(
        name="imported_inertia_not_turned",
        file=IMPORT,
        original="inertia = turn.T @ body.inertia @ turn",
        mutated="inertia = body.inertia",
        wrong="The inertia of a link stays in the axes of the URDF.",
        tests=IMPORT_TESTS,
    ),
    Mutant(
        name="imported_com_turned_the_other_way",
        file=IMPORT,
        original="com=_clean(turn.T @ body.lever)",
        mutated="com=_clean(turn @ body.lever)",
        wrong="The centre of mass of a link is turned the other way.",
        tests=IMPORT_TESTS,
    ),
    Mutant(
        name="import_forgets_the_turn_of_the_link_before",
        file=IMPORT,
        original="before.T @ placement.translation, before.T @ placement.rotation @ turn",
        mutated="placement.translation, placement.rotation @ turn",
        wrong="A joint is placed in the axes that the link before it had in the URDF.",
        tests=IMPORT_TESTS,
    ),
    Mutant(
        name="flange_of_the_urdf_not_turned_back",
        file=IMPORT,
        original="flange = _origin(before.T @ frame.translation, before.T @ frame.rotation)",
        mutated="flange = _origin(before.T @ frame.translation, frame.rotation)",
        wrong="The flange of an arm whose last axis is not z points elsewhere.",
        tests=IMPORT_TESTS,
    ),
    Mutant(
        name="limits_of_a_urdf_swapped",
        file=IMPORT,
        original="    return lower, upper, velocity, effort\n",
        mutated="    return lower, upper, effort, velocity\n",
        wrong="Velocity and torque limits of a URDF are swapped.",
        tests=IMPORT_TESTS,
    ),
    Mutant(
        name="drive_check_without_the_link",
        file=STABILITY,
        original="inertia = 1.0 / (1.0 / link_inertia + 1.0 / motor_inertia)",
        mutated="inertia = motor_inertia",
        wrong="The stability of a drive knows only the motor: a light link is overlooked.",
        tests=STABILITY_TESTS,
    ),
    Mutant(
        name="drive_check_explicit_euler",
        file=STABILITY,
        original="step = np.block([[identity + period * from_stretch, period * from_rate], [from_stretch, from_rate]])",
        mutated="step = np.block([[identity, period * identity], [from_stretch, from_rate]])",
        wrong="The stability of a drive is that of another integrator.",
        tests=STABILITY_TESTS,
    ),
    Mutant(
        name="drive_check_with_the_heaviest_link",
        file="impact_rs_sim/robot_check.py",
        original="lightest = link_inertias(inverses).min(axis=0)",
        mutated="lightest = link_inertias(inverses).max(axis=0)",
        wrong="Drives are checked with the heaviest inertia a link can have.",
        tests=CHECK_TESTS,
    ),
    Mutant(
        name="flange_rotation_forgotten",
        file="impact_rs_sim/urdf.py",
        original="facts.flange.rotation @ np.array([0.0, 0.0, end_effector.length])",
        mutated="np.array([0.0, 0.0, end_effector.length])",
        wrong="The end effector stands on the z of the last link, not on that of the flange.",
        tests=("test/impact_rs_sim/test_urdf.py", *IMPORT_TESTS),
    ),
    Mutant(
        name="assumed_drive_swings",
        file="impact_rs_sim/assumed_drive.py",
        original="damping = np.maximum(DAMPING * stiffness, RESONANCE / (1.0 / usual + 1.0 / reduced))",
        mutated="damping = DAMPING * stiffness",
        wrong="A heavy motor swings against its spring in the loop of the controller.",
        tests=("test/impact_rs_sim/test_assumed_drive.py",),
    ),
    Mutant(
        name="a_way_beyond_the_limits_is_fine",
        file="impact_rs_trials/scenario_draft.py",
        original="margin = float(np.minimum(q - model.position_min, model.position_max - q).min())",
        mutated="margin = float(np.maximum(q - model.position_min, model.position_max - q).min())",
        wrong="A drafted pose may leave the joint limits on its way.",
        tests=("test/impact_rs_trials/test_scenario_draft.py",),
    ),
]
