# SPDX-License-Identifier: Apache-2.0
"""The server: who may ask, how mistakes are answered, and that nothing outside its folder is read or written."""

from __future__ import annotations

import json
import re
import shlex
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest
from starlette.testclient import TestClient

from impact_rs_cli.main import main
from impact_rs_trials.store import Folder, owned
from impact_rs_workbench import prediction
from impact_rs_workbench.prediction import MapQuery
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
CAMPAIGN = {"command": "campaign", "scenario": "push"}


@pytest.fixture
def stranger(workbench: Workbench) -> TestClient:
    """A client on this machine that does not have the key."""
    return TestClient(application(workbench, TOKEN, PORT), base_url=f"http://{HOST}", follow_redirects=False)


def test_the_address_with_its_key_opens_the_page_with_a_strict_cookie(stranger: TestClient) -> None:
    answer = stranger.get("/", params={"token": TOKEN})
    assert (answer.status_code, answer.headers["location"]) == (303, "/")
    cookie = answer.headers["set-cookie"].lower()
    assert "samesite=strict" in cookie and "httponly" in cookie
    assert "<h1>impact_rs</h1>" in stranger.get("/").text


@pytest.mark.parametrize("path", ["/", "/api/workspace", "/static/workbench.js", "/files/a.html", "/?token=guessed"])
def test_without_the_key_nothing_is_answered(stranger: TestClient, path: str) -> None:
    answer = stranger.get(path)
    assert answer.status_code == 403
    assert answer.text == "Open the address that impact-rs workbench has printed: it contains the access key."


ATTACKER = "attacker.example"
HOSTS = [f"{ATTACKER}:{PORT}", f"127.0.0.1.{ATTACKER}:{PORT}", f"localhost.{ATTACKER}:{PORT}", f"evil{HOST}"]


@pytest.mark.parametrize("host", [*HOSTS, f"127.0.0.1:{PORT + 1}", "127.0.0.1", ""])
def test_another_name_for_this_machine_is_refused_with_the_key(client: TestClient, host: str) -> None:
    answer = client.get("/api/workspace", headers={"host": host})
    assert (answer.status_code, answer.text) == (403, "impact-rs workbench serves its own machine only.")


ORIGINS = [f"http://{ATTACKER}", f"http://evil127.0.0.1:{PORT}", f"http://evil{HOST}@{ATTACKER}", f"https://{HOST}"]


@pytest.mark.parametrize("origin", [*ORIGINS, f"http://localhost:{PORT}", f"http://127.0.0.1:{PORT + 1}", "null", ""])
def test_what_changes_something_has_to_come_from_our_own_page(
    client: TestClient, workbench: Workbench, origin: str
) -> None:
    form = {"command": "blind make", "seed": 1, "output": "x"}
    assert client.post("/api/jobs", json=form, headers={"origin": origin}).status_code == 403
    assert not workbench.jobs.all()


def test_the_page_may_load_nothing_from_elsewhere(client: TestClient) -> None:
    page = client.get("/")
    assert "default-src 'none'" in page.headers["content-security-policy"]
    names = re.findall('(?:src|href)="(/static/[^"]+)"', page.text)
    assert {"/static/palette.css", "/static/workbench.js", "/static/steps/predict.js"} <= set(names)
    for text in [page.text, *(client.get(name).text for name in names)]:
        assert "http://" not in text and "https://" not in text


@pytest.mark.parametrize(
    "name",
    ["../secret.html", "/etc/passwd", "a/../../secret.html", "..%2Fsecret.html", ".workbench/x.json", "link.html"],
)
def test_no_file_outside_the_folder_is_shown(client: TestClient, tmp_path: Path, name: str) -> None:
    secret = tmp_path.parent / "secret.html"
    secret.write_text("secret")
    (tmp_path / "link.html").symlink_to(secret)
    answer = client.get(f"/files/{name}")
    assert answer.status_code in (404, 403)
    assert "secret" not in answer.text.replace("secret.html", "")


@pytest.mark.parametrize("name", ["../elsewhere", "/tmp/elsewhere", ".workbench/x", ""])
def test_no_command_writes_outside_the_folder(client: TestClient, workbench: Workbench, name: str) -> None:
    answer = client.post("/api/jobs", json=CAMPAIGN | {"output": name})
    assert answer.status_code == 400
    assert "\n" not in answer.json()["error"]
    assert not workbench.jobs.all()


def test_reports_are_sandboxed_and_other_kinds_of_files_not_shown(client: TestClient, tmp_path: Path) -> None:
    (tmp_path / "compare.html").write_text("<p>a report</p>")
    answer = client.get("/files/compare.html")
    assert answer.text == "<p>a report</p>"
    assert answer.headers["content-security-policy"].startswith("sandbox allow-scripts")
    assert "allow-same-origin" not in answer.headers["content-security-policy"]
    (tmp_path / "trial.mcap").write_bytes(b"bag")
    (tmp_path / "folder.html").mkdir()
    for name in ("trial.mcap", "folder.html"):
        answer = client.get(f"/files/{name}")
        assert (answer.status_code, answer.text) == (404, f"{name} cannot be shown in the browser.")


def test_a_figure_gives_way_to_a_slider_that_has_moved_meanwhile(
    workbench: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    question = MapQuery.model_validate(QUESTION | {"moving": True})
    whole = prediction.sweep

    def moved(*given: Any) -> Iterator[prediction.SweepPoint]:
        for point in whole(*given):
            yield point
            workbench._moving_queries += 1  # as a prediction does before it waits for its turn

    assert len(workbench.sweep(question, "speed")["x"]) == prediction.SWEEP_POINTS
    monkeypatch.setattr(prediction, "sweep", moved)
    assert workbench.sweep(question, "speed") == {"superseded": True}


@pytest.mark.parametrize("moving", [False, True])
def test_a_prediction_gives_way_to_a_slider_and_to_no_other_window(
    workbench: Workbench, monkeypatch: pytest.MonkeyPatch, moving: bool
) -> None:
    question = MapQuery.model_validate(QUESTION)
    answer = prediction.answer

    def meanwhile(*given: Any) -> Any:
        """A prediction during which another window asks, and waits for its turn."""
        monkeypatch.setattr(prediction, "answer", answer)
        other = threading.Thread(target=workbench.predict, args=(question.model_copy(update={"moving": moving}),))
        other.start()
        others.append(other)
        other.join(0.2)
        return answer(*given)

    others: list[threading.Thread] = []
    monkeypatch.setattr(prediction, "answer", meanwhile)
    assert ("rows" in workbench.predict(question)) is not moving
    others[0].join()


def test_formulas_replace_formulas_and_nothing_else(client: TestClient, tmp_path: Path) -> None:
    (tmp_path / "model.yaml").write_text("name: mine\neffects: []\n")
    answer = client.post("/api/formulas", json={"path": "model.yaml", "text": FORMULA})
    error = "model.yaml: there is a file of another kind; choose another name"
    assert (answer.status_code, answer.json()) == (400, {"error": error})
    assert (tmp_path / "model.yaml").read_text() == "name: mine\neffects: []\n"
    for text in (FORMULA, FORMULA.replace("50", "60")):
        assert client.post("/api/formulas", json={"path": "mine.yaml", "text": text}).status_code == 200
        assert (tmp_path / "mine.yaml").read_text() == text


MISTAKES: list[tuple[str, Any, str]] = [
    ("predict", QUESTION | {"scenario": "pusch"}, "did you mean 'push'?"),
    ("predict", QUESTION | {"object": "cat_fod"}, "did you mean 'cat_food'?"),
    ("predict", QUESTION | {"case": "7"}, "has no case '7'"),
    ("predict", QUESTION | {"values": {"contact.colour": 1}}, "no slider 'contact.colour'"),
    ("predict", QUESTION | {"values": {"contact.restitution": 2}}, "contact.restitution = 2"),
    ("predict", {"scenario": "push"}, "object: this key is missing"),
    ("predict", [1], "expected names with their values"),
    ("command", {"command": "compare", "runs": ".", "model": "model_9.yaml"}, "there is nothing at 'model_9.yaml'"),
    ("formulas/check", {"text": "effects: ["}, "formulas: not valid YAML at line 1"),
]


@pytest.mark.parametrize(("path", "content", "expected"), MISTAKES)
def test_a_mistake_is_answered_in_one_line(client: TestClient, path: str, content: Any, expected: str) -> None:
    answer = client.post(f"/api/{path}", json=content)
    assert answer.status_code == 400
    error = answer.json()["error"]
    assert expected in error and "\n" not in error


def test_what_is_no_json_or_too_large_is_refused(client: TestClient) -> None:
    assert client.post("/api/predict", content=b"{").json() == {"error": "the request is not valid JSON"}
    assert "larger than" in client.post("/api/predict", content=b" " * 1_000_001).json()["error"]


@pytest.mark.parametrize("name", ["x" * 300, "x/" * 3000, "x" * 6000, "1" * 5000, "\ud800"], ids=range(5))
def test_a_name_that_no_file_can_have_is_a_short_line(client: TestClient, workbench: Workbench, name: str) -> None:
    quoted = quote(name, errors="surrogatepass")
    asked = ("comparison?path=", "diagnosis?path=", "laboratory?scenario=push&path=", "scenario?name=")
    formulas = {"path": f"{name}.yaml", "text": FORMULA}
    for answer in (
        *(client.get(f"/api/{path}{quoted}") for path in asked),
        client.get(f"/api/jobs/{quoted}/log"),
        client.get(f"/files/{quoted}.html"),
        client.post("/api/jobs", content=json.dumps(CAMPAIGN | {"output": name})),
        client.post("/api/formulas", content=json.dumps(formulas)),
        client.post("/api/predict", content=json.dumps(QUESTION | {"scenario": f"{name}.yaml"})),
        client.post(f"/api/jobs/{quoted}/stop"),
    ):
        assert 400 <= answer.status_code < 500, answer.text
        assert "\n" not in answer.text and len(answer.text) < 600
    assert not workbench.jobs.all()


def test_the_manual_is_there_with_its_tables_and_no_other_file(client: TestClient) -> None:
    page = client.get("/manual/your_data.md").json()["html"]
    assert '<h1 id="' in page and "<table>" in page
    assert client.get("/manual/..%2FREADME.md").status_code in (400, 404)


def test_one_folder_has_one_workbench(tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    with owned(Folder(tmp_path / ".workbench")):
        assert main(["workbench", str(tmp_path), "--no-browser"]) == 2
    assert "works on this workbench; wait for it, or stop it" in capfd.readouterr().err


def test_a_prediction_is_that_of_the_command_it_shows(client: TestClient, capfd: pytest.CaptureFixture) -> None:
    values = {"speed": 0.8, "contact.restitution": 0.2, "objects.cat_food.mass": 1.5}
    answer = client.post("/api/predict", json=QUESTION | {"values": values, "motor_inertia": "rotor"}).json()
    assert answer["command"].startswith("impact-rs map push cat_food case_2 --uncertainty --motor-inertia rotor --set ")
    assert main([*shlex.split(answer["command"])[1:], "--json"]) == 0
    printed = json.loads(capfd.readouterr().out)
    row = next(row for row in answer["rows"] if row["main"] and row["body"] == "arm")
    assert row["after"] == pytest.approx(printed["post"]["end_effector_twist"]["arm"][1], rel=1e-9)
    interval = printed["uncertainty"]["interval"]["arm.velocity.y"]
    assert [row["low"], row["high"]] == pytest.approx([interval["low"], interval["high"]])


def test_a_model_of_the_folder_is_predicted_as_its_command_does(
    client: TestClient, tmp_path: Path, capfd: pytest.CaptureFixture
) -> None:
    """A heavier object takes more of the velocity, in the answer, along a slider and on the terminal."""
    heavier = {"name": "object_mass", "parameters": {"scale": {"estimate": 1.6, "unit": "-"}}}
    (tmp_path / "heavier.yaml").write_text(json.dumps({"name": "heavier", "parent": "nominal", "effects": [heavier]}))

    def answered(**change: Any) -> Any:
        return client.post("/api/predict", json=QUESTION | change).json()

    def after(answer: Any) -> float:
        return abs(float(next(row["after"] for row in answer["rows"] if row["main"] and row["body"] == "arm")))

    nominal, found = answered(), answered(model="heavier.yaml")
    assert after(found) < after(nominal) - 0.01
    assert f"--model {tmp_path}/heavier.yaml" in found["command"] and "--model" not in nominal["command"]
    capfd.readouterr()
    assert main([*shlex.split(found["command"])[1:], "--json"]) == 0
    printed = json.loads(capfd.readouterr().out)
    assert printed["model"] == "heavier"
    assert after(found) == pytest.approx(abs(printed["post"]["end_effector_twist"]["arm"][1]), rel=1e-9)
    mass = {"over": "objects.cat_food.mass"}
    lines = [
        client.post("/api/sweep", json=QUESTION | mass | {"model": model}).json()
        for model in ("nominal", "heavier.yaml")
    ]
    at_rest, heavy = (np.abs(next(line["y"] for line in one["lines"] if line["chosen"])) for one in lines)
    assert (heavy < at_rest).all()
    assert "there is nothing at" in answered(model="nowhere.yaml")["error"]


def test_the_impact_is_drawn_where_it_is_predicted(client: TestClient) -> None:
    """Joints and object of the scenario, velocities of the table, and intervals about them."""
    question = {"scenario": "push", "object": "cat_food", "case": "case_2", "moving": True}
    found = client.post("/api/predict", json=question).json()
    scene = client.get("/api/scene", params={"name": "push", "object": "cat_food"}).json()
    arm, item = found["moment"]["jumps"]
    assert len(found["moment"]["joints"]) == len([joint for joint in scene["joints"] if "column" in joint])
    assert (arm["arm"], item["arm"]) == ("arm", None)
    for body, jump in (("arm", arm), ("object", item)):
        rows = [row for row in found["rows"] if row["body"] == body]
        assert jump["after"] == [row["after"] for row in rows]
        assert all(
            low <= value <= high for low, value, high in zip(jump["low"], jump["after"], jump["high"], strict=True)
        )
    assert client.post("/api/impact", json=question).json()["moment"] == found["moment"]


def test_a_trial_that_is_none_is_refused_in_one_line(client: TestClient, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    assert client.get("/api/trials", params={"path": "empty"}).json() == []
    for path in ("empty", "../x", "nothing"):
        answer = client.get("/api/trial", params={"path": path})
        assert (answer.status_code, "\n" in answer.json()["error"]) == (400, False)
    assert "truth.json" in client.get("/api/reveal", params={"path": "empty"}).json()["error"]


def test_a_file_name_that_is_not_utf_8_is_shown(client: TestClient, workbench: Workbench) -> None:
    """Kills an answer in UTF-8, which cannot hold such a name and fails as a whole."""
    folder = workbench.workspace.root / "messung_\udcfc" / "bag"  # of byte 0xfc, as Latin-1 has it
    folder.mkdir(parents=True)
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information")
    answer = client.get("/api/workspace")
    assert answer.status_code == 200
    assert "messung_\\udcfc" in answer.text
