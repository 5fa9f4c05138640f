"""What the logger "mexpress" hears of selections."""

import logging
import subprocess
import sys

import numpy as np
import pytest

import mexpress as mx

SOURCE = np.random.default_rng(0).uniform(0, 100, (60, 2))
TARGET = SOURCE + np.sin(SOURCE / 30)
SMALL = {"image_size": (100, 50)}


def heard(caplog):
    return [(record.levelname, record.getMessage()) for record in caplog.records]


def test_a_selection_is_told_with_its_notes(caplog):
    with caplog.at_level("INFO", "mexpress"):
        selection = mx.select_warp(SOURCE, TARGET, **SMALL)
    begun, selected, *notes = heard(caplog)
    assert begun == ("INFO", "Selecting for Matches(60 matches, diagonal 111.803).")
    assert selected[0] == "INFO"
    assert selected[1].endswith(f" s: {selection!r}.")
    assert notes == [("WARNING", note) for note in selection.notes]
    assert notes
    assert {record.name for record in caplog.records} == {"mexpress"}


def test_what_is_left_out_is_told_and_the_rounds_of_the_search_are_not(caplog):
    wrong = TARGET.copy()
    wrong[7] += 20
    with caplog.at_level("INFO", "mexpress"):
        mx.select_warp(SOURCE, wrong, robust=True)
    assert len(caplog.records) == 2
    assert caplog.records[1].getMessage().endswith("; 1 left out as wrong.")


def test_surfaces_are_told(caplog):
    with caplog.at_level("INFO", "mexpress"):
        selection = mx.select_surface(SOURCE, TARGET[:, 0])
    assert repr(selection) in caplog.records[1].getMessage()


@pytest.mark.parametrize("level", ["WARNING", "ERROR"])
def test_who_does_not_listen_does_not_wait_for_notes(level, caplog):
    with caplog.at_level(level, "mexpress"):
        selection = mx.select_warp(SOURCE, TARGET, **SMALL)
    assert caplog.records == []
    assert "notes" not in vars(selection)
    assert selection.notes


def test_nothing_is_printed_by_default():
    program = """
import logging
import numpy as np
import mexpress as mx
source = np.random.default_rng(0).uniform(0, 100, (60, 2))
mx.select_warp(source, source, image_size=(100, 50))
logging.getLogger("mexpress").setLevel("INFO")
assert mx.select_warp(source, source, image_size=(100, 50)).notes
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")


def test_the_logger_has_one_handler_that_drops():
    handlers = logging.getLogger("mexpress").handlers
    assert [type(handler) for handler in handlers if isinstance(handler, logging.NullHandler)] == [
        logging.NullHandler
    ]
