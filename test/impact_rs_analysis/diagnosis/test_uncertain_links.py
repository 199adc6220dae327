# SPDX-License-Identifier: Apache-2.0
"""Discrimination of a load from errors of the links of a URDF; both are planted in MuJoCo."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mujoco_leg import FACTS, leg_log, leg_source, wrong_links

from impact_rs_analysis.diagnosis.diagnose import diagnose, effects_for
from impact_rs_analysis.diagnosis.search.effect_selection import Search
from impact_rs_analysis.diagnosis.search.fit import Evidence
from impact_rs_analysis.diagnosis.verdict import CONFIRMED, Kind
from impact_rs_sim.effects.link import LINK_EFFECTS, LINK_ERRORS
from impact_rs_sim.physics import ArmPhysics
from impact_rs_sim.robots.bodies import is_physically_consistent

PAYLOAD = "end_effector_payload"
CONSIDERED = [PAYLOAD, *(one.name for one in LINK_EFFECTS)]


def explained_by_links(folder: Path, wrong: bool, load: float) -> bool:
    links = wrong_links(0.2, 0.01, seed=3) if wrong else FACTS.links
    source = leg_source(folder, leg_log(links, load))
    search = Search(effects_for(source, [PAYLOAD]), Evidence.of(source))
    chosen = search.fitted([PAYLOAD])
    assert chosen is not None
    return search.explained_by_links(chosen, PAYLOAD)


@pytest.mark.parametrize(
    ("wrong", "load", "tied"), [(True, 0.0, True), (False, 0.02, True), (False, 0.2, False), (True, 0.4, False)]
)
def test_a_load_is_tied_with_the_links_as_far_as_these_may_be_wrong(
    wrong: bool, load: float, tied: bool, tmp_path: Path
) -> None:
    """The calf weighs 0.24 kg. Kills links without bounds (ties all), with a scale alone (ties no wrong link)."""
    assert explained_by_links(tmp_path, wrong, load) is tied


@pytest.mark.parametrize(("wrong", "load"), [pytest.param(True, 0.0, marks=pytest.mark.slow), (False, 0.2)])
def test_wrong_links_confirm_no_load_and_a_load_is_confirmed(wrong: bool, load: float, tmp_path: Path) -> None:
    """Kills a comparison with single effects of the links alone: none has the numbers of a body."""
    links = wrong_links(0.2, 0.01, seed=3) if wrong else FACTS.links
    source = leg_source(tmp_path, leg_log(links, load))
    found = diagnose(source, source.model, CONSIDERED).effect(PAYLOAD)
    assert found is not None
    if wrong:
        assert found.verdict.kind in (Kind.CONFUSABLE, Kind.NO_IMPROVEMENT, Kind.UNIDENTIFIABLE)
    else:
        assert found.verdict == CONFIRMED
        assert found.parameters["mass"].estimate == pytest.approx(load, abs=0.01)


def test_errors_of_a_link_span_its_ten_inertial_parameters_and_leave_a_body(tmp_path: Path) -> None:
    """Kills a strain that acts on the moments of inertia in place of the second moments, and a missing parameter."""
    source = leg_source(tmp_path, leg_log(FACTS.links))
    scalars = LINK_ERRORS.scalars(source.joints)
    assert len(scalars) == 10 * FACTS.joint_count

    def arm(vector: np.ndarray) -> ArmPhysics:
        return next(iter(LINK_ERRORS.apply_vector(source.physics, vector).arms.values()))

    def parameters(vector: np.ndarray) -> np.ndarray:
        link = arm(vector).facts.links[2]
        return np.array([link.mass, *link.com, *link.inertia])

    own = [number for number, scalar in enumerate(scalars) if scalar.joint == 2]
    nominal = parameters(np.zeros(len(scalars)))
    steps = [parameters(0.01 * (np.arange(len(scalars)) == number)) - nominal for number in own]
    sizes = np.linalg.norm(steps, axis=0)
    assert np.linalg.matrix_rank(np.array(steps) / sizes) == 10
    for seed in range(20):
        ends = np.random.default_rng(seed).choice([scalars[0].lower, scalars[0].upper], len(scalars))
        for link in arm(ends).facts.links:
            assert is_physically_consistent(link.mass, link.inertia_matrix)
