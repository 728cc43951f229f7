"""The page stands alone, is the same for the same report, and shows names without obeying them."""

import base64
import hashlib
import re
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser

import numpy as np
import pytest

from jaxmocap.calibration.evidence import Weakness
from jaxmocap.report import (
    CalibrationReport,
    CameraReport,
    ParameterRow,
    ViewReport,
    calibration_html,
    card_html,
    summary_text,
)
from jaxmocap.report.data import RMS_DEFINITION
from jaxmocap.report.figures import camera_pictures
from jaxmocap.report.text import verdict, verdict_sentence

EVIL = "<script>alert('$x$')</script>\"&.jpg"
K = np.array([[859.0, 0.0, 337.3], [0.0, 860.2, 288.2], [0.0, 0.0, 1.0]])
LENS = np.array([-0.12, 0.03, 0.0, 0.0, 0.0])
SERIOUS = Weakness("few-views", "serious", "1 view gives 2 equations.", "Take more photos.")
WARNING = Weakness("coverage", "warning", "The board was seen in only 10 % of the image.", "Move the board.")
NOTE = Weakness("lens-term-near-zero", "note", "Not told apart from zero: k2.", "Leave it out.")


def parameters(truth=None):
    rows = [("fx", 858.72, 0.43, "px"), ("fy", 859.7, 0.44, "px"), ("k1", -0.1213, 0.0021, "1")]
    free = [ParameterRow(n, v, s, u, False, 0.8 * s, truth and v + s) for n, v, s, u in rows]
    return (*free, ParameterRow("k3", 0.0, None, "1", True))


def view(i, name=None):
    rng = np.random.default_rng(i)
    grid = np.stack(np.meshgrid(np.arange(9.0), np.arange(6.0)), -1).reshape(-1, 2)
    uv = grid * 30.0 + (40.0 + 20.0 * i, 60.0 + 15.0 * i)
    residual = rng.normal(0.0, 0.1, uv.shape)
    grey = (128 + 60 * np.sin(np.add.outer(np.arange(576), np.arange(704)) / 9.0)).astype(np.uint8)
    rms = float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))
    attitude = (10.0 + 3.0 * i, 50.0 * i, 250.0 + 9.0 * i)
    return ViewReport(name or f"photo_{i:02d}.jpg", 0, uv, residual, rms, *attitude, grey)


def camera(name="camera", **changes):
    correlation = np.array([[1.0, 0.9, -0.3], [0.9, 1.0, np.nan], [-0.3, np.nan, 1.0]])
    record = CameraReport(name, (704, 576), parameters(), K, LENS, 0.125, correlation, ("fx", "fy", "k1"), 900.0)
    return replace(record, **changes)


def report(**changes):
    record = CalibrationReport(
        "Calibration of camera", "jaxmocap calibrate chessboard *.jpg", 0.125, (camera(),),
        tuple(view(i) for i in range(6)), 324, "mm", "9x6 inner corners", warnings=(WARNING, NOTE),
        skipped=(("dark.jpg", "no board found"),), provenance={"jaxmocap": "0.1.0"}, iterations=(10.0, 1.0),
    )  # fmt: skip
    return replace(record, **changes)


class Collector(HTMLParser):
    """Checks nesting and gathers tags, links and visible text."""

    VOID = {"meta", "img", "br"}

    def __init__(self):
        super().__init__()
        self.open, self.tags, self.links, self.text = [], [], [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [v for k, v in attrs if k in ("src", "href", "action", "data", "srcset")]
        assert not [k for k, _ in attrs if k.startswith("on")]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "style" not in self.open:
            self.text.append(data)


@cache
def page_of_the_report():
    return calibration_html(report())


def parsed(page):
    collector = Collector()
    collector.feed(page)
    collector.close()
    assert not collector.open
    return collector


def test_the_page_is_whole_and_asks_for_nothing():
    page = page_of_the_report()
    found = parsed(page)
    assert found.tags.count("img") == 9 and found.tags.count("h1") == 1
    assert all(link.startswith("data:image/") for link in found.links)
    assert not re.search(r"url\(|@import|<script|<link", page)
    assert len(page) < 1_500_000


def test_the_policy_admits_the_style_by_its_hash():
    page = page_of_the_report()
    style = re.search(r"<style>(.*?)</style>", page, re.DOTALL).group(1)
    digest = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode()
    assert f"style-src &#x27;sha256-{digest}&#x27;" in page and "default-src &#x27;none&#x27;" in page
    assert " style=" not in page


def test_the_pictures_ask_for_nothing_either():
    for picture in camera_pictures(camera(), report().views, "mm"):
        assert len(picture.data) < 150_000
        if picture.media_type == "image/svg+xml":
            text = picture.data.decode()
            links = re.findall(r'(?:href|src)="([^"]*)"', text)
            assert all(link.startswith(("#", "data:")) for link in links)
            assert "<dc:date>" not in text


def test_the_same_report_gives_the_same_bytes():
    assert calibration_html(report()) == page_of_the_report()


def test_names_are_shown_and_not_obeyed():
    evil = report(
        title=EVIL, command=EVIL, board=EVIL, cameras=(camera(EVIL),), views=(view(0, EVIL), view(1, EVIL)),
        skipped=((EVIL, EVIL),), notes=(EVIL,), provenance={EVIL: EVIL}, rms_definition=EVIL,
        warnings=(Weakness("x", "serious", EVIL, EVIL),),
    )  # fmt: skip
    for page in (calibration_html(evil), card_html(evil)):
        found = parsed(page)
        assert "script" not in found.tags and "<script" not in page
        assert EVIL in "".join(found.text)


@pytest.mark.parametrize(
    ("warnings", "word"),
    [
        ((), "good"),
        ((NOTE,), "good"),
        ((NOTE, WARNING), "usable with care"),
        ((WARNING, SERIOUS), "do not use"),
    ],
)
def test_the_verdict_follows_the_gravest_warning(warnings, word):
    assert verdict(report(warnings=warnings)) == word
    assert verdict_sentence(report(warnings=warnings)).lower().startswith(word)


def test_the_verdict_quotes_the_gravest_warning_and_counts_the_others():
    sentence = verdict_sentence(report(warnings=(WARNING, SERIOUS, NOTE)))
    assert sentence == "Do not use: 1 view gives 2 equations, and 1 more."


def test_the_page_says_what_was_found():
    text = " ".join(parsed(page_of_the_report()).text)
    numbers = ("858.72 ± 0.43 px", "0.34 px", "0 (fixed)", "1 step, cost from 10 to 1")
    words = (WARNING.sentence, WARNING.next_step, RMS_DEFINITION, "no board found", "photo_05.jpg", "distance [mm]")
    assert [part for part in (*numbers, *words) if part not in text] == []


def test_the_truth_has_a_column_only_where_there_is_one():
    assert "truth" not in page_of_the_report()
    page = calibration_html(report(cameras=(camera(parameters=parameters(truth=True)),)))
    assert "truth" in page and "1.0 sigma" in page


def test_two_cameras_have_sections_of_their_own():
    views = tuple(replace(view(i), camera=i % 2) for i in range(6))
    stereo = (ParameterRow("tx", -99.8, 0.14, "mm"),)
    text = " ".join(parsed(calibration_html(report(cameras=(camera("left"), camera("right")), views=views,
                                                   stereo=stereo))).text)  # fmt: skip
    assert "Pictures of left" in text and "Pictures of right" in text and "-99.80 ± 0.14 mm" in text


def nothing():
    return report(cameras=(), views=(), rms_px=np.nan, observations=0, iterations=())


def not_finite():
    bad = replace(view(0), residual=np.full((54, 2), np.nan), rms_px=np.nan, tilt_deg=np.nan, depth=np.inf)
    rows = (
        ParameterRow("fx", np.nan, np.nan, "px"),
        ParameterRow("fy", 1.0, np.inf, "px", False, np.nan, np.nan),
    )
    lost = camera(K=np.full((3, 3), np.nan), parameters=rows, valid_radius_px=np.nan, rms_px=np.nan)
    return report(cameras=(lost,), views=(bad,), rms_px=np.nan, iterations=(np.nan, np.inf))


def one_view_without_photo():
    return report(views=(replace(view(0), grey=None),))


def exact():
    return report(views=(replace(view(0), residual=np.zeros((54, 2)), rms_px=0.0),), rms_px=0.0)


def one_point_each():
    return report(views=tuple(replace(view(i), uv=view(i).uv[:1], residual=view(i).residual[:1]) for i in range(3)))


def no_corners():
    return report(views=(replace(view(0), uv=np.zeros((0, 2)), residual=np.zeros((0, 2))),))


def many_views():
    return report(views=tuple(replace(view(i), name=f"a_rather_long_name_of_a_photo_{i}.jpg") for i in range(70)))


@pytest.mark.parametrize(
    "make", [nothing, not_finite, one_view_without_photo, exact, one_point_each, no_corners, many_views]
)
def test_poor_reports_are_shown_without_nan(make):
    made = make()
    text = " ".join(parsed(calibration_html(made)).text)
    for shown in (text, summary_text(made), card_html(made)):
        assert not re.search(r"\b(nan|inf)\b", shown, re.IGNORECASE)


def test_the_summary_is_aligned_and_complete():
    lines = summary_text(report(cameras=(camera(parameters=parameters(truth=True)),), notes=("a note",))).splitlines()
    assert lines[1] == f"  RMS 0.125 px ({RMS_DEFINITION}); 6 views, 324 points, 1 photo not used"
    assert "    fx  858.72 ± 0.43 px   truth 859.15" in lines
    assert len({line.index("truth") for line in lines if "truth" in line}) == 1
    assert "    k3  0 (fixed)" in lines
    assert "  ! The board was seen in only 10 % of the image." in lines and "    Move the board." in lines
    assert "  - dark.jpg: no board found" in lines and "  a note" in lines
    assert lines[-1].startswith("Usable with care: ")
    assert not any(line != line.rstrip() for line in lines)


def test_the_card_is_small_and_names_the_numbers():
    card = card_html(report())
    assert len(card) < 4000 and "858.72 ± 0.43 px" in card and "Usable with care" in card
    parsed(card)
