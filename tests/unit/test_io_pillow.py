"""What Pillow reads, from bytes that are laid out by `rasters.png`, or by hand."""

import io
import struct
import sys

import cv2
import numpy as np
import PIL.Image
import PIL.ImageOps
import pytest
from rasters import png, tiff

from mexpress.io.images import read_image, read_raster
from mexpress.io.pillow import read_by_pillow
from mexpress.io.raster import Raster

RANDOM = np.random.default_rng(0)


@pytest.mark.parametrize("bits", [2, 4, 8, 16])
def test_gray_of_any_depth_is_not_stretched(bits):
    samples = RANDOM.integers(0, 2**bits, (7, 9)).astype(np.uint8 if bits <= 8 else np.uint16)
    found = read_by_pillow(png(samples, bits))
    assert found.dtype == samples.dtype
    np.testing.assert_array_equal(found, samples)


def test_single_bits_are_true_or_false():
    samples = RANDOM.integers(0, 2, (7, 9))
    found = read_by_pillow(png(samples, bits=1))
    assert found.dtype == bool
    np.testing.assert_array_equal(found, samples == 1)


@pytest.mark.parametrize("channels", [2, 3, 4])
def test_channels_of_eight_bits_stay_what_they_are(channels):
    samples = RANDOM.integers(0, 256, (7, 9, channels)).astype(np.uint8)
    samples[0, :, -1] = 0  # colours below full transparency are colours
    np.testing.assert_array_equal(read_by_pillow(png(samples)), samples)


@pytest.mark.parametrize("channels", [2, 3, 4])
def test_channels_of_sixteen_bits_would_be_cut(channels):
    with pytest.raises(ValueError, match="channels of 16 bits, which Pillow would cut to 8"):
        read_by_pillow(png(RANDOM.integers(0, 2**16, (7, 9, channels)).astype(np.uint16)))


@pytest.mark.parametrize("bits", [1, 2, 4, 8])
def test_a_palette_means_its_colours(bits):
    colours = RANDOM.integers(0, 256, (2**bits, 3)).astype(np.uint8)
    samples = RANDOM.integers(0, 2**bits, (7, 9)).astype(np.uint8)
    found = read_by_pillow(png(samples, bits, colour=3, palette=colours.tobytes()))
    np.testing.assert_array_equal(found, colours[samples])


def saved(image, kind, **options):
    file = io.BytesIO()
    image.save(file, kind, **options)
    return file.getvalue()


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (
            saved(PIL.Image.new("CMYK", (4, 3)), "JPEG"),
            "Pillow's mode CMYK; gray, RGB and RGBA of 8 bits can be read",
        ),
        (tiff(np.ones((3, 4), np.uint8), tags=[(262, 3, [5])]), "no image that Pillow knows"),
        (tiff(np.ones((3, 4, 4), np.uint8), photometric=5), "mode CMYK"),
        (tiff(np.ones((3, 4), np.float32)), "mode F"),
        (b"", "no image that Pillow knows"),
        (b"\x89PNG\r\n\x1a\n", "no image that Pillow knows"),
        (b"\x76\x2f\x31\x01 OpenEXR", "no image that Pillow knows"),
    ],
)
def test_what_is_refused(content, says):
    with pytest.raises(ValueError, match=says):
        read_by_pillow(content)


def test_every_cut_of_the_samples_is_refused():
    content = png(RANDOM.integers(0, 2**16, (5, 6)).astype(np.uint16))
    end = 20  # two sums that check the samples, and the chunk that says that this is the end
    for size in range(len(content) - end):
        with pytest.raises(
            ValueError, match=r"^(it is no image that Pillow knows|.*[Tt]runcated.*|.*broken.*)$"
        ):
            read_by_pillow(content[:size])


def test_a_bitmap_of_windows():
    # 2 x 2 pixels of 24 bits, from the bottom, blue first, rows of 8 bytes.
    body = bytes([1, 2, 3, 4, 5, 6, 0, 0, 7, 8, 9, 10, 11, 12, 0, 0])
    head = struct.pack("<2sIHHI", b"BM", 54 + len(body), 0, 0, 54) + struct.pack(
        "<IiiHHIIiiII", 40, 2, 2, 1, 24, 0, 16, 0, 0, 0, 0
    )
    np.testing.assert_array_equal(
        read_by_pillow(head + body), [[[9, 8, 7], [12, 11, 10]], [[3, 2, 1], [6, 5, 4]]]
    )


def test_without_pillow_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(ImportError, match=r"mexpress\[image\]"):
        read_by_pillow(png(np.ones((3, 4), np.uint8)))


@pytest.mark.parametrize("orientation", [None, *range(10)])
@pytest.mark.parametrize("kind", ["JPEG", "PNG"])
def test_photographs_are_turned_as_viewers_do(tmp_path, orientation, kind):
    colours = np.repeat(
        np.repeat(RANDOM.integers(0, 256, (2, 3, 3)).astype(np.uint8), 16, axis=0), 16, axis=1
    )
    exif = PIL.Image.Exif()
    if orientation is not None:
        exif[0x0112] = orientation
    path = tmp_path / "photo"
    path.write_bytes(saved(PIL.Image.fromarray(colours), kind, exif=exif))
    with PIL.Image.open(path) as image:
        raw, seen = np.array(image), np.array(PIL.ImageOps.exif_transpose(image))
    np.testing.assert_array_equal(read_image(path), seen)
    np.testing.assert_array_equal(read_raster(path, "cloud").pixels, raw)
    if kind == "JPEG":
        np.testing.assert_array_equal(read_image(path)[..., ::-1], cv2.imread(str(path)))


@pytest.mark.parametrize("orientation", [None, *range(1, 9)])
@pytest.mark.parametrize("packing", ["raw", "tiff_lzw", "jpeg"])
@pytest.mark.parametrize("mode", ["L", "RGB", "P"])
def test_tiffs_are_turned_once_whoever_reads_them(tmp_path, orientation, packing, mode):
    if mode == "P" and packing == "jpeg":
        packing = "raw"
    quality = {"quality": 100} if packing == "jpeg" else {}
    gray = np.repeat(np.repeat(RANDOM.integers(0, 256, (2, 3)).astype(np.uint8), 16, axis=0), 16, axis=1)
    image = PIL.Image.fromarray(gray).convert(mode)
    tags = {} if orientation is None else {0x0112: orientation}
    image.save(tmp_path / "photo.tif", compression=packing, tiffinfo=tags, **quality)
    expected = Raster(np.array(image.convert("RGB") if mode == "P" else image), orientation=orientation or 1)
    found = read_image(tmp_path / "photo.tif")
    assert found.shape == expected.upright().shape
    np.testing.assert_allclose(
        found.astype(int), expected.upright().astype(int), atol=3 if packing == "jpeg" else 0
    )


def test_damaged_exif_data_say_nothing(tmp_path):
    path = tmp_path / "photo.jpg"
    path.write_bytes(saved(PIL.Image.new("L", (3, 2)), "JPEG", exif=b"Exif\0\0MM\0*"))
    assert read_image(path).shape == (2, 3)
