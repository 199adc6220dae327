# SPDX-License-Identifier: Apache-2.0
"""Meshes are found where a URDF says, in installed packages, and in sources that are not installed."""

from __future__ import annotations

from pathlib import Path

import pytest

from impact_rs_sim.mesh_files import mesh_address, mesh_path


@pytest.fixture(autouse=True)
def no_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)


def file_at(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    return path


@pytest.mark.parametrize("name", ["meshes/l 1.stl", "../meshes/l 1.stl", "/{folder}/meshes/l 1.stl"])
def test_a_path_is_relative_to_the_urdf(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "arm" if name.startswith("..") else tmp_path
    mesh = file_at(tmp_path / "meshes" / "l 1.stl")
    urdf = file_at(folder / "arm.urdf")
    monkeypatch.chdir(urdf.parent)
    for file in (urdf, Path("arm.urdf")):  # whatever the folder it is read from
        address = mesh_address(name.format(folder=str(tmp_path).strip("/")), file)
        assert address is not None
        assert mesh_path(address) == mesh


def test_an_installed_package_keeps_its_address(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So that facts work on another machine with the package."""
    mesh = file_at(tmp_path / "install" / "share" / "arm_description" / "meshes" / "l1.stl")
    file_at(tmp_path / "src" / "arm_description" / "meshes" / "l1.stl")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'other'}:{tmp_path / 'install'}")
    name = "package://arm_description/meshes/l1.stl"
    assert mesh_address(name, tmp_path / "src" / "arm_description" / "arm.urdf") == name
    assert mesh_path(name) == mesh


@pytest.mark.parametrize("urdf", ["src/arm_description/urdf/arm.urdf", "src/bringup/arm.urdf", "elsewhere/arm.urdf"])
def test_a_package_that_is_not_installed_is_found_above_the_urdf_or_where_the_user_says(
    tmp_path: Path, urdf: str
) -> None:
    mesh = file_at(tmp_path / "src" / "arm_description" / "meshes" / "l1.stl")
    name = "package://arm_description/meshes/l1.stl"
    given = [[tmp_path / "src"], [tmp_path / "src" / "arm_description"]] if urdf.startswith("else") else [[]]
    for packages in given:
        address = mesh_address(name, tmp_path / urdf, packages)
        assert address is not None
        assert mesh_path(address) == mesh
    if given != [[]]:
        assert mesh_address(name, tmp_path / urdf) == name


def test_what_is_nowhere_has_an_address_and_no_file(tmp_path: Path) -> None:
    for name in ("package://arm/l1.stl", f"file://{tmp_path}/l1.stl", "l1.stl"):
        address = mesh_address(name, tmp_path / "arm.urdf")
        assert address is not None
        assert mesh_path(address) is None
    assert mesh_address("model://arm/l1.stl", tmp_path / "arm.urdf") is None
