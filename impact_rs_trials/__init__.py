# SPDX-License-Identifier: Apache-2.0
"""Trials, their bags and campaigns; foreign recordings and impact tables.

Record a trial of the simulated plant, and read its bag::

    from pathlib import Path

    from impact_rs_sim import load_scenario
    from impact_rs_trials import TrialBag, TrialInfo, TrialKey, TrialSpec, record_trial

    plan = TrialSpec.of(load_scenario("push"), "juice", "case_1").plan
    key = TrialKey("juice", "case_1", 1.0, 0)
    record_trial(plan, TrialInfo.of(plan, key, key.seed(0), "inprocess"), Path("campaigns/one", key.name))
    bag = TrialBag.open(Path("campaigns/one", key.name))

The names below are imported when they are first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from impact_rs_sim.lazy_names import lazy_names

if TYPE_CHECKING:
    from impact_rs_trials.bags.reader import TrialBag as TrialBag
    from impact_rs_trials.bags.record import record_trial as record_trial
    from impact_rs_trials.bags.trial_info import TrialInfo as TrialInfo
    from impact_rs_trials.bags.trial_info import TrialKey as TrialKey
    from impact_rs_trials.campaign import make_manifest as make_manifest
    from impact_rs_trials.campaign import run_campaign as run_campaign
    from impact_rs_trials.spec import TrialSpec as TrialSpec

MODULES = {
    "bags.reader": ("TrialBag",),
    "bags.record": ("record_trial",),
    "bags.trial_info": ("TrialInfo", "TrialKey"),
    "campaign": ("make_manifest", "run_campaign"),
    "spec": ("TrialSpec",),
}
__all__ = sorted(name for names in MODULES.values() for name in names)  # noqa: PLE0605
__getattr__ = lazy_names(__name__, MODULES)
