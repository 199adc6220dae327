# SPDX-License-Identifier: Apache-2.0
"""How long the workbench takes to answer, in a headless browser that draws by software; wall time.

* slider to paint: from one input event of the restitution slider to the frame that shows its answer, 3D included
* change of scenario: from the choice of another scenario to the frame with its numbers, and with its 3D picture
* first numbers: from opening the page, in a window without cache, to the frame with the first numbers
* start: of the command, to the printed address
"""

from __future__ import annotations

import argparse
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from playwright.sync_api import Browser, Page, sync_playwright

from benchmarks.harness import Case, Row, Work, quantiles
from benchmarks.results import Table

KEY = "contact.restitution"
OTHERS = ("push_ur5e", "push_fr3", "push_iiwa7", "push")  # one arm each, as the first one
PAINTED = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
MOVE = f"""async (value) => {{
    const slider = document.querySelector("[data-key='{KEY}']"), plot = document.getElementById('predict-plot');
    const begun = performance.now();
    await new Promise((done) => {{
        const answered = new MutationObserver(() => {{
            if (JSON.parse(plot.dataset.shown)['{KEY}'] !== Number(slider.value)) return;
            answered.disconnect();
            done();
        }});
        answered.observe(plot, {{attributes: true, attributeFilter: ['data-shown']}});
        slider.value = value;
        slider.dispatchEvent(new Event('input'));
    }});
    await {PAINTED};
    return performance.now() - begun;
}}"""
ANSWERS = """() => performance.getEntriesByType('resource').filter((one) => one.name.endsWith('/api/predict'))
    .map((one) => one.responseEnd - one.requestStart)"""
CHANGE = f"""async (name) => {{
    const choice = document.getElementById('predict-scenario'), rows = document.querySelector('#predict-table tbody');
    const scene = document.getElementById('predict-scene');
    const begun = performance.now();
    const since = async (node, options, there) => {{
        await new Promise((done) => {{
            const seen = new MutationObserver(() => {{ if (there()) {{ seen.disconnect(); done(); }} }});
            seen.observe(node, options);
        }});
        await {PAINTED};
        return performance.now() - begun;
    }};
    choice.value = name;
    const both = Promise.all([since(rows, {{childList: true}}, () => rows.children.length > 0),
        since(scene, {{attributes: true}}, () => scene.dataset.shown.includes(`"${{name}}"`))]);
    choice.dispatchEvent(new Event('change'));
    return both;
}}"""
FIRST = f"""async () => {{
    while (!document.querySelector('#predict-table tbody tr')) await {PAINTED};
    return performance.now();
}}"""


@contextmanager
def served(folder: Path) -> Iterator[tuple[str, float]]:
    """Address of a workbench, and how long it took to start [s]."""
    begun = time.perf_counter()
    command = [sys.executable, "-m", "impact_rs_cli.main", "workbench", str(folder), "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        address = re.search(r"http://\S+", process.stdout.readline())
        assert address is not None
        try:
            yield address[0], time.perf_counter() - begun
        finally:
            process.send_signal(signal.SIGINT)


def opened(browser: Browser, address: str) -> tuple[Page, float]:
    """A page in a window of its own, and when its first numbers were painted [ms]."""
    page = browser.new_context(viewport={"width": 1280, "height": 800}).new_page()
    page.goto(address, wait_until="commit")
    return page, float(page.evaluate(FIRST))


def rested(page: Page) -> None:
    """Until nothing is asked any more: the interval of many draws and the curves of the sweep are there."""
    page.locator("#predict-facts", has_text="200 draws").wait_for()
    page.locator("#predict-plot .scatterlayer .trace").nth(6).wait_for(state="attached")


def add_options(parser: argparse.ArgumentParser) -> None:
    """How often."""
    parser.add_argument("--moves", type=int, default=60, help="moves of the slider")
    parser.add_argument("--openings", type=int, default=3, help="how often page and scenarios are opened")


def cases(options: argparse.Namespace) -> list[Case]:
    """One server, one browser."""
    del options
    return [Case("workbench")]


def run(case: Case, work: Work) -> Row:
    """Times [ms]."""
    del case
    options, path = work.options, shutil.which("chromium") or shutil.which("google-chrome")
    with served(work.folder / "bench") as (address, start), sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        pages = [opened(browser, address) for _ in range(options.openings)]
        for page, _ in pages[1:]:
            page.context.close()
        page = pages[0][0]
        rested(page)
        values = 0.25 + 0.2 * np.sin(np.linspace(0.3, 6.0, options.moves + 1))
        page.evaluate(MOVE, float(values[0]))  # the first one compiles
        painted = [float(page.evaluate(MOVE, float(value))) for value in values[1:]]
        answers = page.evaluate(ANSWERS)[-options.moves :]
        changes = []
        for name in OTHERS * options.openings:
            changes.append(page.evaluate(CHANGE, name))
            rested(page)
        browser.close()
    numbers, pictures = np.array(changes).T
    return {
        "from a move of the restitution slider to a painted frame, 3D included": painted,
        "... until the answer is there": answers,
        "from another scenario to its numbers": numbers,
        "... to its 3D picture": pictures,
        "first numbers after opening the page": [time_ for _, time_ in pages],
        "start of `impact-rs workbench`, to the printed address": [1e3 * start],
    }


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """A row for each wait."""
    del options
    lines = [(label, quantiles(times)) for label, times in rows[0].items() if label != "name"]
    return Table(("Workbench with 3D, drawn by software", "wall time [ms], median (10 to 90 %)"), tuple(lines))
