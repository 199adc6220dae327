# SPDX-License-Identifier: Apache-2.0
"""Conventions of the sources, as a linter would hold them: layers, imports, names, words. Every file is parsed once."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import importlib.metadata
import importlib.util
import inspect
import re
import subprocess
import sys
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import grimp
import pytest
from catkin_pkg.package import parse_package

from impact_rs_sim import physics
from impact_rs_sim.effects import library
from tools import complexity

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

# Who loads these owns them and does it where they are used: each takes a third of a second or more, or is optional.
SLOW = ("scipy", "matplotlib", "distributed", "dask", "pyarrow", "h5py")
LATE = (*SLOW, "fsspec", "mcap_protobuf")
LATE_ROS = {  # what some commands need for running nodes alone
    ("impact_rs_cli/commands/show.py", "impact_rs_cli.live_graph"),
    ("impact_rs_cli/commands/investigate.py", "impact_rs_cli.node_benches"),
    ("impact_rs_cli/commands/workbench.py", "impact_rs_ros.spectator"),
    ("impact_rs_cli/commands/campaign.py", "impact_rs_ros.graph"),
    ("impact_rs_cli/commands/campaign.py", "impact_rs_ros.node_processes"),
}

RIDDLES = re.compile(r"(?<![a-z])(?:told|tells?|things?|somebody|nobody|whoever)(?![a-z])", re.IGNORECASE)
TEXT = {".cpp", ".css", ".hpp", ".html", ".js", ".md", ".msg", ".action", ".py", ".pyi", ".srv", ".yaml"}
# Occurrences that remain: two names of tests, a verdict, three calls of a stream's tell(). Lower a number as they go.
MOST_RIDDLES = {"docs": 2, "impact_rs_analysis": 1, "impact_rs_trials": 3}
READ_FOR_RIDDLES = ("README.md", "docs", "examples", *PACKAGES)

GLOSSARY = ROOT / "docs" / "glossary.md"
HEAD = ["Term", "Name in code", "Meaning"]


@dataclasses.dataclass
class Module:
    """What the checks need of a file, from one walk over its tree."""

    name: str
    imported: set[str] = dataclasses.field(default_factory=set)  # modules
    at_top: set[str] = dataclasses.field(default_factory=set)  # of these, when it is loaded
    late: set[str] = dataclasses.field(default_factory=set)  # of these, in functions
    names: set[str] = dataclasses.field(default_factory=set)
    strings: set[str] = dataclasses.field(default_factory=set)
    defined: set[str] = dataclasses.field(default_factory=set)
    classes: dict[str, tuple[set[str], set[str]]] = dataclasses.field(default_factory=dict)  # members, bases
    seven_joints: list[int] = dataclasses.field(default_factory=list)  # lines that count joints in figures

    @property
    def package(self) -> str:
        return self.name.split("/")[0]


def walk(tree: ast.AST) -> Iterator[tuple[ast.AST, bool]]:
    """Every node, and whether it stands in a function."""
    todo = [(tree, False)]
    while todo:
        node, inside = todo.pop()
        yield node, inside
        inside = inside or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        todo += [(child, inside) for child in ast.iter_child_nodes(node)]


def defined(node: ast.AST) -> str | None:
    """Name of a class or function, or one that is assigned."""
    if isinstance(node, ast.ClassDef | ast.FunctionDef):
        return node.name
    if isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
        return node.id if isinstance(node, ast.Name) else node.attr
    return None


def parsed(path: Path) -> Module:
    """A file."""
    found = Module(path.relative_to(ROOT).as_posix())
    counted = {"range", "scalars", "nominal", "steps", "complexity"}
    tree = ast.parse(path.read_text(encoding="utf-8"), str(path))
    for node, inside in walk(tree):
        if (name := defined(node)) is not None:
            found.defined.add(name)
        match node:
            case ast.Import() | ast.ImportFrom():
                from_one = isinstance(node, ast.ImportFrom)
                modules = {str(node.module)} if from_one else {alias.name for alias in node.names}
                for kind, holds in ((found.imported, True), (found.at_top, node in tree.body), (found.late, inside)):
                    kind.update(modules if holds else ())
                found.names.update(str(node.module).split(".") if from_one else ())
            case ast.alias():
                found.names.update((node.name.split(".")[-1], str(node.asname)))
            case ast.Constant(value=str(text)):
                found.strings.add(text)
            case ast.Name(id=name) | ast.arg(arg=name) | ast.FunctionDef(name=name):
                found.names.add(name)
            case ast.ClassDef():
                found.names.add(node.name)
                members = {str(defined(item)) for item in ast.walk(node)}
                found.classes[node.name] = members, {ast.unparse(base).rpartition(".")[2] for base in node.bases}
            case ast.Call() if any(isinstance(one, ast.Constant) and one.value == 7 for one in node.args):
                called = getattr(node.func, "attr", getattr(node.func, "id", ""))
                found.seven_joints += [node.lineno] if called in counted else []
    return found


@cache
def modules() -> list[Module]:
    return [parsed(path) for package in (*PACKAGES, "impact_msgs_py") for path in (ROOT / package).rglob("*.py")]


@pytest.fixture(scope="module")
def graph() -> grimp.ImportGraph:
    """Every import, wherever it stands."""
    return grimp.build_graph(*PACKAGES, "impact_msgs_py", include_external_packages=True, cache_dir=None)


def test_imports_run_one_way_from_the_command_line_down_to_physics(graph: grimp.ImportGraph) -> None:
    layers = [grimp.Layer(*layer, independent=True) for layer in LAYERS]
    illegal = graph.find_illegal_dependencies_for_layers(layers)
    assert not illegal, [(found.importer, found.imported) for found in illegal]
    assert not graph.find_shortest_chains("impact_rs_workbench", "impact_rs_ros")
    analysis = "impact_rs_analysis"
    for lower, higher in (
        ("measure", "report"),
        ("measure", "diagnosis"),
        ("evidence", "measure"),
        ("evidence", "diagnosis"),
        ("evidence", "report"),
        ("diagnosis", "report"),
        ("report", "application"),
        ("investigation", "application"),
    ):
        assert not graph.find_shortest_chains(f"{analysis}.{lower}", f"{analysis}.{higher}"), f"{higher} <- {lower}"


def test_ros_is_known_to_its_nodes_alone(graph: grimp.ImportGraph) -> None:
    ros = {name for name in graph.modules if name.endswith(("_msgs", "_srvs", "_interfaces"))}
    for name in {"rclpy", "impact_rs", "impact_msgs_py"} | ros:
        importers = {importer.split(".")[0] for importer in graph.find_modules_that_directly_import(name)}
        assert importers <= {"impact_rs_ros", "impact_msgs_py"}, name


def test_nothing_imports_in_a_circle(graph: grimp.ImportGraph) -> None:
    """Neither modules, nor the folders they lie in."""
    for package in PACKAGES:
        inside = graph.find_descendants(package)
        no_circle({name: graph.find_modules_directly_imported_by(name) & inside for name in inside})
        for folder in {package} | {name for name in inside if graph.find_children(name)}:
            parts = {name: one for one in graph.find_children(folder) for name in {one} | graph.find_descendants(one)}
            links: dict[str, set[str]] = defaultdict(set)
            for name, one in parts.items():
                imported = graph.find_modules_directly_imported_by(name)
                links[one] |= {parts[other] for other in imported if other in parts} - {one}
            no_circle(links)


def no_circle(links: dict[str, set[str]]) -> None:
    try:
        TopologicalSorter(links).prepare()
    except CycleError as error:
        pytest.fail(f"a circle: {' <- '.join(error.args[1])}")


def test_imports_stand_at_the_top_and_slow_libraries_load_when_they_are_used() -> None:
    """SciPy itself loads its parts when they are used: ``import scipy`` and ``scipy.optimize.least_squares``."""
    late = {(m.name, imported) for m in modules() for imported in m.late if imported.split(".")[0] not in LATE}
    assert late <= LATE_ROS
    slow = [(m.name, one) for m in modules() for one in m.at_top if one.split(".")[0] in SLOW and one != "scipy"]
    assert not slow


def test_no_module_above_physics_knows_an_effect_by_name_or_counts_joints_in_figures() -> None:
    """Neither as a string nor as a name; what is called alike in the physics (restitution) is no effect."""
    kinds = [kind for _, kind in inspect.getmembers(physics, dataclasses.is_dataclass)]
    properties = {field.name for kind in kinds for field in dataclasses.fields(kind)}
    above = [module for module in modules() if module.package not in ("impact_rs_sim", "impact_msgs_py")]
    for module in above:
        assert not (module.strings | module.names - properties) & set(library()), module.name
        assert "JOINT_COUNT" not in module.names and not module.seven_joints, (module.name, module.seven_joints)


def test_no_two_modules_or_classes_share_a_name() -> None:
    """A module of ``impact_rs_cli/commands`` is named after its command."""
    files = [Path(module.name) for module in modules()]
    names = Counter(path.name for path in files if path.name != "__init__.py" and path.parent.name != "commands")
    names.update(name for module in modules() for name in module.classes)
    assert [name for name, count in names.items() if count > 1] == []


def glossary() -> Iterator[list[str]]:
    """The cells of every row of its tables with names in the code."""
    inside = False
    for line in GLOSSARY.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        inside = cells == HEAD or (inside and line.startswith("|"))
        if inside and line.startswith("| ") and cells != HEAD:
            yield cells


def test_every_term_of_the_glossary_has_one_meaning_and_a_name_in_the_code() -> None:
    rows = list(glossary())
    assert len(rows) >= 60
    assert [row for row in rows if len(row) != len(HEAD) or not (row[0] and "`" in row[1] and row[2])] == []
    assert len({row[0] for row in rows}) == len(rows)
    stubs = [parsed(path) for path in (ROOT / "impact_rs_sim").glob("*.pyi")]
    known = {name for module in (*modules(), *stubs) for name in module.defined}
    known |= {module.name.removesuffix(".py").replace("/", ".") for module in modules()}
    classes: dict[str, tuple[set[str], set[str]]] = {}
    for module in (*modules(), *stubs):
        classes |= module.classes
    for owner, (_, bases) in classes.items():
        known |= {f"{owner}.{name}" for one in (owner, *bases) if one in classes for name in classes[one][0]}
    named = {name: row[0] for row in rows for name in re.findall(r"`([^`]+)`", row[1])}
    assert {name: term for name, term in named.items() if name not in known} == {}


def test_words_that_need_a_translation_do_not_return() -> None:
    for folder in READ_FOR_RIDDLES:
        place = ROOT / folder
        files = [place] if place.is_file() else [path for path in place.rglob("*") if path.suffix in TEXT]
        count = sum(len(RIDDLES.findall(path.read_text(encoding="utf-8"))) for path in files)
        assert count <= MOST_RIDDLES.get(folder, 0), folder


def test_functions_above_the_limits_of_complexity_only_become_fewer() -> None:
    """Kills a new long function, and a baseline that keeps room for one."""
    now, before = complexity.present_counts(), complexity.baseline()
    assert complexity.grown(now, before) == [], "split the function"
    assert complexity.grown(before, now) == [], "./run python -m tools.complexity"


def test_every_source_file_begins_with_the_licence() -> None:
    """In its first line, or behind the ``#!`` of an executable."""
    folders = [path for path in ROOT.iterdir() if path.is_dir() and (path.name == ".ci" or path.name[0] not in "._")]
    built = ("build", "install", "log")
    files = [path for folder in folders if folder.name not in built for path in folder.rglob("*") if path.is_file()]
    sources = [
        path for path in files if path.suffix in (".py", ".cmake", ".sh", ".j2") or path.parent.name == "scripts"
    ]
    licence = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["license"]
    line = f"SPDX-License-Identifier: {licence}"
    assert len(sources) > 500
    for path in (*sources, ROOT / "run", ROOT / "CMakeLists.txt"):
        head = path.read_text(encoding="utf-8").splitlines()[:2]
        first = head[1:] if head and head[0].startswith("#!") else head[:1]
        assert first in ([f"# {line}"], [f"{{# {line} -#}}"]), path


@pytest.mark.parametrize("check", ["lint", "check"])
def test_scripts_of_the_workbench_pass_linter_and_type_check(check: str) -> None:
    """Kills a name that no module exports, a method that no class has, a variable that is never used."""
    done = subprocess.run([sys.executable, "-m", "deno", check], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_scripts_of_the_workbench_have_checked_types_and_lines_as_long_as_in_python() -> None:
    scripts = list((ROOT / "impact_rs_workbench" / "static").rglob("*.js"))
    assert len(scripts) > 20
    longest = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["ruff"]["line-length"]
    for path in scripts:
        lines = path.read_text(encoding="utf-8").splitlines()
        assert lines[:2] == ["// SPDX-License-Identifier: Apache-2.0", "// @ts-check"], path
        assert max(map(len, lines)) <= longest, path


def test_all_that_is_imported_is_required_of_pip_or_of_ros() -> None:
    """Nothing is left to what a system happens to have; rosdep installs what is of ROS, pip what is not."""
    depends = {depend.name for depend in parse_package(ROOT / "package.xml").exec_depends}
    ros = {name for name in depends if not name.startswith("python3-") and name != "pinocchio"}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    required = [*project["dependencies"], *project["optional-dependencies"]["export"]]
    names = [re.split(r"[^\w.-]", line)[0] for line in required]
    names = [name for name in names if not name.startswith("ros-")]
    names += ["annotated-types", "markupsafe", "coal"]  # which pydantic, Jinja2 and pin bring
    files = [file for name in names for file in importlib.metadata.files(name) or ()]
    provided = {file.parts[0].split(".")[0] for file in files}
    provided |= {file.parts[4] for file in files if file.parts[0] == "cmeel.prefix" and len(file.parts) > 5}
    imported = {name.split(".")[0] for module in modules() for name in module.imported}
    assert imported - provided - ros - {*sys.stdlib_module_names, *PACKAGES, "impact_msgs_py", "impact_rs"} == set()


def test_benchmarks_import_names_that_exist() -> None:
    """Nothing else notices a module that is renamed and that only they use."""
    missing = []
    for path in (ROOT / "benchmarks").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith("impact_"):
                module = importlib.import_module(str(node.module))
                names = [alias.name for alias in node.names if not hasattr(module, alias.name)]
                names = [name for name in names if importlib.util.find_spec(f"{node.module}.{name}") is None]
                missing += [(path.name, node.module, name) for name in names]
    assert not missing
