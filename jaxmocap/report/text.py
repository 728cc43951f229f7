"""The words of a report: numbers with their sigmas, the verdict, and the summary the command line prints."""

import math
from typing import Literal

from jaxmocap.report.data import CalibrationReport, ParameterRow

Verdict = Literal["good", "usable with care", "do not use"]

# Beyond these a fixed-point number is a row of zeros; the mantissa and one exponent are read faster.
_FIXED_FROM, _FIXED_BELOW = 1e-4, 1e7
_MOST_DIGITS = 12  # of a value, however small its sigma: a float holds 15, and nobody compares more


def format_value(value: float, sigma: float | None = None, unit: str = "1") -> str:
    """A value with its standard deviation and unit: "859.12 ± 0.34 px".

    The sigma has two significant digits and the value as many decimals; without a sigma the value has six.

    Args:
        value: any number; NaN and infinity read "not determined".
        sigma: standard deviation in the same unit; None or not finite if unknown.
        unit: "1" for none.

    Returns:
        Text without NaN and without "-0.00".
    """
    tail = "" if unit in ("", "1") else f" {unit}"
    if not math.isfinite(value):
        return "not determined"
    if sigma is None:
        return _plain(value, 6) + tail
    if not math.isfinite(sigma):
        return f"{_plain(value, 6)}{tail} (sigma not determined)"
    sigma = abs(sigma)
    if sigma == 0.0:
        return f"{_plain(value, _MOST_DIGITS)} ± 0{tail}"
    size = max(abs(value), sigma)
    if _FIXED_FROM <= size < _FIXED_BELOW:
        return f"{_rounded(value, sigma)}{tail}"
    exponent = _exponent(size)
    return f"({_rounded(value / 10.0**exponent, sigma / 10.0**exponent)})e{exponent:+03d}{tail}"


def format_number(value: float | None, decimals: int = 2) -> str:
    """A number with fixed decimals; a dash where there is none."""
    return "–" if value is None or not math.isfinite(value) else f"{value + 0.0:.{decimals}f}"


def _plain(value: float, digits: int) -> str:
    return f"{value + 0.0:.{digits}g}"


def _exponent(value: float) -> int:
    """Power of ten of a positive number, after rounding to two digits (0.0996 counts as 0.10)."""
    return int(f"{value:.1e}".split("e")[1])


def _rounded(value: float, sigma: float) -> str:
    """Value and sigma with the decimals that give sigma two significant digits."""
    decimals = 1 - _exponent(sigma)
    most = _MOST_DIGITS - 1 - (_exponent(abs(value)) if value else 0)
    if decimals > most:
        return f"{round(value, most) + 0.0:.{max(most, 0)}f} ± {sigma:.1e}"
    shown = max(decimals, 0)
    return f"{round(value, decimals) + 0.0:.{shown}f} ± {round(sigma, decimals):.{shown}f}"


def verdict(report: CalibrationReport) -> Verdict:
    """What the warnings add up to."""
    severities = {w.severity for w in report.warnings}
    if "serious" in severities or not report.cameras:
        return "do not use"
    return "usable with care" if "warning" in severities else "good"


_GOOD = "Good: nothing speaks against the result."


def verdict_sentence(report: CalibrationReport) -> str:
    """The verdict in one plain sentence."""
    word = verdict(report)
    if not report.cameras:
        return "Do not use: there is no result."
    notes = sum(w.severity == "note" for w in report.warnings)
    if word == "good":
        return f"Good: nothing speaks against the result but {count(notes, 'note')}." if notes else _GOOD
    serious = [w for w in report.warnings if w.severity == "serious"]
    first = (serious or [w for w in report.warnings if w.severity == "warning"])[0]
    more = sum(w.severity != "note" for w in report.warnings) - 1
    rest = f", and {more} more" if more else ""
    return f"{word.capitalize()}: {first.sentence[0].lower() + first.sentence[1:].rstrip('.')}{rest}."


def parameter_text(row: ParameterRow) -> str:
    """Value, sigma and unit of a row, or the value and "fixed"."""
    if row.frozen:
        return f"{format_value(row.value, None, row.unit)} (fixed)"
    return format_value(row.value, row.sigma, row.unit)


def headline(report: CalibrationReport) -> str:
    """RMS with its definition, and what it was measured on."""
    counts = f"{count(len(report.views), 'view')}, {count(report.observations, 'point')}"
    if report.rejected:
        counts += f", {report.rejected} rejected"
    if report.skipped:
        counts += f", {count(len(report.skipped), 'photo')} not used"
    return f"RMS {format_number(report.rms_px, 3)} px ({report.rms_definition}); {counts}"


def count(n: int, word: str) -> str:
    """A number of things: "1 view", "2 views"."""
    return f"{n} {word}{'' if n == 1 else 's'}"


def relative_title(report: CalibrationReport) -> str:
    """What the poses in `stereo` are."""
    if len(report.cameras) == 2:
        return f"{report.cameras[1].name} relative to {report.cameras[0].name}"
    return "The other cameras relative to the first"


def summary_text(report: CalibrationReport) -> str:
    """The lines the command line prints: headline, parameters, warnings, photos not used.

    Args:
        report: a finished or failed calibration.

    Returns:
        Text that ends in a newline.
    """
    lines = [report.title, f"  {headline(report)}"]
    for camera in report.cameras:
        name = f"{camera.name}, {camera.image_size[0]} x {camera.image_size[1]} px"
        lines += ["", f"  {name}, RMS {format_number(camera.rms_px, 3)} px"]
        lines += _parameter_lines(camera.parameters)
    if report.stereo:
        lines += ["", f"  {relative_title(report)}", *_parameter_lines(report.stereo)]
    lines += ["", *(f"  {note}" for note in report.notes)] if report.notes else []
    for name, reason in report.skipped:
        lines.append(f"  - {name}: {reason}")
    for warning in report.warnings:
        mark = "-" if warning.severity == "note" else "!"
        lines += [f"  {mark} {warning.sentence}", f"    {warning.next_step}"]
    return "\n".join([*lines, verdict_sentence(report), ""])


def _parameter_lines(rows: tuple[ParameterRow, ...]) -> list[str]:
    """One line per parameter, columns aligned."""
    names = max((len(row.name) for row in rows), default=0)
    texts = [parameter_text(row) for row in rows]
    width = max((len(text) for text in texts), default=0)
    lines = []
    for row, text in zip(rows, texts):
        truth = "" if row.truth is None else f"   truth {format_value(row.truth)}"
        lines.append(f"    {row.name:<{names}}  {text:<{width}}{truth}".rstrip())
    return lines
