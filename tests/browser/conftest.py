"""A headless browser for pages opened from files; absent: skipped with a reason, under CI a failure."""

import os
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

ARGUMENTS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]


def _missing(reason: str) -> None:
    if os.environ.get("CI"):
        pytest.fail(reason)
    pytest.skip(reason)


@pytest.fixture(scope="session")
def launch() -> Iterator[Callable[..., Any]]:
    """Starts Chromium, the machine's own if it has one, with further arguments."""
    try:
        from playwright.sync_api import Error, sync_playwright
    except ImportError:
        _missing("playwright is not installed: the page is not looked at")
    # None: the browser that playwright itself may have downloaded.
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    with sync_playwright() as playwright:
        started = []

        def start(*more: str) -> Any:
            try:
                started.append(playwright.chromium.launch(executable_path=program, args=[*ARGUMENTS, *more]))
            except Error as error:
                _missing(f"no browser that starts, so the page is not looked at: {str(error).splitlines()[0]}")
            return started[-1]

        yield start
        for browser in started:
            browser.close()


@pytest.fixture(scope="session")
def browser(launch: Callable[..., Any]) -> Any:
    """One browser with WebGL drawn by the processor."""
    return launch()


@dataclass
class Opened:
    """A page, and whatever it complained about or asked for."""

    page: Any
    complaints: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def until(self, condition: Callable[[], bool], seconds: float = 30) -> bool:
        """Ask again until it is true; the page's policy forbids the waiting that playwright itself would do there."""
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                return False
            self.page.wait_for_timeout(50)
        return True

    def settle(self) -> None:
        """Wait until nothing has been drawn for two frames."""
        self.page.evaluate(
            """async () => {
                const drawn = () => document.querySelector('.jaxmocap-viewer').dataset.drawn;
                const frame = () => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
                for (let before = null; before !== drawn(); ) { before = drawn(); await frame(); }
            }"""
        )

    def picture(self) -> np.ndarray:
        """(height, width, 3) what is on the screen."""
        self.settle()
        return np.asarray(Image.open(BytesIO(self.page.screenshot())).convert("RGB")).astype(int)


def open_page(browser: Any, path: Path) -> Opened:
    """Open a file and note every error, warning of the policy, and request."""
    page = browser.new_page(viewport={"width": 1100, "height": 650})
    opened = Opened(page)
    page.on("console", lambda m: opened.complaints.append(m.text) if m.type in ("error", "warning") else None)
    page.on("pageerror", lambda e: opened.complaints.append(str(e)))
    page.on("dialog", lambda d: (opened.complaints.append(f"dialog {d.message}"), d.dismiss()))
    page.on("request", lambda r: opened.requests.append(r.url))
    page.goto(path.as_uri())
    return opened
