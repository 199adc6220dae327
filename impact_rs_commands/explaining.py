# SPDX-License-Identifier: Apache-2.0
"""Commands that read measurements: estimates, comparison, diagnosis, better models and figures."""

from __future__ import annotations

from impact_rs_commands.declaration import Command, argument, option
from impact_rs_commands.shared import (
    JOBS,
    JSON,
    MODEL,
    NO_BROWSER,
    RUNS,
    RUNS_TEXT,
    SCENARIO_TEXT,
    SOURCE,
    contact,
    output,
)

ANALYZE = Command(
    name="analyze",
    summary="compare predictions with recorded trials",
    about="""\
Compare the impact map's predictions with a folder of trials.

For every object and case: the net feedback of each trial over its post-impact reference velocity, a line through them,
and its zero crossing, which is the experimental estimate of the post-impact velocity, with a 95 % interval. Errors are
(prediction - estimate) / estimate in percent, for three models of the motor inertia, just after the first simultaneous
impact and for the settled contact, when the pads lie flat on the object and move with it.

If settings were varied (impact-rs campaign --sensitivity, impact-rs study), every estimate also has a systematic band:
how far it moves with settings that it should not depend on. More trials do not make this band smaller.

Damaged or foreign bags and failed trials are listed with the reason and left out; trials without impact never enter a
fit. Published numbers appear next to a set with the published robot, object and velocity only. A warning names each
prediction that is further from the estimate than a fifth of the ante-impact speed.

Runs recorded with another controller have no net feedback. For them the speed 20 to 40 ms after the impact is
compared with the impact map of the measured state just before it.""",
    examples="""\
impact-rs analyze campaigns/push                  # report in campaigns/push/report
impact-rs analyze campaigns/push -o /tmp/report --json
impact-rs analyze lab/""",
    output="a table; report.html (opens offline and on a phone), analysis.json, and the figures as PNG.",
    units="speeds in m/s along the scenario's axis, errors in percent.",
    options=(
        argument(
            "directory", "folder whose subfolders are bags of trials, or URL", kind="runs", url=True, metavar="DIR",
            label="measurements",
        ),
        output("new_folder", "folder for the report", "REPORT_DIR", otherwise="DIR/report"),
        option(
            "--experiment", kind="experiment", metavar="FILE.yaml", label="experiment file", advanced=True,
            help="DIR holds runs recorded with another controller: their experiment file, relative to the working "
            "directory, else to DIR",
            otherwise="experiment.yaml in DIR, if there is one",
        ),
        contact("predictions in the figures (both have a table); of other controllers predictions in the table"),
        *JOBS,
        JSON,
    ),
)  # fmt: skip

PAPER = Command(
    name="paper",
    summary="fit a motor-inertia scale to the published results",
    about="""\
Fit one motor-inertia scale to the 18 published rows (config/paper/tables.yaml).

The published predictions are known for no motor inertia, for B_theta and for B_rho = 3 B_theta. In between they are
interpolated by a parabola in s, B = s B_theta. Gives the s with the smallest mean absolute mismatch, its interval from
resampling the rows, the mismatch of held-out rows, and the rows that no motor inertia between 0 and B_rho explains.""",
    examples="""\
impact-rs paper
impact-rs paper --json -o report""",
    output="a table; with -o a figure and the table as files.",
    units="mismatch is (prediction - estimate) / estimate in percent; the scale has none.",
    options=(output("new_folder", "folder for figure and table", "REPORT_DIR"), JSON),
)

IMPORT = Command(
    name="import",
    module="import_files",
    summary="describe raw files: joints, units, rates and signs, with evidence",
    about="""\
Look at recorded files and write the files that describe them: mapping.yaml, runs.csv, and experiment.yaml where
something is hit.

Tables (.csv, .txt, .tsv, .dat, .json, .parquet, .npy), arrays (.npz, .h5, .mat, .pt) and bags are read as they are:
lines above the names, no names at all, all joints in one cell, decimal commas, timestamps in s, ms, us, ns, as seconds
and nanoseconds or as dates, a file per signal and run, a folder per session, several recordings in one file. What a
column is, its numbers decide: positions lie within the limits of the robot, velocities are their derivative, torques
are those of gravity and inertia. Every value is printed and written with its evidence; ASSUMED marks values that
nothing shows. Look at those, then compare. Files are never overwritten.""",
    examples="""\
impact-rs import log.csv --robot franka_fr3 -o my_lab
impact-rs compare log.csv --mapping my_lab/mapping.yaml

# hits: a folder of runs, each in one or several files; the scenario says what was hit
impact-rs import hits/ --robot kuka_iiwa7 --scenario my_push.yaml -o my_lab
impact-rs impacts hits --experiment my_lab/experiment.yaml -o impacts.csv

# a tossed body or a ball alone, tracked at 148 Hz without timestamps
impact-rs import tosses/ --robot none --rate 148 -o my_tosses""",
    output="a table of guesses and their evidence; mapping.yaml, runs.csv and experiment.yaml.",
    units="as in the files; the mapping names them.",
    options=(
        argument("files", "recordings, or folders of them", kind="file", metavar="FILE", many=True, label="recordings"),
        option(
            "--robot", kind="robot", metavar="ROBOT", otherwise="the one that the files name",
            help="name of robot facts or path of their YAML file (impact-rs robot import makes them from a URDF); "
            "none: an object alone was tracked",
        ),
        option(
            "--scenario", kind="scenario", metavar="NAME",
            help="scenario (name or file) with the robots and objects of the hits",
        ),
        option(
            "--rate", kind="number", metavar="HZ", unit="Hz", help="sampling rate of files without timestamps",
            label="rate, without timestamps", otherwise="from the timestamps",
        ),
        option(
            "--dedupe", kind="switch", label="keep the first of repeated timestamps", advanced=True,
            help="keep the first of samples with the same timestamp; without it such files are refused",
        ),
        output("new_folder", "folder of the description", required=True, label="folder of the description"),
        JSON,
    ),
)  # fmt: skip

IMPACTS = Command(
    name="impacts",
    module="impacts",
    summary="find impacts in runs, and write a table of them",
    about="""\
Find the impacts in recorded runs and write a table with one row per impact, which compare and diagnose take.

Where a robot hits: joint positions on both sides are parabolas that meet at the impact (recorded velocities are often
low-passed and are not used), the object slides, flies, or is judged by the way it slid. Where a body without a robot
hits a plane: it flies freely on both sides. Every row says its noise, and how well the pose is known; contact points
follow from the geometry. Further columns hold the friction of the support and the way that an object slid. Whatever
gives no row is listed with the reason.""",
    examples="""\
impact-rs impacts tosses --experiment my_tosses/experiment.yaml -o tosses.csv
impact-rs diagnose --impacts tosses.csv -o diagnosis.json

# a robot hits objects; the scenario says which
impact-rs impacts lab -o impacts.csv
impact-rs compare --impacts impacts.csv --scenario push""",
    output="number of impacts, omitted runs with reasons; the table as CSV.",
    units="in the header of every column.",
    options=(
        argument("directory", "folder of the recordings", kind="folder", metavar="DIR", label="recordings"),
        option(
            "--experiment", kind="experiment", metavar="FILE.yaml", label="experiment file",
            help="experiment file (impact-rs import writes one), relative to the working directory, else to DIR",
            otherwise="experiment.yaml in DIR",
        ),
        output("new_file", "table to write", "TABLE.csv", required=True, label="file of the table"),
        *JOBS,
        JSON,
    ),
)  # fmt: skip

COMPARE = Command(
    name="compare",
    summary="show where a model fails against trials",
    about="""\
Compare a model with measurements, and show where it fails.

Three levels: the velocity jump of the impact map, free motion, and the impact with the push after it. The latter two
use a twin: an open-loop simulation from the measured state, driven by the recorded torque. Differences have their own
units and are also given as multiples of repeatability (the scatter of repeats). One score summarises all; a score of 1
equals repeatability. Only measured signals are read.""",
    examples="""\
impact-rs compare campaigns/blind/runs --model config/models/nominal.yaml -o report
impact-rs compare campaigns/blind/runs --model model_2.yaml --mcap aligned --json

# runs recorded with another controller (bags, CSV, NPZ, Parquet, HDF5)
impact-rs compare lab/ -o report

# a recording of a real robot in free motion is compared on joint torque
impact-rs compare recording.db3 --mapping joint_state

# a table with one row per impact, of one free body on a plane or of an arm and an object (--scenario), is compared
# on the velocities just after; docs/files.md lists its columns
impact-rs compare --impacts tosses.csv
impact-rs compare --impacts pushes.csv --scenario push""",
    output="score, size and place of the largest differences; with -o compare.html and compare.json.",
    units="""\
beside each difference; scores are multiples of repeatability, for recordings N m, for impacts without repeats
m/s.""",
    options=(
        RUNS,
        MODEL,
        output("new_folder", "folder for an HTML report", "REPORT_DIR", label="folder of the report"),
        *SOURCE,
        option(
            "--mcap", kind="new_folder", metavar="DIR", advanced=True, label="folder for aligned bags",
            help="folder for aligned bags: measured, predicted and residual signals",
        ),
        *JOBS,
        JSON,
    ),
)  # fmt: skip

DIAGNOSE = Command(
    name="diagnose",
    summary="name the effect that a model lacks, of the physics or of the measurement",
    about="""\
Find out what a model lacks: a fault of a reading, or an effect of the physics.

Fits every effect of the library (impact-rs effects lists them) and of your own formulas to the measurements, and
judges it by its held-out error: how well it predicts conditions that the search has not seen. The verdict on an effect
is CONFIRMED, CONFUSABLE-WITH{...}, PRESENT-BUT-SMALL, NOT-IDENTIFIABLE, NO-IMPROVEMENT or AT-BOUND; the verdict on
the model names the missing effects, or is NOTHING-MISSING, NONE-EXPLAINS, PARTLY{...}, TOO-FEW-REPEATS, or, where
impacts break a law of mechanics, IMPOSSIBLE-DATA.

Needs at least three conditions (object x case) and three extra repeats (runs minus conditions >= 3). A free motion
(scenario excite) separates friction, offset and gain of the torque.""",
    examples="""\
impact-rs diagnose campaigns/blind/runs --model config/models/nominal.yaml -o diagnosis.json
impact-rs diagnose campaigns/blind/runs -o diagnosis.json --effects torque_offset joint_coulomb_friction
impact-rs add torque_offset --model config/models/nominal.yaml --from diagnosis.json -o model_2.yaml

# runs recorded with another controller (bags, CSV, NPZ, Parquet, HDF5)
impact-rs diagnose lab/ -o diagnosis.json

# a recording of a real robot in free motion is compared on joint torque
impact-rs diagnose recording.db3 --mapping joint_state

# a table with one row per impact, of one free body on a plane or of an arm and an object (--scenario), is diagnosed
# on the velocities just after; docs/files.md lists its columns
impact-rs diagnose --impacts tosses.csv -o diagnosis.json
impact-rs diagnose --impacts pushes.csv --scenario push -o diagnosis.json

# what follows a change: all trials since one of them, or since a time
impact-rs diagnose campaigns/day/runs --since push/juice__case_2__s1.000__r36 -o diagnosis.json

# does an effect depend on the session or on the temperature? does the verdict turn on a size that is not known well?
impact-rs diagnose --impacts tosses.csv --covariates session temperature -o diagnosis.json
impact-rs diagnose --impacts tosses.csv --unsure size_z=0.09:0.11 -o diagnosis.json""",
    output="verdict, ranking of the effects, estimates; with -o a JSON file, with --report diagnosis.html.",
    units="""\
beside each estimate; errors are multiples of repeatability, for recordings N m, for impacts without repeats
m/s.""",
    options=(
        RUNS,
        MODEL,
        option(
            "--report", kind="new_folder", metavar="DIR", help="folder for an HTML report", label="folder of the report"
        ),
        output("new_file", "file for the diagnosis", "FILE.json", label="file of the diagnosis"),
        option(
            "--formulas", kind="formulas", metavar="FILE.yaml", help="consider your own effects as well",
            label="your own effects",
        ),
        option(
            "--effects", kind="effect", many=True, metavar="NAME", help="consider only these effects",
            otherwise="all", label="only these effects",
        ),
        option(
            "--bounds", kind="text", many=True, default=(), metavar="EFFECT.PARAMETER=LOW:HIGH", advanced=True,
            label="ranges of parameters", otherwise="in proportion to the robot",
            help="ranges of parameters that you know better, in their units, or a YAML file with EFFECT.PARAMETER: "
            "[LOW, HIGH]; they are not widened",
        ),
        option(
            "--budget", kind="number", metavar="SECONDS", unit="s", least=0.0, default=120.0,
            advanced=True, label="processor time",  # twice what 16 runs of a right model take on a slow machine (55 s)
            help="processor time, of all worker processes together; when it is spent, the best answer so far is "
            "judged, and untried explanations are listed",
        ),
        option(
            "--unsure", kind="text", many=True, default=(), metavar="NAME=LOW:HIGH", advanced=True,
            label="uncertain geometry", otherwise="none",
            help="with --impacts: ranges of uncertain quantities, in SI units: columns of the body (size_x, radius, "
            "mass, ixx ...), offset_x ... of the tracked point from the centre, tilt_x and tilt_y of the plane; of an "
            "arm tool_mass, tool_length, pad_x, pad_y, joint2_z ... and flange_x ... (offsets), support_friction; the "
            "summary says if the verdict turns on them",
        ),
        *SOURCE,
        option(
            "--each-arm", kind="switch", label="parameters of every arm separately", advanced=True,
            help="fit parameters of every arm separately; by default arms of one kind share them (arms of different "
            "kinds never do)",
        ),
        *JOBS,
        JSON,
    ),
)  # fmt: skip

FOLLOWED = ("impacts", "scenario", "contact_tolerance", "calibration", "no_discrepancy")  # of SOURCE

FOLLOW = Command(
    name="follow",
    summary="learn from every impact, and say when something has changed",
    about="""\
Follow a model from hit to hit: trials of a folder in the order in which they were recorded, or impacts of a table.

The first hits give the scatter. Then each hit is predicted before its data are used, updates the parameter estimates of
the model with their intervals, and is tested for a change of any effect of the library: another object or tool, a worn
surface, a joint that warms up. A change is announced with its first hit, its evidence, and all effects that explain it;
where there are several, with what decides between them. At most one alarm in 10,000 hits is false where noise is as the
first hits show it (--mean-time).

A change also starts a full diagnosis of the hits since then, in a process of its own, as soon as they have three
conditions and three repeats; its verdict is printed when it ends. A further change starts it anew. --no-diagnosis only
prints the command.

With --live the command waits for further trials or rows until Ctrl-C. With --state a later run continues this one, also
if it was killed. Column 'time [s]' of a table says when its rows were measured; without it they are in
order.""",
    examples="""\
impact-rs follow campaigns/day/runs --model model_2.yaml --state follow.npz -o model_now.yaml
impact-rs follow campaigns/day/runs --live --state follow.npz

# impacts of an arm, and of one free body, from a table
impact-rs follow --impacts pushes.csv --scenario push
impact-rs follow --impacts tosses.csv --json""",
    output="""\
a line for every change and every odd hit, the believed parameters, and the prediction of the next hit; with -o the
followed model as a file.""",
    units="next to each number; prediction errors are multiples of the standard deviation of a hit.",
    options=(
        RUNS,
        MODEL,
        output("new_file", "file for the followed model", "MODEL.yaml", label="file of the followed model"),
        option(
            "--live", kind="switch", help="wait for further trials or rows until Ctrl-C", label="wait for further hits"
        ),
        option(
            "--state", kind="new_file", metavar="FILE.npz", label="state file", otherwise="none",
            help="state file: read where it exists, so that the command goes on; written after every hit, of many that "
            "are there already after every tenth",
        ),
        option(
            "--diagnoses", kind="new_folder", metavar="DIR", label="folder of the diagnoses", advanced=True,
            otherwise="that of --state, or the working directory",
            help="folder for the full diagnosis that a change calls for",
        ),
        option(
            "--no-diagnosis", kind="switch", label="only print the command of a full diagnosis", advanced=True,
            help="do not start the full diagnosis that a change calls for",
        ),
        option(
            "--learn", kind="whole", least=5, default=20, metavar="N", label="hits that teach the scatter",
            advanced=True, help="hits that give the scatter before the search for changes begins",
        ),
        option(
            "--mean-time", kind="number", default=10000.0, metavar="N", label="hits to a false alarm", advanced=True,
            help="mean number of hits to a false alarm, at least",
        ),
        option(
            "--effects", kind="effect", many=True, metavar="NAME", help="look for changes of only these effects",
            otherwise="all", label="only these effects",
        ),
        *(source for source in SOURCE if source.name in FOLLOWED),
        JSON,
    ),
    resumable=True,
)  # fmt: skip

DISCOVER = Command(
    name="discover",
    summary="look for a law that the library of effects does not have",
    about="""\
Look for a formula that explains what no effect of the library does: the step after NONE-EXPLAINS and PARTLY.

A law is a place, a quantity and a form (config/grammar.yaml): torque on a motor × its velocity × cube, force on the
object × its speed × square; of a table of impacts, restitution or friction × closing or sliding speed × step. Laws
stand where a residual is seen. All are screened linearly, the best are fitted by simulation with thresholds, widths
and periods free, and judged by the held-out error of a search that has not seen the condition, beside the effects of
the library. Laws that predict equally well are listed together. Dependences on columns of a table, such as the session,
are found by diagnose --covariates.

Nothing is proposed where the library explains the measurements, where nothing is missing, and where the hold-out does
not support a law. The same data as for diagnose are needed.""",
    examples="""\
impact-rs discover campaigns/blind/runs -o discovery.json
impact-rs add object_drag_square --from discovery.json -o model_2.yaml
impact-rs compare campaigns/blind/runs --model model_2.yaml

# a restitution that is a curve over the closing speed, in a table with one row per impact
impact-rs discover --impacts tosses.csv -o discovery.json

# runs recorded with another controller, and terms of your own in addition to the shipped grammar
impact-rs discover lab/ --grammar my_terms.yaml -o discovery.json""",
    output="the law as a formula with intervals, laws tied with it; with -o a JSON file, with --report discovery.html.",
    units="next to each estimate; errors are multiples of repeatability, for recordings N m, for impacts m/s.",
    options=(
        RUNS,
        MODEL,
        option(
            "--report", kind="new_folder", metavar="DIR", help="folder for an HTML page with the picture of the law",
            label="folder of the report",
        ),
        output("new_file", "file for the discovery", "FILE.json", label="file of the discovery"),
        option(
            "--grammar", kind="file", metavar="FILE.yaml", help="further quantities, forms and places of laws",
            label="your own terms of laws", advanced=True,
        ),
        option(
            "--effects", kind="effect", many=True, metavar="NAME", otherwise="all", label="only these effects",
            help="effects of the library to consider in addition to the laws", advanced=True,
        ),
        *SOURCE,
        *JOBS,
        JSON,
    ),
)  # fmt: skip

ADD = Command(
    name="add",
    summary="add diagnosed effects to a model, and faults of the readings to a calibration",
    module="add_effect",
    about="""\
Write a new model file: the old model and effects of the physics with the parameters of a diagnosis.

Effects of the measurement (encoder_offset, torque_delay, ...) belong to the laboratory and not to the robot: they go
into calibration.yaml in the folder of the measurements, which is made or extended. compare, diagnose, discover, follow
and history read it and predict the readings of those measurements with it, whatever the model, so that a model file
can be used in another laboratory. Without an effect of the physics no model file is written.

The new file names its parent, so impact-rs history can list all versions. Model files are never overwritten. The
command refuses a diagnosis of another model, and an effect that the trials do not determine; --force adds effects
whose verdict is NO-IMPROVEMENT, and the mean of effects that depend on a covariate. Effects that a diagnosis names
together belong together: their parameters were fitted together.""",
    examples="""\
impact-rs add torque_offset --model config/models/nominal.yaml --from diagnosis.json -o model_2.yaml
impact-rs compare campaigns/blind/runs --model model_2.yaml

# an effect of the measurement goes into calibration.yaml in the folder of the measurements
impact-rs add torque_delay --from diagnosis.json""",
    output="the effects with their parameters, and the YAML files that hold them.",
    units="as in the diagnosis and the model file.",
    options=(
        argument(
            "effect", "effects of the diagnosis, by name", kind="effect", metavar="EFFECT", many=True, label="effects"
        ),
        MODEL._replace(label="model that was diagnosed", advanced=True),
        option(
            "--from", name="source", kind="diagnosis", required=True, metavar="FILE.json", label="diagnosis",
            help="diagnosis of the model",
        ),
        output(
            "new_file", "new model file; needed for effects of the physics", "FILE.yaml", label="new model",
        ),
        option(
            "--calibration", kind="file", metavar="FILE.yaml", label="calibration of the readings", advanced=True,
            otherwise="calibration.yaml in the folder of the measurements",
            help="file for effects of the measurement, made or extended",
        ),
        option(
            "--force", kind="switch", help="add effects even if they are NO-IMPROVEMENT, or depend on a covariate",
            label="add them even if they do not reduce the error",
        ),
        JSON,
    ),
)  # fmt: skip

HISTORY = Command(
    name="history",
    summary="show how the error fell from model to model",
    about="""\
Show the error of every version of a model, from its first parent to MODEL.yaml. Where the folder of the measurements
has a calibration.yaml, its faults of the readings come after the first model, one by one.

Two errors: with the parameters of the file, and held out, where the parameters of the added effect are fitted to all
other conditions. Fitting noise does not reduce the held-out error.""",
    examples="""\
impact-rs history model_3.yaml --runs campaigns/blind/runs
impact-rs history model_3.yaml --runs campaigns/blind/runs -o report --json
impact-rs history model_2.yaml --impacts tosses.csv""",
    output="a table with one row per version; with -o history.html and history.json.",
    units="errors are multiples of repeatability, for recordings of the torque noise; for impacts without repeats m/s.",
    options=(
        argument("model", "the last model", kind="model", metavar="MODEL.yaml"),
        option(
            "--runs", kind="runs", url=True, metavar="RUNS", help=f"{RUNS_TEXT}; leave it out with --impacts",
            label="measurements",
        ),
        output("new_folder", "folder for an HTML page with the plot", label="folder of the page"),
        *SOURCE,
        *JOBS,
        JSON,
    ),
)  # fmt: skip

SHOW = Command(
    name="show",
    summary="show a trial in 3D",
    about="""\
Show one run in 3D: arms, object and support as measured, contact forces, velocities before and after the impact.

Writes one HTML page that opens offline and on a phone, and opens it in the browser. A time slider moves the bodies and
the plots of joint positions, joint velocities and end-effector velocity together; the impact is played a hundred times
slower. Space plays, arrow keys step by 1 ms, with shift by 10 ms, I goes to the impact. Only measured signals are read.

With --live, running nodes (up, a cell, nodes of your own) are shown until Ctrl-C; the page is served to this machine
alone.""",
    examples="""\
impact-rs show campaigns/push/cat_food__case_2__s1.000__r0
impact-rs show campaigns/push/cat_food__case_2__s1.000__r0 -o impact.html --no-browser

# a run recorded with another controller, as compare reads it; with --model next to its twin, window by window
impact-rs show lab --run run_03
impact-rs show lab --run run_03 --model model_2.yaml

# running nodes
impact-rs show --live
impact-rs show --live --namespace cell_a --no-browser""",
    output="one HTML page; with --live the address of a page.",
    units="s, m, m/s, N; joints in rad and rad/s (prismatic joints in m and m/s).",
    options=(
        argument(
            "path", "folder of a trial, or of runs with an experiment file; leave it out with --live",
            kind="folder", metavar="BAG", required=False,
        ),
        option(
            "--experiment", kind="experiment", metavar="FILE.yaml",
            help="BAG is a folder of runs recorded with another controller: their experiment file "
            "(docs/files.md); relative to the working directory, else to BAG", otherwise="experiment.yaml in BAG",
        ),
        option("--run", name="run_name", metavar="NAME", help="name of the run in the table of the experiment"),
        option(
            "--model", kind="model", metavar="FILE",
            help="for runs of an experiment file: model file, or nominal, whose twin is shown next to the run",
        ),
        option("--live", kind="switch", help="show the running nodes until Ctrl-C"),
        option(
            "--namespace", metavar="NAME", help="with --live: ROS namespace of the nodes", otherwise="none"
        ),
        option("--port", kind="whole", metavar="N", help="with --live: port to listen on", otherwise="a free one"),
        output(
            "new_file", "the page", "FILE.html",
            otherwise="NAME_OF_THE_BAG.html next to the bag, DIR_RUN.html next to a folder of runs",
        ),
        NO_BROWSER._replace(help="do not open the page, only write or serve it"),
        *JOBS,
        JSON,
    ),
)  # fmt: skip

EXPORT = Command(
    name="export",
    summary="write a campaign as a table, or a model for another simulator",
    about="""\
Write a campaign into one file for other tools, or a scenario with a model as files of other simulators.

CAMPAIGN -o FILE: .parquet has a row per trial, .h5 (or .hdf5) has every measured signal. A name without suffix is a
folder of .parquet files that are read as one table, with the same rows. It grows with its campaign: run the same
command again, also while the campaign runs, and it reads only new or repeated trials. Rows stay when their bags are
removed.

A row holds scenario, object, case, scale, repeat, seed, outcome, predicted and reference velocity, net feedback and
impact times. In HDF5 every trial is a group, with a group per arm (joint states, motor states, commands, controller
state) and one for the object. Ground truth of the simulated plant is not exported. Unreadable bags
are listed and left out. Needs pyarrow for Parquet and h5py for HDF5; where they
are missing, impact-rs asks whether to install them, or says how.

--mjcf, --drake, --urdf, --usd-params: the scene at its impact with what --model says of it. Masses, centres of mass,
inertias, motor inertia (armature), joint friction, friction, restitution or stiffness and damping of the pads, as far
as a format has them. The head of a file says how its numbers follow, and what it cannot hold.""",
    examples="""\
impact-rs export campaigns/push -o push.parquet
impact-rs export s3://bucket/push -o push.h5
impact-rs export campaigns/push -o push_rows     # folder: push_rows/part-00000.parquet, ...
impact-rs export --mjcf push.xml --scenario push --object cat_food --case 2
impact-rs export --mjcf push.xml --drake push.sdf --model push_1.yaml --scenario push --object cat_food --case 2""",
    output="how many trials were written, and one file or a folder of files; or a file for each simulator, and what it "
    "does not hold.",
    units="a column name ends with its unit; datasets have an attribute units; models are in SI.",
    options=(
        argument("campaign", RUNS_TEXT, kind="runs", url=True, metavar="CAMPAIGN", required=False),
        output("new_file", "for CAMPAIGN: .parquet, .h5, .hdf5, or a folder", "FILE"),
        option("--mjcf", kind="new_file", metavar="FILE.xml", help="MuJoCo model"),
        option("--drake", kind="new_file", metavar="FILE.sdf", help="world of SDFormat with the elements of Drake"),
        option("--urdf", kind="new_file", metavar="FILE.urdf", help="URDF of arms, support and object"),
        option(
            "--usd-params", kind="new_file", metavar="FILE.usda",
            help="layer of USD with masses, materials and armatures, over a robot imported from --urdf",
        ),
        option("--scenario", kind="scenario", metavar="NAME", help=f"scene of the model: {SCENARIO_TEXT}"),
        option("--object", kind="object", metavar="NAME", help="object of the scene"),
        option("--case", kind="case", metavar="NAME", help="case of the scene"),
        MODEL,
        option(
            "--motor-inertia", choices=("reduced", "rotor", "zero"), default="reduced",
            help="motor inertia of the exported arm: B_theta with the torque loop, B_rho without, or none",
        ),
        option(
            "--pads", choices=("rigid", "compliant"), default="rigid",
            help="rigid: with the restitution of the impact map; compliant: with stiffness and damping of the pads",
        ),
        *JOBS,
        JSON,
    ),
)  # fmt: skip

EVIDENCE = Command(
    name="evidence",
    summary="exchange evidence with other laboratories",
    about="""\
Pack evidence for other laboratories, check a package, or merge packages of several laboratories.

pack writes one JSON file: the model, its diagnosis, the SHA-256 of every file of the measurements, versions, and who
measured which robot and object. check tests that nothing was changed, and with --data that the measurements are those.
merge refuses packages of the same measurements, pools every parameter by a random-effects meta-analysis, names
laboratories that do not agree with the others, and says whether a parameter is shared or differs by robot, object or
laboratory.""",
    examples="""\
impact-rs evidence pack diagnosis.json --data runs --laboratory north --robot franka_fer --object cat_food -o north.json
impact-rs evidence check north.json --data runs
impact-rs evidence merge north.json south.json west.json -o merged.json""",
    output="pack: a file. check: list of checks; exit code 1 if one fails. merge: a table, and a file of everything.",
    units="as the parameters.",
    actions=(
        Command(
            name="evidence pack",
            summary="one file with model, diagnosis and digests of the measurements",
            function="pack",
            options=(
                argument("diagnosis", "result of diagnose", kind="diagnosis", metavar="FILE.json"),
                MODEL._replace(help="model that was diagnosed"),
                option(
                    "--data", kind="folder", required=True, metavar="PATH", help="folder or file that was diagnosed",
                    label="measurements",
                ),
                option("--laboratory", required=True, metavar="NAME", help="who measured"),
                option("--robot", required=True, metavar="NAME", help="name of the robot, equal in all laboratories"),
                option("--object", required=True, metavar="NAME", help="name of the object; none in free motion"),
                option("--note", default="", metavar="TEXT", help="remarks for others", otherwise="none"),
                output("new_file", "file of the package", "FILE.json", required=True, label="file of the package"),
                JSON,
            ),
        ),
        Command(
            name="evidence check",
            summary="whether a package, and its measurements, are as packed",
            function="check",
            options=(
                argument("package", "package of evidence", kind="file", metavar="FILE.json"),
                option(
                    "--data", kind="folder", metavar="PATH", help="folder or file of the measurements",
                    label="measurements", otherwise="not checked",
                ),
                JSON,
            ),
        ),
        Command(
            name="evidence merge",
            summary="meta-analysis of several packages",
            function="merge",
            options=(
                argument("packages", "packages of evidence", kind="file", many=True, metavar="FILE.json"),
                output("new_file", "file of the result", "FILE.json", label="file of the result"),
                JSON,
            ),
        ),
    ),
)  # fmt: skip

WORKBENCH = Command(
    name="workbench",
    summary="run the loop on a page in the browser",
    about="""\
Run the loop on one page in the browser: predict, measure, compare, diagnose, add, history.

The page is served to this machine alone, until Ctrl-C; the printed address contains the access key. Every action is a
command of this command line, which the page shows, and every result is a file in DIR: closing the page loses
nothing.""",
    examples="""\
impact-rs workbench
impact-rs workbench campaigns --no-browser""",
    output="the address of the page.",
    units="next to every number on the page.",
    options=(
        argument(
            "directory", "folder of campaigns, recordings and models", kind="folder", required=False, metavar="DIR",
            default="workbench",
        ),
        NO_BROWSER,
        option("--port", kind="whole", default=0, metavar="N", help="port to listen on", otherwise="a free one"),
    ),
)  # fmt: skip
