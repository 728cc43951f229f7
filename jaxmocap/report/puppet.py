"""The report of a puppet's pose: photographs with their beads, places, bones, the turntable, and the scene in 3D."""

import html
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from typing import Protocol

from jaxmocap.report import html as page
from jaxmocap.report.canvas import Picture
from jaxmocap.report.text import format_number, format_value

_e = html.escape


class View(Protocol):
    """A scene that turns, ready for a page."""

    @property
    def style(self) -> str:
        """CSS."""
        ...

    @property
    def body(self) -> str:
        """The element that shows it."""
        ...

    @property
    def scripts(self) -> tuple[str, ...]:
        """JavaScript, in this order."""
        ...

    def policy(self, styles: Sequence[str] = ()) -> str:
        """Content security policy of a page with it and further styles."""
        ...


@dataclass(frozen=True)
class BeadRow:
    """One bead."""

    name: str
    xyz: tuple[float, float, float]
    sigma: tuple[float, float, float]
    views: int
    rms_px: float
    truth: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class BoneRow:
    """One bone."""

    name: str
    direction: tuple[float, float, float]
    marker_distance: float | None
    off_deg: float | None = None
    """From the true direction."""


@dataclass(frozen=True)
class PuppetReport:
    """Everything the page of one pose shows."""

    title: str
    command: str
    unit: str
    rms_px: float
    photos: int
    beads: tuple[BeadRow, ...]
    bones: tuple[BoneRow, ...]
    angles: tuple[tuple[str, float, float, float], ...]
    """Photograph, stated, measured, sigma [degrees]."""
    free: tuple[str, ...]
    notes: tuple[str, ...]
    contact_sheet: bytes | None = None
    """PNG."""
    provenance: Mapping[str, str] = field(default_factory=dict)


def puppet_html(report: PuppetReport, view: View | None = None) -> str:
    """The report as one self-contained page.

    Args:
        report: of a pose.
        view: the scene in 3D; None: the page has no script.

    Returns:
        HTML; the same text for the same report.
    """
    sections = list(_sections(report, view))
    if view is None:
        return page.page_html(report.title, sections)
    css = resources.files("jaxmocap.report").joinpath("page.css").read_text(encoding="utf-8")
    css += ".jaxmocap-viewer { height: 34rem; }\n"
    scripts = "\n".join(f"<script>{text}</script>" for text in view.scripts)
    body = "\n".join(sections)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_e(view.policy([css]))}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{_e(report.title)}</title>\n<style>{view.style}</style>\n<style>{css}</style>\n</head>\n"
        f"<body>\n<main>\n{body}\n</main>\n{scripts}\n</body>\n</html>\n"
    )


def _sections(report: PuppetReport, view: View | None) -> Iterable[str]:
    worst = max((max(b.sigma) for b in report.beads), default=0.0)
    unit = "" if report.unit == "1" else f" {report.unit}"
    yield (
        f'<header>\n<h1>{_e(report.title)}</h1>\n<dl class="headline">\n'
        + page._headline("Beads in space", str(len(report.beads)), "of 16")
        + page._headline("Photos used", str(report.photos), "")
        + page._headline("RMS", f"{format_number(report.rms_px, 3)} px", "root of the mean squared residual length")
        + page._headline("Largest sigma", f"{format_number(worst, 3)}{unit}", "of a coordinate")
        + "</dl>\n</header>"
    )
    if report.notes:
        yield page._section("What to know", page._weaknesses((), report.notes))
    if view is not None:
        yield page._section("In space", view.body + '<p class="soft">Drag or press the arrow keys to turn.</p>')
    if report.contact_sheet is not None:
        said = "Circles: named beads. Crosses: spots without a name. A red frame marks a photo that needs a look."
        sheet = Picture(report.contact_sheet, "image/png", "Contact sheet", said, wide=True)
        yield page._section("Photos", page._figures([sheet]))
    yield page._section("Beads", _beads(report))
    yield page._section("Bones", _bones(report))
    yield page._section("Turntable", _angles(report))
    origin = {"command": report.command, **report.provenance}
    cells = [(f"<td>{_e(k)}</td>", f"<td><code>{_e(v)}</code></td>") for k, v in origin.items()]
    yield page._section("Where this comes from", page._table([], cells))


def _number(text: str) -> str:
    return f'<td class="number">{_e(text)}</td>'


def _beads(report: PuppetReport) -> str:
    length = "" if report.unit == "1" else f" [{report.unit}]"
    known = any(b.truth is not None for b in report.beads)
    heads = ["bead", f"x ± sigma{length}", f"y ± sigma{length}", f"z ± sigma{length}", "#photos", "#RMS [px]"]
    heads += ["truth", "#off by"] if known else []
    rows = []
    for b in report.beads:
        places = [f"<td>{_e(format_value(v, s))}</td>" for v, s in zip(b.xyz, b.sigma)]
        cells = [page._name(b.name), *places, _number(str(b.views)), _number(format_number(b.rms_px, 3))]
        if known and b.truth is not None:
            off = sum((v - t) ** 2 for v, t in zip(b.xyz, b.truth)) ** 0.5
            cells += [f"<td>{_e(', '.join(format_number(t, 2) for t in b.truth))}</td>", _number(format_number(off, 3))]
        rows.append(cells)
    return page._table(heads, rows)


def _bones(report: PuppetReport) -> str:
    known = any(b.off_deg is not None for b in report.bones)
    length = "" if report.unit == "1" else f" [{report.unit}]"
    heads = ["bone", "direction", f"#distance of its beads{length}", *(["#off by [°]"] if known else [])]
    rows = []
    for b in report.bones:
        apart = "" if b.marker_distance is None else format_number(b.marker_distance, 2)
        told = ", ".join(format_number(d, 3) for d in b.direction)
        cells = [page._name(b.name), f"<td>{_e(told)}</td>", _number(apart)]
        if known:
            cells.append(_number("" if b.off_deg is None else format_number(b.off_deg, 2)))
        rows.append(cells)
    return page._table(heads, rows)


def _angles(report: PuppetReport) -> str:
    rows = [
        (
            page._name(name),
            _number(f"{stated:g}"),
            f"<td>{_e(f'{measured:g} (zero of the angles)' if sigma == 0 else format_value(measured, sigma))}</td>",
        )
        for name, stated, measured, sigma in report.angles
    ]
    free = f'<p class="soft">The photos leave free: {_e("; ".join(report.free))}.</p>'
    return page._table(["photo", "#stated [°]", "measured [°]"], rows) + free
