# SPDX-License-Identifier: Apache-2.0
"""The layout of the sources: who may import whom, and what no module may know."""

import ast
import dataclasses
import inspect
from collections import Counter, defaultdict
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import grimp
import pytest

from impact_rs_sim import physics
from impact_rs_sim.effects import library

ROOT = Path(__file__).resolve().parent.parent
LAYERS = (  # the higher imports the lower; packages beside each other do not know each other
    ("impact_rs_cli",),
    ("impact_rs_workbench",),
    ("impact_rs_analysis", "impact_rs_ros"),
    ("impact_rs_trials",),
    ("impact_rs_control",),
    ("impact_rs_sim", "impact_rs_commands"),
)
PACKAGES = tuple(package for layer in LAYERS for package in layer)
ABOVE_SIM = tuple(package for package in PACKAGES if package != "impact_rs_sim")
MODULES = sorted(path for package in (*PACKAGES, "impact_msgs_py") for path in (ROOT / package).rglob("*.py"))

# Who loads these owns them and does it where they are used: each takes a third of a second or more, or is optional.
SLOW = ("scipy", "matplotlib", "distributed", "dask", "pyarrow", "h5py")
LATE = (*SLOW, "fsspec")


@pytest.fixture(scope="module")
def graph() -> grimp.ImportGraph:
    """Every import, wherever it stands."""
    return grimp.build_graph(*PACKAGES, "impact_msgs_py", include_external_packages=True, cache_dir=None)


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


def modules_of(package: str) -> Iterator[tuple[str, ast.Module]]:
    for path in MODULES:
        if path.relative_to(ROOT).parts[0] == package:
            yield path.relative_to(ROOT).as_posix(), tree(path)


def test_imports_run_one_way_from_the_command_line_down_to_physics(graph: grimp.ImportGraph) -> None:
    layers = [grimp.Layer(*layer, independent=True) for layer in LAYERS]
    illegal = graph.find_illegal_dependencies_for_layers(layers)
    assert not illegal, [(found.importer, found.imported) for found in illegal]


def test_ros_is_known_to_its_nodes_alone(graph: grimp.ImportGraph) -> None:
    ros = {name for name in graph.modules if name.endswith(("_msgs", "_srvs", "_interfaces"))}
    for name in {"rclpy", "impact_rs", "impact_msgs_py"} | ros:
        importers = {importer.split(".")[0] for importer in graph.find_modules_that_directly_import(name)}
        assert importers <= {"impact_rs_ros", "impact_msgs_py"}, name


def test_the_workbench_does_without_ros(graph: grimp.ImportGraph) -> None:
    assert not graph.find_shortest_chains("impact_rs_workbench", "impact_rs_ros")


@pytest.mark.parametrize(
    ("lower", "higher"),
    [
        ("measure", "report"),
        ("measure", "diagnosis"),
        ("evidence", "measure"),
        ("evidence", "diagnosis"),
        ("evidence", "report"),
        ("diagnosis", "report"),
    ],
)
def test_the_analysis_is_built_upwards(graph: grimp.ImportGraph, lower: str, higher: str) -> None:
    chains = graph.find_shortest_chains(f"impact_rs_analysis.{lower}", f"impact_rs_analysis.{higher}")
    assert not chains, f"{higher} <- {lower}"


@pytest.mark.parametrize("package", PACKAGES)
def test_nothing_in_a_package_imports_in_a_circle(graph: grimp.ImportGraph, package: str) -> None:
    """Neither modules, nor the folders they lie in."""
    inside = graph.find_descendants(package)
    _no_circle({name: graph.find_modules_directly_imported_by(name) & inside for name in inside})
    for folder in {package} | {name for name in inside if graph.find_children(name)}:
        _no_circle(_between(graph, graph.find_children(folder)))


def _between(graph: grimp.ImportGraph, parts: set[str]) -> dict[str, set[str]]:
    """Imports between modules and folders, whatever in them it is that imports."""
    part = {name: one for one in parts for name in {one} | graph.find_descendants(one)}
    links: dict[str, set[str]] = defaultdict(set)
    for name, one in part.items():
        links[one] |= {part[other] for other in graph.find_modules_directly_imported_by(name) if other in part} - {one}
    return links


def _no_circle(links: dict[str, set[str]]) -> None:
    try:
        TopologicalSorter(links).prepare()
    except CycleError as error:
        pytest.fail(f"a circle: {' <- '.join(error.args[1])}")


@pytest.mark.parametrize("package", PACKAGES)
def test_imports_stand_at_the_top_of_modules(package: str) -> None:
    """Slow and optional libraries aside; and ROS 2, which some commands need for running nodes alone."""
    late = {
        (name, imported)
        for name, module in modules_of(package)
        for imported in _imported_later(module)
        if imported.split(".")[0] not in LATE
    }
    nodes = ("impact_rs_ros.graph", "impact_rs_ros.node_processes")
    live = {
        ("impact_rs_cli/commands/show.py", "impact_rs_cli.live_graph"),
        ("impact_rs_cli/commands/investigate.py", "impact_rs_cli.node_benches"),
        ("impact_rs_cli/commands/workbench.py", "impact_rs_ros.spectator"),
    }
    assert late <= live | {("impact_rs_cli/commands/campaign.py", module) for module in nodes}


def _imported_later(module: ast.Module) -> Iterator[str]:
    """What functions import."""
    for function in ast.walk(module):
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            for node in ast.walk(function):
                yield from _imported(node)


def _imported(node: ast.AST) -> list[str]:
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    return [str(node.module)] if isinstance(node, ast.ImportFrom) else []


@pytest.mark.parametrize("package", PACKAGES)
def test_no_module_waits_for_a_slow_library_that_it_may_not_need(package: str) -> None:
    """SciPy itself loads its parts when they are used: ``import scipy`` and ``scipy.optimize.least_squares``."""
    slow = [
        (name, imported)
        for name, module in modules_of(package)
        for node in module.body
        for imported in _imported(node)
        if imported.split(".")[0] in SLOW and imported != "scipy"
    ]
    assert not slow


@pytest.mark.parametrize("package", ABOVE_SIM)
def test_no_module_above_physics_knows_an_effect_by_name(package: str) -> None:
    """Neither as a string nor as a name; what is called alike in the physics (restitution) is no effect."""
    effects = set(library())
    properties = {
        field.name
        for _, kind in inspect.getmembers(physics, dataclasses.is_dataclass)
        for field in dataclasses.fields(kind)
    }
    found = [
        (name, word)
        for name, module in modules_of(package)
        for node in ast.walk(module)
        for word in _strings_and_names(node, properties)
        if word in effects
    ]
    assert not found


def _strings_and_names(node: ast.AST, properties: set[str]) -> Iterator[str]:
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    names = {
        ast.Name: lambda: [node.id],
        ast.arg: lambda: [node.arg],
        ast.alias: lambda: [node.name.split(".")[-1], node.asname],
        ast.ImportFrom: lambda: str(node.module).split("."),
        ast.FunctionDef: lambda: [node.name],
        ast.ClassDef: lambda: [node.name],
    }
    yield from (name for name in names.get(type(node), list)() if name and name not in properties)


@pytest.mark.parametrize("package", ABOVE_SIM)
def test_no_module_above_physics_counts_joints_in_figures(package: str) -> None:
    """Neither by a constant that stands for it, nor by a seven to count to or to spell parameters out for."""
    counted = {"range", "scalars", "nominal", "steps", "complexity"}
    found = []
    for name, module in modules_of(package):
        for node in ast.walk(module):
            if isinstance(node, ast.alias | ast.Name) and "JOINT_COUNT" in vars(node).values():
                found.append((name, node.lineno))
            if isinstance(node, ast.Call) and any(isinstance(a, ast.Constant) and a.value == 7 for a in node.args):
                called = getattr(node.func, "attr", getattr(node.func, "id", ""))
                found += [(name, node.lineno)] if called in counted else []
    assert not found


def test_no_two_modules_share_a_name() -> None:
    """A module of ``impact_rs_cli/commands`` is named after its command."""
    names = [path.name for path in MODULES if path.name != "__init__.py" and path.parent.name != "commands"]
    assert [name for name, count in Counter(names).items() if count > 1] == []


def test_no_two_classes_share_a_name() -> None:
    where: dict[str, list[str]] = defaultdict(list)
    for path in MODULES:
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.ClassDef):
                where[node.name].append(path.relative_to(ROOT).as_posix())
    assert {name: paths for name, paths in where.items() if len(paths) > 1} == {}
