# SPDX-License-Identifier: Apache-2.0
"""Scenario files (``config/scenarios/*.yaml``) with the files that they name: robots, meshes, friction compensation.

They are cached until one of them changes.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

from impact_rs_sim.errors import InputError, did_you_mean, shortened
from impact_rs_sim.files import is_file
from impact_rs_sim.paths import config_directory
from impact_rs_sim.robots.robot import RobotFacts
from impact_rs_sim.scenarios.friction_compensation import FrictionCompensation
from impact_rs_sim.scenarios.object_mesh import read_object_mesh
from impact_rs_sim.scenarios.scenario import Scenario, check_compensation
from impact_rs_sim.schema import load, load_mapping, validate


def scenario_path(name: str) -> Path:
    """Path of the scenario ``name`` in the config folder, or ``name`` itself where it is a path to a YAML file."""
    directory = config_directory() / "scenarios"
    path = Path(name) if name.endswith((".yaml", ".yml")) else directory / f"{name}.yaml"
    if not is_file(path):
        names = sorted(file.stem for file in directory.glob("*.yaml"))
        raise InputError(
            f"no scenario {shortened(name)!r}; known scenarios: {', '.join(names)}, or give a path to a .yaml file"
            f"{did_you_mean(name, names)}"
        )
    return path


@functools.lru_cache(maxsize=32)
def _named_files(path: Path, modified: int) -> tuple[Path, ...]:
    """Files of robots and meshes of objects that a scenario names."""
    del modified
    data, files = load_mapping(path), []
    for section, key in (("robots", "facts"), ("objects", "mesh"), ("neighbours", "mesh")):
        entries = data.get(section)
        specs = entries.values() if isinstance(entries, dict) else ()
        names = [spec.get(key) for spec in specs if isinstance(spec, dict)]
        files += [path.parent / name for name in names if isinstance(name, str)]
    return tuple(files)


def _modified(path: Path) -> int:
    """Modification time of a file [ns since 1970]; 0: it does not exist."""
    return path.stat().st_mtime_ns if is_file(path) else 0


def _read_robot_files(data: dict[str, Any], directory: Path) -> None:
    """Replace paths to robot facts by the facts, so that bags contain them."""
    robots = data.get("robots")
    for robot in robots.values() if isinstance(robots, dict) else ():
        facts = robot.get("facts") if isinstance(robot, dict) else None
        if isinstance(facts, str) and facts.endswith((".yaml", ".yml")):
            robot["facts"] = load(RobotFacts, directory / facts).model_dump()


def _read_meshes(data: dict[str, Any], directory: Path) -> None:
    """Replace paths to meshes of objects by shape, size and inertia of the meshes, so that bags contain them."""
    sections = {key: data.get(key) for key in ("objects", "neighbours")}
    bodies = {
        f"{key}.{name}": spec
        for key, section in sections.items()
        if isinstance(section, dict)
        for name, spec in section.items()
        if isinstance(spec, dict) and isinstance(spec.get("mesh"), str)
    }
    for key, spec in bodies.items():
        if redundant := {"shape", "corners", "size"} & set(spec):
            raise InputError("mesh has shape, corners and size: leave these out", key=f"{key}.{min(redundant)}")
        mesh = read_object_mesh(directory / spec.pop("mesh"))
        spec |= {"shape": "hull", "corners": mesh.corners.tolist(), "size": mesh.size.tolist()}
        if not spec.get("fixed"):
            spec.setdefault("com_offset", mesh.com.tolist())
            spec.setdefault("moments_per_mass", mesh.moments.tolist())


@functools.lru_cache(maxsize=32)
def _load_cached(path: Path, modified: tuple[int, ...]) -> tuple[Scenario, Path | None]:
    """The scenario of a file, and the file of its friction compensation.

    Args:
        path: The file.
        modified: Modification times of the file and of the files that it names, part of the cache key.
    """
    del modified
    data = load_mapping(path)
    compensation = data.get("friction_compensation")
    if isinstance(compensation, str):
        del data["friction_compensation"]
    _read_robot_files(data, path.parent)
    _read_meshes(data, path.parent)
    return validate(Scenario, data, path), path.parent / compensation if isinstance(compensation, str) else None


@functools.lru_cache(maxsize=32)
def _compensated(
    path: Path, modified: tuple[int, ...], compensation_path: Path, compensation_modified: int
) -> Scenario:
    del compensation_modified
    scenario, _ = _load_cached(path, modified)
    compensation = load(FrictionCompensation, compensation_path)
    try:
        check_compensation(compensation, scenario)
    except InputError as error:
        raise error.in_file(compensation_path) from None
    return scenario.model_copy(update={"friction_compensation": compensation})


def load_scenario(name: str) -> Scenario:
    """Load a scenario by name or path, and the friction compensation that it names."""
    path = scenario_path(name).resolve()
    own_time = _modified(path)
    modified = (own_time, *map(_modified, _named_files(path, own_time)))
    scenario, compensation = _load_cached(path, modified)
    if compensation is None:
        return scenario
    if not is_file(compensation):
        raise InputError("no such file", file=path, key="friction_compensation", value=str(compensation))
    return _compensated(path, modified, compensation, compensation.stat().st_mtime_ns)
