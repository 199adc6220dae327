# SPDX-License-Identifier: Apache-2.0
"""Settings that hold for every test."""

from __future__ import annotations

import fcntl
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hypothesis
import pytest

if TYPE_CHECKING:
    from impact_rs_ros.graph import Graph

sys.path.append(str(Path(__file__).parent / "shared"))  # what tests of several packages have in common

import cost  # noqa: E402 (below test/shared)
from cost import Costs, read_costs  # noqa: E402

# Read when NumPy is loaded. Our matrices are small: a second thread of BLAS triples the processor time of the
# statistics on two busy cores and gains nothing.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# A shared machine is slow now and then, and the first message of a type loads its type support.
hypothesis.settings.register_profile("impact_rs", deadline=None)
hypothesis.settings.load_profile("impact_rs")


WAITING = 1  # processes more than cores: those that test nodes and pages wait for them half of the time
GRAPH = "nodes that share a graph"
OTHER_NODES = "other nodes"
SHARING = ("nodes_", "one_impact_map", "impact_map_node", "node_parameters")  # test_*: use the graph below
COSTS = Path(__file__).parent / "costs.json"  # as ``./run test --all --cost=test/costs.json`` measured them
# A test that takes longer hangs. At a load of 25 on two cores, setups of fast tests took more than 120 s.
FAST, SLOW = 300.0, 900.0  # s


def pytest_addoption(parser: pytest.Parser) -> None:
    """Two tiers, and what they cost."""
    group = parser.getgroup("impact_rs")
    group.addoption(
        "--all", action="store_true", help="also the slow tests: every variant, whole investigations, fuzz in full"
    )
    group.addoption(
        "--cost",
        type=Path,
        metavar="FILE",
        help="write what each test costs, and refuse dear ones that are fast by name",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Tests measure themselves, where they run."""
    config.pluginmanager.register(Costs(None if hasattr(config, "workerinput") else config.option.cost), "costs")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave the slow ones out, unless they are asked for, and end what hangs."""
    slow = [item for item in items if item.get_closest_marker("slow")]
    if not config.option.all and not config.option.markexpr:
        config.hook.pytest_deselected(items=slow)
        left_out = set(slow)
        items[:] = [item for item in items if item not in left_out]
    items.sort(key=lambda item: uses_the_graph(item.nodeid.partition("::")[0]))  # together, for it ends after them
    for item in items:
        if not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(SLOW if item.get_closest_marker("slow") else FAST))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """``-n auto``: more than cores."""
    del config
    return len(os.sched_getaffinity(0)) + WAITING


@pytest.hookimpl(optionalhook=True)  # colcon tests without pytest-xdist, one package at a time
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Where several processes test (``-n``), a file stays together, for its fixtures are dear, and so do nodes.

    A graph of nodes takes more than one core, and what it waits for is wall time: there are few of them at a time.
    """
    from xdist.scheduler import LoadFileScheduling
    from xdist.workermanage import WorkerController

    costs = read_costs(COSTS)

    class LongestFirst(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = super()._split_scope(nodeid)
            if not file.startswith(("test/system/", "test/impact_rs_ros/")):
                return file
            return GRAPH if uses_the_graph(file) else OTHER_NODES

        def _assign_work_unit(self, node: WorkerController) -> None:
            self.workqueue.move_to_end(max(self.workqueue, key=self._cost), last=False)
            super()._assign_work_unit(node)

        def _cost(self, scope: str) -> float:
            return sum(costs.get(file, 0.0) for file in {test.partition("::")[0] for test in self.workqueue[scope]})

    return LongestFirst(config, log)


def uses_the_graph(file: str) -> bool:
    """Whether the tests of a file share the five nodes of ``graph``."""
    return Path(file).name.removeprefix("test_").startswith(SHARING)


MadeOnce = Callable[[str, Callable[[Path], None]], Path]


@pytest.fixture(scope="session")
def made_once(tmp_path_factory: pytest.TempPathFactory) -> MadeOnce:
    """Folders by name that the processes of a test run share: the first one makes it, the others wait for it."""
    base = tmp_path_factory.getbasetemp()
    shared = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "shared"
    shared.mkdir(exist_ok=True)

    def folder(name: str, make: Callable[[Path], None]) -> Path:
        path, partial = shared / name, shared / f".{name}"
        with open(shared / f"{name}.lock", "w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not path.exists():
                shutil.rmtree(partial, ignore_errors=True)
                partial.mkdir()
                with cost.shared():
                    make(partial)
                partial.rename(path)
        return path

    return folder


@pytest.fixture(scope="session")
def push_campaign(made_once: MadeOnce) -> Path:
    """A small campaign, run once: cat food, case 2, three scales. Tests copy it before they change it."""
    from impact_rs_trials.campaign import make_manifest, run_campaign

    def run(folder: Path) -> None:
        manifest = make_manifest("push", ["cat_food"], ["case_2"], [0.8, 1.0, 1.2], trials=1)
        reports = list(run_campaign(folder / "push", manifest))
        assert [report.outcome for report in reports] == ["OK"] * 3

    return made_once("push_campaign", run) / "push"


def rewrite_bag(
    source: Path, target: Path, keep: Callable[[str], bool], change: Callable[[str, Any], None] | None = None
) -> None:
    """Copy a bag with its metadata, as another program does (no checksums), without topics that ``keep`` refuses.

    ``change`` is given the topic of each message and the message itself.
    """
    from rosbags.rosbag2 import Reader, StoragePlugin, Writer

    from impact_rs_trials.bags import checksums
    from impact_rs_trials.bags.types import typestore

    target.parent.mkdir(parents=True, exist_ok=True)
    store = typestore()
    with Reader(source) as reader:
        writer = Writer(target, version=9, storage_plugin=StoragePlugin.MCAP)
        for name, value in (reader.storage.metadata.custom or {}).items():
            if name != checksums.NAME:
                writer.set_custom_data(name, value)
        with writer:
            connections = {
                c.topic: writer.add_connection(c.topic, c.msgtype, typestore=store)
                for c in reader.connections
                if keep(c.topic)
            }
            for connection, timestamp, data in reader.messages():
                if connection.topic not in connections:
                    continue
                if change is not None:
                    message = store.deserialize_cdr(data, connection.msgtype)
                    change(connection.topic, message)
                    data = store.serialize_cdr(message, connection.msgtype)
                writer.write(connections[connection.topic], timestamp, data)


@pytest.fixture(name="rewrite_bag")
def _rewrite_bag() -> Callable[..., None]:
    return rewrite_bag


@pytest.fixture(scope="session")
def domain_ids() -> Iterator[Callable[[], int]]:
    """Hands out ROS domain ids that no other test run on this machine uses; a lock on a file holds each."""
    from impact_rs_ros.middleware import set_middleware

    set_middleware(os.environ)
    with ExitStack() as held:

        def take() -> int:
            for number in range(1, 100):  # 101 and above run into the ports the system hands out
                lock = _opened(Path(tempfile.gettempdir()) / f"impact_rs_domain_{number}.lock")
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except OSError:
                    os.close(lock)
                    continue
                held.callback(os.close, lock)
                return number
            raise RuntimeError("no ROS domain id is free")

        yield take


def _opened(path: Path) -> int:
    """A file to lock, which may be another user's: to create or write that one is refused in a shared folder."""
    try:
        return os.open(path, os.O_RDONLY)
    except FileNotFoundError:
        return os.open(path, os.O_RDONLY | os.O_CREAT, 0o644)


_graphs = ExitStack()


@pytest.fixture(scope="session")
def graph(domain_ids: Callable[[], int], tmp_path_factory: pytest.TempPathFactory) -> Graph:
    """The five nodes as processes, shared by the tests that leave them running."""
    from impact_rs_ros.graph import Graph

    with cost.shared():
        return _graphs.enter_context(Graph.running("push", domain_ids(), root=tmp_path_factory.getbasetemp()))


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """End the graph after the last test that uses it: idle nodes cost what the tests after it need."""
    del item
    if nextitem is None or not uses_the_graph(nextitem.nodeid.partition("::")[0]):
        _graphs.close()


@pytest.fixture(scope="session")
def mixed_trial(made_once: MadeOnce) -> Path:
    """Bag of a trial in which arms of different kinds clamp a parcel."""
    from mixed_grab import MIXED
    from trials import recorded

    from impact_rs_trials.spec import TrialSpec

    name = "parcel__case_1__s1.000__r0"

    def run(folder: Path) -> None:
        verdict = recorded(TrialSpec.of(MIXED, "parcel", "case_1").plan, folder / name)
        assert verdict.outcome == "OK", verdict.reason

    return made_once("mixed_trial", run) / name


HIDDEN_FRICTION = 0.18  # more friction of the support than the scenario says
CONSIDERED = ["support_friction"]  # few, because every effect costs twin rollouts


@pytest.fixture(scope="session")
def hidden_campaign(made_once: MadeOnce) -> Path:
    """Six trials of a plant whose support is rougher than stated: two objects and a free motion, twice each."""
    from impact_rs_control.plan import plan_trial
    from impact_rs_sim.scenarios.scenario_files import load_scenario
    from impact_rs_sim.scene import Scene
    from impact_rs_trials.bags.record import record_trial
    from impact_rs_trials.bags.trial_info import TrialInfo, TrialKey
    from impact_rs_trials.blind import Hidden, hide

    conditions = ("push", "parcel", "case_1"), ("push", "juice", "case_1"), ("excite", "none", "fast")

    def run(folder: Path) -> None:
        hidden = [Hidden("support_friction", (HIDDEN_FRICTION,), 6.0)]
        for scenario, item, case in conditions:
            plan = plan_trial(Scene.resolve(load_scenario(scenario), item, case))
            for repeat in range(2):
                key = TrialKey(item, case, 1.0, repeat)
                info, path = TrialInfo.of(plan, key, key.seed(3), "inprocess"), folder / "runs" / scenario / key.name
                verdict, _ = record_trial(plan, info, path, hide(plan.scene.physics, hidden))
                assert verdict.outcome == "OK", verdict.reason

    return made_once("hidden_campaign", run) / "runs"


@pytest.fixture(scope="session")
def diagnosed(hidden_campaign: Path, made_once: MadeOnce) -> Path:
    """Diagnosis of ``hidden_campaign`` by the command line, for the effect that is hidden alone."""
    from impact_rs_cli.main import main

    def run(folder: Path) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("XDG_CACHE_HOME", str(folder / "cache"))  # nothing from earlier runs
            arguments = ["-o", str(folder / "diagnosis.json"), "--effects", *CONSIDERED]
            assert main(["diagnose", str(hidden_campaign), *arguments, "--jobs", "1"]) == 0  # more only start

    return made_once("diagnosis", run) / "diagnosis.json"
