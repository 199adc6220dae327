# SPDX-License-Identifier: Apache-2.0
"""What was chosen in the overlay outlives page and server, and holds no result."""

from __future__ import annotations

from pathlib import Path

import pytest
from starlette.testclient import TestClient

NONE = {"runs": None, "models": None}


def test_a_choice_is_kept_list_by_list(client: TestClient, tmp_path: Path) -> None:
    assert client.get("/api/choices").json() == NONE
    runs = {"chosen": ["a/1", "b/2"], "pinned": ["b/2"]}
    models = {"chosen": [], "pinned": []}
    client.post("/api/choices", json={"name": "runs"} | runs)
    client.post("/api/choices", json={"name": "models"} | models)
    assert client.get("/api/choices").json() == {"runs": runs, "models": models}
    assert [path.name for path in tmp_path.iterdir()] == [".workbench"]


@pytest.mark.parametrize("text", ["", "{", "[]", '{"runs": 3}'])
def test_a_damaged_file_is_no_choice(client: TestClient, tmp_path: Path, text: str) -> None:
    (tmp_path / ".workbench").mkdir(exist_ok=True)
    (tmp_path / ".workbench" / "overlay.json").write_text(text)
    assert client.get("/api/choices").json() == NONE
    chosen = {"chosen": ["a"], "pinned": []}
    assert client.post("/api/choices", json={"name": "runs"} | chosen).json()["runs"] == chosen


def test_another_list_is_refused_in_one_line(client: TestClient) -> None:
    answer = client.post("/api/choices", json={"name": "jobs"})
    assert answer.status_code == 400
    assert "name = 'jobs': expected 'runs' or 'models'" in answer.json()["error"]
