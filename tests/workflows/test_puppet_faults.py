"""Every fault of the hand that the puppet commands are to survive: what is said, and that nothing is lost."""

import io
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from puppet_photos import STEP, folder_of, take, write_camera, write_take

from jaxmocap._errors import InputError, SolveError
from jaxmocap.bodies.puppet import DOCUMENT_COLOURS, MARKERS
from jaxmocap.io import ColoursFile, write_colours, write_many
from jaxmocap.io.puppet_folder import open_puppet_folder
from jaxmocap.synthetic.puppet_set import measured_hsb
from jaxmocap.tracking import BeadColours
from jaxmocap.workflows import stopmotion
from jaxmocap.workflows.stopmotion import add_to_puppet, contact_sheet, identify, learn_colours, new_puppet, reconstruct

ANGLES = range(0, 360, STEP)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Camera, photographs of a pose, and colours as the photographs of the T-pose show them."""
    folder = tmp_path_factory.mktemp("drawn")
    write_take(folder, "wave")
    write_camera(folder / "camera.toml")
    as_painted = measured_hsb(list(take("tpose").values()))
    painted = {name: tuple(as_painted[name]) for name in MARKERS}
    write_colours(folder / "colours.toml", ColoursFile(BeadColours.of(painted)))
    return folder


def photo(drawn: Path, angle: int) -> Path:
    return drawn / f"wave_{angle:03d}.jpg"


def as_drawn(drawn: Path) -> dict[int, Path]:
    return {angle: photo(drawn, angle) for angle in ANGLES}


@pytest.fixture()
def wave(tmp_path: Path, drawn: Path) -> Path:
    return folder_of(tmp_path / "w", drawn, as_drawn(drawn))


@pytest.fixture(scope="module")
def named(drawn: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pose that has been identified and reconstructed; only to be copied."""
    path = folder_of(tmp_path_factory.mktemp("named") / "w", drawn, as_drawn(drawn))
    for step in (identify, reconstruct):
        write_many(step(path).files)
    return path


def dark(path: Path) -> Path:
    """A photograph that shows nothing; a corner of it is not grey."""
    picture = np.full((576, 704, 3), 3, np.uint8)
    picture[0, 0] = 9, 3, 3
    Image.fromarray(picture).save(path)
    return path


def wrong_names(detections: dict[str, dict[str, list[float]]], at: dict[str, int]) -> list[tuple[str, str]]:
    """Beads that bear a name more than half a bead away from where they are."""
    truth = {name: take("wave")[angle].beads for name, angle in at.items()}
    return [
        (file, bead)
        for file in at
        for bead, uv in detections[file].items()
        if np.hypot(*np.subtract(uv, truth[file][bead]["outline_centroid_px"])) > 4.0
    ]


# Photographs


def _another_size(path: Path, drawn: Path) -> None:
    Image.open(photo(drawn, 45)).resize((640, 480)).save(path)


def _grey(path: Path, drawn: Path) -> None:
    Image.open(photo(drawn, 45)).convert("L").save(path)


def _grey_in_colour(path: Path, drawn: Path) -> None:
    Image.open(photo(drawn, 45)).convert("L").convert("RGB").save(path)


def _truncated(path: Path, drawn: Path) -> None:
    path.write_bytes(photo(drawn, 45).read_bytes()[:20000])


def _text(path: Path, drawn: Path) -> None:
    path.write_text("this is no photograph")


def _empty(path: Path, drawn: Path) -> None:
    path.write_bytes(b"")


BAD_PHOTOS = [
    (_another_size, "640x480 px, but the camera was calibrated at 704x576 px. Take the photograph with that camera"),
    (_grey, "a greyscale photo, but colour is needed.*Give the colour photo"),
    (_grey_in_colour, "a greyscale photo, but colour is needed"),
    (_truncated, "damaged or truncated.*Copy it again"),
    (_text, "not an image that can be read.*Give PNG, JPEG"),
    (_empty, "empty"),
]


@pytest.mark.parametrize("make, said", BAD_PHOTOS)
def test_a_bad_photograph_is_refused_and_nothing_added(wave: Path, drawn: Path, tmp_path: Path, make, said) -> None:
    index = (wave / "puppet.toml").read_bytes()
    shutil.copy(photo(drawn, 0), tmp_path / "good_010.jpg")
    make(tmp_path / "bad_045.png", drawn)
    with pytest.raises(InputError, match=f"bad_045.png.*{said}"):
        add_to_puppet(wave, [tmp_path / "good_010.jpg", tmp_path / "bad_045.png"])
    assert (wave / "puppet.toml").read_bytes() == index and len(list((wave / "photos").iterdir())) == len(ANGLES)


def test_a_photograph_damaged_in_the_folder_or_gone_is_named(named: Path, tmp_path: Path) -> None:
    wave = shutil.copytree(named, tmp_path / "w")
    (wave / "photos/p_045.jpg").write_bytes(b"x" * 100)
    for step in (identify, reconstruct, contact_sheet):
        with pytest.raises(InputError, match="p_045.jpg.*not an image"):
            step(wave)
    for angle in (45, 90):
        (wave / f"photos/p_{angle:03d}.jpg").unlink()
    for step in (identify, reconstruct, contact_sheet):
        with pytest.raises(InputError, match=r"gone: p_045.jpg, p_090.jpg. Put them back.*puppet add"):
            step(wave)


def test_a_lost_photograph_is_taken_again(wave: Path, drawn: Path) -> None:
    (wave / "photos/p_045.jpg").unlink()
    changed, said = add_to_puppet(wave, [photo(drawn, 45)])
    assert changed.photos[45.0] == "wave_045.jpg" and "p_045.jpg at 45 degrees was replaced" in said[0]
    assert open_puppet_folder(wave) == changed


def test_a_photograph_taken_again_replaces_with_a_warning_and_is_kept(wave: Path, drawn: Path) -> None:
    changed, said = add_to_puppet(wave, photo(drawn, 90), angle=45.0)
    assert changed.photos[45.0] == "wave_090.jpg" and len(changed.photos) == len(ANGLES)
    assert len(said) == 1 and "p_045.jpg at 45 degrees was replaced by wave_090.jpg" in said[0]
    assert (wave / "replaced/p_045.1.jpg").read_bytes() == photo(drawn, 45).read_bytes()


@pytest.mark.parametrize(
    "names, angle, said",
    [
        (["front.jpg"], None, r"front.jpg: no angle in the name. Call photos.*_<angle>.jpg"),
        (["a_030.jpg", "b_030.jpg"], None, r"a_030.jpg and b_030.jpg both stand at 30 degrees. Rename or remove one"),
        (["a_0.jpg", "b_360.jpg"], None, r"a_0.jpg and b_360.jpg both stand at"),
        (["a_030.jpg", "b_060.jpg"], 30.0, r"--angle: belongs to one photograph, 2 were given"),
        (["a_030.jpg"], np.nan, r"--angle: expected degrees, got nan"),
        (["*.png"], None, "no photo matches"),
    ],
)
def test_angles_that_cannot_be(wave: Path, drawn: Path, tmp_path: Path, names, angle, said) -> None:
    for name in names:
        if "*" not in name:
            shutil.copy(photo(drawn, 45), tmp_path / name)
    index = (wave / "puppet.toml").read_bytes()
    with pytest.raises(InputError, match=said):
        add_to_puppet(wave, [tmp_path / name for name in names], angle)
    assert (wave / "puppet.toml").read_bytes() == index


# Files a pose is made with


@pytest.mark.parametrize(
    "cameras, unit, options, said",
    [
        (2, "mm", {}, "camera.toml.*2 cameras"),
        (1, "mm", {"distance": "400"}, "--distance.*unit"),
        (1, "1", {"distance": "400mm"}, "--distance.*unit"),
        (1, "mm", {"distance": "near"}, "--distance"),
        (1, "mm", {"distance": "-4cm"}, "--distance"),
        (1, "mm", {"colours": "camera.toml"}, "camera.toml.*colours"),
        (1, "mm", {"turntable": "camera.toml"}, "camera.toml"),
        (1, "mm", {"colours": "none.toml"}, "none.toml: no such file"),
        (1, "1", {"bones": "bones.toml"}, "--bones.*unit"),
    ],
)
def test_files_that_do_not_fit_make_no_folder(tmp_path: Path, monkeypatch, cameras, unit, options, said) -> None:
    monkeypatch.chdir(tmp_path)
    write_camera(tmp_path / "camera.toml", cameras, unit)
    (tmp_path / "bones.toml").write_text('unit = "mm"\n[lengths]\nl-elbow-joint = 33.5\n')
    with pytest.raises(InputError, match=said):
        new_puppet("w", "camera.toml", **options)
    assert not (tmp_path / "w").exists()


def test_lengths_are_brought_to_the_unit_of_the_camera(tmp_path: Path) -> None:
    write_camera(tmp_path / "camera.toml", unit="cm")
    made = new_puppet(tmp_path / "w", tmp_path / "camera.toml", distance="400mm", height="0.08m")
    assert (made.unit, made.distance, made.height) == ("cm", 40.0, 8.0)


# What the photographs show


def test_nothing_to_see(tmp_path: Path, drawn: Path) -> None:
    wave = folder_of(tmp_path / "w", drawn, {a: dark(tmp_path / "dark.png") for a in (0, 45, 90)})
    with pytest.raises(SolveError, match="No bead was found in any photograph. Check that the puppet is in the"):
        identify(wave)
    (tmp_path / "tpose").mkdir()
    for angle in (0, 45, 90):
        dark(tmp_path / f"tpose/t_{angle}.png")
    with pytest.raises(SolveError, match="No bead was found"):
        learn_colours(tmp_path / "tpose", drawn / "camera.toml")


def test_no_photograph(tmp_path: Path, drawn: Path) -> None:
    new_puppet(tmp_path / "w", drawn / "camera.toml")
    for step in (identify, reconstruct, contact_sheet):
        with pytest.raises(InputError, match="holds no photograph yet. Add some with `jaxmocap puppet add`"):
            step(tmp_path / "w")


def test_one_photograph_without_beads_gets_a_red_frame(tmp_path: Path, drawn: Path) -> None:
    """And the others are used all the same."""
    wave = folder_of(tmp_path / "w", drawn, as_drawn(drawn) | {180: dark(tmp_path / "dark.png")})
    step = contact_sheet(wave)
    (said,) = [note for note in step.notes if note.startswith("p_180.png")]
    assert "no bead was found" in said and "lit" in said
    assert "8 photographs, 1 with a problem: p_180.png" in step.summary
    assert step.value.visible.sum() > 70 and not wrong_names(
        step.content["detections"], {f"p_{a:03d}.jpg": a for a in ANGLES if a != 180}
    )
    picture = np.asarray(Image.open(io.BytesIO(step.files[wave / "contact_sheet.png"])).convert("RGB")).astype(int)
    red = (picture[..., 0] > 150) & (picture[..., 1:].max(axis=2) < 80)
    assert red.sum() > 4 * 500  # one frame, several pixels wide


def test_an_angle_that_is_missing(tmp_path: Path, drawn: Path) -> None:
    photos = as_drawn(drawn)
    del photos[90]
    pose = reconstruct(folder_of(tmp_path / "w", drawn, photos)).value
    true = np.array([take("wave")[0].beads[m]["outline_centroid_px"] for m in MARKERS])
    assert pose.seen.sum() >= 15 and pose.beads.visible[0].sum() >= 12
    assert np.abs((pose.beads.uv[0] - true)[pose.beads.visible[0]]).max() < 2.0


def test_merged_beads(tmp_path: Path, drawn: Path) -> None:
    """Another bead stands half in front of one: neither may be taken for something else."""
    picture = np.asarray(Image.open(photo(drawn, 0))).copy()
    beads = take("wave")[0].beads
    disc = np.hypot(*np.mgrid[-8:9, -8:9]) < 7.0
    for stands, moved in (("leg.L1", "leg.R1"), ("leg.L2", "leg.R2")):
        (u, v), (mu, mv) = (np.rint(beads[name]["outline_centroid_px"]).astype(int) for name in (stands, moved))
        patch = picture[mv - 8 : mv + 9, mu - 8 : mu + 9].copy()
        picture[v - 8 : v + 9, u + 1 : u + 18][disc] = patch[disc]
        picture[mv - 9 : mv + 10, mu - 9 : mu + 10] = 5
    Image.fromarray(picture).save(tmp_path / "merged.png")
    wave = folder_of(tmp_path / "w", drawn, as_drawn(drawn) | {0: tmp_path / "merged.png"})
    step = reconstruct(wave)
    found = {"p_000.png": identify(wave).content["detections"]["p_000.png"]}
    assert not wrong_names(found, {"p_000.png": 0})
    assert step.value.seen.sum() >= 15  # the other photographs hold


def test_two_beads_of_one_colour_are_told(named: Path, tmp_path: Path) -> None:
    wave = shutil.copytree(named, tmp_path / "w")
    alike = {**DOCUMENT_COLOURS, "leg.R1": DOCUMENT_COLOURS["arm.L1"]}
    write_colours(wave / "colours.toml", ColoursFile(BeadColours.of(alike)))
    notes = " ".join(identify(wave).notes)
    assert "arm.L1 and leg.R1 have nearly the same colour" in notes and "Repaint" in notes


def test_a_turntable_that_did_not_turn(tmp_path: Path, drawn: Path) -> None:
    still = folder_of(tmp_path / "w", drawn, {a: photo(drawn, 0) for a in (0, 45, 90)})
    with pytest.raises(SolveError, match="The turntable did not turn: .* all photographs. Turn it by its step"):
        identify(still)
    pair = folder_of(tmp_path / "v", drawn, as_drawn(drawn) | {90: photo(drawn, 45)})
    with pytest.raises(SolveError, match="did not turn between p_045.jpg and p_090.jpg.*Take one of each pair again"):
        identify(pair)


def test_a_turntable_that_turned_the_other_way(tmp_path: Path, drawn: Path) -> None:
    backwards = {(360 - a) % 360: file for a, file in as_drawn(drawn).items()}
    with pytest.raises(SolveError, match="turned the other way.*anticlockwise seen from above.*360 minus"):
        identify(folder_of(tmp_path / "w", drawn, backwards))


def test_a_t_pose_that_was_turned_the_other_way(tmp_path: Path) -> None:
    (tmp_path / "t").mkdir()
    for angle, picture in take("tpose").items():
        (tmp_path / "t" / f"t_{(360 - angle) % 360:03d}.jpg").write_bytes(picture.file)
    with pytest.raises(SolveError, match="turned the other way"):
        learn_colours(tmp_path / "t", write_camera(tmp_path / "camera.toml"))


def test_fewer_than_two_views(tmp_path: Path, drawn: Path) -> None:
    one = folder_of(tmp_path / "w", drawn, {0: photo(drawn, 0)})
    with pytest.raises(SolveError, match=r"in 1 of 1 photographs: a place in space needs two. Add photographs at"):
        reconstruct(one)
    assert not (one / "reconstruction.json").exists()


# Results that were there before


def _no_json(content: dict) -> str:
    return json.dumps(content)[:-200]


def _other_inputs(content: dict) -> str:
    content["inputs"]["p_000.jpg"] = "0" * 64
    return json.dumps(content)


def _other_angles(content: dict) -> str:
    content["stated_deg"]["p_000.jpg"] = 5.0
    return json.dumps(content)


def _unknown_bead(content: dict) -> str:
    content["detections"]["p_000.jpg"]["arm.L9"] = [1.0, 2.0]
    return json.dumps(content)


def _not_a_number(content: dict) -> str:
    bead = next(iter(content["detections"]["p_000.jpg"]))
    content["detections"]["p_000.jpg"][bead] = [float("nan"), 2.0]
    return json.dumps(content)


def _too_large(content: dict) -> str:
    bead = next(iter(content["sigma_px"]["p_000.jpg"]))
    content["sigma_px"]["p_000.jpg"][bead] = 10**400
    return json.dumps(content)


def _a_photo_less(content: dict) -> str:
    for key in ("detections", "sigma_px", "stated_deg"):
        del content[key]["p_000.jpg"]
    return json.dumps(content)


def _list(content: dict) -> str:
    return json.dumps([content])


def _deep(content: dict) -> str:
    return "[" * 100_000


@pytest.mark.parametrize(
    "damage",
    [_no_json, _other_inputs, _other_angles, _unknown_bead, _not_a_number, _too_large, _a_photo_less, _list, _deep],
)
def test_names_that_are_damaged_or_of_other_photographs_are_found_anew(
    named: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damage
) -> None:
    wave = shutil.copytree(named, tmp_path / "w")
    content = json.loads((wave / "identified.json").read_text())
    (wave / "identified.json").write_text(damage(content))

    class Anew(Exception):
        pass

    def anew(*args: object, **options: object) -> None:
        raise Anew

    monkeypatch.setattr(stopmotion, "identify", anew)
    with pytest.raises(Anew):
        reconstruct(wave)


def test_names_are_kept_while_nothing_changes(named: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And a pose is the same, to the byte, whether its names were found now or before."""
    monkeypatch.setattr(stopmotion, "identify", None)  # not called
    again = reconstruct(named)
    monkeypatch.undo()
    assert again.files[named / "reconstruction.json"] == (named / "reconstruction.json").read_bytes()
    (named / "identified.json").unlink()
    anew = reconstruct(named)
    assert anew.files[named / "reconstruction.json"] == again.files[named / "reconstruction.json"]
    write_many(anew.files)


def test_a_photograph_that_changed_is_identified_anew(named: Path, drawn: Path, tmp_path: Path) -> None:
    wave = shutil.copytree(named, tmp_path / "w")
    add_to_puppet(wave, dark(tmp_path / "new_315.png"))
    step = reconstruct(wave)
    assert (wave / "identified.json") in step.files and not step.value.beads.visible[-1].any()
