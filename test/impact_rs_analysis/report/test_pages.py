# SPDX-License-Identifier: Apache-2.0
"""Pages show what the documents say, in units, and nothing in a document can get out of its place."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Callable, Sequence
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from mixed_grab import MIXED

from impact_rs_analysis.diagnosis.compare import ComparisonDocument, SignalLevel
from impact_rs_analysis.diagnosis.document import DiagnosisDocument, EstimateDocument, read_document
from impact_rs_analysis.diagnosis.history import VersionError
from impact_rs_analysis.evidence.cluster import TIMES
from impact_rs_analysis.evidence.tracks import TrackSet, TrackSignal
from impact_rs_analysis.measure.arms import arms_of
from impact_rs_analysis.report import page as skeleton
from impact_rs_analysis.report.analysis import AnalysisPage, Listing
from impact_rs_analysis.report.animation import ReplayPart
from impact_rs_analysis.report.comparison import write_comparison
from impact_rs_analysis.report.diagnosis import write_diagnosis
from impact_rs_analysis.report.history import write_history
from impact_rs_analysis.report.page import p_text, quantity_text, sentence_text, subscripts_text, track_data
from impact_rs_analysis.report.plots import effects_plot
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics

EVIL = "</script><script>alert('x')</script><img src=http://evil.example/x>"


class Page(HTMLParser):
    """What a browser makes of a page: its text, its elements and the JSON beside it."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.words: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.data: dict[str, object] = {}
        self._inside: str | None = None
        self._name: str | None = None
        self.feed(path.read_text(encoding="utf-8"))
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self._inside, self._name = tag, dict(attrs).get("id")

    def handle_endtag(self, tag: str) -> None:
        self._inside = None

    def handle_data(self, data: str) -> None:
        if self._inside == "script":
            if self._name is not None:
                self.data[self._name] = json.loads(data)
        elif self._inside != "style":
            self.words.append(data)

    def count(self, tag: str) -> int:
        return sum(name == tag for name, _ in self.elements)


def floats(text: str) -> np.ndarray:
    """What the page's scripts make of packed numbers."""
    return np.frombuffer(base64.b64decode(text), dtype="<f4")


@pytest.fixture(autouse=True)
def small_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages without the libraries that draw them, which are most of their size."""
    monkeypatch.setattr(skeleton, "script_of", lambda path: "var Plotly;")


@pytest.fixture
def diagnosed(
    diagnosis: DiagnosisDocument,
    comparison: ComparisonDocument,
    tracks: Sequence[TrackSet],
    versions: Sequence[VersionError],
    tmp_path: Path,
) -> Page:
    return Page(write_diagnosis(diagnosis, comparison, tracks, versions, tmp_path))


def test_a_diagnosis_shows_everything_that_it_knows(diagnosed: Page) -> None:
    shown = [
        "What model 'nominal' lacks",
        "object_mass + joint_coulomb_friction",
        "Model 'nominal' lacks object_mass and joint_coulomb_friction.",
        "12 trials of 2 conditions",
        "10 degrees of freedom of the noise",
        "Multiples of repeatability: 1.0 is the scatter of repeats",
        "61.8 → 1.6 times repeatability; change −60 [−71, −49]",
        "Held out: Conditions with all their repeats.",
        "p < 0.0005 before, p = 0.0031 after",
        "differences between equally valid simulations with the same parameters do not count",
        "Two engines, 9 conditions.",
        "impact (first 80 ms): end-effector velocity 3 mm/s 2.2 mm/s",
        "No free motion was measured.",
        "object_mass CONFIRMED 1.4 61.8 → 1.3 < 0.0005 5 of 6 Predicts unseen data.",
        "mass = 1.101 [1.080, 1.120] kg",
        "moves end-effector velocity by up to 4 mm/s (impact; relevance limit 3 mm/s)",
        "CONFUSABLE-WITH{joint_stribeck_friction}",
        "coulomb_joint4 joint4 0.310 [0.290, 0.330] N m AT-BOUND 0.004 0.44 → 0.12",
        "base_tilt NO-IMPROVEMENT – 1.3 → 60.2 0.42",
        "Not measured: restitution.",
        "joint_coulomb_friction and joint_stribeck_friction",
        "7 % of the error beyond noise remains",
        "push: contact force z 0.21 N 0.05 N 55 % 3.3",
        "Run a motion there and back.",
        "excite none fast (not measured before)",
        "17: squared distance of the predictions",
        "juice, case_2, impact (first 80 ms): end-effector velocity y −41 mm/s",
        "Condition number of the fit: 30",
        "Singular values: 210, 7.",
        "mass and coulomb_joint4: correlation −0.87",
        "nominal object_mass 1.4 2.25",
        "juice__case_2__r7 : NO-IMPACT: nothing was hit",
    ]
    assert [text for text in shown if text.lower() not in diagnosed.text.lower()] == []


def test_an_effect_that_was_not_confirmed_tells_no_estimate(diagnosed: Page) -> None:
    tail = diagnosed.text[diagnosed.text.index("base_tilt") :]
    assert "mass = " not in tail[: tail.index("Not measured")]


def test_figures_and_tracks_lie_beside_the_page(diagnosed: Page) -> None:
    assert {"effects", "where-0", "where-1", "history", "tracks-data", "tracks-plot"} <= set(diagnosed.data)
    drawn = [attributes["data-figure"] for tag, attributes in diagnosed.elements if "data-figure" in attributes]
    assert set(drawn) <= set(diagnosed.data)
    hit, free = diagnosed.data["tracks-data"]  # type: ignore[misc]
    assert (hit["impact"], free["impact"]) == (0.9, None)
    assert len(floats(hit["time"])) == len(floats(hit["signals"][0]["measured"])) <= 500
    assert np.isnan(floats(hit["signals"][0]["predicted"])[-1])  # what is missing stays missing


def test_a_line_breaks_between_windows_however_long_the_track_is() -> None:
    time = np.arange(5000.0)
    time[[1111, 3333]] = np.nan
    (shown,) = track_data([TrackSet("run", None, time, (TrackSignal("velocity", "m/s", time, time),))])
    assert np.isnan(floats(shown["time"])).sum() == 2
    assert shown["signals"][0]["measured"] == shown["time"]
    assert len(floats(shown["time"])) <= skeleton.MOST_POINTS + 2


def test_errors_that_lie_decades_apart_are_all_seen(diagnosed: Page) -> None:
    axis = diagnosed.data["effects"]["layout"]["xaxis"]  # type: ignore[index]
    assert axis["type"] == "log"
    low, high = (10.0**end for end in axis["range"])
    assert low < 1.0 < 61.8 < high


def test_effects_are_drawn_alone_and_beside_the_chosen_one(diagnosis: DiagnosisDocument) -> None:
    """Beside the effect that explains all, all others do: only alone do they lie apart."""
    errors = {"object_mass": (1.3, 61.8), "base_tilt": (58.0, 1.3), "pad_tilt": (40.0, 1.3)}
    effects = [
        diagnosis.effects[0].model_copy(
            update={
                "name": name,
                "verdict": "CONFIRMED" if name == "object_mass" else "NO-IMPROVEMENT",
                "held_out_error_alone": alone,
                "held_out_error_others": others,
                "held_out_error_after": 1.3,
            }
        )
        for name, (alone, others) in errors.items()
    ]
    document = diagnosis.model_copy(update={"effects": tuple(effects), "named": ("object_mass",)})
    drawn = effects_plot(document)
    assert drawn is not None
    traces = {trace.name: trace for trace in drawn.data if trace.name}
    assert list(traces["alone"].x) == [1.3, 58.0, 40.0]
    assert list(traces["with the chosen effects"].x) == [1.3, 1.3, 1.3]
    assert [list(trace.x) for trace in drawn.data if trace.mode == "lines"] == [[61.8, 1.3], [1.3, 1.3], [1.3, 1.3]]
    nothing = effects_plot(document.model_copy(update={"named": ()}))
    assert nothing is not None and [trace.name for trace in nothing.data] == ["alone"]
    older = tuple(effect.model_copy(update={"held_out_error_alone": None}) for effect in effects)
    old = effects_plot(document.model_copy(update={"named": (), "effects": older}))
    assert old is not None and [trace.name for trace in old.data if trace.name] == ["with the chosen effects"]


def test_versions_of_one_name_are_not_drawn_on_top_of_each_other(diagnosed: Page) -> None:
    figure = diagnosed.data["history"]
    assert figure["layout"]["xaxis"]["ticktext"] == ["nominal", "nominal"]  # type: ignore[index]
    assert figure["data"][0]["x"] == [0, 1]  # type: ignore[index]


def test_a_comparison_shows_levels_places_and_units(
    comparison: ComparisonDocument, tracks: Sequence[TrackSet], tmp_path: Path
) -> None:
    page = Page(write_comparison(comparison, tracks, None, tmp_path))
    for shown in (
        "Residual of model 'nominal' in 12 trials: 61.8 × repeatability.",
        "Largest in end-effector velocity y (juice, case_2, impact (first 80 ms)): −41 mm/s",
        "Velocity jump — 7.7 × repeatability",
        "juice, case_2: object velocity y 0.51 0.48 0.03 m/s 7.7",
        "36 mm/s 1.1 mm/s 2.2 mm/s 3 mm/s 12",
        "push/juice/case_2 6 71.5",
        "The gripper was open.",
        "Two engines, 9 conditions.",
    ):
        assert shown in page.text
    assert "History" not in page.text
    assert "Free motion —" not in page.text  # a level that holds nothing
    assert json.loads((tmp_path / "compare.json").read_text()) == comparison.model_dump(mode="json")


def test_pages_of_the_same_measurements_are_linked(
    comparison: ComparisonDocument, tracks: Sequence[TrackSet], tmp_path: Path
) -> None:
    others = {"../compare.html": "the better model", "../diagnosis.html": "what it lacks"}
    page = Page(write_comparison(comparison, tracks, None, tmp_path, others))
    assert [facts["href"] for tag, facts in page.elements if tag == "a"] == list(others)
    assert "The same measurements: the better model , what it lacks" in page.text
    assert "The same measurements" not in Page(write_comparison(comparison, tracks, None, tmp_path)).text


def test_two_arms_have_a_table_of_their_joints_each(
    diagnosis: DiagnosisDocument, comparison: ComparisonDocument, tmp_path: Path
) -> None:
    def level(arm: str, joint: int, error: float) -> SignalLevel:
        return SignalLevel(
            phase="free", signal="link torque balance", index=f"joint{joint}", arm=arm, error=error, noise_floor=0.01,
            unit="N m", times_noise=100.0 * error,
        )  # fmt: skip

    two = comparison.model_copy(
        update={
            "arms": arms_of([Physics.nominal(MIXED, "parcel")]),
            "joints": (level("left", 7, 0.12), level("right", 1, 0.34), level("right", 2, 0.56)),
        }
    )
    text = Page(write_comparison(two, [], None, tmp_path)).text
    assert "left: franka_fr3, 7 joints Free motion: link torque balance joint7 0.12 N m × 12" in text
    assert "right: ur5e, 6 joints Free motion: link torque balance joint1 0.34 N m × 34 joint2 0.56 N m × 56" in text

    parameters = {
        f"coulomb_{arm}_joint1": EstimateDocument(
            estimate=1.0, ci95=None, unit="N m", joint="joint1", arm=arm, verdict="CONFIRMED"
        )
        for arm in ("left", "right")
    }
    own = diagnosis.effects[0].model_copy(update={"verdict": "CONFIRMED", "parameters": parameters})
    found = diagnosis.model_copy(update={"effects": (own,)})
    text = Page(write_diagnosis(found, two, [], None, tmp_path)).text
    assert re.search(
        r"left: franka_fr3, 7 joints coulomb_left_joint1 .*right: ur5e, 6 joints coulomb_right_joint1", text
    )


def test_joints_of_the_only_arm_need_no_name_of_it(
    diagnosis: DiagnosisDocument, comparison: ComparisonDocument, tmp_path: Path
) -> None:
    parameters = {
        f"offset_joint{joint}": EstimateDocument(
            estimate=1.0, ci95=None, unit="N m", joint=f"joint{joint}", verdict="CONFIRMED"
        )
        for joint in (1, 2)
    }
    own = diagnosis.effects[0].model_copy(update={"verdict": "CONFIRMED", "parameters": parameters})
    found = diagnosis.model_copy(update={"effects": (own,)})
    text = Page(write_diagnosis(found, comparison, [], None, tmp_path)).text
    assert re.search(r"p offset_joint1 joint1 1 N m CONFIRMED \S+ offset_joint2 joint2 1 N m CONFIRMED", text)


def test_recordings_are_shown_on_the_same_pages_in_newton_metres(
    diagnosis_of_recordings: DiagnosisDocument,
    comparison_of_recordings: ComparisonDocument,
    tracks: Sequence[TrackSet],
    tmp_path: Path,
) -> None:
    compared = Page(write_comparison(comparison_of_recordings, tracks, None, tmp_path))
    found = Page(write_diagnosis(diagnosis_of_recordings, comparison_of_recordings, tracks, None, tmp_path))
    facts = "recording.db3 : 727 samples at 30 Hz, 22.9 of 24.2 s used; franka_fer with 0.73 kg mounted"
    assert facts in compared.text
    assert facts in found.text
    assert "Torque residual of model 'nominal': 0.379 N m rms (noise alone: 0.128 N m)." in compared.text
    assert "Not measured Velocity jump, object." in compared.text
    assert "In N m; noise alone: 0.128." in found.text
    assert "0.379 → 0.19 N m" in found.text
    assert "repeatability" not in compared.text
    bars = found.data["joints"]["data"]  # type: ignore[index]
    assert [trace["y"] for trace in bars] == [[0.48], [0.21], [0.2]]
    assert "level-recording" in compared.data


def test_a_score_close_to_noise_names_no_place(comparison: ComparisonDocument, tmp_path: Path) -> None:
    good = comparison.model_copy(update={"score": 1.2})
    text = Page(write_comparison(good, (), None, tmp_path)).text
    assert "close to noise" in text
    assert "Largest in" not in text


def test_errors_of_earlier_versions_are_multiples_of_repeatability(
    diagnosis: DiagnosisDocument, comparison: ComparisonDocument, tmp_path: Path
) -> None:
    earlier = "times what repetition alone gives"
    path = tmp_path / "diagnosis.json"
    path.write_text(json.dumps(diagnosis.model_dump(mode="json") | {"error_unit": earlier}))
    assert read_document(path).error_unit == TIMES
    assert ComparisonDocument(**dict(comparison) | {"score_unit": earlier}).score_unit == TIMES


def test_documents_that_say_little_make_whole_pages(
    minimal_diagnosis: DiagnosisDocument, minimal_comparison: ComparisonDocument, tmp_path: Path
) -> None:
    found = Page(write_diagnosis(minimal_diagnosis, minimal_comparison, (), None, tmp_path))
    compared = Page(write_comparison(minimal_comparison, (), None, tmp_path))
    assert "NONE-EXPLAINS" in found.text
    assert "In times the noise; noise alone: 0.41." in found.text
    assert "1.0 is the scatter of repeats" not in found.text
    assert "5.2 × the relevance limit" in compared.text
    for page in (found, compared):
        assert page.count("select") == 0
        assert "None" not in page.text
        assert "Undefined" not in page.text


def test_a_diagnosis_of_version_0_1_0_is_shown(comparison_of_recordings: ComparisonDocument, tmp_path: Path) -> None:
    old = {
        "kind": "recording",
        "verdict": "joint_coulomb_friction",
        "named": ["joint_coulomb_friction"],
        "effects": [
            {
                "name": "joint_coulomb_friction", "sentence": "", "verdict": "CONFIRMED", "p_value": 1e-7,
                "held_out_error_before": 0.4, "held_out_error_after": 0.2, "reason": None,
                "parameters": {"coulomb_joint1": {"estimate": 0.4, "ci95": [0.3, 0.5], "unit": "N m"}},
            },
            {
                "name": "restitution", "sentence": "", "verdict": "NOT-IDENTIFIABLE", "p_value": None, "reason": "",
                "held_out_error_before": None, "held_out_error_after": None, "parameters": {},
            },
        ],
        "confusable": [],
        "unexplained": {"where": [
            {"phase": "slow", "signal": "torque", "index": "joint1", "share": 1.0, "times_noise": 2.0}
        ]},
        "next_experiment": {"advice": "move faster"},
        "model": {"name": "nominal", "digest": "0"},
        "noise_floor": 0.13,
        "held_out_error_before": 0.4,
        "held_out_error_after": 0.2,
        "recording": {
            "files": ["a.db3"], "robot": "franka_fer", "end_effector_mass_kg": 0.0, "samples": 7, "recorded_s": 1.0,
            "used_s": 1.0, "sampled_Hz": 30.0, "low_pass_Hz": 3.0,
        },
    }  # fmt: skip
    (tmp_path / "old.json").write_text(json.dumps(old))
    document = read_document(tmp_path / "old.json")
    text = Page(write_diagnosis(document, comparison_of_recordings, (), None, tmp_path)).text
    assert "coulomb_joint1 = 0.40 [0.30, 0.50] N m" in text
    assert "< 0.0005" in text  # whatever was written then
    assert "slow: torque joint1 – – 100 % 2" in text
    assert "Not measured: restitution." in text


@pytest.mark.parametrize("kind", ["comparison", "diagnosis", "history"])
def test_no_name_can_leave_its_place(
    kind: str,
    diagnosis: DiagnosisDocument,
    comparison: ComparisonDocument,
    tracks: Sequence[TrackSet],
    versions: Sequence[VersionError],
    tmp_path: Path,
) -> None:
    """Names come from files that anybody may have written."""

    def write(name: str, text: Callable[[str], str]) -> Page:
        directory = tmp_path / name
        labelled = [TrackSet(text(track.label), track.impact, track.time, track.signals) for track in tracks]
        named = [
            VersionError(_renamed(entry, text), entry.error_fit, entry.error_held_out, entry.noise_floor)
            for entry in versions
        ]
        shown = ComparisonDocument.model_validate(_everywhere(comparison.model_dump(), text))
        if kind == "history":
            return Page(write_history(named, directory))
        if kind == "comparison":
            return Page(write_comparison(shown, labelled, named, directory))
        found = DiagnosisDocument.model_validate(_everywhere(diagnosis.model_dump(), text))
        return Page(write_diagnosis(found, shown, labelled, named, directory))

    plain, evil = write("plain", lambda value: value), write("evil", lambda value: f"{value}{EVIL}")
    assert [tag for tag, _ in evil.elements] == [tag for tag, _ in plain.elements]
    assert EVIL in evil.text
    labels = json.dumps([value for name, value in evil.data.items() if name != "tracks-data"])
    assert "<img" not in labels  # Plotly reads its labels as HTML
    assert "&lt;img" in labels


def test_no_name_of_a_bag_can_leave_its_place(tmp_path: Path) -> None:
    def write(text: str) -> Page:
        listing = Listing("Bags skipped", ((text, text),))
        content = AnalysisPage(
            "Jumps",
            text,
            0,
            rows=(),
            arms=(),
            by_arm={text: ()},
            with_paper=False,
            contacts=("first",),
            none_fit=False,
            sensitivity=(),
            far=text,
            left_out=(listing,),
            sets=(),
            contact="first",
            replay=ReplayPart({"scenes": [], "runs": [{"label": text}, {"label": text}]}, choose=True),
        )
        return Page(skeleton.write_files(tmp_path, {"page.html": skeleton.render("analysis.html.j2", content)})[0])

    plain, evil = write("bag"), write(EVIL)
    assert evil.elements == plain.elements
    assert evil.text.count(EVIL) == 7
    assert "No set has enough trials" in evil.text


KEPT = ("source", "error_unit", "score_unit", "verdict", "unit", "phase", "format")


def _everywhere(value: object, text: Callable[[str], str]) -> object:
    """A document with all its free texts changed."""
    if isinstance(value, dict):
        return {key: item if key in KEPT or key == "levels" else _everywhere(item, text) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return tuple(_everywhere(item, text) for item in value)
    return text(value) if isinstance(value, str) and value else value


def _renamed(entry: VersionError, text: Callable[[str], str]) -> object:
    model = entry.version.model.model_copy(update={"name": text(entry.version.model.name)})
    return type(entry.version)(entry.version.file, model, entry.version.effect_added)


def test_pages_ask_the_network_for_nothing(
    diagnosed: Page, comparison: ComparisonDocument, versions: Sequence[VersionError], tmp_path: Path
) -> None:
    pages = [
        diagnosed,
        Page(write_comparison(comparison, (), versions, tmp_path)),
        Page(write_history(versions, tmp_path)),
    ]
    for page in pages:
        for tag, attributes in page.elements:
            assert not {"src", "href", "srcset", "action"} & set(attributes), tag
        policy = next(a["content"] for _, a in page.elements if a.get("http-equiv") == "Content-Security-Policy")
        assert policy is not None
        assert "default-src 'none'" in policy
        assert "http" not in policy


def test_a_page_is_replaced_at_once_and_leaves_nothing_behind(versions: Sequence[VersionError], tmp_path: Path) -> None:
    (tmp_path / "history.html").write_text("old")
    write_history(versions, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["history.html", "history.json"]
    assert "Error by model version" in (tmp_path / "history.html").read_text(encoding="utf-8")
    document = json.loads((tmp_path / "history.json").read_text())
    assert [entry["effect_added"] for entry in document["history"]] == [None, "object_mass"]


def test_a_folder_that_cannot_be_written_is_told(versions: Sequence[VersionError], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        write_history(versions, tmp_path / "file")
    (tmp_path / "history.json").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        write_history(versions, tmp_path)
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize(
    ("value", "text"), [(1e-300, "< 0.0005"), (0.0005, "< 0.0005"), (0.00051, "0.00051"), (0.4, "0.4"), (None, "–")]
)
def test_no_p_is_printed_below_what_is_known_of_noise(value: float | None, text: str) -> None:
    assert p_text(value).replace("\N{NO-BREAK SPACE}", " ") == text


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.004, "m/s", "4 mm/s"),
        (-0.041, "m/s", "−41 mm/s"),
        (0.15, "m/s", "0.15 m/s"),
        (4e-6, "rad", "4 µrad"),
        (0.02, "m/s^2", "20 mm/s²"),
        (0.05, "N m", "0.05 N m"),
        (0.0, "m", "0 m"),
        (1.2, "-", "1.2"),
    ],
)
def test_small_lengths_and_angles_are_told_in_thousandths_or_millionths(value: float, unit: str, text: str) -> None:
    assert quantity_text(value, unit).replace("\N{NO-BREAK SPACE}", " ") == text


def test_sentences_begin_with_a_capital_and_end_with_one_full_stop() -> None:
    assert sentence_text("run it again.") == sentence_text("run it again") == "Run it again."
    assert sentence_text("") == ""


def test_subscripts_are_the_only_markup_of_a_figures_text() -> None:
    assert subscripts_text("B<sub>θ</sub> <b>&") == "B<sub>θ</sub> &lt;b&gt;&amp;"


def test_every_page_extends_the_skeleton_and_none_switches_escaping_off() -> None:
    for name in ("analysis", "comparison", "diagnosis", "history", "paper"):
        text = (skeleton.TEMPLATES / f"{name}.html.j2").read_text(encoding="utf-8")
        assert text.splitlines()[1] == '{% extends "page.html.j2" %}'  # behind the licence
    for path in skeleton.TEMPLATES.iterdir():
        assert not re.search(r"\|\s*safe|autoescape", path.read_text(encoding="utf-8")), path
