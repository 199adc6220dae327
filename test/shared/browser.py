# SPDX-License-Identifier: Apache-2.0
"""Pages in a headless Chromium: one process for the tests of a file, a context of its own for each page.

Without a graphics card everything is drawn by a software renderer of OpenGL, which takes a third of the time of a
test that never looks at the picture. Pages have no WebGL unless a test asks for it; bodies and arrows are placed all
the same.

The driver of Playwright keeps an event loop in the thread of the tests, where no other may run: it ends with the file.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cost
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, BrowserType, Locator, Page, Route, expect, sync_playwright

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="no chromium or chrome on this machine")
SOFTWARE_WEBGL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
NO_WEBGL = ("--disable-gpu", "--disable-software-rasterizer")
LOCAL = ("file:", "data:", "blob:")
EXPECTED = ("THREE.WebGLRenderer: ", "Failed to load resource: ")  # errors of the console: no WebGL; a mistake is a 400
FRAMES = (
    "(count) => new Promise((done) => { const next = () => count-- ? requestAnimationFrame(next) : done(); next(); })"
)
PICTURES = bool(os.environ.get("IMPACT_RS_PICTURES"))  # the pictures of the manual are made anew
IMAGES = Path(__file__).resolve().parents[2] / "docs" / "images"
PATIENCE = 60_000.0  # ms, for what a page shall show; never reached on a machine that works
expect.set_options(timeout=PATIENCE)


@contextmanager
def chromium() -> Iterator[Browser]:
    """A browser, whose start is charged to no test, and whose processes take their times with them at the end."""
    driver = sync_playwright()
    with cost.shared():
        browser = _launched(driver.start().chromium, webgl=PICTURES)
    yield browser
    with cost.shared():
        browser.close()
        driver.__exit__()


def _launched(kind: BrowserType, *, webgl: bool) -> Browser:
    return kind.launch(executable_path=CHROMIUM, args=("--no-sandbox", *(SOFTWARE_WEBGL if webgl else NO_WEBGL)))


@contextmanager
def opened(browser: Browser, address: str, *, webgl: bool = False, **options: object) -> Iterator[Page]:
    """A page in a context of its own; it throws no error, complains of nothing and asks no other server.

    Args:
        browser: The browser.
        address: What is opened.
        webgl: Whether it draws in 3D: in a second browser, which can.
        options: Of the context.
    """
    of_its_own = webgl and not PICTURES
    if of_its_own:
        browser = _launched(browser.browser_type, webgl=True)
    context = browser.new_context(**options)  # type: ignore[arg-type]
    page, wrong, home = context.new_page(), list[str](), address.partition("/?")[0]
    page.set_default_timeout(PATIENCE)
    page.on("pageerror", lambda error: wrong.append(str(error.stack)))
    page.on(
        "console",
        lambda said: None if said.type != "error" or said.text.startswith(EXPECTED) else wrong.append(said.text),
    )
    page.on("request", lambda asked: None if asked.url.startswith((home, *LOCAL)) else wrong.append(asked.url))
    page.goto(address)
    yield page
    context.close()
    if of_its_own:
        browser.close()
    assert wrong == [], wrong


def accessible(page: Page) -> None:
    """Names, roles, order of headings, contrast: the rules of axe-core."""
    found = Axe().run(page).response["violations"]
    assert [(one["id"], one["nodes"][0]["html"][:200]) for one in found] == []


def picture(part: Page | Locator, name: str) -> None:
    """A picture of the manual, where those are made anew."""
    if PICTURES:
        part.screenshot(path=IMAGES / f"{name}.png", animations="disabled")


class Held:
    """Answers of the server that come late.

    Args:
        page: The page that asks.
        pattern: What it asks for.
    """

    def __init__(self, page: Page, pattern: str) -> None:
        self._routes: list[Route] = []
        self._page, self._free = page, False
        page.route(pattern, self._take)  # a route ends the cache of the browser

    def _take(self, route: Route) -> None:
        """Hold a question; one that comes after the others were let go is answered at once."""
        if self._free:
            route.continue_()
        else:
            self._routes.append(route)

    def wait_for(self, count: int) -> None:
        """Until so many questions were asked."""
        while len(self._routes) < count:
            self._page.evaluate("1")  # hears of requests meanwhile

    def let_go(self) -> None:
        """Answer every question, and let the page paint."""
        self._free = True
        while self._routes:
            route = self._routes.pop(0)
            route.fulfill(response=route.fetch())
        self._page.evaluate(FRAMES, 6)

    def answer_last_of(self, count: int) -> None:
        """Answer the last question alone, once so many were asked."""
        self.wait_for(count)
        self._routes.pop().continue_()


Visit = Callable[..., Page]
