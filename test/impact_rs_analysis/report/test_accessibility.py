# SPDX-License-Identifier: Apache-2.0
"""A screen reader and a keyboard can read every kind of report; its first line says what it is and what comes next."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from itertools import product
from pathlib import Path
from typing import Literal

import pytest
from browser import accessible, needs_browser, opened
from playwright.sync_api import Browser
from reports import REPORTS

from impact_rs_analysis.report.page import PALETTE

PHONE = {"width": 390, "height": 844}  # where wide tables scroll
MEASURED = ("analysis", "trial")
RICH = ("comparison", "diagnosis", "trial")  # pages of the fast tests, beside limits
DARK = ("analysis", "diagnosis", "trial")  # together they have every colour of a page


@needs_browser
@pytest.mark.parametrize(
    ("kind", "scheme"),
    [
        *((kind, "light") for kind in RICH),
        *(pytest.param(kind, "light", marks=pytest.mark.slow) for kind in (*REPORTS, *MEASURED) if kind not in RICH),
        ("limits", "dark"),  # kills: a figure with bars that is not drawn
        *(pytest.param(kind, "dark", marks=pytest.mark.slow) for kind in DARK),
    ],
)
def test_a_report_is_accessible_with_every_section_open(
    kind: str, scheme: Literal["light", "dark"], report: Callable[[str], Path], browser: Browser
) -> None:
    """The rules of axe-core (landmarks, headings, tables, contrast, keyboard)."""
    options = {"reduced_motion": "reduce", "color_scheme": scheme, "viewport": PHONE, "bypass_csp": True}
    with opened(browser, report(kind).as_uri(), **options) as page:
        page.locator("details").evaluate_all("all => { for (const one of all) one.open = true; }")
        accessible(page)


def colours(style: str) -> dict[str, dict[str, str]]:
    """Colours of a style sheet by their names, in both schemes."""
    light, dark = re.findall(r":root \{(.*?)\}", style, re.DOTALL)
    named = r"--([a-z-]+): #([0-9a-f]{3,6})\b"
    own = {"light": dict(re.findall(named, light)), "dark": dict(re.findall(named, dark))}
    assert own["light"].keys() == own["dark"].keys()
    return own


def luminance(colour: str) -> float:
    """Relative luminance of a colour (WCAG 2.2), 0 to 1."""
    whole = colour if len(colour) == 6 else "".join(2 * digit for digit in colour)
    parts = [int(whole[at : at + 2], 16) / 255.0 for at in (0, 2, 4)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: str, other: str) -> float:
    """Contrast ratio of two colours, 1 to 21."""
    darker, lighter = sorted((luminance(one), luminance(other)))
    return (lighter + 0.05) / (darker + 0.05)


# Texts on what lies behind them: of the reports, and of the workbench.
REPORT = [*product(("ink", "soft"), ("paper", "shade", "tag")), *product(("ink",), ("good-tag", "maybe-tag", "chosen"))]
WORKBENCH = [
    *product(("ink", "soft", "good", "bad", "accent"), ("paper", "shade")),
    ("ink", "chosen"),
    ("soft", "chosen"),
]
PAIRS: Mapping[str, list[tuple[str, str]]] = {
    "report": [*REPORT, ("accent", "paper")],
    "workbench": [*WORKBENCH, ("on-accent", "accent")],
}


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", PAIRS)
def test_every_text_stands_out_from_what_is_behind_it(name: str, scheme: str) -> None:
    """By the colours of the style sheet: kills a faint dark colour, which axe sees in slow tests alone."""
    own = colours(PALETTE.read_text(encoding="utf-8"))[scheme]
    faint = {pair: round(contrast(*(own[one] for one in pair)), 2) for pair in PAIRS[name]}
    assert {pair: ratio for pair, ratio in faint.items() if ratio < 4.5} == {}


@pytest.mark.parametrize("kind", [*REPORTS, *MEASURED])
def test_the_first_line_says_what_a_report_is_and_what_comes_next(kind: str, report: Callable[[str], Path]) -> None:
    text = report(kind).read_text(encoding="utf-8")
    lead = text.partition("</h1>")[2].partition("</p>")[0].partition('<p class="note">')[2]
    assert 30 < len(lead) < 400
    assert "Next: " in lead
