# SPDX-License-Identifier: Apache-2.0
"""What ``show --live`` costs, and how late its picture is: from a message at 1 kHz to the paint of a browser.

    ./run python benchmarks/live.py

publishes joint states of `push` or `grab` at 1 kHz with object pose and contact forces, as a graph of nodes does,
starts ``show --live``, opens its page in a headless Chromium (which draws by software where there is no graphics card)
and tells, over some seconds: age of a state when its picture is complete [ms], pictures per second, and processor time
of the server, before there is a graph, without a page and with one [% of a core].
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
from playwright.sync_api import sync_playwright

from impact_rs_ros.middleware import set_middleware

sys.path.append(str(Path(__file__).resolve().parents[1] / "test" / "shared"))

from fake_graph import FakeGraph, fake_graph  # noqa: E402

RATE = 1000.0  # Hz
SOFTWARE = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
CLOCK = os.sysconf("SC_CLK_TCK")
READY = "async () => { while (!window.impact_rs.live.state) await new Promise(requestAnimationFrame); }"
AGES = """(start) => { const {live, events} = window.impact_rs, update = live.update.bind(live);
  window.ages = []; window.received = 0;
  events.addEventListener('state', () => { window.received += 1; });
  live.update = (state) => { update(state); live.renderer.getContext().finish();
    window.ages.push(1000 * (Date.now() / 1000 - start - state.time)); }; }"""


def publish(graph: FakeGraph, arms: list[str], start: float, stopping: threading.Event, sent: list[int]) -> None:
    """Joint states whose stamp is the time since ``start``, object pose every eighth and force every tick."""
    tick, q = 0, np.zeros(7)
    while not stopping.is_set():
        tick += 1
        late = start + tick / RATE - time.time()
        if late > 0.0:
            time.sleep(late)
        now = time.time() - start
        q[:] = 0.3 * np.sin(now + np.arange(7))
        for arm in arms:
            graph.joints(arm, q, now)
            graph.force_on_pad(arm, (0.0, 10.0 * np.sin(now), 0.0))
        if tick % 8 == 0:
            graph.object(np.array([0.5, -0.1 * np.sin(now), 0.5, 0.0, 0.0, 0.0, 1.0]))
        sent[0] = tick


def processor_time(process: int) -> float:
    """What a process has used so far [s]."""
    words = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / CLOCK


def main() -> None:
    """Measure, and print a line per figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenario", default="push", help="push (one arm) or grab (two)")
    parser.add_argument("--seconds", type=float, default=10.0, help="of every measurement")
    parser.add_argument("--domain", type=int, default=74, help="ROS domain, which nobody else should use")
    parser.add_argument("--chromium", default="/usr/bin/chromium")
    args = parser.parse_args()
    os.environ["ROS_DOMAIN_ID"] = str(args.domain)
    set_middleware(os.environ)
    server = subprocess.Popen(
        [sys.executable, "-m", "impact_rs_cli.main", "show", "--live", "--no-browser"],
        stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    stopping, sent, start = threading.Event(), [0], time.time()
    try:
        assert server.stdout is not None
        address = re.search(r"http://\S+", server.stdout.readline())
        assert address is not None
        used = processor_time(server.pid)
        time.sleep(args.seconds)
        print(f"server, no graph: {100.0 * (processor_time(server.pid) - used) / args.seconds:.1f} % of a core")
        with fake_graph(args.domain) as graph, sync_playwright() as playwright:
            arms = list(graph.trial(args.scenario).plan.arms)
            publisher = threading.Thread(target=publish, args=(graph, arms, start, stopping, sent))
            publisher.start()
            time.sleep(5.0)  # until it is heard
            used, ticks = processor_time(server.pid), sent[0]
            time.sleep(args.seconds)
            alone = 100.0 * (processor_time(server.pid) - used) / args.seconds
            rate = (sent[0] - ticks) / args.seconds
            print(f"server, no page: {alone:.1f} % of a core, {len(arms)} arm(s) at {rate:.0f} Hz")
            browser = playwright.chromium.launch(executable_path=args.chromium, args=SOFTWARE)
            page = browser.new_page(viewport={"width": 1000, "height": 700})
            page.goto(address[0])
            page.evaluate(READY)
            page.evaluate(AGES, start)
            used, ticks = processor_time(server.pid), sent[0]
            time.sleep(args.seconds)
            cost = 100.0 * (processor_time(server.pid) - used) / args.seconds
            ages, states = (page.evaluate(f"window.{name}") for name in ("ages", "received"))
            rate = (sent[0] - ticks) / args.seconds
            print(f"server, one page: {cost:.1f} % of a core, {len(arms)} arm(s) at {rate:.0f} Hz")
            median, high, worst = np.percentile(ages, (50, 95, 100))
            print(f"message to picture: median {median:.0f} ms, 95 % {high:.0f} ms, largest {worst:.0f} ms")
            print(f"states received: {states / args.seconds:.1f} per second, pictures: {len(ages) / args.seconds:.1f}")
            stopping.set()
            publisher.join()
            browser.close()
    finally:
        stopping.set()
        server.send_signal(signal.SIGINT)
        print(f"exit code {server.wait(30.0)}")


if __name__ == "__main__":
    main()
