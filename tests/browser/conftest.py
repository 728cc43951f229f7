"""A headless browser for pages opened from files; absent: skipped with a reason, under CI a failure."""

import os
import shutil
from collections.abc import Callable, Iterator
from typing import Any

import pytest

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
