# SPDX-License-Identifier: Apache-2.0
"""Benches of an investigation behind ROS 2: our nodes, and a real cell in the plant's place."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from impact_rs_analysis.application.plant_bench import PlantBench
from impact_rs_analysis.evidence.replays.command_clock import read_runs_of_scenes
from impact_rs_analysis.evidence.replays.measured_runs import Runs
from impact_rs_analysis.investigation.rounds import PlannedTrial
from impact_rs_analysis.investigation.settings import Settings
from impact_rs_cli.cell_guard import CellGuard
from impact_rs_cli.terminal import Terminal
from impact_rs_ros.graph import Graph, run_trial
from impact_rs_sim.errors import InputError
from impact_rs_sim.files import write_whole
from impact_rs_sim.model import Model
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.campaign import Manifest, TrialReport
from impact_rs_trials.experiment_plan import SCENARIO_FILE, write_scenario
from impact_rs_trials.file_names import BAG_METADATA
from impact_rs_trials.recordings.experiment import FREE_MOTION, HIT, NO_OBJECT, YAML, Experiment, load_experiment
from impact_rs_trials.recordings.mapping import load_mapping
from impact_rs_trials.spec import TrialSpec
from impact_rs_trials.workers import Map


class NodesBench(PlantBench):
    """The ROS 2 nodes, with our plant among them.

    Args:
        hidden: Effects of the plant unknown to all other nodes; None: not any.
        without: Nodes that the user provides.
        namespace: ROS namespace of the nodes.
    """

    def __init__(
        self,
        directory: Path,
        settings: Settings,
        map_tasks: Map,
        terminal: Terminal,
        hidden: Model | None = None,
        without: Sequence[str] = (),
        namespace: str = "",
    ) -> None:
        super().__init__(directory, settings, map_tasks, terminal)
        self._hidden, self._without, self._namespace = hidden, without, namespace

    def measure(self, trials: Sequence[PlannedTrial]) -> None:
        """Run trials through the nodes, one after the other."""
        trials = self.in_order(trials)
        self.runs.mkdir(parents=True, exist_ok=True)
        with (
            Graph.running(
                trials[0].scenario,
                root=self.runs,
                without=self._without,
                notify=self.observer.warn,
                namespace=self._namespace,
            ) as graph,
            self.observer.progress("trials") as report,
        ):
            for count, planned in enumerate(trials, start=1):
                graph.wait_until_ready()
                self.run(graph, planned)
                report(count, len(trials))

    def in_order(self, trials: Sequence[PlannedTrial]) -> Sequence[PlannedTrial]:
        """The trials in the order in which they run."""
        return trials

    def run(self, graph: Graph, planned: PlannedTrial) -> TrialReport:
        """Run one trial."""
        report = self.request_trial(graph, planned, repeated=True)
        if report.outcome != "OK":
            self.observer.warn(f"{planned.path}: {report.outcome}: {report.message}")
        if report.outcome == "ABORTED":
            raise RuntimeError(f"{planned.path} was aborted: {report.message}; the same command goes on")
        return report

    def request_trial(self, graph: Graph, planned: PlannedTrial, repeated: bool) -> TrialReport:
        """Ask the experiment node for one trial; a variant of a scenario gets a file, because nodes read files."""
        directory = self.runs / planned.folder
        directory.mkdir(parents=True, exist_ok=True)
        scenario = planned.scenario
        if planned.settings:
            path = directory / SCENARIO_FILE
            write_scenario(load_scenario(scenario).with_settings(planned.settings), path)
            scenario = str(path.resolve())
        key = planned.trial.key
        manifest = Manifest(
            scenario=scenario,
            objects=(key.object,),
            cases=(key.case,),
            velocity_scales=(key.scale,),
            trials=key.repeat + 1,
            seed=planned.campaign_seed,
        )
        return run_trial(graph, directory, manifest, key, self._hidden, repeated)


class CellBench(NodesBench):
    """A real cell in the plant's place, guarded; its bags are read as a laboratory's.

    Args:
        guard: Admits trials.
        mapping: Locates the signals in its bags.

    Raises:
        InputError: There is no such mapping, or a scenario has another robot.
    """

    def __init__(
        self,
        directory: Path,
        settings: Settings,
        map_tasks: Map,
        terminal: Terminal,
        guard: CellGuard,
        namespace: str = "",
        mapping: str = "impact_rs",
    ) -> None:
        super().__init__(directory, settings, map_tasks, terminal, without=("plant",), namespace=namespace)
        facts = load_mapping(mapping).facts  # a wrong one is refused before anything moves
        for scenario in map(load_scenario, settings.scenarios):
            for arm, robot in scenario.robots.items():
                if robot.robot_facts != facts:
                    raise InputError(
                        f"the mapping is for another robot than {robot.facts_name!r}, arm {arm!r} of scenario "
                        f"{scenario.name!r}; expected a copy of it with the key robot of that arm",
                        key="--mapping",
                        value=mapping,
                    )
        self._guard = guard
        self._mapping = str(Path(mapping).absolute()) if mapping.endswith(YAML) else mapping

    def measure(self, trials: Sequence[PlannedTrial]) -> None:
        """Run trials on the cell, after the last stop was answered for."""
        self._guard.begin()
        super().measure(trials)

    def in_order(self, trials: Sequence[PlannedTrial]) -> Sequence[PlannedTrial]:
        """As the guard admits them."""
        return self._guard.in_order(trials)

    def run(self, graph: Graph, planned: PlannedTrial) -> TrialReport:
        """Run one trial as the guard admits it; an aborted one is not repeated.

        Raises:
            SafetyStop: The operator did not agree, or the trial did not go as planned.
        """
        self._guard.admit(planned)
        report = self.request_trial(graph, planned, repeated=False)
        self._guard.after(planned, report)
        return report

    def measured_runs(self) -> Runs:
        """All trials, from measured signals alone: a robot reports no motor states.

        Hits are read in the scene of their own scenario, free motions in the first hit's; without hits in their own.
        """
        specs: dict[Path, TrialSpec] = {}
        hits: dict[str, tuple[Scenario, list[str]]] = {}  # with the rows of the table, by the text of the scenario
        free_rows: list[str] = []
        for path in sorted(self.runs.glob(f"*/*/*/{BAG_METADATA}")):
            bag = TrialBag.open(path.parent)
            spec = specs[path.parent.absolute()] = bag.info.spec
            hit = spec.scenario.excursion is None
            kind, object_name = (HIT, spec.object) if hit else (FREE_MOTION, NO_OBJECT)
            name = path.parent.relative_to(self.runs).as_posix()
            rows = hits.setdefault(spec.scenario_json, (spec.scenario, []))[1] if hit else free_rows
            rows.append(f"{name},{object_name},{kind},{bag.info.scenario},{spec.case},{spec.scale:g}")
        if not specs:
            raise InputError("no trial was recorded here", file=self.runs)
        (scene, rows), *other_hits = hits.values() or [(next(iter(specs.values())).scenario, [])]
        tables = [(scene, rows + free_rows), *other_hits]
        experiments = [self._described(number, *table) for number, table in enumerate(tables, start=1)]
        return read_runs_of_scenes(self.runs.absolute(), experiments, self.map_tasks).named(specs)

    def _described(self, number: int, scenario: Scenario, rows: Sequence[str]) -> Experiment:
        """Description of the trials of one scenario, written next to them."""
        suffix = "" if number == 1 else f"_{number}"
        write_whole(self.runs / f"runs{suffix}.csv", "\n".join(["bag,object,kind,scenario,case,scale", *rows]) + "\n")
        write_scenario(scenario, self.runs / f"scenario{suffix}.yaml")
        experiment = self.runs / f"experiment{suffix}.yaml"
        write_whole(experiment, f"scenario: scenario{suffix}.yaml\nmapping: {self._mapping}\nruns: runs{suffix}.csv\n")
        return load_experiment(experiment)
