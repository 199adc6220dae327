# SPDX-License-Identifier: Apache-2.0
"""Pages show what the documents say, in units, and nothing in a document can get out of its place."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import documents
import numpy as np
import pytest
from snapshots import assert_snapshot

from impact_rs_analysis.diagnosis.compare import ComparisonDocument
from impact_rs_analysis.diagnosis.document import (
    CalibrationExperiment,
    CalibrationIdentity,
    DiagnosisDocument,
    HeldOutRollouts,
    read_document,
)
from impact_rs_analysis.diagnosis.history import VersionError
from impact_rs_analysis.diagnosis.laws.discovery_document import (
    DESCRIBED,
    FOUND,
    NO_LAW,
    CurveDocument,
    DiscoveryDocument,
    DomainDocument,
    LawDocument,
    NumberDocument,
    PointDocument,
)
from impact_rs_analysis.evidence.cluster import TIMES
from impact_rs_analysis.evidence.levels import SignalLevel
from impact_rs_analysis.evidence.rollouts import CLOSED_LOOP
from impact_rs_analysis.evidence.tracks import ComparedSignal, Track
from impact_rs_analysis.report import page as skeleton
from impact_rs_analysis.report.analysis import AnalysisPage, Listing
from impact_rs_analysis.report.animation import ReplayPart
from impact_rs_analysis.report.comparison import joint_tables, write_comparison
from impact_rs_analysis.report.diagnosis import write_diagnosis
from impact_rs_analysis.report.discovery import law_plot, write_report
from impact_rs_analysis.report.error_history import write_history
from impact_rs_analysis.report.page import p_text, quantity_text, sentence_text, subscripts_text, track_data
from impact_rs_analysis.report.plots import effects_plot
from impact_rs_sim.errors import InputError

SNAPSHOTS = Path(__file__).with_name("snapshots")
EVIL = "</script><script>alert('x')</script><img src=http://evil.example/x>"


class Page(HTMLParser):
    """What a browser makes of a page: its text, its elements and the JSON beside it."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.words: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.data: dict[str, Any] = {}
        self._inside: str | None = None
        self._name: str | None = None
        self.feed(path.read_text(encoding="utf-8"))
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self._inside, self._name = tag, dict(attrs).get("id")
        if tag in ("h1", "h2", "h3", "p", "dt", "tr", "li", "summary", "figure"):
            self.words.append("\n")

    def handle_endtag(self, tag: str) -> None:
        self._inside = None

    def handle_data(self, data: str) -> None:
        if self._inside == "script":
            if self._name is not None:
                self.data[self._name] = json.loads(data)
        elif self._inside != "style":
            self.words.append(" ".join(data.split()))

    @property
    def snapshot(self) -> str:
        """What is read, a line each, and what is drawn: names and numbers of every curve."""
        read = [" ".join(line.split()) for line in " ".join(self.words).split("\n")]
        drawn = [
            " ".join([f"{figure}:", trace.get("name", ""), *(_short(trace.get(axis)) for axis in "xyz")])
            for figure, content in sorted(self.data.items())
            if isinstance(content, dict)
            for trace in content.get("data", ())
        ]
        return "\n".join([*filter(None, read), *(line.rstrip() for line in drawn)]) + "\n"


def _short(values: Any) -> str:
    """Numbers and names of a curve, as Plotly writes them: lists, or packed."""
    if isinstance(values, dict):
        values = np.frombuffer(base64.b64decode(values["bdata"]), values["dtype"]).tolist()
    if isinstance(values, list):
        return "[" + ", ".join(map(_short, values)) + "]"
    return f"{values:.6g}" if isinstance(values, float) else "" if values is None else str(values)


def floats(text: str) -> np.ndarray:
    """What the page's scripts make of packed numbers."""
    return np.frombuffer(base64.b64decode(text), dtype="<f4")


@pytest.fixture(autouse=True)
def small_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages without the libraries that draw them, which are most of their size."""
    monkeypatch.setattr(skeleton, "script_of", lambda path: "var Plotly;")


def comparison_page(folder: Path, name: str = "trials", **changes: Any) -> Page:
    tracks = () if name in ("minimal", "arms") else documents.tracks()
    return Page(write_comparison(documents.comparison(name).model_copy(update=changes), tracks, None, folder))


def diagnosis_page(folder: Path, name: str = "trials", beside: str | None = None) -> Page:
    found = read_document(documents.OLD_DIAGNOSIS) if name == "0_1_0" else documents.diagnosis(name)
    tracks = documents.tracks() if name in ("trials", "recordings") else ()
    versions = documents.versions() if name == "trials" else None
    return Page(write_diagnosis(found, documents.comparison(beside or name), tracks, versions, folder))


PAGES: dict[str, Callable[[Path], Page]] = {
    "comparison_trials": comparison_page,
    "comparison_recordings": lambda folder: comparison_page(folder, "recordings"),
    "comparison_arms": lambda folder: comparison_page(folder, "arms"),
    "comparison_minimal": lambda folder: comparison_page(folder, "minimal"),
    "diagnosis_trials": diagnosis_page,
    "diagnosis_recordings": lambda folder: diagnosis_page(folder, "recordings"),
    "diagnosis_arms": lambda folder: diagnosis_page(folder, "arms"),
    "diagnosis_joints": lambda folder: diagnosis_page(folder, "joints", "trials"),
    "diagnosis_minimal": lambda folder: diagnosis_page(folder, "minimal"),
    "diagnosis_0_1_0": lambda folder: diagnosis_page(folder, "0_1_0", "recordings"),
    "history": lambda folder: Page(write_history(documents.versions(), folder)),
}


def test_pages_of_wrong_readings_blame_no_physics_and_say_what_calibrates(tmp_path: Path) -> None:
    """Kills: a title of what the model lacks, experiments or the known calibration left out."""
    found = documents.diagnosis()
    faults = tuple(one.model_copy(update={"of_measurement": one.name in found.named}) for one in found.effects)
    known = CalibrationIdentity(file="lab/calibration.yaml", digest="abc", effects=("torque_delay",))
    said = {
        "effects": faults,
        "measurement": "The measurement: joint 2 reads too much.",
        "calibrate": (CalibrationExperiment(effect="encoder_offset", experiment="hold still in six poses"),),
        "calibration": known,
    }
    page = Page(write_diagnosis(found.model_copy(update=said), documents.comparison(), (), None, tmp_path))
    assert "What is wrong with the readings" in page.text and "What model" not in page.text
    assert "Calibrate the readings encoder_offset : hold still in six poses." in page.text
    applied = "Readings are predicted with known faults, torque_delay ( calibration.yaml )."
    assert applied in page.text and applied in comparison_page(tmp_path, calibration=known).text
    physics = Page(write_diagnosis(found, documents.comparison(), (), None, tmp_path))
    assert "What model" in physics.text and "Calibrate the readings" not in physics.text


def test_rollouts_stand_on_every_page_that_has_them(tmp_path: Path) -> None:
    """Kills: an error without its unit or spread, a growth that is left out, the wrong horizon of a history."""
    before, after = documents.rollouts(), documents.rollouts(0.1)
    page = comparison_page(tmp_path, rollouts=before)
    assert "Open loop: recorded torque drives the model from measured states" in page.text
    assert "Root mean square over 40 starts" in page.text and "diverged" not in page.text
    assert "The error of the joints grows with time to the power 2.0" in page.text
    assert "0.5 s 2.5 deg 1 to 4 15 mm 6 to 24 5 deg 2 to 8" in page.text
    assert [trace["name"] for trace in page.data["rollouts"]["data"]] == [
        "rollouts, rms over starts",
        "growth of a constant torque error, with the square of the time",
    ]
    still = before.model_copy(update={"tool_mm": (0.0,) * 4, "diverged": 3, "what": CLOSED_LOOP})
    (tmp_path / "still").mkdir()
    page = comparison_page(tmp_path / "still", rollouts=still)
    assert "Closed loop: servos drive the model" in page.text and "rollouts" not in page.data
    assert "3 of 40 have diverged (a joint off by more than a turn, or a metre) and are left out." in page.text
    held = HeldOutRollouts(before=before, after=after, compared=12, closer=11, p_value=0.002)
    found = documents.diagnosis("recordings").model_copy(update={"rollouts": held})
    text = Page(write_diagnosis(found, documents.comparison("recordings"), (), None, tmp_path)).text
    assert (
        "tool off by 0.6 → 0.06, 15 → 1.5 mm, joint1 by 0.1 → 0.01, 2.5 → 0.25 deg; closer with the effects in 11"
        in text
    )
    versions = [replace(one, rollouts=own) for one, own in zip(documents.versions(), (before, after), strict=True)]
    history = Page(write_history(versions, tmp_path))
    assert "tool after 0.5 s" in history.text and "15 mm" in history.text and "1.5 mm" in history.text
    written = json.loads((tmp_path / "history.json").read_text())["history"]
    assert [one["rollouts"]["horizons"][1]["tool_mm"] for one in written] == [15.0, 1.5]


@pytest.mark.parametrize("name", PAGES)
def test_a_page_shows_its_document_and_asks_the_network_for_nothing(name: str, tmp_path: Path) -> None:
    page = PAGES[name](tmp_path)
    assert_snapshot(SNAPSHOTS / f"{name}.txt", page.snapshot)
    assert not re.search(r"\bNone\b|Undefined|\bnan\b", page.text)
    drawn = [attributes["data-figure"] for _, attributes in page.elements if "data-figure" in attributes]
    assert set(drawn) <= set(page.data)
    for tag, attributes in page.elements:
        assert not {"src", "href", "srcset", "action"} & set(attributes), tag
    policy = next(a["content"] for _, a in page.elements if a.get("http-equiv") == "Content-Security-Policy")
    assert policy is not None and "default-src 'none'" in policy and "http" not in policy


def test_the_data_file_beside_a_page_is_its_document(tmp_path: Path) -> None:
    comparison_page(tmp_path)
    diagnosis_page(tmp_path)
    for file, document in (("compare", documents.comparison()), ("diagnosis", documents.diagnosis())):
        assert json.loads((tmp_path / f"{file}.json").read_text()) == document.model_dump(mode="json")


def test_an_effect_that_was_not_confirmed_has_no_estimate_on_the_page(tmp_path: Path) -> None:
    text = diagnosis_page(tmp_path).text
    assert "mass = " not in text[text.index("base_tilt") : text.index("Not measured")]


def test_tracks_are_thinned_and_gaps_stay_gaps(tmp_path: Path) -> None:
    hit, free = diagnosis_page(tmp_path).data["tracks-data"]
    assert (hit["impact"], free["impact"]) == (0.9, None)
    assert len(floats(hit["time"])) == len(floats(hit["signals"][0]["measured"])) <= 500
    assert np.isnan(floats(hit["signals"][0]["predicted"])[-1])
    time = np.arange(5000.0)
    long = Track("run", time, starts=(0, 1111, 3333), curves=(ComparedSignal("velocity", "m/s", time, time),))
    (shown,) = track_data([long])
    assert np.isnan(floats(shown["time"])).sum() == 2  # the line breaks between windows
    assert shown["signals"][0]["measured"] == shown["time"]
    assert len(floats(shown["time"])) <= skeleton.MAX_CURVE_POINTS + 2


def test_errors_that_lie_decades_apart_are_all_seen(tmp_path: Path) -> None:
    axis = diagnosis_page(tmp_path).data["effects"]["layout"]["xaxis"]
    assert axis["type"] == "log"
    low, high = (10.0**end for end in axis["range"])
    assert low < 1.0 < 61.8 < high


def test_effects_are_drawn_alone_and_beside_the_chosen_one() -> None:
    """Beside the effect that explains all, all others do: only alone do they lie apart."""
    diagnosis = documents.diagnosis()
    errors = {"object_mass": (1.3, 61.8), "base_tilt": (58.0, 1.3), "pad_tilt": (40.0, 1.3)}

    def drawn(named: tuple[str, ...], alone: bool = True) -> list[Any]:
        effects = tuple(
            diagnosis.effects[0].model_copy(
                update={
                    "name": name,
                    "verdict": "CONFIRMED" if name == "object_mass" else "NO-IMPROVEMENT",
                    "held_out_error_alone": own if alone else None,
                    "held_out_error_others": others,
                }
            )
            for name, (own, others) in errors.items()
        )
        plot = effects_plot(diagnosis.model_copy(update={"effects": effects, "named": named}))
        assert plot is not None
        return list(plot.data)

    traces = {trace.name: trace for trace in drawn(("object_mass",)) if trace.name}
    assert list(traces["alone"].x) == [1.3, 58.0, 40.0]
    assert list(traces["with the chosen effects"].x) == [1.3, 1.3, 1.3]
    lines = [list(trace.x) for trace in drawn(("object_mass",)) if trace.mode == "lines"]
    assert lines == [[61.8, 1.3], [1.3, 1.3], [1.3, 1.3]]
    assert [trace.name for trace in drawn(())] == ["alone"]
    assert [trace.name for trace in drawn((), alone=False) if trace.name] == ["with the chosen effects"]


def test_a_signal_below_its_relevance_limit_in_every_joint_has_no_column(tmp_path: Path) -> None:
    """The deflection of a simulated spring differs by 0.2 microradians, which no robot measures."""
    joint = {"phase": "free", "index": "joint1", "unit": "rad", "noise_floor": 1e-9}
    rows = (
        SignalLevel(signal="elastic deflection", error=2e-7, floor=4e-6, times_noise=200.0, **joint),
        SignalLevel(signal="motor torque balance", error=0.05, floor=0.01, times_noise=5.0, **joint | {"unit": "N m"}),
    )
    (table,) = joint_tables(documents.comparison().model_copy(update={"joints": rows}))
    assert table.signals == ("Free motion: motor torque balance",)
    assert [cell and cell.size for cell in table.rows["joint1"]] == [pytest.approx(5.0)]
    text = comparison_page(tmp_path, joints=rows).text
    assert "Below their relevance limits in every joint: Free motion: elastic deflection (0.2 µrad)." in text


def test_a_page_listens_to_no_other_window(tmp_path: Path) -> None:
    diagnosis_page(tmp_path)
    assert "addEventListener('message'" not in (tmp_path / "diagnosis.html").read_text()


def test_versions_of_one_name_are_not_drawn_on_top_of_each_other(tmp_path: Path) -> None:
    figure = diagnosis_page(tmp_path).data["history"]
    assert figure["layout"]["xaxis"]["ticktext"] == ["nominal", "nominal"]
    assert figure["data"][0]["x"] == [0, 1]


def test_pages_of_the_same_measurements_are_linked(tmp_path: Path) -> None:
    others = {"../compare.html": "the better model", "../diagnosis.html": "what it lacks"}
    page = Page(write_comparison(documents.comparison(), documents.tracks(), None, tmp_path, others))
    assert [facts["href"] for tag, facts in page.elements if tag == "a"] == list(others)
    assert "The same measurements: the better model , what it lacks" in page.text


def test_a_score_close_to_noise_names_no_place(tmp_path: Path) -> None:
    text = comparison_page(tmp_path, score=1.2).text
    assert "close to noise" in text and "Largest in" not in text


def test_errors_of_earlier_versions_are_multiples_of_repeatability(tmp_path: Path) -> None:
    earlier = "times what repetition alone gives"
    (tmp_path / "diagnosis.json").write_text(
        json.dumps(documents.diagnosis().model_dump(mode="json") | {"error_unit": earlier})
    )
    assert read_document(tmp_path / "diagnosis.json").error_unit == TIMES
    assert ComparisonDocument(**dict(documents.comparison()) | {"score_unit": earlier}).score_unit == TIMES


KEPT = ("source", "error_unit", "score_unit", "verdict", "unit", "phase", "format", "levels")


def _everywhere(value: object, text: Callable[[str], str]) -> object:
    """A document with all its free texts changed."""
    if isinstance(value, dict):
        return {key: item if key in KEPT else _everywhere(item, text) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return tuple(_everywhere(item, text) for item in value)
    return text(value) if isinstance(value, str) and value else value


def _renamed(entry: VersionError, text: Callable[[str], str]) -> VersionError:
    model = entry.version.model.model_copy(update={"name": text(entry.version.model.name)})
    return replace(entry, version=replace(entry.version, model=model))


@pytest.mark.parametrize("kind", ["comparison", "diagnosis", "history"])
def test_no_name_can_leave_its_place(kind: str, tmp_path: Path) -> None:
    """Names come from files that anybody may have written."""

    def write(name: str, text: Callable[[str], str]) -> Page:
        labelled = [replace(track, label=text(track.label)) for track in documents.tracks()]
        named = [_renamed(entry, text) for entry in documents.versions()]
        shown = ComparisonDocument.model_validate(_everywhere(documents.comparison().model_dump(), text))
        found = DiagnosisDocument.model_validate(_everywhere(documents.diagnosis().model_dump(), text))
        write_page = {
            "history": lambda folder: write_history(named, folder),
            "comparison": lambda folder: write_comparison(shown, labelled, named, folder),
            "diagnosis": lambda folder: write_diagnosis(found, shown, labelled, named, folder),
        }[kind]
        return Page(write_page(tmp_path / name))

    plain, evil = write("plain", lambda value: value), write("evil", lambda value: f"{value}{EVIL}")
    assert [tag for tag, _ in evil.elements] == [tag for tag, _ in plain.elements]
    assert EVIL in evil.text
    labels = json.dumps([value for name, value in evil.data.items() if name != "tracks-data"])
    assert "<img" not in labels and "&lt;img" in labels  # Plotly reads its labels as HTML


def test_no_name_of_a_bag_can_leave_its_place(tmp_path: Path) -> None:
    def write(text: str) -> Page:
        content = AnalysisPage(
            "Jumps", text, 0, rows=(), arms=(), by_arm={text: ()}, with_paper=False, contacts=("first",),
            none_fit=False, sensitivity=(), far=text, left_out=(Listing("Bags skipped", ((text, text),)),), sets=(),
            contact="first",
            replay=ReplayPart({"scenes": [], "runs": [{"label": text}, {"label": text}]}, choose=True),
        )  # fmt: skip
        return Page(skeleton.write_files(tmp_path, {"page.html": skeleton.render("analysis.html.j2", content)})[0])

    plain, evil = write("bag"), write(EVIL)
    assert evil.elements == plain.elements
    assert evil.text.count(EVIL) == 7
    assert "No set has enough trials" in evil.text


def test_a_page_is_replaced_at_once_and_leaves_nothing_behind(tmp_path: Path) -> None:
    (tmp_path / "history.html").write_text("old")
    write_history(documents.versions(), tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["history.html", "history.json"]
    assert "Error by model version" in (tmp_path / "history.html").read_text(encoding="utf-8")
    document = json.loads((tmp_path / "history.json").read_text())
    assert [entry["effect_added"] for entry in document["history"]] == [None, "object_mass"]


def test_a_folder_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "history.json").mkdir()
    for folder in (tmp_path / "file", tmp_path):
        with pytest.raises(InputError, match="cannot be written"):
            write_history(documents.versions(), folder)
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize(
    ("value", "text"), [(1e-300, "< 0.0005"), (0.0005, "< 0.0005"), (0.00051, "0.00051"), (0.4, "0.4"), (None, "–")]
)
def test_no_p_is_printed_below_what_is_known_of_noise(value: float | None, text: str) -> None:
    assert p_text(value).replace("\N{NO-BREAK SPACE}", " ") == text


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.004, "m/s", "4 mm/s"), (-0.041, "m/s", "−41 mm/s"), (0.15, "m/s", "0.15 m/s"), (4e-6, "rad", "4 µrad"),
        (0.02, "m/s^2", "20 mm/s²"), (0.05, "N m", "0.05 N m"), (0.0, "m", "0 m"), (1.2, "-", "1.2"),
    ],
)  # fmt: skip
def test_small_lengths_and_angles_have_the_prefix_milli_or_micro(value: float, unit: str, text: str) -> None:
    assert quantity_text(value, unit).replace("\N{NO-BREAK SPACE}", " ") == text


def test_texts_are_sentences_and_subscripts_are_the_only_markup() -> None:
    assert sentence_text("run it again.") == sentence_text("run it again") == "Run it again."
    assert sentence_text("") == ""
    assert subscripts_text("B<sub>θ</sub> <b>&") == "B<sub>θ</sub> &lt;b&gt;&amp;"


def test_every_page_extends_the_skeleton_and_none_switches_escaping_off() -> None:
    for name in ("analysis", "comparison", "diagnosis", "history", "paper"):
        text = (skeleton.TEMPLATES / f"{name}.html.j2").read_text(encoding="utf-8")
        assert text.splitlines()[1] == '{% extends "page.html.j2" %}'  # behind the licence
    for path in skeleton.TEMPLATES.iterdir():
        assert not re.search(r"\|\s*safe|autoescape", path.read_text(encoding="utf-8")), path


# ---- The page of a discovery shows the law as a formula, and its force with band and points


LAW = LawDocument(
    name="object_drag_square",
    sentence="Drag on the object, with the square of its speed.",
    place="force on the object",
    formula="-(c * object_speed) * (object_vx, object_vy, object_vz)",
    parameters={"c": NumberDocument(estimate=8.0, ci95=(7.5, 8.5), unit="N s^2/m^2")},
    verdict="CONFIRMED",
    held_out_error_before=12.6,
    held_out_error_after=0.7,
    p_value=0.0005,
    valid=DomainDocument(quantity="object_speed", low=0.0, high=0.5, unit="m/s"),
    curve=CurveDocument(
        at=(0.0, 0.5),
        law=(0.0, 2.0),
        law_ci95=((0.0, 0.0), (1.9, 2.1)),
        points=(PointDocument(at=0.4, force=1.2, ci95=(1.0, 1.5), law=1.3),),
        unit="N",
    ),
)


def document(verdict: str, *laws: LawDocument) -> DiscoveryDocument:
    return DiscoveryDocument(verdict=verdict, summary="In words.", laws=laws, error_unit="times repeatability")


def test_the_page_says_the_law_and_draws_it(tmp_path: Path) -> None:
    page = write_report(document(FOUND, LAW), tmp_path).read_text()
    for text in ("LAW-FOUND", "-(c * object_speed)", "N s^2/m^2", "from 0 to 0.5"):
        assert text in page
    points = law_plot(LAW).data[-1]
    assert (points.error_y.array[0], points.error_y.arrayminus[0]) == pytest.approx((0.3, 0.2))


def test_the_page_of_a_curve_shows_its_values_and_no_formula(tmp_path: Path) -> None:
    curve = LAW.model_copy(update={"name": "object_drag_curve_5", "formula": "f0 * max(0, 1)", "curved": True})
    page = write_report(document(DESCRIBED, curve), tmp_path).read_text()
    assert "f0 * max" not in page
    for text in ("CURVE-FOUND", "What remains, as a curve", "over object_speed", "1 values [N", "it falls to 0"):
        assert text in page


def test_a_page_without_a_law_has_no_picture(tmp_path: Path) -> None:
    page = write_report(document(NO_LAW), tmp_path).read_text()
    assert "NO-LAW-HOLDS" in page and 'data-figure="law"' not in page
