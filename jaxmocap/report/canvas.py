"""Paper and ink of the figures: sizes, colours, and bytes that are the same for the same input.

matplotlib is imported inside the functions, so that a report's numbers cost no plotting library, and without
pyplot, so that no global state of a notebook is touched.
"""

import io
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
else:  # a run-time type check of a test must not need the plotting library
    Axes = Figure = Any

# Okabe and Ito 2008: told apart by every kind of colour vision, and in grey.
BLUE, ORANGE, RED, GREEN, GREY = "#0072B2", "#E69F00", "#D55E00", "#009E73", "#6b6b6b"
HALF = (4.6, 3.8)
"""Size of a figure of half the page width [inch of 100 px]."""

_STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same shapes on every machine
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#888888",
    "axes.labelcolor": "#333333",
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "xtick.color": "#555555",
    "ytick.color": "#555555",
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "svg.hashsalt": "jaxmocap",
    "svg.fonttype": "path",
    "figure.constrained_layout.use": True,
    "figure.dpi": 100,
    "savefig.dpi": 110,  # of what is rasterised inside an SVG
}


@dataclass(frozen=True)
class Picture:
    """An image file in memory with the words that belong to it."""

    data: bytes
    media_type: str
    """"image/svg+xml", "image/jpeg" or "image/png"."""
    title: str
    caption: str
    """One sentence: how to read it."""
    wide: bool = False
    """Whether it takes the full width of the page."""


def draw(size: tuple[float, float], painter: Callable[[Figure], None], media_type: str = "image/svg+xml") -> bytes:
    """The file of a figure.

    Args:
        size: width and height [inch of 100 px].
        painter: fills the empty figure.
        media_type: "image/svg+xml" or "image/jpeg".

    Returns:
        The same bytes for the same drawing.
    """
    import matplotlib
    from matplotlib.figure import Figure

    # From the defaults, so that nobody's matplotlibrc changes a report.
    style: Any = {**matplotlib.rcParamsDefault, "backend": "agg", **_STYLE}
    with matplotlib.rc_context(style):
        figure = Figure(figsize=size)
        painter(figure)
        return _svg(figure) if media_type == "image/svg+xml" else _jpeg(figure)


def _svg(figure: Figure) -> bytes:
    out = io.BytesIO()
    figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    return out.getvalue()


def _jpeg(figure: Figure) -> bytes:
    """JPEG, because the figure holds photos: a PNG of their noise is five times larger."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    canvas = FigureCanvasAgg(figure)
    figure.set_dpi(135)
    canvas.draw()
    out = io.BytesIO()
    Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]).save(out, "JPEG", quality=75, optimize=True)
    return out.getvalue()


def image_axes(axes: Axes, image_size: tuple[int, int], margin: float = 0.03) -> None:
    """Axes over the image plane: v down, border drawn, pixels square."""
    w, h = image_size
    edge = margin * max(w, h)
    axes.set_xlim(-edge, w + edge)
    axes.set_ylim(h + edge, -edge)
    axes.set_aspect("equal")
    axes.plot([-0.5, w - 0.5, w - 0.5, -0.5, -0.5], [-0.5, -0.5, h - 0.5, h - 0.5, -0.5], color="#333333", lw=0.9)
    axes.set_xlabel("u [px]")
    axes.set_ylabel("v [px]")
    axes.grid(False)


def round_number(value: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above a positive value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= value * (1 + 1e-9)))
