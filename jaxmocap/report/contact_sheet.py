"""One picture of many photographs: what was found is circled and named, a red frame marks what needs a look."""

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont

_COLUMNS = 4
_WIDTH = 480  # px of one panel
_FRAME, _TITLE, _LINE = 6, 22, 16
_GOOD, _BAD, _NAMED, _OTHER, _INK = (70, 150, 90), (220, 40, 40), (90, 230, 255), (255, 90, 90), (240, 240, 240)
_GROUND = (28, 28, 32)


@dataclass(frozen=True)
class Panel:
    """One photograph."""

    title: str
    rgb: np.ndarray
    """(height, width, 3), 0..255."""
    names: tuple[str, ...]
    uv: np.ndarray
    """(n, 2) [px], as the names."""
    radius: np.ndarray
    """(n,) [px]."""
    rejected: np.ndarray
    """(m, 2) [px]: spots without a name, drawn as crosses."""
    problems: tuple[str, ...]


def contact_sheet_png(panels: Sequence[Panel]) -> bytes:
    """The sheet as PNG, photographs row by row.

    Args:
        panels: one or more.

    Returns:
        PNG; the same panels give the same bytes.
    """
    drawn = [_draw(panel) for panel in panels]
    columns = min(_COLUMNS, len(drawn))
    width, height = max(p.width for p in drawn), max(p.height for p in drawn)
    rows = -(-len(drawn) // columns)
    sheet = Image.new("RGB", (columns * width, rows * height), _GROUND)
    for k, picture in enumerate(drawn):
        sheet.paste(picture, ((k % columns) * width, (k // columns) * height))
    out = io.BytesIO()
    sheet.save(out, format="PNG")
    return out.getvalue()


def _draw(panel: Panel) -> Image.Image:
    font = ImageFont.load_default(13)
    photo = Image.fromarray(panel.rgb)
    scale = _WIDTH / photo.width
    photo = photo.resize((_WIDTH, round(photo.height * scale)))
    # Bright photos of dark figures: lifted a little, so that what is not lit can be recognised.
    photo = photo.point(lambda v: min(255, int(255 * (v / 255) ** 0.8)))  # pyright: ignore[reportOperatorIssue]
    below = _LINE * len(panel.problems)
    size = (_WIDTH + 2 * _FRAME, photo.height + _TITLE + below + 2 * _FRAME)
    picture = Image.new("RGB", size, _BAD if panel.problems else _GOOD)
    draw = ImageDraw.Draw(picture)
    draw.rectangle((_FRAME, _FRAME, size[0] - _FRAME - 1, size[1] - _FRAME - 1), fill=_GROUND)
    draw.text((_FRAME + 4, _FRAME + 3), panel.title, fill=_INK, font=font)
    top = _FRAME + _TITLE
    picture.paste(photo, (_FRAME, top))

    def at(p: np.ndarray) -> tuple[float, float]:
        return (float(p[0]) + 0.5) * scale + _FRAME, (float(p[1]) + 0.5) * scale + top

    small = ImageFont.load_default(11)
    for name, p, r in zip(panel.names, panel.uv, panel.radius):
        x, y = at(p)
        around = (float(r) + 3.0) * scale
        draw.ellipse((x - around, y - around, x + around, y + around), outline=_NAMED, width=1)
        draw.text((x + around + 1, y - 7), name, fill=_NAMED, font=small, stroke_width=1, stroke_fill=(0, 0, 0))
    for p in panel.rejected:
        x, y = at(p)
        draw.line((x - 4, y - 4, x + 4, y + 4), fill=_OTHER)
        draw.line((x - 4, y + 4, x + 4, y - 4), fill=_OTHER)
    for k, text in enumerate(panel.problems):
        draw.text((_FRAME + 4, top + photo.height + k * _LINE), _fitting(text, draw, small), fill=_OTHER, font=small)
    return picture


def _fitting(text: str, draw: ImageDraw.ImageDraw, font: ImageFont.ImageFont | ImageFont.FreeTypeFont) -> str:
    """The text, cut to the width of a panel."""
    if draw.textlength(text, font=font) <= _WIDTH - 8:
        return text
    while text and draw.textlength(text + "...", font=font) > _WIDTH - 8:
        text = text[:-1]
    return text + "..."
