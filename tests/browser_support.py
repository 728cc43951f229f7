"""A page opened in a browser, and what it does there."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image


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
