# SPDX-License-Identifier: Apache-2.0
"""Commands that run trials, and those that start nodes."""

from __future__ import annotations

from impact_rs_commands.declaration import Command, argument, option
from impact_rs_commands.shared import (
    CASE,
    CASES,
    JOBS,
    JSON,
    MODEL,
    NAMESPACE,
    OBJECT,
    OBJECTS,
    PLANT,
    REFLEXES,
    SCENARIO,
    SEED,
    SETTINGS,
    WITHOUT,
    contact,
    optional,
    output,
)

DEMO = Command(
    name="demo",
    summary="run the whole loop once: trials, analysis, diagnosis, better model",
    about="""\
Run the whole loop through the ROS 2 nodes: a robot hits and pushes boxes, and its plant has a hidden physical effect
that the model lacks. The bags are analysed as in the paper; compare shows where the model fails, diagnose names the
missing effect, add writes a better model, and history shows how the error falls.

Takes some minutes, half of them for trials, and ends with the next commands. --quick runs the paper's experiment alone,
without a hidden effect: five trials, their analysis and the report, in well under a minute.""",
    examples="""\
impact-rs demo
impact-rs demo --quick
impact-rs demo -o /tmp/impact_demo""",
    output="the result of every step, and in DIR trials, diagnosis, model and reports.",
    units="speeds in m/s; errors in percent, or as multiples of repeatability.",
    options=(
        output("new_folder", "folder of trials, model and reports", default="demo_output"),
        option("--quick", kind="switch", help="the paper's experiment alone, without a hidden effect"),
        JSON,
    ),
)

TRIAL = Command(
    name="trial",
    summary="run one trial and record it",
    about="""\
Run one trial of a scenario in this process and record it as a bag.

--scale multiplies the predicted post-impact velocity to give the reference; 1.0 follows the prediction. The trial
equals repeat 0 of a campaign with the same seed.""",
    examples="""\
impact-rs trial push cat_food case_2 --scale 0.9 --seed 7 -o trials
impact-rs analyze trials        # needs trials at three scales or more""",
    output="how the trial ended and its net feedback; in DIR one bag.",
    units="the scale is dimensionless; speeds are in m/s.",
    options=(
        SCENARIO,
        OBJECT,
        CASE,
        option(
            "--scale", kind="number", default=1.0, metavar="S", unit="-", label="reference over prediction",
            help="post-impact reference over prediction",
        ),
        SEED,
        PLANT,
        output("new_folder", "folder for the bag", required=True, label="folder for the bag"),
        JSON,
    ),
)  # fmt: skip

CAMPAIGN = Command(
    name="campaign",
    summary="run many trials, or continue a campaign",
    about="""\
Run all trials of a scenario, or a selection of them, and record one bag each. Conditions alternate in random order.
With --plan the trials of a plan (impact-rs design) run instead, in a folder of DIR for every scenario.

To continue an interrupted campaign, run the same command again: finished bags stay, a half-written one is run again.
Trials run in parallel worker processes; results do not depend on their number (--jobs). With --scheduler they run on
the workers of a dask scheduler; DIR is then a folder that all workers share, or a URL.""",
    examples="""\
impact-rs campaign push -o campaigns/push
impact-rs campaign push -o campaigns/quick --objects cat_food --cases 2 --scales 0.8 1.0 1.2 --trials 2
impact-rs campaign grab -o campaigns/firm --set control.clamp_force=90
impact-rs campaign push -o s3://bucket/push --scheduler tcp://10.0.0.1:8786
impact-rs campaign push -o campaigns/mine --via nodes --without plant
impact-rs campaign --plan plan.yaml -o campaigns/planned
impact-rs analyze campaigns/push""",
    output="how many trials are there and how they ended; in DIR a manifest and one bag per trial.",
    units="scales are dimensionless (post-impact reference velocity over predicted velocity).",
    options=(
        optional(SCENARIO),
        output("new_folder", "folder of the campaign, or URL", required=True, url=True, label="folder of the campaign"),
        option(
            "--plan", kind="file", metavar="FILE.yaml", label="plan of trials", advanced=True,
            help="run the trials of a plan (impact-rs design) instead of a scenario",
        ),
        OBJECTS,
        CASES,
        option(
            "--scales", kind="number", many=True, metavar="S", unit="-", otherwise="the scenario's",
            label="post-impact reference over prediction", help="post-impact references over the prediction",
        ),
        option(
            "--trials", kind="whole", least=1, most=1000, metavar="N", label="repeats of each",
            help="repeats of every scale", otherwise="the scenario's",
        ),
        SEED._replace(help="seed of the campaign"),
        option(
            "--order", choices=("random", "listed"), default="random", label="order of trials", advanced=True,
            help="random: repeat by repeat, conditions in random order (by the seed), so that a drift of the robot "
            "does not look like an effect of the conditions; listed: condition by condition",
        ),
        SETTINGS,
        option(
            "--sensitivity", kind="switch", label="settings halved and doubled", advanced=True,
            help="also halve and double, one at a time, settings that the estimate should not depend on (three scales "
            "of the first case); analyze then reports a systematic band",
        ),
        *JOBS,
        PLANT,
        option(
            "--via", choices=("inprocess", "nodes"), default="inprocess", label="how trials run", advanced=True,
            help="run trials in this program, or through the ROS 2 nodes (one at a time)",
        ),
        WITHOUT,
        NAMESPACE,
        JSON,
    ),
    resumable=True,
)  # fmt: skip

DESIGN = Command(
    name="design",
    summary="plan the most informative trials",
    about="""\
Plan the trials that distinguish explanations best, within a budget.

Every trial that the cell can run (scenario, object, case, further speeds, beside the object's centre, free motions) is
simulated with the model by the compiled twin, in closed loop and within the limits of joints and torques, and
replayed under every explanation. The plan maximises the probability that the next diagnosis distinguishes them:

  without --after   which effect is missing, if any: all effects of the library against each other
  with --after      which of the tied effects or laws of a diagnosis or discovery is there, or a suspected one at all;
                    without either, how large the effects found are

--runs names the trials measured so far, with their scatter and information. The plan lists the gain of each
condition. The probability refers to a likelihood-ratio test between two explanations; a diagnosis asks for more
(docs/design.md).""",
    examples="""\
impact-rs design --budget 18 -o plan.yaml
impact-rs campaign --plan plan.yaml -o campaigns/first
impact-rs diagnose campaigns/first -o diagnosis.json

impact-rs design --after diagnosis.json --runs campaigns/first --budget 6 -o plan_2.yaml
impact-rs campaign --plan plan_2.yaml -o campaigns/second

impact-rs design --scenarios my_push.yaml my_excite.yaml --speed 0.4 --force 200 --budget 12 -o plan.yaml
impact-rs design --envelope envelope.yaml --budget 12 -o plan.yaml""",
    output="explanations to distinguish, gain of each condition; with -o a YAML file for impact-rs campaign --plan.",
    units="speeds in m/s, forces in N, probabilities in percent, information in nat.",
    options=(
        MODEL,
        option(
            "--after", kind="diagnosis", metavar="FILE.json", label="diagnosis",
            help="diagnosis or discovery of this model, whose open decision the plan is for",
        ),
        option(
            "--runs", kind="runs", metavar="DIR", label="trials so far", help="trials measured so far",
            otherwise="none",
        ),
        option(
            "--budget", kind="whole", least=1, most=1000, required=True, metavar="N", help="largest number of trials"
        ),
        output("new_file", "file for the plan", "FILE.yaml", label="file of the plan"),
        option(
            "--scenarios", kind="scenario", many=True, metavar="SCENARIO", default=("push", "excite"),
            help="scenarios that the cell can run",
        ),
        option(
            "--speed", kind="number", metavar="V", unit="m/s", label="largest approach speed", advanced=True,
            help="largest approach speed", otherwise="that of the fastest case of each scenario",
        ),
        option(
            "--force", kind="number", metavar="F", unit="N", label="largest contact force", advanced=True,
            help="largest contact force, in the mean over 4 ms", otherwise="any",
        ),
        option(
            "--envelope", kind="file", metavar="FILE.yaml", advanced=True, otherwise="none",
            help="only trials that the envelope of a real cell allows (docs/safety.md)",
        ),
        option(
            "--method", choices=("design", "random", "fixed"), default="design", advanced=True,
            help="design: the most informative; for comparison random conditions, or fixed: the cases of the files in "
            "equal shares",
        ),
        SEED._replace(
            help="seed of the planned trials, and of random conditions", default=None,
            otherwise="0; with --runs or --after one that they have not",
        ),
        *JOBS,
        JSON,
    ),
)  # fmt: skip

STUDY = Command(
    name="study",
    summary="run and analyse all 450 trials of the published study",
    about="""\
Run the whole published study, analyse it and write one report: both scenarios (push with one arm, grab with two), three
objects, three cases, five post-impact references, five repeats: 450 trials. Then 126 trials for the systematic band of
the estimates: one setting at a time, on which they should not depend, is halved or doubled.

To continue an interrupted study, run the same command again. Its two campaigns are DIR/push and DIR/grab; tables, means
and all figures are in DIR/report, next to the published numbers. The tables have predictions for the first and for the
settled contact (see impact-rs map --help).""",
    examples="""\
impact-rs study -o study
impact-rs study -o study_small --trials 1 --no-sensitivity    # 90 trials""",
    output="a table of estimates and errors; in DIR two campaigns and the report.",
    units="speeds in m/s along each scenario's axis (push y, grab z), errors in percent.",
    options=(
        output("new_folder", "folder of the study", required=True),
        option("--trials", kind="whole", metavar="N", help="repeats of every reference", otherwise="5"),
        SEED._replace(help="seed of the study"),
        option(
            "--no-sensitivity", kind="switch",
            help="leave out the 126 trials for the systematic band of the estimates",
        ),
        contact("predictions shown in the figures; both have a table"),
        *JOBS,
        PLANT,
        JSON,
    ),
    resumable=True,
)  # fmt: skip

BLIND = Command(
    name="blind",
    summary="make a campaign with a hidden effect, or score a diagnosis",
    about="""\
Make a campaign whose plant has a hidden effect, or score a diagnosis of one.

make draws effect and size from SEED, records pushes and free motions into DIR/runs, and writes DIR/truth.json, which
no diagnosis reads. Kinds: single, pair, null (no hidden effect), outside (an effect that is not in the library).""",
    examples="""\
impact-rs blind make 7 -o blind_7 --size small
impact-rs diagnose blind_7/runs -o diagnosis.json
impact-rs blind score blind_7 --diagnosis diagnosis.json
impact-rs blind score inquiry                        # of impact-rs investigate inquiry --blind 7
impact-rs blind make 8 -o blind_8 --scenarios my_push.yaml my_excite.yaml      # for your own robot""",
    output="make: trials in DIR/runs. score: right or wrong, the hidden and the named effect.",
    units="truth.json has the units of the hidden parameters.",
    actions=(
        Command(
            name="blind make",
            summary="make a campaign with a hidden effect",
            function="make",
            options=(
                argument(
                    "seed", "whole number; the same seed hides the same effect", kind="whole", metavar="SEED", least=0,
                    label="seed: draws effect and size",
                ),
                output("new_folder", "folder of the campaign", required=True, label="folder of the campaign"),
                option(
                    "--kind", choices=("single", "pair", "null", "outside"), default="single", advanced=True,
                    help="kind of the hidden effect",
                ),
                option(
                    "--effect", metavar="NAME", advanced=True, otherwise="drawn from SEED",
                    help="effect to hide, FIRST+SECOND for a pair",
                ),
                option(
                    "--scenarios", kind="scenario", many=True, metavar="SCENARIO", default=("push", "excite"),
                    help="scenarios to record, with arms of one kind: hits and free motions", advanced=True,
                ),
                option("--size", choices=("small", "full"), default="small", help="how many trials", advanced=True),
                *JOBS,
                JSON,
            ),
        ),
        Command(
            name="blind score",
            summary="score a diagnosis, or an investigation, against the truth",
            function="score",
            options=(
                argument("directory", "folder of the campaign", kind="folder", metavar="DIR"),
                option(
                    "--diagnosis", kind="diagnosis", metavar="FILE.json", otherwise="the end of the investigation",
                    help="diagnosis of its folder runs",
                ),
                JSON,
            ),
        ),
    ),
)  # fmt: skip

INVESTIGATE = Command(
    name="investigate",
    summary="run the whole loop until nothing is missing, or it cannot be decided",
    about="""\
Run the loop by itself: choose trials, predict them, measure them, compare, diagnose, add the missing effect to the
model, and try the new model on new trials. It ends with NOTHING-MISSING, EXPLAINED (the effects are named and the model
holds on new trials), LAW-HOLDS (a law outside the library does), or UNDECIDED: the trials of the budget cannot decide
it, or none was left to try the model on.

All that it did is in DIR, step by step; the same command goes on after Ctrl-C, a kill or a power cut. --budget may
grow.

With --blind SEED the plant hides the effect of impact-rs blind make SEED; impact-rs blind score DIR judges the end.

With --via cell trials run on a real cell (docs/real_robot.md): only inside the envelope; before every new kind of
motion, and before every trial, it asks (--yes: it does not); a trial that does not go as planned stops it, and it
moves nothing again until you have answered.""",
    examples="""\
impact-rs investigate inquiry --blind 7
impact-rs investigate inquiry --blind 7 --budget 20 --kind pair
impact-rs investigate inquiry --blind 7 --via nodes
impact-rs investigate cell_7 --via cell --envelope envelope.yaml --budget 24
impact-rs blind score inquiry""",
    output="every decision with its reason; in DIR trials, models, diagnoses, log.md and report/investigation.html.",
    units="errors are multiples of repeatability, speeds in m/s, impulses in N s.",
    options=(
        argument("directory", "folder of the investigation", kind="new_folder", metavar="DIR"),
        option(
            "--budget", kind="whole", default=60, least=6, most=1000, metavar="N", help="trials at most",
            label="trials at most",
        ),
        option(
            "--blind", kind="whole", least=0, metavar="SEED", label="seed of a hidden effect", otherwise="none",
            help="hide the effect of blind make SEED in the plant",
        ),
        option(
            "--kind", choices=("single", "pair", "null", "outside"), default="single", advanced=True,
            help="kind of the effect that --blind hides",
        ),
        option(
            "--effect", metavar="NAME", advanced=True, otherwise="drawn from SEED",
            help="effect that --blind hides, FIRST+SECOND for a pair",
        ),
        option(
            "--scenarios", kind="scenario", many=True, metavar="SCENARIO", default=("push", "excite"),
            help="scenarios with arms of one kind: hits and free motions", advanced=True,
        ),
        MODEL._replace(label="first model", advanced=True),
        option(
            "--effects", kind="effect", many=True, metavar="NAME", otherwise="all", label="only these effects",
            help="effects to consider", advanced=True,
        ),
        SEED._replace(help="seed of scatter and noise; with --blind that seed"),
        option(
            "--via", choices=("inprocess", "nodes", "cell"), default="inprocess", label="how trials run", advanced=True,
            help="run trials in this program, through the ROS 2 nodes, or on a real cell in the plant's place",
        ),
        option(
            "--envelope", kind="file", metavar="FILE.yaml", advanced=True, otherwise="none",
            help="which trials may run (docs/safety.md); needed with --via cell",
        ),
        option("--yes", kind="switch", advanced=True, help="with --via cell: do not ask before motions"),
        option(
            "--mapping", kind="mapping", default="impact_rs", metavar="NAME", advanced=True,
            help="with --via cell: mapping of its bags",
        ),
        NAMESPACE,
        *JOBS,
        JSON,
    ),
    resumable=True,
)  # fmt: skip

FRICTION = Command(
    name="friction",
    summary="identify the friction compensation of a scenario",
    about="""\
Identify a feedforward for joint friction, so that the net feedback shows the impact alone.

identify runs the scenario's plant in free motion, one arm at a time: along the ante-impact reference with the
ante-impact controller, and from rest along the post-impact reference with the post-impact controller. The mean
feedback of these runs is the feedforward. Two more iterations with it correct the remaining feedback. Writes FILE and
next to it SCENARIO_compensated.yaml, a copy of the scenario that uses it. Existing files are never overwritten.""",
    examples="""\
impact-rs friction identify my_push.yaml -o friction/push_friction.yaml
impact-rs campaign friction/my_push_compensated.yaml -o campaigns/compensated""",
    output="the largest feedforward of every arm before and after the impact, and two files.",
    units="""\
accelerations of the end effector [m/s^2, rad/s^2] and of joint 1 [rad/s^2], over the time of the trial [s].""",
    actions=(
        Command(
            name="friction identify",
            summary="identify the feedforward from runs in free motion",
            function="identify",
            options=(
                SCENARIO,
                output("new_file", "file to write, .yaml", "FILE", required=True),
                OBJECTS,
                CASES,
                option(
                    "--runs", kind="whole", default=5, least=1, metavar="N",
                    help="runs per mean, in each of three iterations",
                ),
                SEED,
                option(
                    "--effects", kind="model", metavar="MODEL",
                    help="model file with effects of the plant beyond the scenario",
                ),
                *JOBS,
                JSON,
            ),
        ),
    ),
)  # fmt: skip

REHEARSE = Command(
    name="rehearse",
    summary="the cell against a stand-in of your robot's driver",
    about="""\
Rehearse a trial of a real robot: the cell arms, leads and leaves a simulated robot behind a stand-in of its driver.

Arming, cell, controller, brake and watchdog are those that a robot meets; the driver has the joint names, rate,
gravity convention, latencies and torque rate of its profile, and time is simulated. The checklist holds joint torques,
torque rates, joint velocities, external torques and forces (against the thresholds of the robot's reflexes), the
distance to joint limits, and the time to stop when the cell dies just before the hit, each with its margin. A robot
whose reflexes have a threshold that is passed stops itself, and the cell and the watchdog meet a stopped robot.

The middleware, ros2_control and a machine that keeps time are not rehearsed. Exit code 1: not passed, because the cell
cannot run with this driver, the trial was not armed or ended early, the robot stopped itself, or a margin is
negative.""",
    examples="""\
impact-rs rehearse push_fr3
impact-rs rehearse push_fr3 -o rehearsals/push_fr3
impact-rs rehearse push_fr3 --parameters config/drivers/fr3_cell.yaml
impact-rs rehearse push_fr3 juice 2 --reflex-torque 80 --reflex-force 40
impact-rs rehearse my_push.yaml --driver ros2_control --json""",
    output="""\
what the cell would log, the checklist, and the verdict with what was not checked; with -o rehearsal.html and
rehearsal.json.""",
    units="s, rad, rad/s, N m, N m/s, N; prismatic joints in m, m/s, N and N/s.",
    options=(
        SCENARIO,
        optional(OBJECT)._replace(otherwise="the first of the scenario"),
        optional(CASE)._replace(otherwise="the first of the scenario"),
        option(
            "--driver", choices=("franka_ros2", "ur_robot_driver", "lbr_fri_ros2_stack", "ros2_control"),
            help="profile of the driver", label="driver", otherwise="that of the scenario's robot",
        ),
        option(
            "--parameters", kind="file", metavar="FILE.yaml", label="parameters of the cell", advanced=True,
            otherwise="the defaults, with names and conventions of the driver",
            help="parameter file of cell and watchdog, as the launch files load it (config/drivers)",
        ),
        *REFLEXES,
        SETTINGS,
        SEED,
        output("new_folder", "folder for the page", label="folder of the page"),
        JSON,
    ),
)  # fmt: skip

UP = Command(
    name="up",
    summary="start the ROS 2 nodes",
    about="""\
Start the ROS 2 nodes (plant, controller, impact map, recorder, experiment) and keep them running until Ctrl-C.

Equivalent to `ros2 launch impact_rs impact_rs.launch.py`, without the ROS 2 command line.

With --without, a node of your own replaces one of them; docs/nodes.md lists its duties.""",
    examples="""\
impact-rs up push
impact-rs up push --namespace cell_a
impact-rs up push --without plant""",
    output="services and actions of the nodes, then one line per trial.",
    options=(SCENARIO, WITHOUT, NAMESPACE),
)
