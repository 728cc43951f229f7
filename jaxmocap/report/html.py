"""The calibration report as one HTML page that asks nobody for anything, and as a card for notebooks.

Every text goes through `_e` (escaped), every picture is inside the page, and the page's own policy forbids
scripts and requests, so that a report can be mailed and opened anywhere, whatever the photos are called.
"""

import base64
import hashlib
import html
from collections.abc import Iterable, Sequence
from importlib import resources

from jaxmocap.calibration.evidence import Weakness
from jaxmocap.report.canvas import Picture
from jaxmocap.report.data import CalibrationReport, CameraReport, ParameterRow, ViewReport
from jaxmocap.report.figures import camera_pictures
from jaxmocap.report.text import (
    Verdict,
    count,
    format_number,
    format_value,
    parameter_text,
    relative_title,
    verdict,
    verdict_sentence,
)

_CLASS: dict[Verdict, str] = {"good": "good", "usable with care": "care", "do not use": "bad"}
_e = html.escape


def calibration_html(report: CalibrationReport) -> str:
    """The report as one self-contained page.

    Args:
        report: a finished or failed calibration.

    Returns:
        HTML; the same text for the same report.
    """
    return page_html(report.title, _sections(report))


def page_html(title: str, sections: Iterable[str]) -> str:
    """A self-contained page of ready sections: own style, no script, no request.

    Args:
        title: of the window.
        sections: HTML.

    Returns:
        HTML.
    """
    css = resources.files("jaxmocap.report").joinpath("page.css").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(css.encode()).digest()).decode()
    policy = f"default-src 'none'; img-src data:; style-src 'sha256-{digest}'"
    body = "\n".join(sections)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_e(policy)}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{_e(title)}</title>\n<style>{css}</style>\n</head>\n"
        f"<body>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )


def _sections(report: CalibrationReport) -> Iterable[str]:
    yield _top(report)
    for camera in report.cameras:
        yield _section(f"Parameters of {camera.name}", _parameters(camera.parameters) + _lens_range(camera))
    if report.stereo:
        yield _section(relative_title(report), _parameters(report.stereo))
    if report.warnings or report.notes:
        yield _section("What to know", _weaknesses(report.warnings, report.notes))
    for index, camera in enumerate(report.cameras):
        views = [v for v in report.views if v.camera == index]
        pictures = camera_pictures(camera, views, report.unit)
        if pictures:
            yield _section(f"Pictures of {camera.name}", _figures(pictures))
    if report.views:
        yield _section("Photos used", _views(report))
    if report.skipped:
        rows = [(_name(name), f"<td>{_e(reason)}</td>") for name, reason in report.skipped]
        yield _section("Photos not used", _table(["photo", "reason"], rows))
    yield _section("Where this comes from", _provenance(report))


def _section(title: str, content: str) -> str:
    return f"<section>\n<h2>{_e(title)}</h2>\n{content}\n</section>"


def _top(report: CalibrationReport) -> str:
    start, rest = verdict_sentence(report).split(":", 1)
    board = f'<p class="soft">{_e(report.board)}</p>' if report.board else ""
    used = f"of {len(report.views) + len(report.skipped)}" if report.skipped else ""
    rejected = f"{report.rejected} rejected" if report.rejected else "none rejected"
    return (
        f'<header>\n<h1>{_e(report.title)}</h1>\n{board}\n<p class="verdict {_CLASS[verdict(report)]}">'
        f"<strong>{_e(start)}:</strong>{_e(rest)}</p>\n"
        '<dl class="headline">\n'
        + _headline("RMS", f"{format_number(report.rms_px, 3)} px", report.rms_definition)
        + _headline("Photos used", str(len(report.views)), used)
        + _headline("Points used", str(report.observations), rejected)
        + "</dl>\n</header>"
    )


def _headline(term: str, value: str, below: str) -> str:
    return f"<div><dt>{_e(term)}</dt><dd>{_e(value)}<small>{_e(below)}</small></dd></div>\n"


def _parameters(rows: Sequence[ParameterRow]) -> str:
    """Table of values; the columns for the plain sigma and the truth only where there is one."""
    plain, truth = any(r.sigma_plain is not None for r in rows), any(r.truth is not None for r in rows)
    heads = ["", "value ± sigma"] + ["sigma, points independent"] * plain + ["truth", "off by"] * truth
    cells = [
        (
            f"<td><b>{_e(r.name)}</b></td>",
            f"<td>{_e(parameter_text(r))}</td>",
            *([f"<td>{_e(_plain_sigma(r))}</td>"] if plain else []),
            *([f"<td>{_e(_truth(r))}</td>", f"<td>{_e(_miss(r))}</td>"] if truth else []),
        )
        for r in rows
    ]
    note = '<p class="soft">The first sigma allows for errors shared by all points of a photo.</p>' if plain else ""
    return _table(heads, cells, "parameters") + note


def _plain_sigma(row: ParameterRow) -> str:
    if row.sigma_plain is None or row.frozen:
        return ""
    return format_value(0.0, row.sigma_plain, row.unit).split("±", 1)[-1].replace(")e", "e").strip()


def _truth(row: ParameterRow) -> str:
    return "" if row.truth is None else format_value(row.truth, None, row.unit)


def _miss(row: ParameterRow) -> str:
    """Distance from the truth, in sigmas where there is one: 68 % should lie below 1, 95 % below 2."""
    if row.truth is None:
        return ""
    if row.frozen or not row.sigma:
        return format_value(row.value - row.truth, None, row.unit)
    return f"{format_number(abs(row.value - row.truth) / row.sigma, 1)} sigma"


def _lens_range(camera: CameraReport) -> str:
    if camera.valid_radius_px is None:
        return ""
    return (
        '<p class="soft">The lens model can be inverted up to '
        f"{format_number(camera.valid_radius_px, 0)} px from the principal point.</p>"
    )


def _weaknesses(warnings: Sequence[Weakness], notes: Sequence[str]) -> str:
    items = [
        f'<li class="{w.severity}"><span class="tag">{w.severity}</span> {_e(w.sentence)}'
        f'<br><span class="next">{_e(w.next_step)}</span></li>'
        for w in warnings
    ]
    items += [f'<li class="note"><span class="tag">note</span> {_e(note)}</li>' for note in notes]
    return '<ul class="weaknesses">\n' + "\n".join(items) + "\n</ul>"


def _figures(pictures: Sequence[Picture]) -> str:
    return '<div class="figures">\n' + "\n".join(_figure(p) for p in pictures) + "\n</div>"


def _figure(picture: Picture) -> str:
    data = base64.b64encode(picture.data).decode()
    attribute = ' class="wide"' if picture.wide else ""
    return (
        f"<figure{attribute}><h3>{_e(picture.title)}</h3>"
        f'<img alt="{_e(picture.title)}. {_e(picture.caption)}" '
        f'src="data:{picture.media_type};base64,{data}">'
        f"<figcaption>{_e(picture.caption)}</figcaption></figure>"
    )


def _views(report: CalibrationReport) -> str:
    several = len(report.cameras) > 1
    length = "distance" if report.unit == "1" else f"distance [{report.unit}]"
    heads = ["photo", *(["camera"] if several else []), "#points", "#RMS [px]", "#tilt [°]", f"#{length}"]
    return _table(heads, [_view_cells(report, v, several) for v in report.views])


def _view_cells(report: CalibrationReport, view: ViewReport, several: bool) -> tuple[str, ...]:
    numbers = (
        str(len(view.uv)),
        format_number(view.rms_px, 3),
        format_number(view.tilt_deg, 1),
        format_number(view.depth, 1) if report.unit != "1" else format_number(view.depth, 3),
    )
    camera = [f"<td>{_e(report.cameras[view.camera].name)}</td>"] if several else []
    return (_name(view.name), *camera, *(f'<td class="number">{_e(n)}</td>' for n in numbers))


def _name(name: str) -> str:
    return f'<td class="name">{_e(name)}</td>'


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]], css_class: str = "") -> str:
    """A table of ready cells; a head that starts with # is a column of numbers."""
    columns = "".join(
        f'<th class="number" scope="col">{_e(h[1:])}</th>' if h[:1] == "#" else f'<th scope="col">{_e(h)}</th>'
        for h in heads
    )
    body = "\n".join(f"<tr>{''.join(cells)}</tr>" for cells in rows)
    head = f"<thead><tr>{columns}</tr></thead>\n" if heads else ""
    attribute = f' class="{css_class}"' if css_class else ""
    return f'<div class="scroll"><table{attribute}>{head}<tbody>\n{body}\n</tbody></table></div>'


def _provenance(report: CalibrationReport) -> str:
    rows = [("<td>command</td>", f"<td><code>{_e(report.command)}</code></td>")]
    rows += [(f"<td>{_e(k)}</td>", f"<td><code>{_e(v)}</code></td>") for k, v in report.provenance.items()]
    if report.iterations:
        first, last = (format_value(report.iterations[i]) for i in (0, -1))
        steps = count(len(report.iterations) - 1, "step")
        rows.append(("<td>solver</td>", f"<td>{steps}, cost from {_e(first)} to {_e(last)}</td>"))
    return _table([], rows)


def card_html(report: CalibrationReport) -> str:
    """A small card for `_repr_html_` in a notebook; readable on light and dark backgrounds.

    Args:
        report: a finished or failed calibration.

    Returns:
        An HTML fragment with its own inline style.
    """
    colour = {"good": "#009E73", "care": "#E69F00", "bad": "#D55E00"}[_CLASS[verdict(report)]]
    lines = "".join(_card_line(c, pair) for c in report.cameras for pair in _pairs(c.parameters))
    return (
        f'<div style="border-left:4px solid {colour};padding:.3em 1em;margin:.4em 0;max-width:46em">'
        f"<div><b>{_e(report.title)}</b>: RMS {format_number(report.rms_px, 3)} px, {len(report.views)} "
        "photos</div>"
        f"<div>{_e(verdict_sentence(report))}</div><table>{lines}</table></div>"
    )


def _card_line(camera: CameraReport, rows: Sequence[ParameterRow]) -> str:
    gap = ' style="padding-right:1.5em"'
    cells = "".join(f"<td>{_e(p.name)}</td><td{gap}>{_e(parameter_text(p))}</td>" for p in rows)
    return f"<tr><td{gap}>{_e(camera.name)}</td>{cells}</tr>"


def _pairs(rows: Sequence[ParameterRow]) -> Iterable[Sequence[ParameterRow]]:
    free = [row for row in rows if not row.frozen]
    return (free[i : i + 2] for i in range(0, len(free), 2))
