"""The page as a text: nothing from outside, nothing that a name could break, numbers as given."""

import base64
import hashlib
import json
import re

import numpy as np
import pytest

from jaxmocap._errors import InputError
from jaxmocap.viewer import Axis, CameraView, Markers, Skeleton, ViewerScene, page, scene_page, viewer_parts

NAN = np.nan
HOSTILE = "</script><script>alert(1)</script><!--&amp;"


def points(frames: int = 3, **more) -> ViewerScene:
    p = np.arange(frames * 6, dtype=float).reshape(frames, 2, 3)
    return ViewerScene("t", markers=Markers(("a", "b"), p, **more))


def data_of(text: str) -> dict:
    return json.loads(re.search(r'<script type="application/json">(.*?)</script>', text, re.S)[1])


def unpacked(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), "<f4")


def test_the_policy_allows_the_scripts_inside_and_nothing_else():
    text = scene_page(points())
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', text)[1].replace("&#x27;", "'")
    assert policy.startswith("default-src 'none';") and "unsafe" not in policy and "http" not in policy
    inside = re.findall(r"<(script|style)>(.*?)</\1>", text, re.S)
    assert [kind for kind, _ in inside] == ["style", "style", "script", "script"]
    for _, content in inside:
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in policy
    assert not re.search(r"\b(src|href)=", text.split("<script>")[0])


def test_the_page_is_small_and_the_same_every_time():
    text = scene_page(points())
    assert len(text.encode()) < 1_000_000
    assert text == scene_page(points())
    assert "three.js authors" in text  # the licence asks to go along


def test_names_cannot_leave_their_place():
    p = np.zeros((1, 1, 3))
    scene = ViewerScene(
        HOSTILE,
        markers=Markers((HOSTILE,), p),
        skeleton=Skeleton((HOSTILE,), (-1,), p),
        cameras=(CameraView(HOSTILE, np.zeros(3), np.ones((4, 3))),),
        notes=(HOSTILE, "half \udc80"),
    )
    text = scene_page(scene)
    assert text.count("</script>") == text.count("<script") == 3 and "alert(1)</script>" not in text
    data = data_of(text)
    names = [data["title"], data["markers"]["names"][0], data["skeleton"]["names"][0], data["cameras"][0]["name"]]
    assert names == [HOSTILE] * 4
    assert "<title>&lt;/script&gt;" in text
    text.encode()  # what is half of a character is escaped


def test_numbers_come_through_and_empty_frames_do_not():
    scene = points(4, sigma=np.full((4, 2, 3), 0.5))
    scene.markers.p_world[1] = NAN  # nothing seen
    scene.markers.p_world[2, 0] = NAN  # one of two seen
    data = data_of(scene_page(scene))
    assert data["frames"] == [0, 2, 3] and "1 frames in which nothing was seen" in data["notes"][0]
    np.testing.assert_array_equal(unpacked(data["markers"]["p"]).reshape(3, 2, 3), scene.markers.p_world[[0, 2, 3]])
    np.testing.assert_array_equal(unpacked(data["markers"]["sigma"]), 0.5)


def test_frames_keep_the_numbers_of_their_source():
    scene = ViewerScene("t", markers=Markers(("a",), np.ones((2, 1, 3))), frame_numbers=np.array([7, 90]))
    assert data_of(scene_page(scene))["frames"] == [7, 90]


def test_a_hundred_thousand_frames_are_thinned_and_said():
    scene = ViewerScene("t", markers=Markers(("a",), np.ones((100_000, 1, 3))))
    data = data_of(scene_page(scene))
    assert len(data["frames"]) == page.MAX_FRAMES and data["frames"][1] == 5
    assert "one frame in 5" in data["notes"][0]


def test_colours_are_told_apart_or_given():
    own = data_of(scene_page(points()))["markers"]["colours"]
    assert len(set(own)) == 2 and all(re.fullmatch("#[0-9a-f]{6}", c) for c in own)
    given = data_of(scene_page(points(colours=((1, 0, 0.5), (0, 2, -1)))))["markers"]["colours"]
    assert given == ["#ff0080", "#00ff00"]


@pytest.mark.parametrize("up", ["y", "-y", "z", "-z", "x", "-x"])
def test_up_is_drawn_upwards_and_nothing_is_mirrored(up):
    R = np.reshape(data_of(scene_page(ViewerScene("t", up=up)))["rotation"], (3, 3))
    axis = np.eye(3)["xyz".index(up[-1])] * (-1 if up[0] == "-" else 1)
    np.testing.assert_array_equal(R @ axis, [0, 1, 0])
    assert np.linalg.det(R) == pytest.approx(1)


def test_a_camera_without_a_place_is_left_out_and_an_axis_kept():
    lost = CameraView("lost", np.full(3, NAN), np.ones((4, 3)))
    axis = Axis(np.array([1.0, 2, 3]), np.array([0, 1.0, 0]))
    data = data_of(scene_page(ViewerScene("t", cameras=(lost,), axis=axis)))
    assert data["cameras"] == [] and data["axis"] == {"point": [1, 2, 3], "direction": [0, 1, 0]}


def test_wrong_scenes_are_refused():
    p = np.zeros((2, 1, 3))
    for make, sentence in [
        (lambda: ViewerScene("t", up="north"), "up: expected one of"),
        (lambda: ViewerScene("t", markers=Markers(("a", "b"), p)), r"markers: expected shape \(frames, 2, 3\)"),
        (lambda: ViewerScene("t", markers=Markers(("a",), p, p[:1])), "sigma: expected"),
        (lambda: ViewerScene("t", markers=Markers(("a",), p, colours=())), "colours: expected 1"),
        (lambda: ViewerScene("t", skeleton=Skeleton(("a",), (3,), p)), "parents"),
        (lambda: ViewerScene("t", markers=Markers(("a",), p), skeleton=Skeleton(("a",), (-1,), p[:1])), "frames"),
    ]:
        with pytest.raises(InputError, match=sentence):
            make()


def test_the_parts_fit_into_another_page():
    parts = viewer_parts(points())
    assert "default-src 'none'" in parts.policy(["body {}"]) and parts.policy(["body {}"]) != parts.policy()
    selectors = [line for line in parts.style.splitlines() if "{" in line and not line.startswith((" ", "@"))]
    assert selectors and all(line.startswith(".jaxmocap-viewer") for line in selectors)
