"""Reports of the loop: compare, diagnose and history, each one HTML file that works offline and on a phone."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from impact_rs_analysis.diagnosis.compare import SCORE_IS, Comparison
from impact_rs_analysis.diagnosis.document import DiagnosisDocument, EffectDocument
from impact_rs_analysis.diagnosis.history import VersionError
from impact_rs_analysis.evidence.aligned import AlignedTrial, Track
from impact_rs_analysis.report.figures import BLUE, RED
from impact_rs_analysis.report.page import MOST_POINTS, Page, number, p_text, short
from impact_rs_analysis.report.words import verdict_in_words
from impact_rs_sim.robot import Array

PHASES = {"free": "Free motion", "impact": "Impact (first 80 ms)", "push": "Push"}


def write_comparison(
    comparison: Comparison, aligned: Sequence[AlignedTrial], versions: Sequence[VersionError] | None, directory: Path
) -> Path:
    """Write ``compare.html`` and ``compare.json``.

    Args:
        comparison: Model against measurement.
        aligned: A representative trial of every condition.
        versions: Errors of the model and its parents; None where it has none.
        directory: Folder of the report.

    Raises:
        InputError: It cannot be written.
    """
    page = Page(f"Model '{comparison.model}' against measurement")
    page.add(f'<p class="answer">{html.escape(_comparison_in_words(comparison))}</p>')
    page.add(f'<p class="note">The score is the {html.escape(SCORE_IS)}.</p>')
    page.remarks(comparison.remarks)
    _levels(page, comparison)
    _where(page, comparison)
    _tracks(page, aligned)
    if versions:
        _history(page, versions)
    _skipped(page, comparison)
    return page.write(directory, "compare", comparison.to_json())


def write_diagnosis(
    document: DiagnosisDocument,
    comparison: Comparison,
    aligned: Sequence[AlignedTrial],
    versions: Sequence[VersionError] | None,
    directory: Path,
) -> Path:
    """Write ``diagnosis.html`` and ``diagnosis.json``; arguments as for :func:`write_comparison`.

    Raises:
        InputError: It cannot be written.
    """
    page = Page(f"What model '{document.model.name}' lacks")
    page.add(
        f'<p class="answer"><b>{html.escape(document.verdict)}</b><br>{html.escape(verdict_in_words(document))}</p>'
    )
    page.add(
        f'<p class="note">{document.runs.trials} trials in {len(document.runs.conditions)} conditions. Errors are in '
        "multiples of what repeating a trial explains. Whether repetition alone explains the rest: "
        f"p {p_text(document.lack_of_fit['before'])} before, p {p_text(document.lack_of_fit['after'])} after.</p>"
    )
    page.remarks(document.remarks)
    _effects(page, document)
    _confusability(page, document)
    _identifiability(page, document)
    _next_experiment(page, document)
    _unexplained(page, document)
    _where(page, comparison)
    _tracks(page, aligned)
    if versions:
        _history(page, versions)
    _skipped(page, comparison)
    return page.write(directory, "diagnosis", document.model_dump(mode="json"))


def write_history(versions: Sequence[VersionError], directory: Path) -> Path:
    """Write ``history.html`` and ``history.json``.

    Raises:
        InputError: It cannot be written.
    """
    page = Page("How the error fell")
    _history(page, versions)
    return page.write(directory, "history", {"history": [entry.to_json() for entry in versions]})


def _comparison_in_words(comparison: Comparison) -> str:
    floor = comparison.noise_floor
    text = f"Model '{comparison.model}' scores {comparison.score:.3g} in {len(comparison.runs.trials)} trials"
    text += "." if floor is None else f"; repetition alone would give {floor:.3g}."
    if floor is not None and comparison.score < 1.3 * floor:
        return text + " What differs is hardly more than what differs between repeats."
    worst = comparison.where[0]
    return (
        text + f" It fails most in {_place(worst.object, worst.case)}, {PHASES[worst.phase].lower()}: {worst.signal} "
        f"{worst.index} is off by {worst.error:+.3g} {worst.unit}, {worst.times_noise:.3g} times what repetition "
        "explains."
    )


def _place(thing: str, case: str) -> str:
    return case if thing == "none" else f"{thing}, {case}"


def _skipped(page: Page, comparison: Comparison) -> None:
    skipped = comparison.to_json()["skipped"]
    if skipped:
        rows = "".join(f"<li><code>{html.escape(s['name'])}</code>: {html.escape(s['reason'])}</li>" for s in skipped)
        page.add(f"<details><summary>Bags left out <span>({len(skipped)})</span></summary><ul>{rows}</ul></details>")


def _levels(page: Page, comparison: Comparison) -> None:
    levels = comparison.to_json()["levels"]
    titles = {"jump": "Velocity jump", "free_motion": "Free motion", "trial": "Whole trial"}
    page.add("<h2>Three levels</h2>")
    for name, level in levels.items():
        rows = level.get("signals") or level.get("entries")
        if not rows:
            continue
        page.add(
            f"<details{' open' if name == 'trial' else ''}><summary>{titles[name]} <span>— "
            f"{number(level['times_noise'])} times what repetition explains</span></summary>"
            f'<p class="note">{html.escape(level["what"]).capitalize()}.</p><div class="wide"><table>'
        )
        if name == "jump":
            page.add(
                "<tr><th></th><th>measured</th><th>predicted</th><th>difference</th><th></th><th>× noise</th></tr>"
            )
            for row in rows:
                label = f"{_place(row['object'], row['case'])}: {row['signal']} {row['index']}"
                numbers = "".join(f"<td>{number(row[key])}</td>" for key in ("measured", "predicted", "error"))
                page.add(
                    f"<tr><td>{html.escape(label)}</td>{numbers}<td>{html.escape(row['unit'])}</td>"
                    f"<td>{number(row['times_noise'])}</td></tr>"
                )
        else:
            page.add("<tr><th></th><th>difference (rms)</th><th>repetition alone</th><th></th><th>× noise</th></tr>")
            for row in rows:
                label = row["signal"] if name == "free_motion" else f"{row['phase']}: {row['signal']}"
                page.add(
                    f"<tr><td>{html.escape(label)}</td><td>{number(row['error'])}</td>"
                    f"<td>{number(row['noise_floor'])}</td><td>{html.escape(row['unit'])}</td>"
                    f"<td>{number(row['times_noise'])}</td></tr>"
                )
        page.add("</table></div></details>")


def _where(page: Page, comparison: Comparison) -> None:
    """A heat map per phase: signal and joint or axis over object and case, signed."""
    page.add(
        "<h2>Where it fails</h2><p class=note>Difference in multiples of what repetition explains; the sign is that of "
        "measured minus model where it is largest (blue: measured more, red: less). Only rows above twice the "
        "repetition are shown.</p>"
    )
    cells = comparison.where
    top = max(3.0, min(20.0, cells[0].times_noise if cells else 3.0))
    shown = False
    for phase, title in PHASES.items():
        here = [cell for cell in cells if cell.phase == phase]
        rows = sorted({(cell.signal, cell.index) for cell in here})
        columns = list(dict.fromkeys((cell.scenario, cell.object, cell.case) for cell in here))
        columns.sort()
        values = {((c.signal, c.index), (c.scenario, c.object, c.case)): c for c in here}
        rows = [
            row
            for row in rows
            if any((row, column) in values and values[row, column].times_noise > 2.0 for column in columns)
        ]
        if not rows:
            continue
        shown = True
        grid, texts = [], []
        for row in rows:
            found = [values.get((row, column)) for column in columns]
            grid.append([None if c is None else round(math.copysign(c.times_noise, c.error), 2) for c in found])
            texts.append(["" if c is None else f"{c.error:+.3g} {c.unit} in the worst time bin" for c in found])
        page.add(f"<h3>{title}</h3>")
        page.figure(
            f"where-{phase}",
            [
                {
                    "type": "heatmap",
                    "z": grid,
                    "x": [_place(thing, case).replace(", ", "<br>") for _, thing, case in columns],
                    "y": [f"{signal} {index}" for signal, index in rows],
                    "text": texts,
                    "hovertemplate": "%{y}<br>%{x}<br>%{z:.1f} × noise<br>%{text}<extra></extra>",
                    "zmin": -top,
                    "zmax": top,
                    "colorscale": [
                        [0, "#B2182B"],
                        [0.25, "#EF8A62"],
                        [0.5, "#F7F7F7"],
                        [0.75, "#67A9CF"],
                        [1, "#2166AC"],
                    ],
                    "colorbar": {"thickness": 10, "len": 1, "outlinewidth": 0},
                    "xgap": 1,
                    "ygap": 1,
                }
            ],
            {
                "height": 90 + 19 * len(rows),
                "xaxis": {"side": "top", "automargin": True, "fixedrange": True, "tickfont": {"size": 11}},
                "yaxis": {"automargin": True, "autorange": "reversed", "fixedrange": True, "tickfont": {"size": 11}},
            },
        )
    if not shown:
        page.add("<p>Nowhere by more than twice what repetition explains.</p>")


def _tracks(page: Page, aligned: Sequence[AlignedTrial]) -> None:
    """Measured against predicted over time, selectable."""
    if not aligned:
        return
    sets = []
    aligned = sorted(aligned, key=lambda trial: not trial.condition.plan.expects_impact)
    for trial in aligned:
        step = max(1, math.ceil(trial.time.size / MOST_POINTS))
        signals = _signals(trial)
        impact = trial.condition.plan.scene.scenario.timing.nominal_impact
        sets.append(
            {
                "impact": impact if trial.condition.plan.expects_impact else None,
                "time": [round(float(value), 4) for value in trial.time[::step]],
                "signals": [
                    {"name": name, "unit": unit, "measured": short(a[::step]), "predicted": short(b[::step])}
                    for name, unit, a, b in signals
                ],
            }
        )
    labels = [
        _place(trial.condition.object, trial.condition.case)
        + ("" if trial.condition.scale == 1.0 else f" ({trial.condition.scale:g} v)")
        for trial in aligned
    ]
    page.tracks(
        "The first trial of every condition; the model's twin starts where the trial started. Dotted: nominal impact.",
        labels,
        sets,
    )


def _signals(trial: AlignedTrial) -> list[tuple[str, str, Array, Array]]:
    found: list[tuple[str, str, Array, Array]] = []

    def add(name: str, unit: str, pick: Any) -> None:
        found.append((name, unit, np.asarray(pick(trial.measured)), np.asarray(pick(trial.predicted))))

    several = len(trial.measured.arms) > 1
    for arm in trial.measured.arms:
        label = f"{arm}: " if several else ""
        main = trial.condition.plan.scene.scenario.axis_index
        for axis in (main, *(i for i in range(3) if i != main)):
            add(f"{label}end-effector velocity {'xyz'[axis]}", "m/s", lambda t, a=arm, i=axis: _arm(t, a).twist[:, i])
        for axis in (main, *(i for i in range(3) if i != main)):
            add(f"{label}feedback {'xyz'[axis]}", "m/s²", lambda t, a=arm, i=axis: _arm(t, a).feedback[:, i])
        for joint in range(trial.measured.arms[arm].position.shape[1]):
            add(f"{label}torque of joint {joint + 1}", "N m", lambda t, a=arm, i=joint: _arm(t, a).torque[:, i])
        for joint in range(trial.measured.arms[arm].position.shape[1]):
            add(f"{label}velocity of joint {joint + 1}", "rad/s", lambda t, a=arm, i=joint: _arm(t, a).velocity[:, i])
    if trial.condition.plan.expects_impact:
        for axis in range(2):
            add(f"object position {'xyz'[axis]}", "m", lambda t, i=axis: t.object_position[:, i])
        add("object yaw", "rad", lambda t: t.object_yaw)
    return found


def _arm(track: Track, name: str) -> Any:
    return track.arms[name]


def _effects(page: Page, document: DiagnosisDocument) -> None:
    page.add("<h2>Effects, best first</h2>")
    ranked = list(document.effects)
    bars = ranked[:12]
    page.figure(
        "effects",
        [
            {
                "type": "bar",
                "orientation": "h",
                "y": [effect.name for effect in bars],
                "x": [round(effect.held_out_error_after, 4) for effect in bars],
                "marker": {"color": [_colour(effect) for effect in bars]},
                "hovertemplate": "%{y}: %{x:.3g}<extra></extra>",
            }
        ],
        {
            "height": 120 + 24 * len(bars),
            "xaxis": {
                "title": {"text": "error on unseen conditions", "standoff": 6},
                "rangemode": "tozero",
                "automargin": True,
            },
            "yaxis": {"automargin": True, "autorange": "reversed", "tickfont": {"size": 11}},
            "shapes": [
                _mark(document.held_out_error_before, "#555555"),
                _mark(document.noise_floor, "#009E73"),
            ],
            "annotations": [
                _label(document.held_out_error_before, "without", "right"),
                _label(document.noise_floor, "repetition alone", "left"),
            ],
        },
    )
    page.add(
        '<p class="note">Error of each effect, fitted to all conditions but one and tried on that one, in turn. Chosen '
        "effects stand together where there are several.</p>"
        '<div class="wide"><table><tr><th>effect</th><th class=text>verdict</th><th>before → after</th><th>p</th>'
        "<th class=text>estimate [95 % interval]</th></tr>"
    )
    for effect in ranked:
        shown = effect.verdict not in ("NO-IMPROVEMENT", "NOT-IDENTIFIABLE")
        values = "<br>".join(
            f"{html.escape(name)} {number(p.estimate)} [{number(p.interval[0])}, {number(p.interval[1])}] "
            f"{html.escape(p.unit if p.unit != '-' else '')}"
            for name, p in effect.parameters.items()
            if shown
        )
        page.add(
            f'<tr title="{html.escape(effect.sentence)}"><td>{html.escape(effect.name)}</td>'
            f'<td class=text><span class="tag {_tag(effect)}" style="white-space:normal">'
            f"{html.escape(effect.verdict)}</span></td>"
            f"<td>{number(effect.held_out_error_before)} → {number(effect.held_out_error_after)}</td>"
            f"<td>{p_text(effect.p_value).removeprefix('= ')}</td><td class=values>{values}</td></tr>"
        )
    page.add("</table></div>")


def _mark(x: float, colour: str) -> dict[str, Any]:
    line = {"color": colour, "width": 1.5, "dash": "dot"}
    return {"type": "line", "x0": x, "x1": x, "y0": 0, "y1": 1, "xref": "x", "yref": "paper", "line": line}


def _label(x: float, text: str, side: str) -> dict[str, Any]:
    return {
        "x": x,
        "y": 1.0,
        "xref": "x",
        "yref": "paper",
        "text": text,
        "showarrow": False,
        "yanchor": "bottom",
        "xanchor": side,
        "font": {"size": 11, "color": "#555555"},
    }


def _tag(effect: EffectDocument) -> str:
    if effect.verdict == "CONFIRMED":
        return "good"
    return "no" if effect.verdict in ("NO-IMPROVEMENT", "NOT-IDENTIFIABLE") else "maybe"


def _colour(effect: EffectDocument) -> str:
    return {"good": "#009E73", "maybe": "#E69F00", "no": "#BBBBBB"}[_tag(effect)]


def _confusability(page: Page, document: DiagnosisDocument) -> None:
    page.add("<h2>What cannot be told apart</h2>")
    if not document.confusable:
        page.add("<p>Nothing: no other effect predicts unseen conditions as well.</p>")
        return
    rows = "".join(f"<li>{html.escape(' and '.join(group))}</li>" for group in document.confusable)
    page.add(f"<ul>{rows}</ul>")


def _identifiability(page: Page, document: DiagnosisDocument) -> None:
    facts = document.identifiability
    if not facts:
        return
    page.add(
        "<h2>How well it is determined</h2><p>Condition number of the fit: "
        f"{number(facts.get('condition_number'))} (largest over smallest sensitivity of the chosen parameters; below "
        "about 100 each is determined on its own).</p>"
    )
    pairs = facts.get("correlated") or []
    if pairs:
        rows = "".join(
            f"<li>{html.escape(pair['first'])} and {html.escape(pair['second'])}: correlation "
            f"{number(pair['correlation'], 2)}</li>"
            for pair in pairs
        )
        page.add(f"<p>Estimates that move together:</p><ul>{rows}</ul>")


def _next_experiment(page: Page, document: DiagnosisDocument) -> None:
    if document.next_experiment:
        advice = str(document.next_experiment.get("advice", ""))
        page.add(f"<h2>Next experiment</h2><p>{html.escape(advice[:1].upper() + advice[1:])}.</p>")


def _unexplained(page: Page, document: DiagnosisDocument) -> None:
    rows = document.unexplained.get("where") or []
    if not rows or document.lack_of_fit["after"] > 0.01:
        return
    page.add(
        "<h2>What stays unexplained</h2><div class=wide><table><tr><th></th><th>share of the rest</th>"
        "<th>× noise</th></tr>"
    )
    for row in rows[:8]:
        label = f"{row['phase']}: {row['signal']} {row['index']}"
        page.add(
            f"<tr><td>{html.escape(label)}</td><td>{100.0 * row['share']:.0f}&nbsp;%</td>"
            f"<td>{number(row['times_noise'])}</td></tr>"
        )
    page.add("</table></div>")


def _history(page: Page, versions: Sequence[VersionError]) -> None:
    page.add("<h2>History of the model</h2>")
    names = [entry.version.model.name for entry in versions]
    floor = [entry.noise_floor for entry in versions]
    lines: list[tuple[str, list[float | None], str, str]] = [
        ("error, parameters of the file", [entry.error_fit for entry in versions], BLUE, "solid"),
        ("error, held out", [entry.error_held_out for entry in versions], RED, "dash"),
        ("repetition alone", floor, "#009E73", "dot"),
    ]
    page.figure(
        "history",
        [
            {
                "x": names,
                "y": values,
                "name": label,
                "mode": "lines" if dash == "dot" else "lines+markers",
                "line": {"color": colour, "dash": dash},
                "marker": {"size": 9},
            }
            for label, values, colour, dash in lines
        ],
        {
            "height": 360,
            "yaxis": {"rangemode": "tozero", "automargin": True, "title": {"text": "× repetition", "standoff": 6}},
            "xaxis": {"automargin": True, "type": "category"},
            "legend": {"orientation": "h", "y": -0.2, "yanchor": "top", "x": 0},
        },
    )
    page.add("<div class=wide><table><tr><th>model</th><th>effect added</th><th>fit</th><th>held out</th></tr>")
    for entry in versions:
        page.add(
            f"<tr><td>{html.escape(entry.version.model.name)}</td>"
            f"<td>{html.escape(entry.version.effect_added or '–')}</td><td>{number(entry.error_fit)}</td>"
            f"<td>{number(entry.error_held_out)}</td></tr>"
        )
    page.add(
        "</table></div><p class=note>Held out: in every condition, with the parameters of the added effect fitted to "
        "all other conditions.</p>"
    )
