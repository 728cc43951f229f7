"""The page in a browser, by its pixels."""

import numpy as np
import pytest
from browser_support import open_page

from jaxmocap.viewer import Axis, CameraView, Markers, Skeleton, ViewerScene, scene_page, viewer_parts

HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"
NAN = np.nan


def scene() -> ViewerScene:
    """A red and a green marker 100 apart, a bone, a camera, an axis; the green one is not seen in the last frame."""
    p = np.tile(np.array([[-50.0, 80, 0], [50, 80, 0]]), (3, 1, 1))
    p[1] += [0, 30, 0]
    p[2, 1] = NAN
    joints = np.tile(np.array([[0.0, 0, 0], [0, 80, 0]]), (3, 1, 1))
    corners = np.array([[-0.4, 0.3, -1], [0.4, 0.3, -1], [0.4, -0.3, -1], [-0.4, -0.3, -1]])
    return ViewerScene(
        HOSTILE,
        unit="mm",
        markers=Markers((HOSTILE, "green"), p, np.full(p.shape, 0.5), ((1.0, 0, 0), (0, 0.8, 0))),
        skeleton=Skeleton(("root", "top"), (-1, 0), joints),
        cameras=(CameraView("cam1", np.array([0.0, 80, 400]), corners),),
        axis=Axis(np.zeros(3), np.array([0.0, 1, 0])),
        fps=25.0,
    )


@pytest.fixture(scope="module")
def opened(browser, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "a page.html"
    path.write_text(scene_page(scene()), encoding="utf-8")
    found = open_page(browser, path)
    yield found
    found.page.close()


@pytest.fixture(autouse=True)
def from_the_start(opened):
    opened.page.query_selector("input[type=range]").fill("0")
    opened.page.evaluate("document.activeElement && document.activeElement.blur()")
    opened.page.keyboard.press("r")


def only(opened, *names: str) -> None:
    """Show these parts and no others."""
    for label in opened.page.query_selector_all(".about label:has(input)"):
        label.query_selector("input").set_checked(label.inner_text().strip() in names)
    if opened.page.query_selector("select"):
        opened.page.select_option("select", "0")
    opened.page.evaluate("document.activeElement.blur()")


def where(picture: np.ndarray, channel: int) -> np.ndarray:
    """Centre (u, v) of what is clearly red (0) or green (1), outside the panels."""
    others = [c for c in range(3) if c != channel]
    strong = (picture[..., channel] > 90) & (picture[..., channel] > 2 * picture[..., others].max(axis=2))
    rows, columns = np.nonzero(strong)
    return np.array([columns.mean(), rows.mean(), len(rows)]) if len(rows) else np.full(3, NAN)


def test_markers_are_drawn_where_they_are(opened):
    only(opened, "markers")
    picture = opened.picture()
    red, green = where(picture, 0), where(picture, 1)
    assert min(red[2], green[2]) > 40  # pixels
    assert red[0] < green[0] and abs(red[1] - green[1]) < 40  # x to the right, both at one height


def test_arrow_keys_turn_the_picture_and_r_brings_it_back(opened):
    only(opened, "markers", "skeleton")
    before = opened.picture()
    for _ in range(6):
        opened.page.keyboard.press("ArrowRight")
    turned = opened.picture()
    assert (np.abs(turned - before).max(axis=2) > 30).sum() > 200
    for _ in range(6):
        opened.page.keyboard.press("ArrowUp")
    assert (np.abs(opened.picture() - turned).max(axis=2) > 30).sum() > 200
    opened.page.keyboard.press("r")
    np.testing.assert_array_equal(opened.picture(), before)


def test_arrow_keys_still_turn_after_a_box_was_ticked(opened):
    only(opened, "markers")
    opened.page.click("text=grid")
    before = opened.picture()
    for _ in range(6):
        opened.page.keyboard.press("ArrowLeft")
    assert (np.abs(opened.picture() - before).max(axis=2) > 30).sum() > 100


def test_the_mouse_turns_and_the_wheel_zooms(opened):
    only(opened, "markers")
    before = where(opened.picture(), 0)
    opened.page.mouse.move(420, 420)
    opened.page.mouse.down()
    opened.page.mouse.move(520, 420, steps=4)
    opened.page.mouse.up()
    assert opened.until(lambda: abs(where(opened.picture(), 0)[0] - before[0]) > 5)
    size = where(opened.picture(), 0)[2]
    opened.page.mouse.wheel(0, 600)
    assert opened.until(lambda: where(opened.picture(), 0)[2] < 0.8 * size)


@pytest.mark.parametrize("part", ["skeleton", "cameras", "axis", "grid"])
def test_each_part_draws_something(opened, part):
    only(opened)
    empty = opened.picture()
    only(opened, part)
    assert (np.abs(opened.picture() - empty).max(axis=2) > 8).sum() > 60


def test_frames_move_and_what_is_not_seen_is_not_there(opened):
    only(opened, "markers")
    first = opened.picture()
    slider = opened.page.query_selector("input[type=range]")
    slider.fill("1")
    second = opened.picture()
    assert where(second, 0)[1] < where(first, 0)[1] - 10  # higher up in the picture
    slider.fill("2")
    assert np.isfinite(where(opened.picture(), 0)).all() and np.isnan(where(opened.picture(), 1)).any()
    assert opened.page.inner_text("output") == "frame 2 · 0.080 s"
    opened.page.click(".numbers summary")
    row = opened.page.inner_text(".jaxmocap-viewer table tr:has-text('green')").split()
    assert row == ["green", *["not", "seen"] * 3]
    slider.fill("0")
    assert "50.0 ± 0.5" in opened.page.inner_text(".jaxmocap-viewer table tr:has-text('green')")
    opened.page.click(".numbers summary")


def test_play_goes_on_and_pauses(opened):
    opened.page.click("text=Play")
    try:
        assert opened.until(lambda: opened.page.inner_text("output").startswith("frame 1"))
    finally:
        opened.page.click("text=Pause")
    shown = opened.page.inner_text("output")
    opened.page.wait_for_timeout(200)
    assert opened.page.inner_text("output") == shown


def test_names_are_text(opened):
    only(opened, "markers", "names")
    opened.settle()
    assert opened.page.inner_text("h1") == HOSTILE
    visible = opened.page.eval_on_selector_all(
        ".labels span", "spans => spans.filter(s => s.style.visibility === 'visible').map(s => s.textContent)"
    )
    assert visible == [HOSTILE, "green"]
    assert opened.page.query_selector("img") is None


def test_nothing_was_asked_for_and_nothing_complained(opened):
    opened.settle()
    assert opened.complaints == []
    assert len(opened.requests) == 1 and opened.requests[0].startswith("file:")


def test_scenes_with_nothing_in_them_open_side_by_side(browser, tmp_path):
    scenes = [
        ViewerScene("nothing"),
        ViewerScene("no frame seen", markers=Markers(("a",), np.full((2, 1, 3), NAN))),
        ViewerScene("one point", markers=Markers(("a",), np.ones((1, 1, 3)))),
        ViewerScene("axis alone", axis=Axis(np.zeros(3), np.array([0.0, 1, 0]))),
        ViewerScene("no joints", skeleton=Skeleton((), (), np.zeros((1, 0, 3)))),
    ]
    parts = [viewer_parts(what) for what in scenes]
    scripts = "".join(f"<script>{text}</script>" for text in parts[0].scripts)
    path = tmp_path / "page.html"
    path.write_text(
        f'<meta charset="utf-8"><meta http-equiv="Content-Security-Policy" content="{parts[0].policy()}">'
        f"<style>{parts[0].style}</style>{''.join(part.body for part in parts)}{scripts}",
        encoding="utf-8",
    )
    opened = open_page(browser, path)
    assert opened.until(lambda: len(opened.page.query_selector_all("[data-drawn]")) == 5)
    assert opened.complaints == []
    opened.page.close()


def test_without_webgl_the_page_says_so_and_shows_the_numbers(launch, tmp_path):
    path = tmp_path / "page.html"
    path.write_text(scene_page(scene()), encoding="utf-8")
    opened = open_page(launch("--disable-gpu", "--disable-3d-apis"), path)
    assert "no WebGL" in opened.page.inner_text(".problem")
    assert "50.0 ± 0.5" in opened.page.inner_text(".numbers table")
    assert [c for c in opened.complaints if "WebGL" not in c] == []
