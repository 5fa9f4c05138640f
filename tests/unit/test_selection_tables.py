"""Selections as tables of pandas, and as plain values."""

import json
import sys

import numpy as np
import pandas as pd
import pytest

import mexpress as mx
from mexpress.cli.report import write_curves

RNG = np.random.default_rng(0)
SOURCE = RNG.uniform(0, 100, (60, 2))
BENT = SOURCE + 3 * np.sin(SOURCE / 20)
MADE = {
    "auto": lambda: mx.select_warp(SOURCE, BENT + RNG.normal(0, 0.1, BENT.shape)),
    "an affine map": lambda: mx.select_warp(SOURCE, SOURCE + RNG.normal(size=SOURCE.shape)),
    "one weight": lambda: mx.select_warp(
        SOURCE, BENT, "ER10", ["FIT", "AIC"], counts=[3, 9, 60], smoothing=0
    ),
    "several": lambda: mx.select_surface(SOURCE, BENT[:, 0], smoothing=[1, 10], max_count=9),
}


@pytest.fixture(params=MADE)
def selection(request):
    return MADE[request.param]()


def test_every_model_has_a_row(selection):
    frame = selection.to_frame()
    assert list(frame.columns) == ["rival", "count", "smoothing", "parameters", *selection.maps, "selected"]
    for name, entrant in [(None, selection), *selection.rivals.items()]:
        rows = frame[frame.rival.isna() if name is None else frame.rival == name]
        assert len(rows) == len(entrant.counts) * len(entrant.weights)
        for criterion, scores in entrant.maps.items():
            table = rows.pivot(index="count", columns="smoothing", values=criterion)
            np.testing.assert_array_equal(table.index, entrant.counts)
            np.testing.assert_array_equal(table.columns, entrant.weights)
            np.testing.assert_array_equal(table.to_numpy(), scores)
        parameters = rows.pivot(index="count", columns="smoothing", values="parameters").to_numpy()
        np.testing.assert_array_equal(parameters, entrant.parameters)
    assert len(frame) == sum(scores.maps["FIT"].size for scores in (selection, *selection.rivals.values()))


def test_one_row_is_selected(selection):
    frame = selection.to_frame()
    (row,) = frame[frame.selected].to_dict("records")
    assert row["count"] == selection.count
    assert row["smoothing"] == selection.smoothing
    assert row["parameters"] == selection.effective_parameters
    assert row[selection.criterion] == selection.score
    assert (row["rival"] is None) == (selection.rival is None)
    assert row["rival"] in (None, selection.rival)


def test_rivals_have_no_score_by_what_does_not_suit_them():
    frame = MADE["an affine map"]().to_frame()
    assert frame[frame.rival.notna()]["PRESS"].isna().all()
    assert frame[frame.rival.isna()]["PRESS"].notna().all()
    assert frame.dtypes["count"] == np.int64


def test_the_table_is_that_of_the_command_line(selection, tmp_path):
    write_curves(tmp_path / "curves.csv", selection)
    written = pd.read_csv(tmp_path / "curves.csv")
    frame = selection.to_frame()
    frame = frame[frame.rival.isna()].drop(columns=["rival", "selected"])
    assert set(frame.columns) - set(written.columns) <= {"smoothing", "parameters"}
    pd.testing.assert_frame_equal(written, frame[written.columns], check_exact=True)


def test_without_pandas_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r"pip install 'mexpress\[pandas\]'"):
        MADE["one weight"]().to_frame()


def test_plain_values_are_json(selection):
    plain = selection.to_dict()
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain
    for name in ("criterion", "count", "smoothing", "effective_parameters", "score", "selected", "rival"):
        assert plain[name] == getattr(selection, name)
    assert plain["notes"] == list(selection.notes)
    assert list(plain["rivals"]) == list(selection.rivals)
    for name, curve in selection.curves.items():
        np.testing.assert_array_equal(np.array(plain["curves"][name], float), curve)
    assert ("maps" in plain) == (len(selection.weights) > 1)


def test_what_is_undefined_is_none():
    selection = mx.select_warp(SOURCE, BENT, "FIT", ["NN55PTS"], counts=[3, 20], smoothing=0)
    plain = selection.to_dict()
    assert plain["curves"]["NN55PTS"] == [selection.curves["NN55PTS"][0], None]
    assert plain["undefined"]["NN55PTS"]["20"] == selection.undefined["NN55PTS"][20].tolist()
    assert np.isnan(selection.to_frame()["NN55PTS"][1])
