"""A drawn session: the same layout as rendered_puppet's truth, which describes the drawn pictures."""

import io
import time

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import puppet_truth
import pytest
from PIL import Image

from jaxmocap.bodies.puppet import MARKERS
from jaxmocap.cameras import BrownDistortion, Camera, Intrinsics, project
from jaxmocap.geometry import Pose
from jaxmocap.synthetic.puppet import Studio, puppet_photo
from jaxmocap.synthetic.puppet_camera import Build, PuppetCamera
from jaxmocap.synthetic.puppet_figure import POSES, pose_figure, random_pose
from jaxmocap.synthetic.puppet_render import WARM_LIGHT, Look
from jaxmocap.synthetic.puppet_set import Session, puppet_set

FOUR = tuple(float(a) for a in np.deg2rad([0, 60, 180, 300]))
BUILD = Build(tilt=np.deg2rad(1.0), tilt_towards=1.0, turned=np.deg2rad(-1.0))


@pytest.fixture(scope="module")
def session() -> Session:
    poses = {"wave": POSES["wave"], "stride": POSES["stride"]}
    return Session(Studio(build=BUILD), poses, angles=FOUR, step_error=np.deg2rad(0.5), chessboards=2)


@pytest.fixture(scope="module")
def drawn(session):
    return puppet_set(session, seed=3)


seen_by = jax.jit(jax.vmap(lambda camera, p: project(camera, p)[0], in_axes=(None, 0)))


def keys(record: object) -> object:
    """The layout of a record: keys of dictionaries, first entry of lists, kinds of leaves."""
    if isinstance(record, dict):
        return {k: keys(v) for k, v in record.items()}
    if isinstance(record, list):
        return [keys(record[0])] if record else []
    return {bool: "bool", int: "number", float: "number", str: "text", type(None): "nothing"}[type(record)]


def holds(mine: object, theirs: object, where: str = "") -> list[str]:
    """What their layout has and mine lacks."""
    if isinstance(theirs, dict):
        missing = [f"{where}.{k}" for k in theirs if k not in mine]
        return missing + [m for k in theirs if k in mine for m in holds(mine[k], theirs[k], f"{where}.{k}")]
    if isinstance(theirs, list):
        return holds(mine[0], theirs[0], where + "[]")
    return [] if mine == theirs else [f"{where}: {mine} instead of {theirs}"]


def test_layout_is_that_of_rendered_puppet(drawn, data_dir):
    theirs = puppet_truth.read_truth(data_dir / "rendered_puppet")
    for prose in ("conventions", "set", "units"):
        theirs.pop(prose)
    theirs["beads"].pop("tpose_measured_hsb")  # the drawn set has no T-pose
    for key in ("chessboard", "turntable_chessboard"):
        theirs[key].pop("board_frame")
    theirs["poses"] = {"wave": theirs["poses"]["wave"]}
    for angles in ("torso_side_forward_deg", "head_side_forward_deg"):
        theirs["poses"]["wave"].pop(angles)
    assert holds(keys(drawn.truth), keys(theirs)) == []


def test_the_record_agrees_with_the_library_and_with_itself(session, drawn):
    lens = PuppetCamera()
    for pose in ("wave", "stride"):
        take = puppet_truth.take_truth(drawn.truth, pose)
        figure = pose_figure(POSES[pose])
        np.testing.assert_allclose(take.beads_world, figure.beads, atol=1e-9)
        for T, uv in zip(take.T_camera_world, take.uv):
            rotvec = cv2.Rodrigues(T[:3, :3])[0][:, 0]
            K = Intrinsics(*(jnp.asarray(float(x)) for x in (lens.fx, lens.fy, lens.cx, lens.cy, 0.0)))
            d = BrownDistortion.from_vector(jnp.asarray(lens.distortions()))
            camera = Camera(K, d, Pose(jnp.asarray(rotvec), jnp.asarray(T[:3, 3])), (lens.width, lens.height))
            found = seen_by(camera, jnp.asarray(figure.beads))
            np.testing.assert_allclose(uv, found, atol=1e-5)
        error = np.rad2deg(take.actual - take.nominal)
        assert error[0] == 0.0 and 0.0 < np.abs(error[1:]).min() and np.abs(error).max() <= 0.5
    waved, strode = (puppet_truth.take_truth(drawn.truth, pose).actual for pose in ("wave", "stride"))
    assert not np.allclose(waved, strode), "each take is turned by hand anew"


def test_radius_and_occlusion_are_those_of_rendered_puppet(data_dir):
    """The figure drawn here stands as theirs in the T-pose; bodies differ, so only beads with nothing before them."""
    truth = puppet_truth.read_truth(data_dir / "rendered_puppet")
    take = puppet_truth.take_truth(truth, "tpose")
    photo = puppet_photo(Studio(), pose_figure({}), 0.0)
    for i, name in enumerate(take.names):
        np.testing.assert_allclose(photo.beads[name]["centre_px"], take.uv[0, i], atol=0.1)
        assert photo.beads[name]["radius_px"] == pytest.approx(take.radius[0, i], abs=2e-3)
        assert photo.beads[name]["visible_fraction"] >= 0.97 and take.visible_fraction[0, i] >= 0.97


def test_visible_fraction_is_the_area_that_is_seen():
    """Colours of one bead at a time in a picture without noise: its lit area against rays, over a random pose."""
    figure = pose_figure(random_pose(np.random.default_rng(0)))
    look = Look(lamp=(0.0, 0.0, 0.0), highlight=0.0, noise=0.0, blur=0.0, vignetting=0.0, jpeg_quality=0)
    compared = 0
    for k, angle in enumerate((0.4, 2.0)):
        truth = puppet_photo(Studio(look=look), figure, angle).beads
        for i in range(k, len(MARKERS), 4):
            hsb = np.tile([0.0, 0.0, 0.05], (len(MARKERS), 1))
            hsb[i] = [0.0, 1.0, 1.0]
            rgb = puppet_photo(Studio(look=look, hsb=hsb), figure, angle).rgb.astype(int)
            # Only this bead is red; a pixel counts as far as it is covered, roughly: half of the rim is too dark.
            area = (rgb[..., 0] - rgb[..., 1] > 60).sum() / (np.pi * truth[MARKERS[i]]["radius_px"] ** 2)
            assert area == pytest.approx(truth[MARKERS[i]]["visible_fraction"], abs=0.12), (MARKERS[i], angle)
            compared += 1
    assert compared == 8


def test_board_corners_are_where_the_truth_says(drawn):
    for photo in drawn.truth["chessboard"]["photos"] + drawn.truth["turntable_chessboard"]["photos"][:2]:
        grey = np.asarray(Image.open(io.BytesIO(drawn.files[photo["file"]])).convert("L"))
        corners = np.array(photo["corners_px"], dtype=np.float32)[:, None]
        start = corners + np.float32(1.0)
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-3)
        found = cv2.cornerSubPix(grey, start, (5, 5), (-1, -1), stop)
        assert np.median(np.abs(found - corners)) < 0.07, photo["file"]
        assert photo["pattern_towards_camera"]
    facing = [photo["pattern_towards_camera"] for photo in drawn.truth["turntable_chessboard"]["photos"]]
    assert facing == [True, True, False, True]


def test_same_seed_same_bytes(session, drawn):
    small = Session(session.studio, {"wave": POSES["wave"]}, angles=FOUR[:1], chessboards=1)
    first, second, other = puppet_set(small, 5), puppet_set(small, 5), puppet_set(small, 6)
    assert first.files == second.files and first.truth == second.truth
    assert first.files.keys() == other.files.keys() and first.files != other.files


def test_options_change_what_they_name():
    figure = pose_figure(POSES["tpose"])
    plain = puppet_photo(Studio(), figure, 0.0).rgb.astype(float)
    warm = puppet_photo(Studio(look=Look(light=WARM_LIGHT)), figure, 0.0).rgb.astype(float)
    noisy = puppet_photo(Studio(look=Look(noise=4.0)), figure, 0.0).rgb.astype(float)
    specked = puppet_photo(Studio(look=Look(specks=12)), figure, 0.0)
    wall = np.s_[230:280, 60:160]
    assert warm[wall][..., 2].mean() < 0.9 * warm[wall][..., 0].mean()
    assert plain[wall][..., 2].mean() == pytest.approx(plain[wall][..., 0].mean(), rel=0.02)
    assert noisy[wall].std() > 2.0 * plain[wall].std()
    assert len(specked.specks) == 12 and (specked.rgb.max(axis=2) > 90).sum() > (plain.max(axis=2) > 90).sum() + 50


def test_a_photo_takes_a_fifth_of_a_second():
    figure = pose_figure(POSES["stride"])
    puppet_photo(Studio(), figure, 0.0)  # rays and stage are made once
    start = time.process_time()
    for k in range(3):
        puppet_photo(Studio(), figure, 0.5 * k)
    assert (time.process_time() - start) / 3 < 0.4  # 0.13 s measured; twice that and more on a busy machine
