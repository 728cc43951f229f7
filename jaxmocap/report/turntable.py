"""The report of a turntable: what its numbers are, how far the build is from the document's, every photo's angle."""

import html
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from jaxmocap.calibration.evidence import Weakness
from jaxmocap.report import html as page
from jaxmocap.report.data import RMS_DEFINITION, ParameterRow
from jaxmocap.report.text import count, format_number, format_value, parameter_text

_e = html.escape


@dataclass(frozen=True)
class AngleRow:
    """One photo."""

    name: str
    stated_deg: float
    measured_deg: float
    sigma_deg: float
    """0 for the photo that holds the zero of the angles."""
    deviation_deg: float
    """Measured minus stated, in [-180, 180)."""
    rms_px: float


@dataclass(frozen=True)
class TurntableReport:
    """Everything a page or a summary of one turntable shows."""

    command: str
    board: str
    rms_px: float
    unit: str
    axis: tuple[ParameterRow, ...]
    """Point and direction in the camera frame at angle 0, distance, height."""
    build: tuple[ParameterRow, ...]
    """How far the build is from nominal."""
    angles: tuple[AngleRow, ...]
    free: tuple[str, ...]
    """What the data leave free, in sentences."""
    warnings: tuple[Weakness, ...] = ()
    notes: tuple[str, ...] = ()
    skipped: tuple[tuple[str, str], ...] = ()
    """(photo, reason)."""
    provenance: Mapping[str, str] = field(default_factory=dict)


def turntable_html(report: TurntableReport) -> str:
    """The report as one self-contained page; the same text for the same report."""
    return page.page_html("Turntable", _sections(report))


def _sections(report: TurntableReport) -> Iterable[str]:
    yield (
        f'<header>\n<h1>Turntable</h1>\n<p class="soft">{_e(report.board)}</p>\n<dl class="headline">\n'
        + page._headline("RMS", f"{format_number(report.rms_px, 3)} px", RMS_DEFINITION)
        + page._headline("Photos used", str(len(report.angles)), f"of {len(report.angles) + len(report.skipped)}")
        + "</dl>\n</header>"
    )
    if report.warnings or report.notes:
        yield page._section("What to know", page._weaknesses(report.warnings, report.notes))
    yield page._section("Axis, in the camera frame at angle 0", page._parameters(report.axis))
    yield page._section("How far the build is from nominal", page._parameters(report.build))
    yield page._section("What the photos leave free", "".join(f"<p>{_e(text)}</p>" for text in report.free))
    heads = ["photo", "#stated [°]", "measured [°]", "#difference [°]", "#RMS [px]"]
    rows = [
        (
            page._name(a.name),
            _number(f"{a.stated_deg:g}"),
            f"<td>{_e(_angle(a))}</td>",
            _number(format_number(a.deviation_deg, 3)),
            _number(format_number(a.rms_px, 3)),
        )
        for a in report.angles
    ]
    yield page._section("Angles", page._table(heads, rows))
    if report.skipped:
        cells = [(page._name(name), f"<td>{_e(reason)}</td>") for name, reason in report.skipped]
        yield page._section("Photos not used", page._table(["photo", "reason"], cells))
    origin = {"command": report.command, **report.provenance}
    cells = [(f"<td>{_e(k)}</td>", f"<td><code>{_e(v)}</code></td>") for k, v in origin.items()]
    yield page._section("Where this comes from", page._table([], cells))


def _number(text: str) -> str:
    return f'<td class="number">{_e(text)}</td>'


def _angle(row: AngleRow) -> str:
    return (
        f"{row.measured_deg:g} (zero of the angles)"
        if row.sigma_deg == 0
        else format_value(row.measured_deg, row.sigma_deg)
    )


def turntable_summary(report: TurntableReport) -> str:
    """The lines the command line prints.

    Args:
        report: a finished calibration.

    Returns:
        Text that ends in a newline.
    """
    photos = count(len(report.angles), "photo")
    lines = ["Turntable", f"  RMS {format_number(report.rms_px, 3)} px ({RMS_DEFINITION}); {photos}"]
    for title, rows in (("Axis, in the camera frame at angle 0", report.axis), ("Build, from nominal", report.build)):
        lines += ["", f"  {title}", *(f"    {r.name:28}{parameter_text(r)}" for r in rows)]
    lines += ["", "  Angles [degrees]"]
    lines += [f"    {a.name:28}{_angle(a)}   (stated {a.stated_deg:g})" for a in report.angles]
    lines += ["", *(f"  {text}" for text in report.free)]
    lines += [f"  {w.severity}: {w.sentence} {w.next_step}" for w in report.warnings]
    lines += [f"  {note}" for note in report.notes]
    if report.skipped:
        lines += ["", "  Photos not used", *(f"    {name}: {reason}" for name, reason in report.skipped)]
    return "\n".join(lines) + "\n"
