"""Reports of recordings of real robots: what the model does not explain of the torque in free motion."""

from __future__ import annotations

import html
import math
from pathlib import Path
from typing import Any

from impact_rs_analysis.imports.diagnose import Setup
from impact_rs_analysis.report.figures import BLUE
from impact_rs_analysis.report.page import MOST_POINTS, Page, number, p_text, short
from impact_rs_sim.robot import Array

GREEN, GREY = "#009E73", "#BBBBBB"


def write_recording_comparison(found: dict[str, Any], setup: Setup, directory: Path) -> Path:
    """Write ``compare.html`` and ``compare.json``.

    Args:
        found: What :func:`~impact_rs_analysis.imports.compare_recording` says.
        setup: Of which recordings.
        directory: Folder of the report.

    Raises:
        InputError: It cannot be written.
    """
    page = Page("Model against a recording in free motion")
    rows = found["levels"]["free_motion"]["signals"]
    worst = max(rows, key=lambda row: float(row["error"]))
    page.add(
        f'<p class="answer">The model leaves {number(found["score"])} N m rms of joint torque unexplained, most in '
        f"{worst['index']} ({number(worst['error'])} N m). Noise of the torque signal: {number(found['noise_floor'])} "
        "N m.</p>"
    )
    _facts(page, found["recording"])
    _joint_bars(page, [("model", BLUE, [row["error"] for row in rows])], [row["noise"] for row in rows])
    page.add(
        "<h2>Where it fails</h2><div class=wide><table><tr><th></th><th>mean [N m]</th><th>rms [N m]</th>"
        "<th>share</th></tr>"
    )
    for cell in found["where"][:12]:
        page.add(
            f"<tr><td>{cell['index']} {cell['phase']}</td><td>{number(cell['error'])}</td>"
            f"<td>{number(cell['rms'])}</td><td>{100.0 * cell['share']:.0f}&nbsp;%</td></tr>"
        )
    page.add("</table></div>")
    _tracks(page, setup, [("the model", setup.rest)])
    page.add(f"<p class=note>Not measured: {html.escape(', '.join(found['not_measured']))}.</p>")
    return page.write(directory, "compare", found)


def write_recording_diagnosis(found: dict[str, Any], setup: Setup, rest: Array, directory: Path) -> Path:
    """Write ``diagnosis.html`` and ``diagnosis.json``.

    Args:
        found: What :func:`~impact_rs_analysis.imports.diagnose_recording` says.
        setup: Of which recordings.
        rest: What the named effects leave of the torque, ``(k, n)`` [N m].
        directory: Folder of the report.

    Raises:
        InputError: It cannot be written.
    """
    page = Page(f"What model '{found['model']['name']}' lacks in free motion")
    page.add(
        f'<p class="answer"><b>{html.escape(found["verdict"].replace("+", " + "))}</b><br>The torque error on '
        f"stretches that the fit has not seen falls from {number(found['held_out_error_before'])} to "
        f"{number(found['held_out_error_after'])} N m rms; the noise of the torque signal is "
        f"{number(found['noise_floor'])} N m.</p>"
    )
    _facts(page, found["recording"])
    page.remarks(found["remarks"])
    joints = found["joints"]
    bars = [("before", GREY, [row["before"] for row in joints]), ("after", GREEN, [row["after"] for row in joints])]
    _joint_bars(page, bars, [row["noise"] for row in joints])
    _effects(page, found)
    advice = str(found["next_experiment"]["advice"])
    page.add(f"<h2>Next experiment</h2><p>{html.escape(advice[:1].upper() + advice[1:])}.</p>")
    _tracks(page, setup, [("the model with what was found", rest), ("the model as it is", setup.rest)])
    return page.write(directory, "diagnosis", found)


def _facts(page: Page, facts: dict[str, Any]) -> None:
    files = ", ".join(Path(name).name for name in facts["files"])
    page.add(
        f'<p class="note"><code>{html.escape(files)}</code>: {facts["samples"]} samples at '
        f"{number(facts['sampled_Hz'])} Hz, {number(facts['used_s'])} s used; {html.escape(facts['robot'])} with "
        f"{facts['end_effector_mass_kg']:g} kg mounted; {html.escape(facts['low_pass'])}, {facts['low_pass_Hz']:g} Hz."
        "</p>"
    )


def _joint_bars(page: Page, groups: list[tuple[str, str, list[float]]], noise: list[float]) -> None:
    names = [f"joint {number + 1}" for number in range(len(noise))]
    bars: list[dict[str, Any]] = [
        {
            "type": "bar",
            "name": label,
            "x": names,
            "y": [round(value, 4) for value in values],
            "marker": {"color": colour},
        }
        for label, colour, values in groups
    ]
    marks = {"symbol": "line-ew", "size": 24, "color": "#000", "line": {"width": 2, "color": "#000"}}
    bars.append({"x": names, "y": [round(v, 4) for v in noise], "name": "noise", "mode": "markers", "marker": marks})
    page.add("<h2>Joint by joint</h2>")
    page.figure(
        "joints",
        bars,
        {
            "height": 320,
            "barmode": "group",
            "yaxis": {"title": {"text": "torque error [N m rms]", "standoff": 6}, "automargin": True},
            "xaxis": {"automargin": True},
            "legend": {"orientation": "h", "y": -0.2, "yanchor": "top", "x": 0},
        },
    )


def _effects(page: Page, found: dict[str, Any]) -> None:
    page.add(
        '<h2>Effects</h2><div class="wide"><table><tr><th>effect</th><th class=text>verdict</th><th>without → with '
        "[N m]</th><th>p</th><th class=text>estimate [95 % interval]</th></tr>"
    )
    for effect in found["effects"]:
        if effect["p_value"] is None:
            continue
        chosen = effect["name"] in found["named"]
        tag = "good" if effect["verdict"] == "CONFIRMED" else "maybe" if chosen else "no"
        verdicts = {entry["joint"]: entry["verdict"] for entry in effect["joints"]}
        lines = []
        for name, value in effect["parameters"].items() if chosen else ():
            interval = "" if value["ci95"] is None else " [{}, {}]".format(*map(number, value["ci95"]))
            sure = any(text == "CONFIRMED" for joint, text in verdicts.items() if name.endswith(joint))
            unit = "" if value["unit"] == "-" else value["unit"]
            lines.append(html.escape(f"{name} {number(value['estimate'])}{interval} {unit}{' ✓' if sure else ''}"))
        page.add(
            f'<tr title="{html.escape(effect["sentence"])}"><td>{html.escape(effect["name"])}</td><td class=text>'
            f'<span class="tag {tag}" style="white-space:normal">{html.escape(effect["verdict"])}</span></td>'
            f"<td>{number(effect['held_out_error_before'])} → {number(effect['held_out_error_after'])}</td>"
            f"<td>{p_text(effect['p_value']).removeprefix('= ')}</td><td class=values>{'<br>'.join(lines)}</td></tr>"
        )
    missing = ", ".join(effect["name"] for effect in found["effects"] if effect["p_value"] is None)
    page.add(
        "</table></div><p class=note>✓: confirmed for this joint. Not measured in a free motion: "
        f"{html.escape(missing)}.</p>"
    )


def _tracks(page: Page, setup: Setup, versions: list[tuple[str, Array]]) -> None:
    labels, sets = [], []
    recorded = setup.balance.recorded
    for label, rest in versions:
        start = 0
        for recording, motion in zip(setup.recordings, setup.motions, strict=True):
            time = motion.time[motion.kept]
            rows = slice(start, start + time.size)
            start += time.size
            step = max(1, math.ceil(time.size / MOST_POINTS))
            measured, predicted = recorded[rows][::step], (recorded - rest)[rows][::step]
            labels.append(label if len(setup.motions) == 1 else f"{recording.path.name}, {label}")
            sets.append(
                {
                    "impact": None,
                    "time": short(time[::step]),
                    "signals": [
                        {
                            "name": f"torque of joint {joint + 1}",
                            "unit": "N m",
                            "measured": short(measured[:, joint]),
                            "predicted": short(predicted[:, joint]),
                        }
                        for joint in range(recorded.shape[1])
                    ],
                }
            )
    page.tracks("Both sides low-passed; time since the start of the recording.", labels, sets)
