"""Records of a file: what is whole is read again, whatever the end of the file looks like."""

import os

import numpy as np
import pytest
from inputs import refused

from mexpress.leastsquares.finished import Finished
from mexpress.records import Records

TITLE = b"mexpress: a test\n"
KEPT = [b"one", b"2", bytes(1000)]


def opened(path):
    return Records(path, TITLE, "It must hold a test.")


@pytest.mark.parametrize(
    ("end", "left"),
    [
        (lambda whole: whole + whole[:300], 3),  # the title as a head tells of 10^18 bytes
        (lambda whole: whole + b"\xff" * 12, 3),
        (lambda whole: whole + bytes(5), 3),
        (lambda whole: whole + bytes(4096), 3),  # a head of zeros fits a record of no bytes
        (lambda whole: whole[:-1], 2),
        (lambda whole: whole[:-600] + b"\1" * 600, 2),
        (lambda whole: whole[: len(TITLE) + 14], 0),
        (lambda whole: whole[:5], 0),
        (lambda whole: b"", 0),
    ],
)
def test_what_follows_the_last_whole_record_is_cut_off(end, left, tmp_path):
    path = tmp_path / "file"
    opened(path).add(KEPT)
    path.write_bytes(end(path.read_bytes()))
    records = opened(path)
    assert list(records) == KEPT[:left]
    records.add([b"more"])
    assert list(opened(path)) == [*KEPT[:left], b"more"]


def test_the_file_of_something_else_is_refused_and_left_as_it_is(tmp_path):
    path = tmp_path / "file"
    for content in (b"x,y\n1,2\n", TITLE[:-1] + b"s\n", bytes(100)):
        path.write_bytes(content)
        text = refused(lambda: opened(path), "resume")
        assert "It must hold a test" in text
        assert path.read_bytes() == content


@pytest.mark.skipif(os.name != "posix", reason="limits of files are those of POSIX")
def test_what_the_disk_has_no_room_for_is_an_error(tmp_path):
    import resource  # noqa: PLC0415 - of POSIX

    records = opened(tmp_path / "file")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (500, hard))
    try:
        with pytest.raises(OSError, match="too large"):
            records.add([bytes(1000)])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert list(opened(tmp_path / "file")) == []


def test_a_part_whose_numbers_did_not_get_to_the_disk_is_not_finished(tmp_path):
    path = tmp_path / "parts"
    finished = Finished(path, "key")
    finished.add(3, np.arange(200.0), np.zeros(0, int))
    finished.add(5, np.arange(300.0), np.array([7]))
    whole = path.read_bytes()
    path.write_bytes(whole[:-1600] + bytes(1400) + whole[-200:])  # a page that was lost with the power
    ((number, (numbers, none)),) = Finished(path, "key").read()
    assert number == 3
    np.testing.assert_array_equal(numbers, np.arange(200.0))
    assert none.dtype == int
    assert none.size == 0
