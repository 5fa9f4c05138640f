"""Images come back as they were written."""

import numpy as np
import pytest
from PIL import Image

from mexpress.io.image_writing import IMAGES, is_writable, write_image

RNG = np.random.default_rng(0)
GRAY = RNG.integers(0, 256, (5, 7), dtype=np.uint8)
COLOUR = RNG.integers(0, 256, (5, 7, 3), dtype=np.uint8)


@pytest.mark.parametrize("ending", sorted(IMAGES - {".pgm"}))
def test_every_ending_holds_colours(tmp_path, ending):
    path = tmp_path / f"image{ending.upper()}"
    write_image(path, COLOUR)
    assert is_writable(path)
    with Image.open(path) as image:
        read = np.asarray(image)
    if ending in {".jpg", ".jpeg", ".webp"}:  # these lose some
        assert read.shape == COLOUR.shape
    else:
        np.testing.assert_array_equal(read, COLOUR)


@pytest.mark.parametrize(
    ("ending", "pixels"),
    [
        (".png", GRAY),
        (".pgm", GRAY),
        (".png", GRAY[:, :, None]),
        (".png", GRAY.astype(np.uint16) * 257),
        (".tif", GRAY.astype(np.float32) / 7),
        (".png", GRAY > 99),
        (".png", np.dstack([COLOUR, GRAY])),
    ],
)
def test_types_that_formats_hold_come_back(tmp_path, ending, pixels):
    write_image(tmp_path / f"image{ending}", pixels)
    with Image.open(tmp_path / f"image{ending}") as image:
        np.testing.assert_array_equal(np.asarray(image), pixels.reshape(np.asarray(image).shape))


@pytest.mark.parametrize(
    ("name", "pixels"),
    [
        ("image.csv", GRAY),
        ("image", GRAY),
        ("image.png", GRAY.astype(complex)),
        ("image.png", COLOUR.astype(np.uint16)),
        ("image.png", RNG.uniform(size=(4, 4, 5))),
        ("image.jpg", np.dstack([COLOUR, GRAY])),
        ("image.jpg", GRAY.astype(np.float32)),
    ],
)
def test_what_no_format_holds_is_refused_and_leaves_the_file(tmp_path, name, pixels):
    (tmp_path / name).write_bytes(b"older")
    with pytest.raises(ValueError, match=r"Invalid path\. It must end as a format .* Given image"):
        write_image(tmp_path / name, pixels)
    assert [file.read_bytes() for file in tmp_path.iterdir()] == [b"older"]


def test_without_pillow_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "PIL", None)
    with pytest.raises(ImportError, match=r"pip install 'mexpress\[image\]'"):
        write_image(tmp_path / "image.png", GRAY)
