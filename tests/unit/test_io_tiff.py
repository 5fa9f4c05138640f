"""TIFF whose bytes are laid out by `rasters.tiff`: what is read is what was laid out."""

import struct
import sys

import numpy as np
import pytest
from rasters import tiff

from mexpress.io.tiff import read_tiff

RANDOM = np.random.default_rng(0)
HIGH, WIDE = 37, 52
UNPACKED, LZW, DEFLATE, OLD_DEFLATE, PACK_BITS = 1, 5, 8, 32946, 32773
TYPES = ["u1", "u2", "u4", "u8", "i1", "i2", "i4", "i8", "f2", "f4", "f8"]


def samples(dtype, channels=1):
    """Any bits at all of whole numbers, floats of all sizes, and repetitions, which LZW is made for."""
    shape = (HIGH, WIDE) if channels == 1 else (HIGH, WIDE, channels)
    dtype = np.dtype(dtype)
    if dtype.kind == "f":
        array = (RANDOM.normal(size=shape) * 10.0 ** RANDOM.integers(-4, 4, shape)).astype(dtype)
        array[0, :3] = [np.nan, -np.inf, -0.0] if channels == 1 else np.nan
    else:
        array = np.frombuffer(RANDOM.bytes(dtype.itemsize * int(np.prod(shape))), dtype).reshape(shape).copy()
    array[5:20] = array[5]
    return array


def same(found, array):
    assert found.dtype == array.dtype
    np.testing.assert_array_equal(
        found.view(f"u{array.dtype.itemsize}"), array.view(f"u{array.dtype.itemsize}")
    )


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("compression", [UNPACKED, LZW, DEFLATE, OLD_DEFLATE, PACK_BITS])
@pytest.mark.parametrize("dtype", TYPES)
def test_every_type_and_packing(dtype, compression, order):
    array = samples(dtype)
    for predictor in (1, 2, 3) if compression in (LZW, DEFLATE) else (1,):
        if predictor < 3 or array.dtype.kind == "f":
            raster = read_tiff(tiff(array, order, compression, predictor, rows=8))
            same(raster.pixels, array)
            assert (raster.no_data, raster.georeferenced) == ((), False)


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("planar", [1, 2])
@pytest.mark.parametrize("blocks", [{}, {"rows": 10}, {"rows": 1}, {"tile": (16, 32)}, {"tile": (64, 64)}])
@pytest.mark.parametrize(("channels", "dtype"), [(1, "u2"), (2, "f4"), (3, "u1"), (4, "i2")])
def test_every_layout(channels, dtype, blocks, planar, big):
    array = samples(dtype, channels)
    for order, compression, predictor in [("<", 1, 1), (">", 1, 1), (">", LZW, 2), ("<", DEFLATE, 2)]:
        same(
            read_tiff(tiff(array, order, compression, predictor, planar=planar, big=big, **blocks)).pixels,
            array,
        )


def test_floats_differenced_with_channels():
    for channels in (1, 2, 3):
        array = samples("f8", channels)
        for order in "<>":
            same(read_tiff(tiff(array, order, LZW, 3, tile=(16, 16))).pixels, array)


def test_gray_that_counts_from_white_is_not_turned_round():
    for dtype in ("u1", "u2"):
        array = samples(dtype)
        same(read_tiff(tiff(array, photometric=0)).pixels, array)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        (b"-9999\0", (-9999.0,)),
        (b"-3.40282346638529011e+38 \0", (-3.40282346638529011e38,)),
        (b"0\0\0", (0.0,)),
        (b"\0", ()),
    ],
)
@pytest.mark.parametrize("big", [False, True])
def test_what_means_no_data(text, values, big):
    assert read_tiff(tiff(samples("f4"), big=big, tags=[(42113, 2, text)])).no_data == values
    nan = read_tiff(tiff(samples("f4"), tags=[(42113, 2, b"nan\0")])).no_data
    np.testing.assert_array_equal(nan, [np.nan])


def metadata(*items):
    """GDAL's metadata of such items."""
    lines = "".join(f"  <Item {head}>{text}</Item>\n" for head, text in items)
    return (42112, 2, f"<GDALMetadata>\n{lines}</GDALMetadata>\n\0".encode())


@pytest.mark.parametrize(
    ("items", "scaling"),
    [
        ([('name="SCALE" sample="0" role="scale"', "0.1")], (0.1, 0.0)),
        ([('name="OFFSET" sample="0" role="offset"', "-273.15")], (1.0, -273.15)),
        (
            [
                ('name="OFFSET" sample="0" role="offset"', "1e3"),
                ('name="SCALE" sample="0" role="scale"', "0.0010000000474974513"),
                ('name="UNITTYPE" sample="0" role="unittype"', "m &amp; more"),
            ],
            (0.0010000000474974513, 1000.0),
        ),
        ([("name='SCALE' role='scale'  sample = '0'", " 2 ")], (2.0, 0.0)),
        ([('name="SCALE" sample="1" role="scale"', "0.1")], (1.0, 0.0)),
        ([('name="SCALE"', "0.1"), ('name="who" sample="0"', "0.1")], (1.0, 0.0)),
        ([], (1.0, 0.0)),
    ],
)
@pytest.mark.parametrize("big", [False, True])
def test_the_scale_and_the_offset_of_gdal(items, scaling, big):
    array = samples("u2")
    raster = read_tiff(tiff(array, big=big, tags=[metadata(*items)]))
    assert raster.scaling == scaling
    same(raster.pixels, array)


@pytest.mark.parametrize(
    ("role", "text", "says"),
    [
        ("scale", "ten", r"its tag 42112 \(scale\) is 'ten', no number"),
        ("offset", "", r"its tag 42112 \(offset\) is '', no number"),
        ("scale", "0", r"its tag 42112 has a scale of 0 and an offset of 0"),
        ("scale", "nan", r"its tag 42112 has a scale of nan"),
        ("offset", "inf", r"its tag 42112 has a scale of 1 and an offset of inf"),
    ],
)
def test_scales_that_are_none(role, text, says):
    with pytest.raises(ValueError, match=f"^{says}"):
        read_tiff(tiff(samples("u2"), tags=[metadata((f'sample="0" role="{role}"', text))]))


@pytest.mark.parametrize("orientation", range(10))
def test_how_it_is_to_be_seen(orientation):
    raster = read_tiff(tiff(samples("u2"), tags=[(274, 3, [orientation])]))
    assert raster.orientation == (orientation if 1 <= orientation <= 8 else 1)


@pytest.mark.parametrize(
    "tag", [(33550, 12, [30.0, 30.0, 0.0]), (34264, 12, [1.0] * 16), (34735, 3, [1, 1, 0, 0])]
)
def test_a_place_on_earth(tag):
    raster = read_tiff(tiff(samples("u2"), tags=[tag]))
    assert (raster.georeferenced, raster.no_data) == (True, ())


def test_blocks_that_are_not_there_have_no_data():
    content = tiff(samples("i2"), rows=HIGH, tags=[(273, 4, [0]), (279, 4, [0]), (42113, 2, b"-32768\0")])
    assert (read_tiff(content).pixels == -32768).all()
    assert (read_tiff(tiff(samples("i2"), tags=[(273, 4, [0]), (279, 4, [0])])).pixels == 0).all()


def two_pages(first, kind):
    """A TIFF with a second directory, a copy of the first but for its kind."""
    content = tiff(first, tags=[(254, 4, [0])])
    (at,) = struct.unpack_from("<I", content, 4)
    (entries,) = struct.unpack_from("<H", content, at)
    stop = at + 2 + 12 * entries
    directory = bytearray(content[at:stop] + bytes(4))
    assert struct.unpack_from("<HHI", directory, 2) == (254, 4, 1)
    struct.pack_into("<I", directory, 10, kind)
    return content[:stop] + struct.pack("<I", len(content)) + content[stop + 4 :] + bytes(directory)


def test_smaller_copies_and_masks_do_not_count():
    array = samples("u2")
    for kind in (1, 4, 5):
        same(read_tiff(two_pages(array, kind)).pixels, array)
    with pytest.raises(ValueError, match=r"^it has 2 images$"):
        read_tiff(two_pages(array, 0))


@pytest.mark.parametrize(
    "tags",
    [
        [(258, 3, [12])],
        [(258, 3, [1])],
        [(259, 3, [7])],
        [(262, 3, [3])],
        [(262, 3, [5])],
        [(266, 3, [2])],
        [(339, 3, [3])],
        [(339, 3, [6])],
    ],
)
def test_samples_that_are_not_plain(tags):
    assert read_tiff(tiff(samples("u1"), tags=tags)) is None


@pytest.mark.parametrize(
    ("tags", "says"),
    [
        ([(256, 4, [0])], "it has 0 x 37 pixels"),
        ([(256, 4, [2**32 - 1])], "ends early"),
        ([(257, 4, [2**32 - 1]), (278, 4, [2**32 - 1])], "ends early"),
        ([(278, 4, [0])], "in blocks of 52 x 0"),
        ([(278, 4, [1])], "1 of 37 blocks"),
        ([(277, 3, [2]), (284, 3, [2])], "1 of 2 blocks"),
        ([(273, 4, [2**32 - 1])], "ends early"),
        ([(279, 4, [7])], "ends early"),
        ([(259, 3, [LZW])], "cannot be unpacked"),
        ([(259, 3, [DEFLATE])], "cannot be unpacked"),
        ([(42113, 2, b"many\0")], r"tag 42113 \(no data\) is 'many', no number"),
        ([(256, 2, b"ab\0")], "it has 0 x 37 pixels"),
        ([(256, 12, [52.0])], "it has 0 x 37 pixels"),
    ],
)
def test_what_is_refused(tags, says):
    with pytest.raises(ValueError, match=says):
        read_tiff(tiff(samples("u2"), tags=tags))


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("compression", [UNPACKED, LZW, DEFLATE, PACK_BITS])
def test_every_cut_is_refused(compression, big):
    # The directory stands behind the blocks: what is cut is in it, or beyond it.
    content = tiff(samples("u2")[:9, :9], compression=compression, rows=4, big=big)
    for size in range(4, len(content)):
        with pytest.raises(ValueError, match="ends early"):
            read_tiff(content[:size])


@pytest.mark.parametrize("compression", [LZW, DEFLATE, PACK_BITS])
def test_blocks_that_end_early_are_refused(compression):
    array = samples("u2")[:9, :9]
    whole = tiff(array, compression=compression, rows=9)
    (size,) = [
        size
        for size in range(1, 400)
        if whole == tiff(array, compression=compression, rows=9, tags=[(279, 4, [size])])
    ]
    for less in (1, size // 2, size - 8):
        with pytest.raises(ValueError, match=r"ends early|cannot be unpacked"):
            read_tiff(tiff(array, compression=compression, rows=9, tags=[(279, 4, [less])]))


def test_only_packing_by_lzw_and_packbits_needs_pillow(monkeypatch):
    monkeypatch.setitem(sys.modules, "PIL", None)
    array = samples("u2")
    for compression in (UNPACKED, DEFLATE):
        same(read_tiff(tiff(array, compression=compression)).pixels, array)
    for compression in (LZW, PACK_BITS):
        with pytest.raises(ImportError, match=r"mexpress\[image\]"):
            read_tiff(tiff(array, compression=compression))
