# SPDX-License-Identifier: Apache-2.0
"""Commands about one prediction and its inputs: impact map, effects, robots and scenarios."""

from __future__ import annotations

from impact_rs_commands.declaration import Command, argument, option
from impact_rs_commands.shared import (
    CASE,
    CASES,
    JOBS,
    JSON,
    MODEL,
    OBJECT,
    OBJECTS,
    REFLEXES,
    SCENARIO,
    SETTINGS,
    contact,
    optional,
    output,
)

ROBOT_TEXT = "name of a robot in config/robots, or path of its YAML file"

MAP = Command(
    name="map",
    summary="predict the velocities just after an impact",
    about="""\
Predict the velocities after the nominal impact of a scenario.

Solves the rigid impact map: from the ante-impact configuration and velocities to the post-impact velocities of all
joints and bodies and the contact impulses. Where the contact laws have several solutions, it also gives their spread.
--motor-inertia selects the reflected inertia of the motors: 'reduced' (B_theta, with the robot's torque loop), 'rotor'
(B_rho, without it) or 'zero'. --contact selects the instant: 'first', just after the first simultaneous impact, or
'settled', when the pads lie flat on the object and move with it.

--table solves one problem per row of a table of impacts (docs/files.md) without post-impact velocities: impacts
of an arm if a scenario is given, of free bodies otherwise.""",
    examples="""\
impact-rs map push cat_food case_2
impact-rs map push cat_food 2 --motor-inertia rotor --json
impact-rs map grab cat_food 2 --contact settled
impact-rs map push cat_food 2 --uncertainty
impact-rs map push cat_food 2 --derivatives
impact-rs map push cat_food 2 --set contact.restitution=0.2 objects.cat_food.mass=1.5
impact-rs map push cat_food 2 --model model_2.yaml
impact-rs map push --table problems.parquet -o answers.parquet
impact-rs map --table tosses.csv -o answers.csv""",
    output="""\
velocities before and after of every end effector and the object, the impulse, and the largest residual of the
contact laws; --json adds joints and contacts; with --table the file of -o.""",
    units="m/s and rad/s, impulses in N s, vectors in the axes of the world frame, SI throughout.",
    options=(
        optional(SCENARIO),
        optional(OBJECT),
        optional(CASE),
        option(
            "--uncertainty", kind="switch",
            help="interval of every velocity from the uncertainties of the scenario, and the share of each source",
        ),
        option(
            "--motor-inertia", choices=("reduced", "rotor", "zero"), default="reduced",
            help="reflected inertia of the motors",
        ),
        contact("first: just after the first impact; settled: when the faces lie on each other"),
        option(
            "--engine", choices=("exact", "bullet"), former=(("pinocchio", "exact"),), default="exact",
            help="solver of the first contact: exact, Newton's method on the contact laws (formerly pinocchio), or "
            "bullet, the independent check: the impact map extracted from steps of the physics engine Bullet",
        ),
        option(
            "--restitution-law", choices=("newton", "poisson"), help="law of restitution",
            otherwise="that of the scenario",
        ),
        option(
            "--derivatives", kind="switch",
            help="derivatives of every velocity with respect to masses, inertias, B, friction, restitution, poses and "
            "ante-impact velocities",
        ),
        MODEL._replace(
            help="model file, whose effects count where they act in an impact: masses, contact, motor inertia"
        ),
        SETTINGS,
        option("--table", kind="file", metavar="FILE", help="many problems: a .csv or .parquet table of impacts"),
        output("new_file", "file for the answers of --table", "FILE"),
        *JOBS,
        JSON,
    ),
)  # fmt: skip

LIMITS = Command(
    name="limits",
    summary="how fast the arms may hit",
    about="""\
Say how fast the arms of a scenario may hit, object by object and case by case.

The highest closing speed at which all bounds hold in 99 % of the draws of uncertain quantities: the uncertainties
of the scenario, stiffness and damping of joints and pads, and the discrepancy of the twin from another simulator.
Bounds are joint velocity jumps, joint velocities, joint torques, and the signals that the robot's reflexes compare with
thresholds: external joint torques and the external force. Those of reflexes stand in the robot facts (section
reflexes) or are given here; a kind without a bound is named, and limits nothing.

--places N moves the impact to N x N positions around the scenario's, for a map of the speed limit.""",
    examples="""\
impact-rs limits push_fr3
impact-rs limits push_fr3 --objects juice --cases 2 --reflex-torque 80 --reflex-force 200
impact-rs limits push_iiwa7 --jump 0.5 --places 5 --span 0.1 -o limits/iiwa7""",
    output="""\
a table with a row per object and case; with -o limits.html, limits.json and limits.csv.""",
    units="speeds of closing along the pad's normal, m/s; joints in rad/s and N m, prismatic joints in m/s and N.",
    options=(
        SCENARIO,
        OBJECTS,
        CASES,
        option(
            "--jump", kind="number", least=0.0, metavar="RAD_S", unit="rad/s", help="largest joint velocity jump",
            label="largest joint jump", otherwise="that of the robot facts",
        ),
        *REFLEXES,
        option(
            "--places", kind="whole", least=0, most=25, default=0, metavar="N", label="places of a map, per side",
            help="also N x N positions around the scenario's, with the object and the case that allow least",
        ),
        option(
            "--span", kind="number", least=0.0, default=0.1, metavar="M", unit="m", label="reach of the map",
            advanced=True,
            help="largest distance of these positions along x and z, either way",
        ),
        option(
            "--draws", kind="whole", least=20, default=200, metavar="N", advanced=True,
            help="draws of uncertain quantities",
        ),
        SETTINGS,
        output("new_folder", "folder for the page and the tables", label="folder of the page"),
        *JOBS,
        JSON,
    ),
)  # fmt: skip

STUDY_DESIGN = Command(
    name="study-design",
    summary="rank robots, poses, motor inertias and pads by the effect of an impact",
    about="""\
Predict the hit of every combination of robot, random pose, motor inertia and pad, and rank them: impulse on the object,
largest joint jump over the joint's velocity limit, and sensitivity of the object's velocity to motor inertia. Every
value has an interval from the uncertainties of the scenario, and every rank a range.

The pad comes square to a box that stands free, with the smallest joint velocity. Drives that robot facts lack are
scaled from a Franka arm. Pads: wide (0.10 x 0.10 m), narrow (0.05 x 0.10 m), bouncy (wide, restitution 0.3).""",
    examples="""\
impact-rs study-design -o design
impact-rs study-design -o design --robots franka_fr3 ur5e --poses 50 --rank-by sensitivity
impact-rs study-design -o design --scenario my_push.yaml --object parcel --speed 0.3""",
    output="the first designs; in DIR a page with pictures and designs.csv with all of them.",
    units="impulse in N s, the rest is dimensionless; speeds in m/s.",
    options=(
        output("new_folder", "folder of page and table", required=True, label="folder of the page"),
        option(
            "--robots", kind="robot", many=True, metavar="ROBOT", help=ROBOT_TEXT,
            default=("franka_fer", "franka_fr3", "kinova_gen3", "kuka_iiwa7", "ur5e", "ur10e"),
        ),
        option(
            "--poses", kind="whole", default=100, least=1, metavar="N", help="random poses per robot",
            label="poses per robot",
        ),
        option(
            "--motor-inertia", many=True, choices=("reduced", "rotor"), default=("reduced", "rotor"),
            help="B_theta with a torque loop, B_rho without",
        ),
        option(
            "--pads", many=True, choices=("wide", "narrow", "bouncy"), default=("wide", "narrow", "bouncy"),
            help="pads",
        ),
        option(
            "--scenario", kind="scenario", default="push", metavar="NAME",
            help="scenario with end effector, object and uncertainties",
        ),
        option("--object", kind="object", metavar="NAME", help="object that is hit", otherwise="the first one"),
        option(
            "--speed", kind="number", default=0.5, metavar="V", unit="m/s", help="speed of the pad before the hit",
            label="speed before the hit",
        ),
        option(
            "--rank-by", choices=("impulse", "joint_jump", "sensitivity"), default="impulse",
            help="measure of the table that is printed", advanced=True,
        ),
        option(
            "--draws", kind="whole", default=20, least=2, metavar="N", help="draws from the uncertainties",
            advanced=True,
        ),
        option("--seed", kind="whole", default=0, least=0, metavar="N", help="seed of poses and draws", advanced=True),
        *JOBS,
        JSON,
    ),
    module="study_design",
)  # fmt: skip

EFFECTS = Command(
    name="effects",
    summary="list the library of physical effects",
    about="""\
List the physical effects that a model may have and that diagnose considers, or explain one of them.

Add your own effects with a Python entry point (group impact_rs.effects) or a YAML file of formulas (--formulas checks
it).""",
    examples="""\
impact-rs effects
impact-rs effects torque_offset
impact-rs effects --formulas cable.yaml""",
    output="a table of effects, or the parameters of one with bounds.",
    units="next to every parameter.",
    options=(
        argument("name", "one effect", kind="effect", metavar="NAME", required=False, otherwise="all"),
        option(
            "--formulas", kind="formulas", metavar="FILE.yaml", help="also list the effects of a formula file"
        ),
        JSON,
    ),
)  # fmt: skip

ROBOT = Command(
    name="robot",
    summary="import the URDF of your own robot, and check it",
    about="""\
Import your own robot from its URDF, and check the result.

import writes robot facts (kinematics, inertias, limits) of the serial chain from --base to --tip. Joints may be
revolute or prismatic, about any axis, and may mimic others; mesh files are not needed. Joints off the chain stand still
while the robot hits, unless --move names them. Comments in the file name the facts that a URDF does not hold. Robot
facts are never overwritten. check tests robot facts before a simulation uses them, with --scenario also the drives of
the arms that are this robot.""",
    examples="""\
impact-rs robot import my_robot.urdf --tip flange -o my_robot.yaml
impact-rs robot check my_robot.yaml
impact-rs robot check my_robot.yaml --scenario my_push.yaml""",
    output="import: a YAML file, and notes on data missing in a URDF. check: a table; exit code 1 if a check fails.",
    units="SI; angles in rad. Prismatic joints have m, N and kg instead of rad, N m and kg m^2.",
    actions=(
        Command(
            name="robot import",
            summary="robot facts from a URDF",
            function="import_robot",
            options=(
                argument("urdf", "URDF file; expand xacro first", kind="file", metavar="ROBOT.urdf"),
                output("new_file", "file to write", "FILE.yaml", required=True),
                option("--base", metavar="LINK", help="link that is mounted", otherwise="the root of the tree"),
                option(
                    "--tip", metavar="LINK", help="link whose frame is the flange, +z outwards",
                    otherwise="the only leaf of the tree",
                ),
                option(
                    "--limits", many=True, default=(), metavar="JOINT.QUANTITY=VALUE", otherwise="as in the URDF",
                    help="limits that the URDF lacks or has as 0: elbow.effort=10 '*.velocity=3' '*.position=-3:3'; * "
                    "is every joint",
                ),
                option(
                    "--measured", kind="file", metavar="TABLE", otherwise="none",
                    help="table of a recording in rad, rad/s and N m, with columns named after the joints or numbered; "
                    "its ranges stand in for limits that are missing or 0",
                ),
                option(
                    "--inertia-at", choices=("centre", "joint"), default="centre",
                    help="reference point of the moments of inertia: the centre of mass (as in URDF), or the joint",
                ),
                option(
                    "--lock", many=True, default=(), metavar="JOINT=PLACE",
                    help="joints that were held, and where [rad, m]: torso_lift=0.15 'head_*=0' 'finger*=0.04'; they "
                    "become fixed, on the chain and off it; those off it are held at 0 without it",
                ),
                option(
                    "--move", many=True, default=(), metavar="JOINT",
                    help="joints off the chain that move while the robot hits: 'left_arm_*'; impact map and impact "
                    "tables take them, trials do not",
                ),
                option(
                    "--floating", kind="switch",
                    help="nothing holds the base (a humanoid, a drone); impact map and impact tables take it, trials "
                    "do not",
                ),
                option(
                    "--hand", many=True, default=(), metavar="LINK",
                    help="links whose frames are further flanges, as the other palm of two arms, for pads that hit at "
                    "once; --move lets them move",
                ),
                option(
                    "--package-path", many=True, kind="folder", default=(), metavar="DIR",
                    help="folders of packages that the URDF names its meshes by (package://NAME/...)",
                    otherwise="AMENT_PREFIX_PATH, and folders above the URDF",
                ),
                option("--source", metavar="TEXT", help="source of the numbers, with their licence"),
                JSON,
            ),
        ),
        Command(
            name="robot check",
            summary="check robot facts; exit code 1 if a check fails",
            function="check",
            options=(
                argument("robot", ROBOT_TEXT, kind="robot", metavar="ROBOT"),
                option(
                    "--scenario", kind="scenario", metavar="SCENARIO",
                    help="also check the drives of this robot's arms in the scenario",
                ),
                JSON,
            ),
        ),
    ),
)  # fmt: skip

SCENARIO_DRAFT = Command(
    name="scenario",
    summary="write a scenario to start from, for any robot",
    about="""\
Write a scenario for a robot: boxes or your object, an impact pose, and everything else that trials need.

The command searches for a pose whose whole motion is far from joint limits and singularities, and runs the trials of
the file before it writes it. Motor inertia, stiffness and damping that the robot facts lack are assumptions, scaled
from a Franka arm: replace them with yours. Files are never overwritten.

An object comes from a mesh in metres (STL, OBJ, DAE, PLY; convex hull, centre of mass and inertia of an even density)
or from a URDF (collision shape, inertial). The head of the file states where mass and inertia come from.""",
    examples="""\
impact-rs scenario new --robot franka_fr3 -o my_push.yaml
impact-rs scenario new --robot ur5e --object bottle.stl --scale 0.001 --mass 0.52 -o push_bottle.yaml
impact-rs scenario new --robot my_robot.yaml --kind excite -o my_excite.yaml
impact-rs campaign my_push.yaml -o campaigns/my_push""",
    output="a YAML file.",
    units="SI; angles in rad.",
    actions=(
        Command(
            name="scenario new",
            summary="a working scenario for a robot",
            function="new",
            options=(
                option("--robot", kind="robot", required=True, metavar="ROBOT", help=ROBOT_TEXT),
                option(
                    "--kind", choices=("push", "grab", "excite"), default="push",
                    help="push: one arm hits a box; grab: two arms clamp and lift it; excite: free motion",
                ),
                option(
                    "--object", kind="file", metavar="FILE",
                    help="mesh (.stl, .obj, .dae, .ply) or .urdf of the object, z up as it stands; default: boxes",
                ),
                option(
                    "--mass", kind="number", metavar="KG", unit="kg",
                    help="mass of the object [kg]; default: by its density",
                ),
                option(
                    "--density", kind="number", metavar="RHO", unit="kg/m^3",
                    help="even density of the object [kg/m^3]; default: inertial of its URDF, else 1000",
                ),
                option(
                    "--scale", kind="number", metavar="S", unit="m",
                    help="metres per unit of the mesh, 0.001 for a file in millimetres; default: 1",
                ),
                output("new_file", "file to write", "FILE.yaml", required=True),
                JSON,
            ),
        ),
    ),
)  # fmt: skip
