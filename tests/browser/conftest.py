"""A real Chromium that opens pages from disk, and notes whatever else it is asked for."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

ARGUMENTS = [
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
OWN = ("file", "data", "blob", "about")
"""What a page that holds everything may open."""


class Opened:
    """A page in the browser, and everything that it complained of or asked for."""

    def __init__(self, page, path: Path) -> None:
        self.page = page
        self.complaints: list[str] = []
        self.requests: list[str] = []
        page.on("console", self._heard)
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("request", self._asked)
        page.route("**/*", self._let_through)
        page.goto(path.as_uri())

    def _heard(self, message) -> None:
        if message.type in ("error", "warning"):
            self.complaints.append(message.text)

    def _asked(self, request) -> None:
        if urlsplit(request.url).scheme not in OWN:
            self.requests.append(request.url)

    def _let_through(self, route) -> None:
        own = urlsplit(route.request.url).scheme in OWN
        route.continue_() if own else route.abort()


Open = Callable[..., Opened]


@pytest.fixture(scope="module")
def chromium() -> Iterator:
    """Starts the Chromium that is installed, with arguments of its own."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    found = (
        os.environ.get("GVR_CHROMIUM")
        or shutil.which("chromium")
        or shutil.which("chromium-browser")
    )
    if found is None:
        pytest.skip("no chromium on the path (set GVR_CHROMIUM)")
    with sync_api.sync_playwright() as playwright:

        def start(*more: str):
            return playwright.chromium.launch(executable_path=found, args=[*ARGUMENTS, *more])

        yield start


@pytest.fixture(scope="module")
def browser(chromium) -> Iterator:
    launched = chromium("--disable-gpu")
    yield launched
    launched.close()


@pytest.fixture
def open_page(browser) -> Iterator[Open]:
    """Opens a file; when the test ends, nothing may have been complained of or asked for."""
    opened: list[Opened] = []
    contexts = []

    def open_(path: Path, width: int = 1280, scheme: str = "light") -> Opened:
        context = browser.new_context(
            viewport={"width": width, "height": 800}, color_scheme=scheme, offline=True
        )
        contexts.append(context)
        opened.append(Opened(context.new_page(), path))
        return opened[-1]

    yield open_
    for each in opened:
        assert each.complaints == []
        assert each.requests == []
    for context in contexts:
        context.close()
