# SPDX-License-Identifier: Apache-2.0
"""A running graph as a page in the browser: the newest state some 25 times a second, over server-sent events."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractContextManager, AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

from pydantic import ValidationError
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp

from impact_rs_analysis.following.documents import ChangeDiagnosis, PublishedChange, PublishedPrediction, RefusedHit
from impact_rs_analysis.report.page import BUNDLE, STYLE, TEMPLATES
from impact_rs_analysis.report.scene_3d import described_scene, moving_joints, scene_data
from impact_rs_sim.errors import InputError
from impact_rs_sim.schema import Schema
from impact_rs_trials.snapshot import IdentifyMessages, Snapshot
from impact_rs_workbench.local import listening, serve_locally
from impact_rs_workbench.request_guard import Guard
from impact_rs_workbench.static_files import SHARED, STATIC, static_file

PERIOD = 0.04  # s, between two looks at the graph
IDLE_CHECK_S = 0.25  # after which an idle stream checks whether its page is still there
LINGER_S = 2.0  # that a graph is watched after the last page has left
FILES = {
    **SHARED,
    "page.css": STYLE,
    "three.min.js": BUNDLE / "three.min.js",
    "replay.js": TEMPLATES / "replay.js",
}

log = logging.getLogger(__name__)


class SnapshotSource(Protocol):
    """Source of the newest state of a graph."""

    def look(self) -> Snapshot:
        """The newest snapshot; returns at once."""


Sources = Callable[[str], AbstractContextManager[SnapshotSource]]


@dataclass(frozen=True)
class DrawnScene:
    """The scene as the page draws it.

    Attributes:
        text: The scene as JSON; ``null`` where none is known.
        joints: Names of the joints in the order of the page.
        arms: Names of the arms in the order of the page.
        complaint: Why the scene cannot be drawn; empty: it can, or none is known yet.
    """

    text: str = "null"
    joints: tuple[str, ...] = ()
    arms: tuple[str, ...] = ()
    complaint: str = ""


class LiveView:
    """A graph as every open page sees it.

    Args:
        source: Source of snapshots.
        program: How a terminal calls ``impact-rs``.
        say: Prints every new status line.
    """

    def __init__(self, source: SnapshotSource, program: str, say: Callable[[str], None]) -> None:
        self._source, self._program, self._say = source, program, say
        self._number = -1
        self._scene = DrawnScene()
        self._changed = asyncio.Condition()
        self.news: dict[str, str] = {}  # newest content by name of the event

    async def follow(self) -> None:
        """Poll the graph until it is cancelled."""
        clock = asyncio.get_running_loop().time
        due = clock()
        while True:
            snapshot = self._source.look()
            if snapshot.number != self._number:
                self._number = snapshot.number
                self._scene = await run_in_threadpool(drawn_scene, snapshot)
            news = {
                "scene": self._scene.text,
                "status": json.dumps(status_text(snapshot, self._scene, self._program)),
                "state": json.dumps(state_of(snapshot, self._scene), allow_nan=False),
                "followed": followed_text(snapshot.followed),
            }
            if news != self.news:
                if news["status"] != self.news.get("status"):
                    self._say(json.loads(news["status"]))
                self.news = news
                async with self._changed:
                    self._changed.notify_all()
            due = max(due + PERIOD, clock())
            await asyncio.sleep(due - clock())

    async def stream(self, request: Request) -> AsyncIterator[str]:
        """Server-sent events ``scene``, ``status``, ``state`` and ``followed``: each whole, when it has changed."""
        sent: dict[str, str] = {}
        while not await request.is_disconnected():
            for name, text in self.news.items():
                if sent.get(name) != text:
                    sent[name] = text
                    yield f"event: {name}\ndata: {text}\n\n"
            try:
                async with asyncio.timeout(IDLE_CHECK_S), self._changed:
                    await self._changed.wait_for(lambda: self.news != sent)
            except TimeoutError:
                continue


def drawn_scene(snapshot: Snapshot) -> DrawnScene:
    """The scene of a snapshot."""
    if snapshot.physics is not None:
        text = json.dumps(scene_data(snapshot.physics))
        return DrawnScene(text, tuple(moving_joints(snapshot.physics)), tuple(snapshot.physics.arms))
    if snapshot.description:
        try:
            scene, joints = described_scene(snapshot.description)
        except InputError as error:
            return DrawnScene(complaint=str(error))
        return DrawnScene(json.dumps(scene), tuple(joints))
    return DrawnScene(complaint=snapshot.complaint)


def state_of(snapshot: Snapshot, scene: DrawnScene) -> dict[str, Any] | None:
    """Positions of all bodies; None until the joints of every arm are known.

    ``velocities`` of joints and ``forces`` of arms are None until all of them are known.
    """
    positions, velocities = snapshot.positions, snapshot.velocities
    if not scene.joints or not (any if snapshot.physics is None else all)(name in positions for name in scene.joints):
        return None
    neighbours, neighbour_poses = (() if snapshot.physics is None else snapshot.physics.neighbours), snapshot.neighbours
    forces = None
    if all(arm in snapshot.forces for arm in scene.arms) and scene.arms:
        forces = [snapshot.forces[arm].tolist() for arm in scene.arms]
    return {
        "time": snapshot.time,
        "joints": [positions.get(name, 0.0) for name in scene.joints],
        "velocities": [velocities[name] for name in scene.joints] if velocities.keys() >= set(scene.joints) else None,
        "object": None if snapshot.object is None else snapshot.object.tolist(),
        "neighbours": [
            None if (pose := neighbour_poses.get(neighbour.name)) is None else pose.tolist() for neighbour in neighbours
        ],
        "forces": forces,
    }


def followed_of(followed: IdentifyMessages) -> dict[str, Any]:
    """Document that a node ``identify`` has published, as the page shows it; another text is reported.

    ``prediction``, ``diagnosis`` and ``refused`` are None while missing; ``changes`` are the newest first.
    """
    unreadable: list[str] = []

    def read(schema: type[Schema], text: str) -> dict[str, Any] | None:
        try:
            return schema.model_validate_json(text).model_dump(mode="json") if text else None
        except ValidationError as error:
            unreadable.append(f"a message of identify is not a valid {schema.__name__}: {error.errors()[0]['msg']}")
            return None

    messages = {
        "prediction": read(PublishedPrediction, followed.prediction),
        "changes": [
            change for text in reversed(followed.changes) if (change := read(PublishedChange, text)) is not None
        ],
        "diagnosis": read(ChangeDiagnosis, followed.diagnosis),
        "refused": read(RefusedHit, followed.refused),
    }
    return messages | {"unreadable": unreadable}


@lru_cache(maxsize=8)
def followed_text(followed: IdentifyMessages) -> str:
    """:func:`followed_of` as JSON, kept: it is asked for with every look at the graph."""
    return json.dumps(followed_of(followed), allow_nan=False)


def status_text(snapshot: Snapshot, scene: DrawnScene, program: str) -> str:
    """Status in one line."""
    title = snapshot.title or "the robot of /robot_description"
    if scene.complaint:
        return f"{title} cannot be drawn: {scene.complaint}"
    return {
        "absent": f"no graph runs in {snapshot.place}; {program} up push starts one. Waiting",
        "idle": f"nodes run in {snapshot.place}; nothing has moved yet. Waiting for a trial",
        "running": f"now: {title}",
        "over": f"at rest until the next trial; this is the last state of {title}",
        "gone": f"the nodes have ended; this is the last state of {title}. Waiting",
    }[snapshot.situation]


@dataclass
class _Watched:
    """A graph that pages show: its view, the callbacks that end it, and the number of pages."""

    view: LiveView
    end: AsyncExitStack
    pages: int = 0


class Watch:
    """Graphs that pages show. Each is watched once for all pages, and only while a page shows it.

    Args:
        source: Context manager of a source of snapshots, by namespace.
        program: How a terminal calls ``impact-rs``.
    """

    def __init__(self, source: Sources, program: str) -> None:
        self._source, self._program = source, program
        self._watched: dict[str, _Watched] = {}
        self._lock = asyncio.Lock()
        self._leaving: set[asyncio.Task[None]] = set()

    async def enter(self, namespace: str) -> LiveView:
        """A page begins to look; :meth:`leave` ends it.

        Raises:
            InputError: ROS does not allow such a namespace.
        """
        async with self._lock:
            if namespace not in self._watched:
                self._watched[namespace] = await self._open(namespace)
            self._watched[namespace].pages += 1
            return self._watched[namespace].view

    def leave(self, namespace: str) -> None:
        """A page looks no longer; callable while its request is cancelled, which lets nothing be awaited."""
        self._watched[namespace].pages -= 1
        task = asyncio.create_task(self._close(namespace))
        self._leaving.add(task)
        task.add_done_callback(self._leaving.discard)

    async def _open(self, namespace: str) -> _Watched:
        watching = self._source(namespace)
        source = await run_in_threadpool(watching.__enter__)
        end = AsyncExitStack()
        end.push_async_callback(run_in_threadpool, watching.__exit__, None, None, None)
        view = LiveView(source, self._program, lambda _: None)
        following = asyncio.create_task(view.follow())
        following.add_done_callback(_log_failure)
        end.callback(following.cancel)
        return _Watched(view, end)

    async def close(self) -> None:
        """Look at no graph any more."""
        for task in self._leaving:
            task.cancel()
        async with self._lock:
            while self._watched:
                await self._watched.popitem()[1].end.aclose()

    async def _close(self, namespace: str) -> None:
        await asyncio.sleep(LINGER_S)  # the page is only being loaded again
        async with self._lock:
            watched = self._watched.get(namespace)
            if watched is not None and not watched.pages:
                del self._watched[namespace]
                await watched.end.aclose()


def application(view: LiveView, token: str, port: int) -> ASGIApp:
    """The web application.

    Args:
        view: The view to serve.
        token: Access token of the address.
        port: Port of the server.
    """

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        following = asyncio.create_task(view.follow())
        following.add_done_callback(_log_failure)
        yield
        following.cancel()

    async def events(request: Request) -> Response:
        return StreamingResponse(view.stream(request), media_type="text/event-stream")

    routes = [Route("/", _page), Route("/static/{name:path}", _static), Route("/api/events", events)]
    return Guard(Starlette(routes=routes, lifespan=lifespan), token, port, "show")


def _log_failure(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and (error := task.exception()) is not None:
        log.error("the graph is no longer watched", exc_info=error)


async def _page(request: Request) -> Response:
    return HTMLResponse((STATIC / "live.html").read_text(encoding="utf-8"))


async def _static(request: Request) -> Response:
    return static_file(FILES, request.path_params["name"])


def serve(source: SnapshotSource, program: str, port: int, browser: bool, say: Callable[[str], None]) -> None:
    """Serve the page of a running graph until Ctrl-C.

    Args:
        source: Source of snapshots.
        program: How a terminal calls ``impact-rs``.
        port: Port; 0: any that is free.
        browser: Whether to open a browser.
        say: Prints the address and every new status line.

    Raises:
        InputError: The port is taken.
    """
    with listening(port) as listener:
        view = LiveView(source, program, say)
        serve_locally(
            listener,
            lambda token, number: application(view, token, number),
            browser,
            lambda address: say(f"live: {address}"),
        )
