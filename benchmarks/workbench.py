# SPDX-License-Identifier: Apache-2.0
"""How long the workbench takes from a move of a slider to the painted prediction, in a headless browser.

    ./run python benchmarks/workbench.py [--moves 100]

Each move is one input event of the mass slider; the time ends when the browser has painted a frame after the figure and
the table have been drawn with the answer. Rendering is in software. The last number is the start of the command.
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
from pathlib import Path

import numpy as np
from playwright.sync_api import sync_playwright

MOVE = """(value) => new Promise((done) => {
    const slider = document.querySelector("[data-key='objects.cat_food.mass']");
    const plot = document.getElementById('predict-plot');
    const begun = performance.now();
    const painted = new MutationObserver(() => {
        if (JSON.parse(plot.dataset.shown)['objects.cat_food.mass'] !== Number(slider.value)) return;
        painted.disconnect();
        requestAnimationFrame(() => done(performance.now() - begun));
    });
    painted.observe(plot, {attributes: true, attributeFilter: ['data-shown']});
    slider.value = value;
    slider.dispatchEvent(new Event('input'));
})"""


ANSWERS = """performance.getEntriesByType('resource').filter((one) => one.name.endsWith('/api/predict'))
    .map((one) => one.responseEnd - one.requestStart)"""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--moves", type=int, default=100, help="moves of the slider")
    moves = parser.parse_args().moves
    browser_path = shutil.which("chromium") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        begun = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, "-m", "impact_rs_cli.main", "workbench", str(Path(folder) / "bench"), "--no-browser"],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert process.stdout is not None
        found = re.search(r"http://\S+", process.stdout.readline())
        assert found is not None
        start = time.perf_counter() - begun
        browser = playwright.chromium.launch(executable_path=browser_path, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(found[0])
        page.locator("#predict-plot .scatterlayer .trace").nth(6).wait_for(state="attached")  # the sweep is there
        masses = 1.0 + 0.4 * np.sin(np.linspace(0.0, 6.0, moves + 1))
        page.evaluate(MOVE, float(masses[0]))
        times = [float(page.evaluate(MOVE, float(mass))) for mass in masses[1:]]
        answers = page.evaluate(ANSWERS)[-moves:]
        browser.close()
        process.send_signal(signal.SIGINT)
        process.wait()
    median, late = np.percentile(times, [50, 95])
    server, load = float(np.median(answers)), os.getloadavg()[0]
    print(f"slider to paint: median {median:.0f} ms, 95 % {late:.0f} ms, {moves} moves; load {load:.1f}")
    print(f"of which until the answer is there: median {server:.0f} ms")
    print(f"start of the command: {start:.1f} s")


if __name__ == "__main__":
    main()
