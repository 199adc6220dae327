# SPDX-License-Identifier: Apache-2.0
"""Which version this is, for bags and reports."""

import subprocess
from importlib.metadata import version
from pathlib import Path

import impact_rs_sim
from impact_rs_sim.version import git_revision, package_version


def test_the_version_is_that_of_the_package() -> None:
    assert package_version() == version("impact-rs")


def test_a_revision_is_that_of_the_sources_or_nothing_where_they_lie_in_no_repository() -> None:
    here = ["git", "-C", str(Path(impact_rs_sim.__file__).parent), "rev-parse", "--short=12", "HEAD"]
    asked = subprocess.run(here, capture_output=True, text=True, check=False)
    assert asked.stdout.strip() in git_revision()
    assert git_revision() == "" or asked.returncode == 0
