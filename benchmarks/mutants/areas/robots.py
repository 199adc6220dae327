# SPDX-License-Identifier: Apache-2.0
"""Robots of users: facts from a URDF, and checks of them."""

from mutant import Mutant

IMPORT = "impact_rs_sim/robot_import.py"
IMPORT_TESTS = ("test/impact_rs_sim/test_robot_import.py",)
CHECK_TESTS = ("test/impact_rs_sim/test_robot_check.py",)
SLIDING_TESTS = ("test/impact_rs_sim/test_prismatic.py",)
FEW_TESTS = ("test/impact_rs_sim/test_few_joints.py",)
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
        original="_placement(before.T @ frame.translation, before.T @ frame.rotation)",
        mutated="_placement(before.T @ frame.translation, frame.rotation)",
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
        name="prismatic_joint_of_a_urdf_turns",
        file=IMPORT,
        original='joints.append(JointOrigin.model_validate({"type": _type(joint), **origin}))',
        mutated="joints.append(JointOrigin.model_validate(origin))",
        wrong="A prismatic joint of a URDF becomes one that turns.",
        tests=IMPORT_TESTS,
    ),
    Mutant(
        name="prismatic_joint_written_as_revolute",
        file="impact_rs_sim/urdf.py",
        original='joint = Xml.SubElement(robot, "joint", name=f"joint{index + 1}", type=origin.type)',
        mutated='joint = Xml.SubElement(robot, "joint", name=f"joint{index + 1}", type="revolute")',
        wrong="Every joint turns in the URDF that both engines read.",
        tests=SLIDING_TESTS,
    ),
    Mutant(
        name="assumed_force_without_the_pinion",
        file="impact_rs_sim/assumed_drive.py",
        original="torque = radius * np.array(facts.limits.torque_Nm)",
        mutated="torque = np.array(facts.limits.torque_Nm)",
        wrong="The assumed drive of a joint that slides takes newtons for newton metres.",
        tests=SLIDING_TESTS,
    ),
    Mutant(
        name="damping_of_a_pinion_over_its_radius",
        file="impact_rs_sim/effects/base.py",
        original='"N m s/rad": ("N s/m", 1.0 / PINION**2),',
        mutated='"N m s/rad": ("N s/m", 1.0 / PINION),',
        wrong="The range of viscous friction of a joint that slides is off by the pinion's radius.",
        tests=("test/impact_rs_sim/effects/test_base.py",),
    ),
    Mutant(
        name="given_joints_turn_the_pad_the_other_way",
        file="impact_rs_sim/scene.py",
        original="return np.asarray(dq - still @ back)",
        mutated="return np.asarray(dq + still @ back)",
        wrong="Where joints at impact are given, the pad turns twice as fast instead of as little as it can.",
        tests=FEW_TESTS,
    ),
    Mutant(
        name="object_before_a_tilted_pad_too_far",
        file="impact_rs_sim/scene.py",
        original="position = pad.translation + level * (min(plane / share, face) + scenario.object_gap)",
        mutated="position = pad.translation + level * (max(plane / share, face) + scenario.object_gap)",
        wrong="Before a pad that looks a little up the object stands where it is not touched.",
        tests=FEW_TESTS,
    ),
    Mutant(
        name="robot_of_a_mapping_from_the_working_directory",
        file="impact_rs_trials/recordings/mapping.py",
        original='return mapping.model_copy(update={"robot": str(path.parent / mapping.robot)})',
        mutated="return mapping",
        wrong="The robot of a mapping file is looked for where the user stands.",
        tests=("test/impact_rs_trials/recordings/test_mapping.py",),
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
        original="margin = float((np.minimum(q - model.position_min, model.position_max - q) / comfortable).min())",
        mutated="margin = float((np.maximum(q - model.position_min, model.position_max - q) / comfortable).min())",
        wrong="A drafted pose may leave the joint limits on its way.",
        tests=("test/impact_rs_trials/test_scenario_draft.py",),
    ),
]
