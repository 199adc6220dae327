# SPDX-License-Identifier: Apache-2.0
"""What a bag says is shown by a browser, and never run."""

from __future__ import annotations

import re
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from browser import CHROMIUM, needs_browser
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from impact_rs_cli.main import main
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.bags.types import typestore

STORE = typestore()
NAME = (
    "\"><img src=x onerror=\"document.title='run'\"><script>document.title='run'<"  # no slash, which no name may have
)
LABEL = "</script></title><script>document.title='run'</script><img src=x onerror=\"document.title='run'\">"


def with_other_names(source: Path, target: Path) -> None:
    """A bag as an attacker makes it: names and labels are markup."""
    info = TrialBag.open(source).info
    scenario = info.spec.scenario
    item = scenario.object(info.object)
    text = scenario.model_copy(
        update={"name": NAME, "objects": {NAME: item.model_copy(update={"label": LABEL})}}
    ).model_dump_json()
    evil = replace(info, scenario=NAME, object=NAME, scenario_json=text)
    with Reader(source) as reader, Writer(target, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        writer.set_custom_data("outcome", "OK")
        new = {c.topic: writer.add_connection(c.topic, c.msgtype, typestore=STORE) for c in reader.connections}
        for connection, moment, data in reader.messages():
            if connection.topic == topics.TRIAL_INFO:
                message = STORE.types[connection.msgtype](**evil.values())
                data = STORE.serialize_cdr(message, connection.msgtype)
            writer.write(new[connection.topic], moment, data)


@pytest.fixture(scope="module")
def report(push_campaign: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of such bags."""
    folder = tmp_path_factory.mktemp("evil")
    for bag in sorted(path for path in push_campaign.iterdir() if path.is_dir() and path.name.startswith("cat")):
        with_other_names(bag, folder / bag.name)
    assert main(["analyze", str(folder), "-o", str(folder / "report")]) == 0
    return folder / "report"


def test_files_of_a_report_have_names_that_stay_in_its_folder(report: Path) -> None:
    names = {path.name for path in report.iterdir()}
    assert {"report.html", "analysis.json"} < names
    assert all(re.fullmatch(r"[A-Za-z0-9_.-]+", name) for name in names)


@needs_browser
def test_markup_in_names_and_labels_is_text_in_a_browser(report: Path) -> None:
    assert CHROMIUM is not None
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=5000", "--dump-dom"]
    done = subprocess.run(
        [CHROMIUM, *options, f"file://{report / 'report.html'}"], capture_output=True, text=True, timeout=120
    )
    title = re.search(r"<title>(.*?)</title>", done.stdout)
    assert title is not None, done.stderr
    assert title[1] == "impact_rs: Predicted and measured velocity jumps"
    assert "onerror=&quot;" in done.stdout or "onerror=\"document.title='run'\"&gt;" in done.stdout  # shown as text
