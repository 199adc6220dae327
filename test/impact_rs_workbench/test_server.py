# SPDX-License-Identifier: Apache-2.0
"""The server: who may ask, what is answered to mistakes, and that nothing outside its folder is told."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest
from starlette.testclient import TestClient

from impact_rs_cli.main import main
from impact_rs_trials.store import Folder, owned
from impact_rs_workbench import prediction
from impact_rs_workbench.prediction import Question
from impact_rs_workbench.server import Workbench, application

PORT, TOKEN = 8123, "the-key-of-the-tests"
HOST = f"127.0.0.1:{PORT}"
FORMULA = """effects:
- name: cable_drag
  sentence: A cable drags behind the end effector.
  end_effector_force: {y: "-drag * vy"}
  parameters:
    drag: {unit: N s/m, nominal: 0, lower: 0, upper: 50, scale: 1}
"""
QUESTION = {"scenario": "push", "object": "cat_food", "case": "case_2"}


@pytest.fixture
def stranger(workbench: Workbench) -> TestClient:
    """Somebody on this machine who was not given the address."""
    return TestClient(application(workbench, TOKEN, PORT), base_url=f"http://{HOST}", follow_redirects=False)


def test_the_address_with_its_key_leads_to_the_page_and_leaves_a_strict_cookie(stranger: TestClient) -> None:
    answer = stranger.get("/", params={"token": TOKEN})
    assert (answer.status_code, answer.headers["location"]) == (303, "/")
    assert "samesite=strict" in answer.headers["set-cookie"].lower()
    assert "httponly" in answer.headers["set-cookie"].lower()
    assert "<h1>impact_rs</h1>" in stranger.get("/").text


@pytest.mark.parametrize("path", ["/", "/api/workspace", "/static/workbench.js", "/files/a.html", "/?token=guessed"])
def test_nobody_without_the_key_is_told_anything(stranger: TestClient, path: str) -> None:
    answer = stranger.get(path)
    assert answer.status_code == 403
    assert answer.text == "Open the address that impact-rs workbench has printed: it contains the access key."


@pytest.mark.parametrize(
    "host",
    [
        f"attacker.example:{PORT}",
        f"127.0.0.1.attacker.example:{PORT}",
        f"localhost.attacker.example:{PORT}",
        f"evil{HOST}",
        f"127.0.0.1:{PORT + 1}",
        "127.0.0.1",
        "",
    ],
)
def test_another_name_for_this_machine_is_refused_with_the_key(client: TestClient, host: str) -> None:
    answer = client.get("/api/workspace", headers={"host": host})
    assert (answer.status_code, answer.text) == (403, "impact-rs workbench serves its own machine only.")


@pytest.mark.parametrize(
    "origin",
    [
        "http://attacker.example",
        f"http://evil127.0.0.1:{PORT}",
        f"http://evil{HOST}@attacker.example",
        f"https://{HOST}",
        f"http://localhost:{PORT}",
        f"http://127.0.0.1:{PORT + 1}",
        "null",
        "",
    ],
)
def test_what_changes_something_has_to_come_from_our_own_page(
    client: TestClient, workbench: Workbench, origin: str
) -> None:
    answer = client.post("/api/jobs", json={"step": "blind", "seed": 1, "output": "x"}, headers={"origin": origin})
    assert answer.status_code == 403
    assert not workbench.jobs.all()


def test_the_page_may_load_nothing_from_elsewhere(client: TestClient) -> None:
    page = client.get("/")
    assert "default-src 'none'" in page.headers["content-security-policy"]
    texts = [page.text, client.get("/static/workbench.css").text, client.get("/static/workbench.js").text]
    assert not [text for text in texts if "http://" in text or "https://" in text]


OUTSIDE = [
    "../secret.html",
    "/etc/passwd",
    "a/../../secret.html",
    "..%2Fsecret.html",
    ".workbench/x.json",
    "link.html",
]


@pytest.mark.parametrize("name", OUTSIDE)
def test_no_file_outside_the_folder_is_shown(client: TestClient, tmp_path: Path, name: str) -> None:
    secret = tmp_path.parent / "secret.html"
    secret.write_text("secret")
    (tmp_path / "link.html").symlink_to(secret)
    answer = client.get(f"/files/{name}")
    assert answer.status_code in (404, 403)
    assert "secret" not in answer.text.replace("secret.html", "")


@pytest.mark.parametrize("name", ["../elsewhere", "/tmp/elsewhere", ".workbench/x", ""])
def test_no_command_writes_outside_the_folder(client: TestClient, workbench: Workbench, name: str) -> None:
    answer = client.post("/api/jobs", json={"step": "campaign", "scenario": "push", "output": name})
    assert answer.status_code == 400
    assert "\n" not in answer.json()["error"]
    assert not workbench.jobs.all()


def test_a_report_is_shown_as_if_from_another_site(client: TestClient, tmp_path: Path) -> None:
    (tmp_path / "compare.html").write_text("<p>a report</p>")
    answer = client.get("/files/compare.html")
    assert answer.text == "<p>a report</p>"
    assert answer.headers["content-security-policy"].startswith("sandbox allow-scripts")
    assert "allow-same-origin" not in answer.headers["content-security-policy"]


def test_files_that_no_page_shows_are_not_given_out(client: TestClient, tmp_path: Path) -> None:
    (tmp_path / "trial.mcap").write_bytes(b"bag")
    (tmp_path / "folder.html").mkdir()
    for name in ("trial.mcap", "folder.html"):
        answer = client.get(f"/files/{name}")
        assert (answer.status_code, answer.text) == (404, f"{name} is nothing that a page shows.")


def test_a_figure_gives_way_to_a_slider_that_has_moved_meanwhile(
    workbench: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    question = Question.model_validate(QUESTION | {"moving": True})
    whole = prediction.sweep

    def moved(*given: Any) -> Iterator[prediction.SweepPoint]:
        for point in whole(*given):
            yield point
            workbench._asked += 1  # as a prediction does before it waits for its turn

    assert len(workbench.sweep(question, "speed")["x"]) == prediction.SWEEP_POINTS
    monkeypatch.setattr(prediction, "sweep", moved)
    assert workbench.sweep(question, "speed") == {"superseded": True}


def test_formulas_replace_formulas_and_nothing_else(client: TestClient, tmp_path: Path) -> None:
    (tmp_path / "model.yaml").write_text("name: mine\neffects: []\n")
    answer = client.post("/api/formulas", json={"path": "model.yaml", "text": FORMULA})
    assert (answer.status_code, answer.json()) == (
        400, {"error": "model.yaml: there is a file of another kind; choose another name"},
    )  # fmt: skip
    assert (tmp_path / "model.yaml").read_text() == "name: mine\neffects: []\n"
    for text in (FORMULA, FORMULA.replace("50", "60")):
        assert client.post("/api/formulas", json={"path": "mine.yaml", "text": text}).status_code == 200
        assert (tmp_path / "mine.yaml").read_text() == text


MISTAKES = {
    "an unknown scenario": ("predict", QUESTION | {"scenario": "pusch"}, "did you mean 'push'?"),
    "an unknown object": ("predict", QUESTION | {"object": "cat_fod"}, "did you mean 'cat_food'?"),
    "an unknown case": ("predict", QUESTION | {"case": "7"}, "has no case '7'"),
    "an unknown slider": ("predict", QUESTION | {"values": {"contact.colour": 1}}, "no slider 'contact.colour'"),
    "a value that cannot be": ("predict", QUESTION | {"values": {"contact.restitution": 2}}, "contact.restitution = 2"),
    "a missing key": ("predict", {"scenario": "push"}, "object: this key is missing"),
    "an unknown step": ("command", {"step": "destroy"}, "step = 'destroy': expected one of campaign, "),
    "an option in the place of a name": (
        "command",
        {"step": "campaign", "scenario": "push", "output": "x", "objects": ["--help"]},
        "objects.0 = '--help': expected a name of letters, digits",
    ),
    "a model that is not there": (
        "command",
        {"step": "compare", "runs": ".", "model": "model_9.yaml", "output": "x"},
        "there is nothing at 'model_9.yaml'",
    ),
    "a formula that does not parse": ("formulas/check", {"text": "effects: ["}, "formulas: not valid YAML at line 1"),
    "no JSON object": ("predict", [1], "expected names with their values"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_answered_in_one_line_that_names_it(client: TestClient, name: str) -> None:
    path, content, expected = MISTAKES[name]
    answer = client.post(f"/api/{path}", json=content)
    assert answer.status_code == 400
    assert expected in answer.json()["error"]
    assert "\n" not in answer.json()["error"]


def test_what_is_no_json_or_too_large_is_refused(client: TestClient) -> None:
    assert client.post("/api/predict", content=b"{").json() == {"error": "the request is no JSON"}
    assert "larger than" in client.post("/api/predict", content=b" " * 1_000_001).json()["error"]


LONG_NAMES = ["x" * 300, "x/" * 3000, "x" * 6000, "1" * 5000, "\ud800"]


@pytest.mark.parametrize("name", LONG_NAMES, ids=lambda name: f"{name[:2]!a}-{len(name)}")
@pytest.mark.parametrize(
    "path", ["comparison?path=", "diagnosis?path=", "laboratory?scenario=push&path=", "scenario?name=", "jobs/"]
)
def test_a_name_that_no_file_can_have_is_a_mistake_of_one_short_line(client: TestClient, path: str, name: str) -> None:
    answer = client.get(f"/api/{path}{quote(name, errors='surrogatepass')}{'/log' if path == 'jobs/' else ''}")
    assert 400 <= answer.status_code < 500
    assert "\n" not in answer.text
    assert len(answer.text) < 600


@pytest.mark.parametrize("name", LONG_NAMES, ids=lambda name: f"{name[:2]!a}-{len(name)}")
def test_a_file_name_that_is_too_long_is_not_found_and_not_written(
    client: TestClient, workbench: Workbench, name: str
) -> None:
    assert client.get(f"/files/{quote(name, errors='surrogatepass')}.html").status_code == 404
    content = {"step": "campaign", "scenario": "push", "output": name}
    for answer in (
        client.post("/api/jobs", content=json.dumps(content)),
        client.post("/api/formulas", content=json.dumps({"path": f"{name}.yaml", "text": FORMULA})),
        client.post("/api/predict", content=json.dumps(QUESTION | {"scenario": f"{name}.yaml"})),
        client.post(f"/api/jobs/{quote(name, errors='surrogatepass')}/stop"),
    ):
        assert 400 <= answer.status_code < 500, answer.text
        assert len(answer.text) < 600
    assert not workbench.jobs.all()


def test_the_manual_is_there_with_its_tables_and_no_markup_of_others(client: TestClient) -> None:
    page = client.get("/manual/laboratory.md").json()["html"]
    assert '<h1 id="runs-of-your-own-laboratory">' in page
    assert "<table>" in page
    answer = client.get("/manual/..%2FREADME.md")
    assert answer.status_code in (400, 404)


def test_one_folder_has_one_workbench(tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    with owned(Folder(tmp_path / ".workbench")):
        assert main(["workbench", str(tmp_path), "--no-browser"]) == 2
    assert "works on this workbench; wait for it, or stop it" in capfd.readouterr().err


def test_a_file_in_the_place_of_the_folder_and_an_impossible_port_are_mistakes(
    tmp_path: Path, capfd: pytest.CaptureFixture
) -> None:
    (tmp_path / "file").write_text("")
    assert main(["workbench", str(tmp_path / "file"), "--no-browser"]) == 2
    assert "is a file; expected a folder for the workbench" in capfd.readouterr().err
    assert main(["workbench", str(tmp_path), "--port", "70000"]) == 2
    assert "port 70000: expected 0 (a free one) to 65535" in capfd.readouterr().err


def test_a_prediction_is_that_of_the_command_it_tells(client: TestClient, capfd: pytest.CaptureFixture) -> None:
    values = {"speed": 0.8, "contact.restitution": 0.2, "objects.cat_food.mass": 1.5}
    answer = client.post("/api/predict", json=QUESTION | {"values": values, "motor_inertia": "rotor"}).json()
    assert answer["command"].startswith("impact-rs map push cat_food case_2 --uncertainty --motor-inertia rotor --set ")
    words = shlex.split(answer["command"])[1:]
    assert main([*words, "--json"]) == 0
    told = json.loads(capfd.readouterr().out)
    row = next(row for row in answer["rows"] if row["main"] and row["body"] == "arm")
    assert row["after"] == pytest.approx(told["post"]["end_effector_twist"]["arm"][1], rel=1e-9)
    interval = told["uncertainty"]["interval"]["arm.velocity.y"]
    assert [row["low"], row["high"]] == pytest.approx([interval["low"], interval["high"]])
