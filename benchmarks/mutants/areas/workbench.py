# SPDX-License-Identifier: Apache-2.0
"""The workbench: who may ask, what a form becomes, and what the page shows."""

from mutant import Mutant

GUARD = "impact_rs_workbench/guard.py"
SERVER = "impact_rs_workbench/server.py"
JOBS = "impact_rs_workbench/jobs.py"
STEPS = "impact_rs_workbench/steps.py"
WORKSPACE = "impact_rs_workbench/workspace.py"
LABORATORY = "impact_rs_workbench/laboratory.py"
CANDIDATES = "impact_rs_workbench/candidates.py"
FORMULAS = "impact_rs_workbench/formulas.py"
PREDICTION = "impact_rs_workbench/prediction.py"
RESULTS = "impact_rs_workbench/results.py"
PAGE = "impact_rs_workbench/static/workbench.js"
TESTS = "test/impact_rs_workbench/test_"
SERVER_TESTS = (f"{TESTS}server.py",)
STEPS_TESTS = (f"{TESTS}steps.py",)
JOBS_TESTS = f"{TESTS}jobs.py"
WORKSPACE_TESTS = (f"{TESTS}workspace.py",)
LABORATORY_TESTS = (f"{TESTS}laboratory.py",)
PREDICTION_TESTS = (f"{TESTS}prediction.py",)
PAGE_TESTS = f"{TESTS}page.py"

MUTANTS = [
    Mutant(
        name="origin_by_its_ending",
        file=GUARD,
        original='headers.get("origin") != f"http://{host}"',
        mutated='not headers.get("origin", "").endswith(host)',
        wrong="A page of evil127.0.0.1 may start jobs.",
        tests=SERVER_TESTS,
    ),
    Mutant(
        name="host_by_its_beginning",
        file=GUARD,
        original="if host not in self._hosts:",
        mutated='if not host.startswith(("127.0.0.1", "localhost")):',
        wrong="A name of another site that begins with ours is answered (DNS rebinding).",
        tests=SERVER_TESTS,
    ),
    Mutant(
        name="key_by_its_beginning",
        file=GUARD,
        original="return secrets.compare_digest(text.encode(), self._token.encode())",
        mutated="return self._token.startswith(text)",
        wrong="A part of the key opens the page, an empty one too.",
        tests=SERVER_TESTS,
    ),
    Mutant(
        name="reports_act_as_the_page",
        file=SERVER,
        original='headers={"content-security-policy": FILE_POLICY}',
        mutated="headers={}",
        wrong="A report is shown with the rights of the page.",
        tests=SERVER_TESTS,
    ),
    Mutant(
        name="any_file_is_shown",
        file=SERVER,
        original="if path.suffix not in SHOWN_FILES or not path.is_file():",
        mutated="if not path.is_file():",
        wrong="Files of a kind that no page shows are answered with an error of the server.",
        tests=SERVER_TESTS,
    ),
    Mutant(
        name="a_sweep_never_gives_way",
        file=SERVER,
        original="while self._asked == asked:",
        mutated="while True:",
        wrong="A figure is finished before a moved slider is answered.",
        tests=(f"{TESTS}server.py::test_a_figure_gives_way_to_a_slider_that_has_moved_meanwhile",),
    ),
    Mutant(
        name="own_records_are_in_reach",
        file=WORKSPACE,
        original="if path.relative_to(self.root).parts[:1] == (HIDDEN,):",
        mutated="if path.relative_to(self.root).parts == (HIDDEN,):",
        wrong="Records of jobs are read and overwritten through the page.",
        tests=WORKSPACE_TESTS,
    ),
    Mutant(
        name="parent_outside_of_the_folder",
        file=WORKSPACE,
        original="if beside.is_file() and beside.is_relative_to(self.root):",
        mutated="if beside.is_file():",
        wrong="A model whose parent lies outside ends the look at the folder.",
        tests=WORKSPACE_TESTS,
    ),
    Mutant(
        name="oldest_error_of_a_model",
        file=WORKSPACE,
        original='sorted(found, key=lambda item: -item["when"])',
        mutated='sorted(found, key=lambda item: item["when"])',
        wrong="A model is shown with the oldest of its errors.",
        tests=WORKSPACE_TESTS,
    ),
    Mutant(
        name="a_folder_of_one_campaign",
        file=WORKSPACE,
        original='if len(held) > 1 and folder != "."',
        mutated='if folder != "."',
        wrong="Every folder above a campaign is offered as measurements.",
        tests=WORKSPACE_TESTS,
    ),
    Mutant(
        name="a_job_inside_of_another",
        file=JOBS,
        original="if path == other or path in other.parents or other in path.parents:",
        mutated="if path == other or path in other.parents:",
        wrong="A job may write into a folder that another one is writing.",
        tests=(f"{JOBS_TESTS}::test_two_tabs_see_the_same_jobs_and_one_folder_has_one_job_at_a_time",),
    ),
    Mutant(
        name="job_number_by_their_count",
        file=JOBS,
        original="number = max(taken, default=0) + 1",
        mutated="number = len(taken) + 1",
        wrong="After a record was removed a new job takes the number of an old one.",
        tests=(f"{JOBS_TESTS}::test_a_number_that_was_given_is_not_given_again",),
    ),
    Mutant(
        name="a_lost_job_runs_for_ever",
        file=JOBS,
        original="replace(job, ended=path.stat().st_mtime, exit_code=130, line=LOST)",
        mutated="replace(job, exit_code=130, line=LOST)",
        wrong="A job of an earlier workbench runs for ever.",
        tests=(f"{JOBS_TESTS}::test_records_outlive_the_workbench_and_what_ran_when_it_died_is_told_as_ended",),
    ),
    Mutant(
        name="exit_code_of_a_signal",
        file=JOBS,
        original="code = 128 - code if code < 0 else code",
        mutated="code = 128 + code if code < 0 else code",
        wrong="A job that was killed has another exit code than in a shell.",
        tests=(f"{JOBS_TESTS}::test_a_job_killed_by_a_signal_has_the_exit_code_of_a_shell",),
    ),
    Mutant(
        name="a_path_as_an_option",
        file=STEPS,
        original='return f"./{name}" if name.startswith("-") else name  # no option',
        mutated="return name",
        wrong="A folder called --help becomes an option of the command.",
        tests=STEPS_TESTS,
    ),
    Mutant(
        name="a_scenario_as_an_option",
        file=STEPS,
        original='    if name.startswith("-"):\n        raise InputError("expected the name of a scenario"',
        mutated='    if name.startswith("--x"):\n        raise InputError("expected the name of a scenario"',
        wrong="A scenario called --help becomes an option of the command.",
        tests=STEPS_TESTS,
    ),
    Mutant(
        name="force_turned_round",
        file=STEPS,
        original='(["--force"] if self.force else [])',
        mutated='([] if self.force else ["--force"])',
        wrong="Effects that improve nothing are added unasked.",
        tests=STEPS_TESTS,
    ),
    Mutant(
        name="experiment_of_runs_forgotten",
        file=STEPS,
        original='return ["--experiment", seen(workspace.existing(self.experiment))] if self.experiment else []',
        mutated="return []",
        wrong="Recordings of a laboratory are read as trials of our own.",
        tests=STEPS_TESTS,
    ),
    Mutant(
        name="first_run_instead_of_first_hit",
        file=LABORATORY,
        original="first = next((row for row in rows if row.hit), rows[0])",
        mutated="first = rows[0]",
        wrong="A description is tried on a free motion, where nothing of the object is read.",
        tests=LABORATORY_TESTS,
    ),
    Mutant(
        name="object_pose_of_the_wrong_arm",
        file=LABORATORY,
        original="if description.object_pose is not None and arm == next(iter(scenario.robots)):",
        mutated="if description.object_pose is not None and arm != next(iter(scenario.robots)):",
        wrong="The pose of the object is written for every arm but the first.",
        tests=LABORATORY_TESTS,
    ),
    Mutant(
        name="joints_in_the_order_of_text",
        file=CANDIDATES,
        original='[int(part) if part.isdecimal() else part for part in re.split(r"(\\d+)", name)]',
        mutated='[part for part in re.split(r"(\\d+)", name)]',
        wrong="joint10 comes before joint2.",
        tests=(f"{TESTS}candidates.py",),
    ),
    Mutant(
        name="formulas_over_any_file",
        file=FORMULAS,
        original="if path.exists() and workspace.name(path) not in workspace.contents().formulas:",
        mutated="if False:",
        wrong="Saved formulas replace a model or a scenario.",
        tests=SERVER_TESTS,
    ),
    Mutant(
        name="interval_turned_round",
        file=PREDICTION,
        original='low, high = ends.get(f"{body}.velocity.{axis}", (None, None))',
        mutated='high, low = ends.get(f"{body}.velocity.{axis}", (None, None))',
        wrong="The lower end of an interval is above the upper one.",
        tests=(*SERVER_TESTS, *PREDICTION_TESTS),
    ),
    Mutant(
        name="sweep_forgets_other_sliders",
        file=PREDICTION,
        original='update={"values": {**question.values, slider.key: float(value)}}',
        mutated='update={"values": {slider.key: float(value)}}',
        wrong="The figure is that of the scenario and not of the sliders.",
        tests=PREDICTION_TESTS,
    ),
    Mutant(
        name="budget_smallest_first",
        file=PREDICTION,
        original="key=lambda entry: -entry[1]",
        mutated="key=lambda entry: entry[1]",
        wrong="Who contributes least stands first, and the most may be cut off.",
        tests=PREDICTION_TESTS,
    ),
    Mutant(
        name="torque_for_a_velocity",
        file=RESULTS,
        original='what = "velocity" if "velocity" in cell.signal else "torque"',
        mutated='what = "torque" if "velocity" in cell.signal else "velocity"',
        wrong="A click on a joint's velocity opens its torque.",
        tests=(f"{TESTS}results.py",),
    ),
    Mutant(
        name="page_forgets_the_experiment",
        file=PAGE,
        original="find((lab) => lab.path === runs)?.experiment ?? ''",
        mutated="find((lab) => lab.path !== runs)?.experiment ?? ''",
        wrong="Comparing a laboratory's folder asks for trials of our own.",
        tests=(f"{PAGE_TESTS}::test_a_folder_of_recordings_is_described_from_lists_and_compared",),
    ),
    Mutant(
        name="page_reads_text_as_markup",
        file=PAGE,
        original="  node.append(...children.flat().filter(",
        mutated="  node.innerHTML = children.flat().filter((child) => typeof child === 'string').join('');\n"
        "  node.append(...children.flat().filter((child) => child instanceof Node).filter(",
        wrong="Names of files and notes of models are markup on the page.",
        tests=(f"{PAGE_TESTS}::test_names_and_notes_are_text_and_no_markup",),
    ),
    Mutant(
        name="page_shows_answers_that_come_late",
        file=PAGE,
        original="const content = body(), number = ++asked;",
        mutated="const content = body(), number = asked;",
        wrong="The command of an earlier form stays where its answer comes last.",
        tests=(f"{PAGE_TESTS}::test_an_earlier_command_that_is_answered_last_is_not_shown",),
    ),
    Mutant(
        name="page_keeps_the_first_model_file",
        file=PAGE,
        original="if (!this.output.value || used.has(this.output.value)) {",
        mutated="if (!this.output.value) {",
        wrong="The next model is to be written over the last one.",
        tests=(f"{PAGE_TESTS}::test_the_next_model_is_not_written_over_an_earlier_one",),
    ),
]
