# SPDX-License-Identifier: Apache-2.0
"""Two graphs in two namespaces of one domain run at the same time, and neither sees anything of the other."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from node_trials import whole_trial

from impact_rs_ros.graph import Graph
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.campaign import Manifest, make_manifest, run_one

pytestmark = pytest.mark.slow
CELLS = {
    "cell_a": ("push", 1),
    "cell_b": ("grab", 2),
}  # scenario and seed; an arm is called `arm`, or `left` and `right`


def manifest_of(cell: str) -> Manifest:
    scenario, seed = CELLS[cell]
    return make_manifest(scenario, ["cat_food"], ["2"], [1.0], trials=1, seed=seed)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("namespaces")


@pytest.fixture(scope="module")
def cells(domain_ids: Callable[[], int], folder: Path) -> Iterator[dict[str, Graph]]:
    """Both start with ``push``, so that the second meets the topics of ``grab`` while it runs."""
    domain = domain_ids()
    with ExitStack() as stack:
        yield {cell: stack.enter_context(Graph.running("push", domain, root=folder, namespace=cell)) for cell in CELLS}


@pytest.fixture(scope="module")
def recorded(cells: dict[str, Graph], folder: Path) -> dict[str, TrialBag]:
    """One trial each, at the same time."""

    def run(cell: str) -> TrialBag:
        return whole_trial(cells[cell], folder / cell, manifest_of(cell))

    with ThreadPoolExecutor() as pool:
        return dict(zip(CELLS, pool.map(run, CELLS), strict=True))


@pytest.fixture(scope="module")
def alone(folder: Path) -> dict[str, TrialBag]:
    """The same trials in this process, one after the other."""
    bags = {}
    for cell in CELLS:
        manifest = manifest_of(cell)
        run_one(folder / f"{cell}_alone", manifest.trial(manifest.keys[0]))
        bags[cell] = TrialBag.open(folder / f"{cell}_alone" / manifest.keys[0].name)
    return bags


@pytest.mark.parametrize("cell", CELLS)
def test_its_bag_names_topics_and_frames_as_one_without_a_namespace(
    recorded: dict[str, TrialBag], alone: dict[str, TrialBag], cell: str
) -> None:
    ours = {topic: count for topic, count in recorded[cell].counts.items() if topic != topics.DIAGNOSTICS}
    assert ours == {topic: count for topic, count in alone[cell].counts.items() if topic != topics.DIAGNOSTICS}
    assert frames(recorded[cell]) == frames(alone[cell])


@pytest.mark.parametrize("cell", CELLS)
def test_its_trial_is_the_one_that_runs_alone(
    recorded: dict[str, TrialBag], alone: dict[str, TrialBag], cell: str
) -> None:
    for arm in alone[cell].info.robots:
        for topic in (topics.joint_states(arm), topics.joint_command(arm), topics.truth_joint_states(arm)):
            found, expected = recorded[cell].joints(topic), alone[cell].joints(topic)
            np.testing.assert_allclose(found.position, expected.position, rtol=0.0, atol=1e-9)
            np.testing.assert_allclose(found.effort, expected.effort, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("cell", CELLS)
def test_its_bag_has_the_diagnostics_of_its_own_nodes_alone(recorded: dict[str, TrialBag], cell: str) -> None:
    found = recorded[cell].messages(topics.DIAGNOSTICS)
    assert {status.name.rpartition("/")[0] for one in found for status in one.status} == {f"/{cell}"}


def test_only_what_all_of_ros_agrees_on_is_outside_of_the_namespaces(cells: dict[str, Graph]) -> None:
    node = cells["cell_a"].node
    inside = tuple(f"/{cell}/" for cell in CELLS)
    outside = {name for name, _ in node.get_topic_names_and_types() if not name.startswith(inside)}
    assert outside <= {"/diagnostics", "/tf", "/tf_static", "/parameter_events", "/rosout"}
    assert all(name.startswith(inside) for name, _ in node.get_service_names_and_types())


def frames(bag: TrialBag) -> set[tuple[str, str]]:
    """Every parent and child on ``/tf`` and ``/tf_static``."""
    found = [one for topic in (topics.TF, topics.TF_STATIC) for one in bag.messages(topic)]
    return {(each.header.frame_id, each.child_frame_id) for one in found for each in one.transforms}
