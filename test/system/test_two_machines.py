# SPDX-License-Identifier: Apache-2.0
"""The plant on one machine, all other nodes on a second one: two network namespaces and a cable between them."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from processes import Running, running

from impact_rs_ros.middleware import CHOICES, RANGE
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.campaign import make_manifest, run_one

pytestmark = pytest.mark.slow
MAKE = ["unshare", "--map-root-user", "--net"]
HELD = ["sh", "-c", "echo ready; exec cat"]  # ends with the test, which holds the other end of its input
CABLE = ["ip", "link", "add", "cable", "type", "veth"]


class Machine(NamedTuple):
    """A network namespace with one cable; a user without rights may make it where the kernel permits."""

    process: Running

    def on(self, *command: str) -> list[str]:
        """Command that runs this one here."""
        held = str(self.process.process.pid)
        return ["nsenter", "--preserve-credentials", "--user", "--net", "--target", held, *command]

    def connect(self, address: str) -> None:
        """Give both interfaces their addresses."""
        for words in (f"addr add {address} dev cable", "link set cable up", "link set lo up"):
            subprocess.run(self.on("ip", *words.split()), check=True)


def refused() -> str:
    """Why there is no such machine here; empty: there is."""
    if lacking := [tool for tool in ("unshare", "nsenter", "ip") if shutil.which(tool) is None]:
        return f"needs {', '.join(lacking)}"
    return subprocess.run([*MAKE, *CABLE], capture_output=True, text=True, check=False).stderr.strip()


@pytest.fixture
def machines() -> Iterator[tuple[Machine, Machine]]:
    """Both ends of the cable: 10.77.0.1 and 10.77.0.2."""
    if reason := refused():
        pytest.skip(f"no network namespaces: {reason}")
    with ExitStack() as stack:

        def machine(*before: str) -> Machine:
            made = stack.enter_context(running([*before, *HELD], stdin=subprocess.PIPE))
            made.line("ready")
            return Machine(made)

        first = machine(*MAKE)
        second = machine(*first.on("unshare", "--net"))
        other_end = ["peer", "name", "cable", "netns", str(second.process.process.pid)]
        subprocess.run(first.on(*CABLE, *other_end), check=True)
        first.connect("10.77.0.1/24")
        second.connect("10.77.0.2/24")
        yield first, second


def test_a_trial_over_a_cable_is_the_one_of_one_process(
    machines: tuple[Machine, Machine], domain_ids: Callable[[], int], tmp_path: Path
) -> None:
    """Kills: nodes that keep to the loopback although ``ROS_AUTOMATIC_DISCOVERY_RANGE`` opens discovery."""
    environment = dict.fromkeys(CHOICES, "") | {RANGE: "SUBNET", "ROS_DOMAIN_ID": str(domain_ids())}
    manifest = make_manifest("push", ["parcel"], ["1"], [1.0], trials=1, seed=2)
    scope = ["--objects", "parcel", "--cases", "1", "--scales", "1.0", "--trials", "1", "--seed", "2"]
    command = [sys.executable, "-m", "impact_rs_cli.main", "campaign", "push", "-o", str(tmp_path / "two"), *scope]
    plant, others = machines
    with (
        running(plant.on(sys.executable, "-m", "impact_rs_ros.plant_node"), environment) as node,
        running(others.on(*command, "--via", "nodes", "--without", "plant"), environment) as campaign,
    ):
        code, printed = campaign.end()
        _, by_plant = node.end(signal.SIGTERM)
    assert code == 0, printed
    assert "1 of 1 trials are there (1 OK)" in printed
    assert "push/parcel__case_1__s1.000__r0: OK after 1.800 s" in by_plant
    (key,) = manifest.keys
    run_one(tmp_path / "one", manifest.trial(key))
    one, two = (TrialBag.open(tmp_path / folder / key.name) for folder in ("one", "two"))
    assert (two.outcome, two.missing) == ("OK", [])
    for topic in (topics.joint_states("arm"), topics.joint_command("arm"), topics.truth_joint_states("arm")):
        assert two.counts[topic] == 1801
        np.testing.assert_allclose(two.joints(topic).position, one.joints(topic).position, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(two.joints(topic).effort, one.joints(topic).effort, rtol=0.0, atol=1e-9)
