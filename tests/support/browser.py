"""The Chromium or Chrome of the system without a window, driven by Playwright."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import ConsoleMessage, Page, Request, sync_playwright

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
"""Commands that start the browser. Playwright is never asked to download one of its own."""

CHROMIUM = next((path for name in NAMES if (path := shutil.which(name))), "")
"""The browser; empty where there is none."""

needs_chromium = pytest.mark.skipif(
    not CHROMIUM, reason=f"there is no Chromium: none of {', '.join(NAMES)} is installed"
)

PATIENCE = 60_000.0
"""Milliseconds after which the browser counts as dead. Nothing depends on how fast it is."""


class Browser:
    """One page of a browser.

    Attributes
    ----------
    page
        The page of Playwright.
    errors
        Errors and warnings that the page has written to its console, and exceptions that nothing
        caught.
    requests
        Addresses that the page has asked for, without its own file and data in it.
    """

    def __init__(self, page: Page) -> None:
        self.page = page
        self.errors: list[str] = []
        self.requests: list[str] = []
        page.set_default_timeout(PATIENCE)
        page.on("console", self._hear)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("request", self._note)

    def open(self, page: Path | str) -> None:
        """Open a page, and wait until it says that it is ready."""
        self.errors.clear()
        self.requests.clear()
        self.page.goto(page.as_uri() if isinstance(page, Path) else page)
        self.wait_for("['ready', 'failed'].includes(document.body.dataset.state)")

    def run(self, script: str) -> Any:
        """The value of an expression in the page."""
        return self.page.evaluate(script)

    def wait_for(self, condition: str) -> None:
        """Wait until an expression in the page is true."""
        self.page.wait_for_function(condition)

    def _hear(self, message: ConsoleMessage) -> None:
        if message.type in {"error", "warning", "assert"}:
            self.errors.append(message.text)

    def _note(self, request: Request) -> None:
        if not request.url.startswith(("data:", "file:", "about:", "blob:")):
            self.requests.append(request.url)


@contextmanager
def browser() -> Iterator[Browser]:
    """A browser with an empty profile and a window of 1440 by 900 pixels. It ends with the
    context.
    """
    with (
        sync_playwright() as playwright,
        playwright.chromium.launch(executable_path=CHROMIUM) as chromium,
    ):
        yield Browser(chromium.new_page(viewport={"width": 1440, "height": 900}))
