# SPDX-License-Identifier: Apache-2.0
"""How long the workbench takes to answer, in a headless browser that draws by software.

    ./run python benchmarks/workbench.py [--moves 100] [--openings 4]

    slider to paint       from one input event of the restitution slider to the frame that shows its answer, 3D included
    change of scenario    from the choice of another scenario to the frame with its numbers, and with its 3D picture
    first numbers         from opening the page, in a window without cache, to the frame with the first numbers
    start                 of the command, to the printed address

Times are wall time of a machine that does other work as well: the load is printed beside them.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from playwright.sync_api import Browser, Page, sync_playwright

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
        found = re.search(r"http://\S+", process.stdout.readline())
        assert found is not None
        try:
            yield found[0], time.perf_counter() - begun
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


def said(what: str, times: Sequence[float]) -> None:
    """Print median and 90 % of times [ms], with the load."""
    middle, late = np.percentile(times, [50, 90])
    print(
        f"{what}: median {middle:.0f} ms, 90 % {late:.0f} ms, of {len(times)}; load {os.getloadavg()[0]:.1f}",
        flush=True,
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--moves", type=int, default=100, help="moves of the slider")
    parser.add_argument("--openings", type=int, default=4, help="how often page and scenarios are opened")
    arguments = parser.parse_args()
    path = shutil.which("chromium") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as folder, served(Path(folder) / "bench") as (address, start):
        print(f"start: {start:.1f} s; load {os.getloadavg()[0]:.1f}")
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
            pages = [opened(browser, address) for _ in range(arguments.openings)]
            said("first numbers after opening", [time_ for _, time_ in pages])
            for page, _ in pages[1:]:
                page.context.close()
            page = pages[0][0]
            rested(page)
            values = 0.25 + 0.2 * np.sin(np.linspace(0.3, 6.0, arguments.moves + 1))
            page.evaluate(MOVE, float(values[0]))  # the first one compiles
            said("slider to paint, with 3D", [float(page.evaluate(MOVE, float(value))) for value in values[1:]])
            said("  of which until the answer is there", page.evaluate(ANSWERS)[-arguments.moves :])
            changes = []
            for _ in range(arguments.openings):
                for name in OTHERS:
                    changes.append(page.evaluate(CHANGE, name))
                    rested(page)
            numbers, pictures = np.array(changes).T
            said("change of scenario, numbers", numbers)
            said("change of scenario, 3D", pictures)
            browser.close()


if __name__ == "__main__":
    main()
