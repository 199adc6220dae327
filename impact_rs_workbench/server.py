# SPDX-License-Identifier: Apache-2.0
"""The workbench as a local web application: one page, its requests, and a stream of changes."""

from __future__ import annotations

import asyncio
import json
import re
import threading
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

from impact_rs_analysis.application.shown_runs import run_names
from impact_rs_analysis.report.page import BUNDLE, PLOTLY, TEMPLATES
from impact_rs_commands.predicting import EFFECTS
from impact_rs_sim.errors import InputError, shortened
from impact_rs_sim.impact_map import ImpactMapError
from impact_rs_sim.impact_map.uncertainty import Stopped
from impact_rs_sim.model import Model, load_model
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.schema import validate
from impact_rs_trials.store import Folder, owned
from impact_rs_workbench import formula_editor, manual, prediction, recording_description, results
from impact_rs_workbench.forms import FORMS, form_of, order_of, terminal_name, terminal_path
from impact_rs_workbench.formula_editor import FormulaText
from impact_rs_workbench.jobs import Job, Jobs, PageAnswer
from impact_rs_workbench.kept_choices import ListChoice, choices, keep
from impact_rs_workbench.live_page import Sources, Watch
from impact_rs_workbench.local import listening, serve_locally
from impact_rs_workbench.prediction import MapQuery
from impact_rs_workbench.recording_description import Description, PreviewRequest
from impact_rs_workbench.request_guard import FILE_POLICY, Guard
from impact_rs_workbench.static_files import SCRIPTS, SHARED, STATIC, static_file
from impact_rs_workbench.workspace import HIDDEN, NOMINAL, Workspace

FILES = {
    **SHARED,
    "workbench.css": STATIC / "workbench.css",
    "plotly.js": PLOTLY,
    "three.js": BUNDLE / "three.min.js",
    "replay.js": TEMPLATES / "replay.js",
}
PRELOADED = [name for name in SCRIPTS if name != "show.js"]  # which is of the page of show
SHOWN_FILES = {".html": "text/html", ".json": "application/json", ".yaml": "text/plain", ".csv": "text/plain"}
MAX_REQUEST_BYTES = 1_000_000
JOBS_POLL_S = 0.25  # between two checks of running jobs
FOLDER_POLL_S = 2.0  # between two scans of the folder

Endpoint = Callable[[Request], Awaitable[Response]]
Work = Callable[[Any], Any]


class Workbench:
    """State that the pages of one workbench share.

    Args:
        root: Its folder.
        program: How a terminal calls ``impact-rs``.
        nodes: Source of snapshots of running nodes, by namespace.
    """

    def __init__(self, root: Path, program: str, nodes: Sources) -> None:
        self.workspace = Workspace(root)
        self.program = program
        self.watch = Watch(nodes, program)
        self.jobs = Jobs(self.workspace.root / HIDDEN / "jobs", program)
        self.stopped: list[Job] = []  # jobs that its end has stopped
        self._moving_queries = 0  # number of predictions for moving sliders so far
        self._map = threading.Lock()  # the impact map keeps engines warm and answers one query at a time

    def state(self) -> dict[str, Any]:
        """All that lies in the folder."""
        return {"root": str(self.workspace.root), **asdict(self.workspace.contents())}

    def scenario(self, name: str) -> dict[str, Any]:
        """Choices in a scenario."""
        return prediction.describe(name, self.workspace.scenario_path(name))

    def scene(self, name: str, object_name: str) -> dict[str, Any]:
        """A scenario with one of its objects, as the picture draws it."""
        return prediction.scene_of(self.workspace.scenario_path(name), object_name)

    def predict(self, query: MapQuery) -> dict[str, Any]:
        """One prediction, with the equivalent command; ``superseded`` if a slider has moved meanwhile.

        Other queries wait for their turn: queries of two windows would stop each other for ever.
        """
        scenario = load_scenario(self.workspace.scenario_path(query.scenario))
        settings, model = prediction.settings_of(scenario, query), self.model(query)
        self._moving_queries += query.moving
        query_number = self._moving_queries
        with self._map:
            try:
                document = prediction.answer(scenario, query, model, lambda: self._moving_queries != query_number)
            except Stopped:
                return {"superseded": True}
        name = terminal_name(self.workspace, query.scenario)
        file = NOMINAL if query.model == NOMINAL else terminal_path(self.workspace.existing(query.model))
        arguments = prediction.map_arguments(name, file, query, settings)
        return document | {"command": self.command(arguments)}

    def model(self, query: MapQuery) -> Model:
        """The model of a query.

        Raises:
            InputError: There is no such file, or it is no model.
        """
        return load_model(NOMINAL if query.model == NOMINAL else self.workspace.existing(query.model))

    def impact(self, query: MapQuery) -> dict[str, Any]:
        """The impact for a picture; it does not supersede other queries."""
        scenario = load_scenario(self.workspace.scenario_path(query.scenario))
        with self._map:
            return prediction.answer(scenario, query.model_copy(update={"moving": True}), self.model(query))

    def sweep(self, query: MapQuery, key: str) -> dict[str, Any]:
        """Predictions over a slider; ``superseded`` if a slider has moved meanwhile, which has precedence."""
        scenario = load_scenario(self.workspace.scenario_path(query.scenario))
        slider = prediction.slider_of(scenario, query.object, key)
        remaining_points, query_number = (
            prediction.sweep(scenario, query, slider, self.model(query)),
            self._moving_queries,
        )
        points: list[prediction.SweepPoint] = []
        while self._moving_queries == query_number:
            with self._map:
                point = next(remaining_points, None)
            if point is None:
                return prediction.drawn(query, slider, points)
            points.append(point)
        return {"superseded": True}

    def command(self, words: list[str]) -> str:
        """Arguments as a line for a terminal."""
        return self.jobs.line(words)


def application(workbench: Workbench, token: str, port: int) -> ASGIApp:
    """The web application.

    Args:
        workbench: The shown workbench.
        token: Token in its address.
        port: Port that it is reached at.
    """

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        yield
        workbench.stopped = await run_in_threadpool(workbench.jobs.close)
        await workbench.watch.close()

    return Guard(Starlette(routes=_routes(workbench), lifespan=lifespan), token, port, "workbench")


def _routes(workbench: Workbench) -> list[Route]:
    workspace, jobs = workbench.workspace, workbench.jobs

    def sweep(data: Any) -> Any:
        key = data.pop("over", "") if isinstance(data, dict) else ""
        return workbench.sweep(_map_query(data), str(key))

    def preview(data: Any) -> Any:
        return recording_description.preview(workspace, validate(PreviewRequest, data, None))

    def keep_choice(data: Any) -> Any:
        return keep(workspace, validate(ListChoice, data, None)).model_dump()

    def check(data: Any) -> Any:
        return formula_editor.check(validate(FormulaText, data, None).text)

    return [
        Route("/", _page),
        Route("/static/{name:path}", _static),
        Route("/files/{path:path}", _file_of(workspace)),
        Route("/manual/{name}", _manual),
        Route("/manual/images/{name}", _picture),
        Route("/api/forms", _get(lambda _: {name: form_of(command) for name, command in FORMS.items()})),
        Route("/api/workspace", _get(lambda _: workbench.state())),
        Route("/api/scenario", _get(lambda query: workbench.scenario(query.get("name", "")))),
        Route(
            "/api/scene",
            _get(lambda query: workbench.scene(query.get("name", ""), query.get("object", ""))),
        ),
        Route(
            "/api/comparison",
            _get(lambda query: results.comparison(workspace.existing(query.get("path", "")))),
        ),
        Route("/api/diagnosis", _get(lambda query: results.diagnosis(workspace, query.get("path", "")))),
        Route("/api/reveal", _get(lambda query: _reveal(workbench, query.get("path", "")))),
        Route("/api/plan", _get(lambda query: results.plan(workspace.existing(query.get("path", ""))))),
        Route(
            "/api/investigation",
            _get(lambda query: results.investigation(workspace.existing(query.get("path", "")))),
        ),
        Route("/api/choices", _get(lambda _: choices(workspace).model_dump())),
        Route("/api/choices", _post(keep_choice), methods=["POST"]),
        Route("/api/estimates", _get(lambda _: results.estimates(workspace))),
        Route("/api/trials", _get(lambda query: run_names(workspace.existing(query.get("path", ""))))),
        Route("/api/trial", _get(lambda query: results.trial(workspace.existing(query.get("path", ""))))),
        Route(
            "/api/run",
            _get(lambda query: results.run(workspace.existing(query.get("path", "")), query.get("run", ""))),
        ),
        Route(
            "/api/laboratory",
            _get(lambda query: recording_description.look(workspace, query.get("path", ""), query.get("scenario", ""))),
        ),
        Route("/api/jobs", _get(lambda _: jobs.all())),
        Route("/api/jobs/{number}/log", _get(lambda query: {"log": jobs.log(_job(query))})),
        Route("/api/events", _events(workbench)),
        Route("/api/live", _live(workbench)),
        Route("/api/predict", _post(lambda data: workbench.predict(_map_query(data))), methods=["POST"]),
        Route("/api/impact", _post(lambda data: workbench.impact(_map_query(data))), methods=["POST"]),
        Route("/api/sweep", _post(sweep), methods=["POST"]),
        Route("/api/laboratory/preview", _post(preview), methods=["POST"]),
        Route("/api/laboratory", _post(lambda data: _describe(workbench, data)), methods=["POST"]),
        Route("/api/formulas/check", _post(check), methods=["POST"]),
        Route("/api/formulas", _post(lambda data: _save_formulas(workbench, data)), methods=["POST"]),
        Route("/api/command", _post(lambda data: _command(workbench, data)), methods=["POST"]),
        Route("/api/jobs", _post(lambda data: asdict(jobs.start(order_of(data, workspace)))), methods=["POST"]),
        Route(
            "/api/answer", _post(lambda data: asdict(jobs.answer(validate(PageAnswer, data, None)))), methods=["POST"]
        ),
        Route("/api/jobs/{number}/stop", _job_action(jobs.stop), methods=["POST"]),
        Route("/api/jobs/{number}/again", _job_action(jobs.again), methods=["POST"]),
    ]


def _command(workbench: Workbench, data: Any) -> dict[str, str]:
    return {"command": workbench.command(list(order_of(data, workbench.workspace).arguments))}


def _reveal(workbench: Workbench, path: str) -> dict[str, Any]:
    document = results.reveal(workbench.workspace, path)
    return document | {"command": workbench.command(document.pop("words"))}


def _describe(workbench: Workbench, data: Any) -> dict[str, Any]:
    description = validate(Description, data, None)
    written, remarks = recording_description.describe(workbench.workspace, description)
    name = description.path.strip("./") or "lab"
    form = {"command": "compare", "runs": description.path, "experiment": written[0]}
    return {"written": written, "remarks": remarks} | _command(workbench, form | {"output": f"reports/compare_{name}"})


def _save_formulas(workbench: Workbench, data: Any) -> dict[str, str]:
    path = formula_editor.keep(workbench.workspace, validate(FormulaText, data, None))
    return {
        "command": workbench.command(EFFECTS.words({"formulas": terminal_path(workbench.workspace.existing(path))}))
    }


def _map_query(data: Any) -> MapQuery:
    return validate(MapQuery, data, None)


def _get(work: Work) -> Endpoint:
    """A GET endpoint; ``work`` takes the parameters of query and path."""

    async def endpoint(request: Request) -> Response:
        return await _respond(work, {**request.query_params, **request.path_params})

    return endpoint


def _post(work: Work) -> Endpoint:
    """A POST endpoint; ``work`` takes the JSON document."""

    async def endpoint(request: Request) -> Response:
        body = b""
        async for part in request.stream():
            body += part
            if len(body) > MAX_REQUEST_BYTES:
                return _bad_request(f"the request is larger than {MAX_REQUEST_BYTES} bytes")
        try:
            data = json.loads(body)
        except (ValueError, RecursionError):
            return _bad_request("the request is not valid JSON")
        return await _respond(work, data)

    return endpoint


def _job(query: dict[str, str]) -> int:
    """The number of a job that an address names.

    Raises:
        InputError: It is no number that a job can have.
    """
    text = query["number"]
    if re.fullmatch(r"[0-9]{1,9}", text) is None:
        raise InputError(f"no job {shortened(text)!r}")
    return int(text)


def _job_action(work: Callable[[int], Any]) -> Endpoint:
    """An endpoint that does something to a job."""

    async def endpoint(request: Request) -> Response:
        return await _respond(lambda query: asdict(work(_job(query))), request.path_params)

    return endpoint


async def _respond(work: Work, argument: Any) -> Response:
    """Response with the result of ``work``, which runs in a thread; errors of the input as one line."""
    try:
        return _Answer(await run_in_threadpool(work, argument))
    except (InputError, ImpactMapError) as error:
        return _bad_request(str(error))
    except OSError as error:
        return _bad_request(f"{error.filename or ''}: {error.strerror or error}")


def _bad_request(text: str) -> Response:
    return _Answer({"error": text}, 400)


class _Answer(JSONResponse):
    """A JSON document in ASCII, which also holds names of files that are not UTF-8."""

    def render(self, content: Any) -> bytes:
        return json.dumps(content, allow_nan=False).encode("ascii")


async def _page(request: Request) -> Response:
    preloads = "\n".join(f'<link rel="modulepreload" href="/static/{name}">' for name in PRELOADED)
    page = (STATIC / "workbench.html").read_text(encoding="utf-8")
    return HTMLResponse(page.replace("<!-- preloads -->", preloads))


async def _static(request: Request) -> Response:
    return static_file(FILES, request.path_params["name"])


def _file_of(workspace: Workspace) -> Endpoint:
    async def endpoint(request: Request) -> Response:
        try:
            path = workspace.existing(request.path_params["path"])
        except InputError as error:
            return PlainTextResponse(str(error), 404)
        if path.suffix not in SHOWN_FILES or not path.is_file():
            return PlainTextResponse(f"{path.name} cannot be shown in the browser.", 404)
        return FileResponse(path, media_type=SHOWN_FILES[path.suffix], headers={"content-security-policy": FILE_POLICY})

    return endpoint


async def _manual(request: Request) -> Response:
    try:
        return JSONResponse({"html": await run_in_threadpool(manual.page, request.path_params["name"])})
    except InputError as error:
        return _bad_request(str(error))


async def _picture(request: Request) -> Response:
    try:
        return FileResponse(manual.picture(request.path_params["name"]))
    except InputError as error:
        return PlainTextResponse(str(error), 404)


def _events(workbench: Workbench) -> Endpoint:
    """Server-sent events: ``jobs`` and ``workspace``, each as a whole and only when it has changed."""

    async def stream(request: Request) -> AsyncIterator[str]:
        sent: dict[str, str] = {}
        scanned = -FOLDER_POLL_S
        clock = asyncio.get_running_loop().time
        running: set[int] = set()
        while not await request.is_disconnected():
            jobs = workbench.jobs.all()
            news: dict[str, Any] = {"jobs": jobs}
            before, running = running, {job["number"] for job in jobs if job["ended"] is None}
            if clock() - scanned >= FOLDER_POLL_S or before - running:  # a job that ends has written something
                scanned = clock()
                news["workspace"] = await run_in_threadpool(workbench.state)
            for name, content in news.items():
                text = json.dumps(content)
                if sent.get(name) != text:
                    sent[name] = text
                    yield f"event: {name}\ndata: {text}\n\n"
            await asyncio.sleep(JOBS_POLL_S)

    async def endpoint(request: Request) -> Response:
        return _OpenPage(stream(request), workbench.jobs)

    return endpoint


class _OpenPage(StreamingResponse):
    """A stream of events to a page, which is open as long as it takes them.

    Args:
        events: The events.
        jobs: Jobs, whose questions the page shows.
    """

    def __init__(self, events: AsyncIterator[str], jobs: Jobs) -> None:
        super().__init__(events, media_type="text/event-stream")
        self._jobs = jobs

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the events."""
        with self._jobs.open_page():
            await super().__call__(scope, receive, send)


def _live(workbench: Workbench) -> Endpoint:
    """Server-sent events of running nodes in a namespace, as :mod:`impact_rs_workbench.live_page` has them."""

    async def endpoint(request: Request) -> Response:
        namespace = request.query_params.get("namespace", "")
        try:
            view = await workbench.watch.enter(namespace)
        except InputError as error:
            return _bad_request(str(error))

        async def stream() -> AsyncIterator[str]:
            try:
                async for text in view.stream(request):
                    yield text
            finally:
                workbench.watch.leave(namespace)

        return StreamingResponse(stream(), media_type="text/event-stream")

    return endpoint


def serve(root: Path, program: str, nodes: Sources, port: int, browser: bool, say: Callable[[str], None]) -> list[Job]:
    """Serve the workbench of a folder until Ctrl-C.

    Args:
        root: The folder; made if it does not exist.
        program: How a terminal calls ``impact-rs``.
        nodes: Source of snapshots of running nodes, by namespace.
        port: Port; 0: any that is free.
        browser: Whether to open a browser.
        say: Prints the address.

    Returns:
        The jobs that Ctrl-C has stopped.

    Raises:
        InputError: Another workbench has this folder, or the folder cannot be made, or the port is taken.
    """
    with listening(port) as listener:
        root.mkdir(parents=True, exist_ok=True)
        with owned(Folder(root / HIDDEN), "workbench"):
            workbench = Workbench(root, program, nodes)
            serve_locally(listener, lambda token, number: application(workbench, token, number), browser, say)
            return workbench.stopped
