"""The scene as one HTML page that asks nobody for anything: three.js, the numbers and the style are inside.

It opens from a file. Its own policy forbids everything but the scripts and the style whose hashes it states; names
come from files of strangers and are only ever set as text.
"""

import base64
import colorsys
import hashlib
import html
import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np

from jaxmocap.viewer.scene import Markers, ViewerScene

MAX_FRAMES = 20_000
"""Frames that a page holds: 16 markers and 20 joints then weigh about 15 MB. Of longer takes every n-th is shown."""


@dataclass(frozen=True)
class ViewerParts:
    """The pieces of a page, for one that holds more than the picture."""

    style: str
    """CSS, all of it below the class `jaxmocap-viewer`."""
    body: str
    """The element that shows the scene, its data inside; the scripts must come after it."""
    scripts: tuple[str, ...]
    """JavaScript, in this order, each in a script element of its own."""

    def policy(self, styles: Sequence[str] = ()) -> str:
        """Content security policy of a page with these parts and further style elements with these texts."""
        css = " ".join(_hash(text) for text in (self.style, *styles))
        return f"default-src 'none'; img-src data:; style-src {css}; script-src {' '.join(map(_hash, self.scripts))}"


def scene_page(scene: ViewerScene) -> str:
    """One self-contained page.

    Args:
        scene: what to show.

    Returns:
        HTML; the same text for the same scene.
    """
    parts = viewer_parts(scene)
    whole = "html, body { margin: 0; height: 100%; } body > .jaxmocap-viewer { height: 100%; border: 0; }"
    scripts = "\n".join(f"<script>{text}</script>" for text in parts.scripts)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{html.escape(parts.policy([whole]))}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(scene.title)}</title>\n<style>{parts.style}</style>\n<style>{whole}</style>\n</head>\n"
        f"<body>\n{parts.body}\n{scripts}\n</body>\n</html>\n"
    )


def viewer_parts(scene: ViewerScene) -> ViewerParts:
    """The pieces of which `scene_page` is made.

    Args:
        scene: what to show.

    Returns:
        The parts; a page may hold several bodies, but style and scripts once.
    """
    data = json.dumps(_data(scene), ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    # Within a script element only "<" could end it, or begin a comment.
    data = data.replace("<", "\\u003c").encode("utf-8", errors="backslashreplace").decode()
    body = (
        '<div class="jaxmocap-viewer">\n'
        f'<script type="application/json">{data}</script>\n'
        "<noscript><p>The picture needs JavaScript, which is switched off here.</p></noscript>\n</div>"
    )
    return ViewerParts(_asset("viewer.css"), body, (_asset("three.bundle.js"), _asset("viewer.js")))


def _data(scene: ViewerScene) -> dict[str, Any]:
    """What the script reads; frames in which nothing was seen are left out."""
    kept, notes = _kept_frames(scene)
    markers, skeleton = scene.markers, scene.skeleton
    numbers = np.arange(scene.frames) if scene.frame_numbers is None else np.asarray(scene.frame_numbers)
    return {
        "title": scene.title,
        "unit": "" if scene.unit == "1" else scene.unit,
        "rotation": scene.rotation().ravel().tolist(),
        "fps": scene.fps,
        "frames": numbers[kept].tolist(),
        "notes": [*scene.notes, *notes],
        "markers": None if markers is None else _markers(markers, kept),
        "skeleton": skeleton
        and {
            "names": skeleton.names,
            "parents": [int(p) for p in skeleton.parents],
            "p": _packed(skeleton.p_world[kept]),
        },
        "cameras": [
            {"name": c.name, "centre": _list(c.centre), "corners": _list(c.corners)}
            for c in scene.cameras
            if np.isfinite(c.centre).all() and np.isfinite(c.corners).all()
        ],
        "axis": scene.axis and {"point": _list(scene.axis.point), "direction": _list(scene.axis.direction)},
    }


def _markers(markers: Markers, kept: np.ndarray) -> dict[str, Any]:
    n = len(markers.names)
    colours = markers.colours or [colorsys.hls_to_rgb(0.03 + 0.618034 * i % 1.0, 0.5, 0.75) for i in range(n)]
    return {
        "names": markers.names,
        "colours": ["#" + "".join(f"{round(255 * min(max(float(c), 0), 1)):02x}" for c in rgb) for rgb in colours],
        "p": _packed(markers.p_world[kept]),
        "sigma": None if markers.sigma is None else _packed(markers.sigma[kept]),
    }


def _kept_frames(scene: ViewerScene) -> tuple[np.ndarray, list[str]]:
    """Numbers of the frames to show, and what to say about the others."""
    seen = np.zeros(scene.frames, dtype=bool)
    for track in (scene.markers, scene.skeleton):
        if track is not None:
            seen |= np.any(np.isfinite(track.p_world).all(axis=2), axis=1)
    kept, notes = np.flatnonzero(seen), []
    if len(kept) < scene.frames:
        notes.append(f"{scene.frames - len(kept)} frames in which nothing was seen are left out.")
    if len(kept) > MAX_FRAMES:
        step = -(-len(kept) // MAX_FRAMES)
        kept = kept[::step]
        notes.append(f"The take is long: one frame in {step} is shown.")
    return kept, notes


def _packed(values: np.ndarray) -> str:
    """Numbers as the script unpacks them: 32-bit floats, NaN where missing, in base64."""
    single = np.where(np.isfinite(values), values, np.nan).astype("<f4")
    return base64.b64encode(single.tobytes()).decode()


def _list(values: np.ndarray) -> Any:
    return np.asarray(values, dtype=float).tolist()


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _asset(name: str) -> str:
    return resources.files("jaxmocap.viewer").joinpath(name).read_text(encoding="utf-8")
