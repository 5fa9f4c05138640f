"""Progress in a bar of the user's own; that on the terminal is tested with the command line."""

import io
import time
from functools import partial

import numpy as np
import pytest
from inputs import refused
from tqdm import tqdm

import mexpress as mx
from mexpress.leastsquares.nested import steps

SOURCE = np.random.default_rng(0).uniform(0, 100, (60, 2))
TARGET = SOURCE + np.sin(SOURCE / 30)


class Meter:
    """A bar that keeps what it is told."""

    made: list = []  # noqa: RUF012

    def __init__(self, total, desc):
        self.total, self.desc, self.done, self.closed = total, desc, 0, 0
        self.made.append(self)

    def update(self, number):
        """Count."""
        assert self.closed == 0
        self.done += number

    def close(self):
        """Count."""
        self.closed += 1


@pytest.fixture
def meters(monkeypatch):
    monkeypatch.setattr(Meter, "made", [])
    return Meter.made


CALLS = {
    "warp": lambda show: mx.select_warp(SOURCE, TARGET, progress=show),
    "surface": lambda show: mx.select_surface(SOURCE, TARGET[:, 0], smoothing=0, max_count=9, progress=show),
    "problems": lambda show: mx.map_problems(pow, [(2, 3), (3, 3), (4, 3)], workers=1, progress=show),
}


@pytest.mark.parametrize("what", CALLS)
def test_a_bar_of_ones_own_is_told_of_every_step(what, meters, capfd):
    CALLS[what](Meter)
    (meter,) = meters
    assert meter.desc == what
    assert meter.done == meter.total > 1
    assert meter.closed == 1
    assert capfd.readouterr() == ("", "")


def test_the_steps_are_those_of_the_work(meters):
    mx.select_warp(
        SOURCE, TARGET, "FIT", counts=[3, 6, 12], smoothing=[1, 2], placement="lloyd", progress=Meter
    )
    mx.select_surface(SOURCE, TARGET[:, 0], smoothing=0, progress=Meter)
    assert [meter.total for meter in meters] == [6, steps(60)]


@pytest.mark.parametrize("what", CALLS)
def test_tqdm_is_such_a_bar(what):
    stream = io.StringIO()
    CALLS[what](partial(tqdm, file=stream, mininterval=0))
    last = stream.getvalue().split("\r")[-1]
    assert last.startswith(f"{what}: 100%|")


@pytest.mark.parametrize("where", ["update", "close"])
@pytest.mark.parametrize("what", CALLS)
def test_what_the_bar_raises_ends_the_work(what, where, meters, monkeypatch):
    def fail(self, *_):
        calls.append(where)
        raise ZeroDivisionError("of the bar")

    calls = []
    monkeypatch.setattr(Meter, where, fail)
    with pytest.raises(ZeroDivisionError, match="of the bar"):
        CALLS[what](Meter)
    assert calls == [where]  # and not for each step
    assert meters[0].closed == (where == "update")


def test_a_bar_that_fails_ends_the_processes(meters, monkeypatch):
    monkeypatch.setattr(Meter, "update", lambda self, number: 1 / 0)
    start = time.monotonic()
    with pytest.raises(ZeroDivisionError):
        mx.map_problems(time.sleep, [(0,), *[(60,)] * 3], workers=2, progress=Meter)
    assert time.monotonic() - start < 30


@pytest.mark.parametrize("what", CALLS)
def test_what_makes_no_bar_is_refused(what):
    for wrong in (0, 1.0, "no", None, [True]):
        text = refused(lambda wrong=wrong: CALLS[what](wrong), "progress", TypeError)
        assert "tqdm.tqdm" in text
    for made in (None, {}, io.StringIO()):  # a dictionary can be updated, and a file closed
        text = refused(lambda made=made: CALLS[what](lambda total, desc: made), "progress", TypeError)
        assert "update and close" in text
