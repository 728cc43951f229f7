import io

import cv2
import numpy as np
import pytest
from PIL import Image

from jaxmocap._errors import InputError, JaxMocapError
from jaxmocap.vision import check_same_size, expand_photos, read_colour_photo, read_photo

RAMP = np.tile(np.arange(0, 240, 4, dtype=np.uint8), (40, 1))  # (40, 60), brighter to the right


def save(path, array, **options):
    Image.fromarray(array).save(path, **options)
    return path


def test_grey_png_is_read_exactly(tmp_path):
    photo = read_photo(save(tmp_path / "a.png", RAMP))
    np.testing.assert_array_equal(photo.grey, RAMP)
    assert (photo.name, photo.size, photo.warnings) == ("a.png", (60, 40), ())


def test_sha256_is_of_the_file(tmp_path):
    path = tmp_path / "a.pgm"
    path.write_bytes(b"P5 1 1 255\n\x07")
    # printf 'P5 1 1 255\n\007' | sha256sum
    import hashlib

    assert read_photo(path).sha256 == hashlib.sha256(b"P5 1 1 255\n\x07").hexdigest()


def test_path_with_spaces_and_unicode(tmp_path):
    folder = tmp_path / "mes photos é 写真"
    folder.mkdir()
    np.testing.assert_array_equal(read_photo(save(folder / "bild ü 1.png", RAMP)).grey, RAMP)


def test_colour_becomes_luma(tmp_path):
    colour = np.zeros((4, 4, 3), np.uint8)
    colour[..., 1] = 200  # green: 0.587 of luma (ITU-R BT.601)
    assert np.all(np.abs(read_photo(save(tmp_path / "g.png", colour)).grey - 0.587 * 200) <= 1)


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_16_bit_files_keep_their_contrast(tmp_path, bits):
    path = tmp_path / "deep.png"
    full = 2**bits - 1
    cv2.imwrite(str(path), np.array([[0, full // 2, full]], dtype=np.uint16))
    photo = read_photo(path)
    np.testing.assert_allclose(photo.grey, [[0, 127, 255]], atol=1)
    assert "16-bit" in photo.warnings[0]


def test_transparent_pixels_are_laid_over_white(tmp_path):
    pixels = np.zeros((2, 2, 4), np.uint8)
    pixels[0, :, 3] = 255  # upper row opaque black, lower row transparent black
    photo = read_photo(save(tmp_path / "alpha.png", pixels))
    np.testing.assert_array_equal(photo.grey, [[0, 0], [255, 255]])
    assert "transparent" in photo.warnings[0]


def test_opaque_alpha_needs_no_warning(tmp_path):
    pixels = np.full((2, 2, 4), 255, np.uint8)
    assert read_photo(save(tmp_path / "alpha.png", pixels)).warnings == ()


@pytest.mark.parametrize("suffix", ["jpg", "tif"])
def test_cmyk(tmp_path, suffix):
    path = tmp_path / f"print.{suffix}"
    image = Image.fromarray(np.stack([RAMP] * 3, -1)).convert("CMYK")
    image.save(path)
    photo = read_photo(path)
    assert photo.grey.shape == (40, 60)
    np.testing.assert_allclose(photo.grey, RAMP, atol=8)  # JPEG quality 75
    assert "CMYK" in photo.warnings[0]


@pytest.mark.parametrize("orientation", [3, 6, 8])
def test_exif_rotation_is_ignored_with_a_warning(tmp_path, orientation):
    path = tmp_path / "turned.jpg"
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(RAMP).save(path, exif=exif, quality=95)
    photo = read_photo(path)
    assert photo.size == (60, 40)
    np.testing.assert_allclose(photo.grey, RAMP, atol=6)  # JPEG
    assert f"orientation {orientation}" in photo.warnings[0] and "turned.jpg" in photo.warnings[0]


def noise_jpeg() -> bytes:
    """A picture that does not compress to nothing, so that cutting it cuts pixels."""
    buffer = io.BytesIO()
    noise = np.random.default_rng(0).integers(0, 255, (64, 96), dtype=np.uint8)
    Image.fromarray(noise).save(buffer, "JPEG")
    return buffer.getvalue()


def png_bytes() -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(RAMP).save(buffer, "PNG")
    return buffer.getvalue()


BROKEN = {
    "zero.png": (b"", "empty"),
    "text.png": (b"these are notes, not a photo\n" * 20, "not an image"),
    "half.jpg": (noise_jpeg()[: len(noise_jpeg()) // 2], "truncated"),
    "tail.jpg": (noise_jpeg()[: len(noise_jpeg()) * 9 // 10], "truncated"),
    "half.png": (png_bytes()[: len(png_bytes()) // 2], "truncated"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_files_are_refused_by_name(tmp_path, name):
    content, said = BROKEN[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=said) as caught:
        read_photo(tmp_path / name)
    assert name in str(caught.value)


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_photo(tmp_path / "nowhere.png")
    with pytest.raises(InputError, match="is a folder"):
        read_photo(tmp_path)


def test_decompression_bomb_is_refused(tmp_path):
    path = tmp_path / "bomb.png"
    Image.new("1", (10_000, 10_000)).save(path)
    assert path.stat().st_size < 1_000_000
    with pytest.raises(InputError, match="bomb.png: more than"):
        read_photo(path)


def test_floating_point_pixels_are_refused(tmp_path):
    path = tmp_path / "depth.tif"
    Image.fromarray(RAMP.astype(np.float32)).save(path)
    with pytest.raises(InputError, match="float32"):
        read_photo(path)


@pytest.mark.parametrize("original", [noise_jpeg(), png_bytes()], ids=["jpeg", "png"])
def test_mutated_files_never_raise_anything_else(tmp_path, original):
    rng = np.random.default_rng(1)
    path = tmp_path / "mutant.img"
    for _ in range(60):
        data = bytearray(original)
        for position in rng.integers(0, len(data), rng.integers(1, 12)):
            data[position] = rng.integers(0, 256)
        path.write_bytes(bytes(data[: rng.integers(1, len(data) + 1)] if rng.random() < 0.3 else data))
        try:
            assert read_photo(path).grey.dtype == np.uint8
        except JaxMocapError as error:
            assert "mutant.img" in str(error)


def test_photos_come_in_natural_order_once(tmp_path):
    for name in ("v10.png", "v2.png", "V1.PNG", "notes.txt", ".hidden.png"):
        save(tmp_path / name, RAMP, format="PNG")
    expected = ["V1.PNG", "v2.png", "v10.png"]
    assert [p.name for p in expand_photos([tmp_path])] == expected
    assert [p.name for p in expand_photos([str(tmp_path / "*")])] == expected
    assert [p.name for p in expand_photos([tmp_path / "v10.png", tmp_path / "v2.png"])] == ["v2.png", "v10.png"]
    again = [tmp_path / "v2.png", tmp_path / "x" / ".." / "v2.png", str(tmp_path / "v2*")]
    (tmp_path / "x").mkdir()
    assert [p.name for p in expand_photos(again)] == ["v2.png"]


def test_an_existing_name_with_brackets_is_not_a_pattern(tmp_path):
    path = save(tmp_path / "shot[1].png", RAMP)
    assert expand_photos([path]) == [path]


@pytest.mark.parametrize(
    ("entry", "said"), [("", "is empty"), ("missing", "no such file or folder"), ("*.png", "no photo matches")]
)
def test_nothing_to_read(tmp_path, entry, said):
    with pytest.raises(InputError, match=said):
        expand_photos([tmp_path / entry])


def test_no_patterns_at_all():
    with pytest.raises(InputError, match="no photos were given"):
        expand_photos([])


def test_mixed_sizes_name_the_odd_ones(tmp_path):
    photos = [read_photo(save(tmp_path / f"{i}.png", RAMP)) for i in range(3)]
    assert check_same_size(photos) == (60, 40)
    odd = read_photo(save(tmp_path / "half.png", RAMP[::2, ::2]))
    with pytest.raises(InputError, match=r"half\.png \(30x20\)") as caught:
        check_same_size([odd, *photos])
    assert "0.png" not in str(caught.value)
    turned = read_photo(save(tmp_path / "side.png", RAMP.T.copy()))
    with pytest.raises(InputError, match="turned"):
        check_same_size([*photos, turned])
    with pytest.raises(InputError, match="the camera's size"):
        check_same_size(photos, expected=(640, 480))
    with pytest.raises(InputError, match="no photos"):
        check_same_size([])


COLOURS = np.stack([RAMP, RAMP[::-1, ::-1], np.full_like(RAMP, 77)], axis=-1)


def test_colours_are_read_exactly_and_in_order(tmp_path):
    photo = read_colour_photo(save(tmp_path / "a.png", COLOURS))
    np.testing.assert_array_equal(photo.rgb, COLOURS)
    assert (photo.name, photo.size, photo.warnings) == ("a.png", (60, 40), ())


def test_colours_of_16_bit_files_keep_their_proportions(tmp_path):
    path = tmp_path / "deep.png"
    cv2.imwrite(str(path), np.array([[[0, 2048, 4095]]], dtype=np.uint16))  # blue, green, red; 12 bits
    photo = read_colour_photo(path)
    np.testing.assert_allclose(photo.rgb, [[[255, 128, 0]]], atol=1)
    assert "16-bit" in photo.warnings[0]


def test_colours_of_alpha_and_cmyk(tmp_path):
    half = np.dstack([COLOURS, np.full_like(RAMP, 0)])
    clear = read_colour_photo(save(tmp_path / "alpha.png", np.dstack([COLOURS, np.full_like(RAMP, 255)])))
    np.testing.assert_array_equal(clear.rgb, COLOURS)
    assert clear.warnings == ()
    half[:, 30:, 3] = 255
    photo = read_colour_photo(save(tmp_path / "half.png", half))
    assert (photo.rgb[:, :30] == 255).all() and "transparent" in photo.warnings[0]
    Image.fromarray(COLOURS).convert("CMYK").save(tmp_path / "print.tif")
    printed = read_colour_photo(tmp_path / "print.tif")
    np.testing.assert_allclose(printed.rgb, COLOURS, atol=2)
    assert "CMYK" in printed.warnings[0]


def test_colour_photo_on_its_side_is_not_turned(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(COLOURS).save(tmp_path / "side.jpg", exif=exif)
    photo = read_colour_photo(tmp_path / "side.jpg")
    assert photo.size == (60, 40) and "orientation 6" in photo.warnings[0]


@pytest.mark.parametrize("grey", [RAMP, np.stack([RAMP] * 3, -1)], ids=["one channel", "three equal"])
def test_colour_is_asked_for_where_there_is_none(tmp_path, grey):
    with pytest.raises(InputError, match="grey.png: a greyscale photo, but colour is needed"):
        read_colour_photo(save(tmp_path / "grey.png", grey))


@pytest.mark.parametrize("name", BROKEN)
def test_broken_colour_files_are_refused_by_name(tmp_path, name):
    content, said = BROKEN[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=said) as caught:
        read_colour_photo(tmp_path / name)
    assert name in str(caught.value)
