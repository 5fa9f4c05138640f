"""PGM, PPM and PFM whose bytes are laid out here."""

import struct

import numpy as np
import pytest

from mexpress.io.netpbm import read_netpbm

RANDOM = np.random.default_rng(0)


@pytest.mark.parametrize("top", [1, 7, 255, 256, 1023, 4095, 65535])
@pytest.mark.parametrize("channels", [1, 3])
def test_samples_are_not_stretched(top, channels):
    samples = RANDOM.integers(0, top + 1, (4, 5, channels))[:, :, slice(None) if channels == 3 else 0]
    kinds = {1: ("P2", "P5"), 3: ("P3", "P6")}[channels]
    flat = samples.ravel().tolist()
    plain = f"{kinds[0]}\n5 4\n{top}\n" + " ".join(map(str, flat))
    packed = f"{kinds[1]} 5 4 {top}\n".encode() + struct.pack(
        f">{len(flat)}{'B' if top < 256 else 'H'}", *flat
    )
    for content in (plain.encode(), packed):
        found = read_netpbm(content)
        assert found.dtype == (np.uint8 if top < 256 else np.uint16)
        np.testing.assert_array_equal(found, samples)


@pytest.mark.parametrize(("order", "scale"), [("<", "-1.0"), (">", "1"), ("<", "-0.003922"), (">", "255.5")])
@pytest.mark.parametrize("channels", [1, 3])
def test_floats_come_from_the_bottom_in_either_order_of_bytes(channels, order, scale):
    samples = RANDOM.normal(size=(4, 5, channels))[:, :, slice(None) if channels == 3 else 0].astype(
        np.float32
    )
    samples.ravel()[0] = np.inf
    rows = [struct.pack(f"{order}{row.size}f", *row.ravel().tolist()) for row in samples]
    content = f"{'PF' if channels == 3 else 'Pf'}\n5 4\n{scale}\n".encode() + b"".join(rows[::-1])
    found = read_netpbm(content)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, samples)


@pytest.mark.parametrize(
    "content",
    [
        b"P2#a comment\n2 # 7 8\n  2\t300\r\n1 2 #3\n 256 300\n",
        b"P2 2 2 300 1 2 256 300 the next image",
        b"P5\n2 2\n# made by hand\n300\n" + bytes([0, 1, 0, 2, 1, 0, 1, 44]) + b"P5 another",
        b"P5\r\n2 2\r\n300\r\n" + bytes([0, 1, 0, 2, 1, 0, 1, 44]),
    ],
)
def test_headers_that_programs_write(content):
    np.testing.assert_array_equal(read_netpbm(content), [[1, 2], [256, 300]])


def test_samples_that_look_like_space_are_samples():
    np.testing.assert_array_equal(read_netpbm(b"P5 2 1 255\n\n\r"), [[10, 13]])
    np.testing.assert_array_equal(read_netpbm(b"P5 2 1 255 #\n"), [[35, 10]])


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"P5", "header"),
        (b"P5 64 48", "header"),
        (b"P5 64 x 255\n", "header"),
        (b"P5 -1 4 255\n", "header"),
        (b"P5 0 4 255\n", "it has 0 x 4 pixels"),
        (b"P5 2 2 0\n1234", "its largest sample is 0, which is not from 1 to 65535"),
        (b"P5 2 2 65536\n12345678", "its largest sample is 65536"),
        (b"P5 2 2 many\n1234", "'many' is no number"),
        (b"P5 2 2 255\n123", "it has 3 bytes of samples, not 4"),
        (b"P5 2 2 256\n1234567", "it has 7 bytes of samples, not 8"),
        (b"P5 " + b"9" * 30 + b" 1 255\n1", "it has 1 bytes of samples, not 99"),
        (b"Pf 2 2 -1\n" + bytes(15), "it has 15 bytes of samples, not 16"),
        (b"P2 2 2 255 1 2 3", "it has 3 samples, not 4"),
        (b"P2 2 2 255 1 2 3 256", "whole numbers from 0 to 255"),
        (b"P2 2 2 255 1 2 3 -4", "whole numbers from 0 to 255"),
        (b"P2 2 2 255 1 2 3 0.5", "whole numbers from 0 to 255"),
        (b"P2 2 2 255 1 2 3 nan", "whole numbers from 0 to 255"),
        (b"P2 2 2 255 1 2 3 x", "'x' is no number"),
    ],
)
def test_what_is_refused(content, says):
    with pytest.raises(ValueError, match=says):
        read_netpbm(content)
