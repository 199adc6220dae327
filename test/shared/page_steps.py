# SPDX-License-Identifier: Apache-2.0
"""Steps of the page, and how a person goes through them."""

from __future__ import annotations

import re

from browser import PATIENCE
from playwright.sync_api import Locator, Page, expect

TABS = {  # of every step, as its own tests name them; where there are none, the step alone
    "predict": ("impact", "limits", "designs"),
    "measure": ("campaign", "trial", "design", "rehearse", "recorded", "live", "blind"),
    "laboratory": ("import", "laboratory", "impacts"),
    "compare": ("",),
    "diagnose": ("",),
    "add": ("",),
    "history": ("versions", "evidence"),
    "overlay": ("overlay-runs", "overlay-models", "overlay-estimates"),
    "investigate": ("loop", "follow"),
}
DESK = {"width": 1280, "height": 800}


def predicted(page: Page) -> Page:
    """The page once it has shown a prediction with all that takes longer."""
    expect(page.locator("#predict-plot")).to_have_attribute("data-shown", re.compile("."))
    expect(page.locator("#predict-plot .scatterlayer .trace")).to_have_count(7)  # band, 3 maps, object, 2 of the legend
    return page


def go(page: Page, step: str, tab: str = "") -> Locator:
    """Open a step, or a tab of it; returns the command that its form shows."""
    page.locator(f"[data-step={step}]").click()
    if tab:
        page.locator(f"#tab-{tab}").click()
    return command(page)


def command(page: Page) -> Locator:
    """The command that the form in sight shows."""
    return page.locator("main form:visible .command code")


def start(page: Page, label: str, state: str | int = 0, patience: float = PATIENCE) -> Locator:
    """Start a job with the button of the step, and wait until it is in a state (0: done); returns it."""
    job = page.locator("#job-list > li[data-job]").first  # the newest is the first
    last = int(job.get_attribute("data-job") or 0) if job.count() else 0
    page.locator("main form:visible").get_by_role("button", name=label, exact=True).click()
    expect(job).to_have_attribute("data-job", str(last + 1))
    expect(job).to_have_attribute("data-state", str(state), timeout=patience)
    return job
