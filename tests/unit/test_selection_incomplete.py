import numpy as np
import pytest

import mexpress as mx
from mexpress.plotting import plot_control_points

RNG = np.random.default_rng(3)
SOURCE = RNG.uniform(0, 100, (40, 2))
TARGET = SOURCE + np.sin(SOURCE[:, ::-1] / 20) + RNG.normal(0, 0.05, SOURCE.shape)
TARGET[30] += 25
DEPTH = np.sin(SOURCE[:, 0] / 30) + RNG.normal(0, 0.01, 40)
GONE = [3, 17, 39]
KEPT = np.delete(np.arange(40), GONE)


def holes(array, rows):
    """The array with something missing in rows, in three ways; masked entries have a value beneath."""
    wide = np.ma.array(array, copy=True)
    flat = wide.reshape(len(array), -1)
    flat[rows[0], 0] = np.nan
    flat[rows[1:], -1] = 1e6
    mask = np.zeros(flat.shape, bool)
    mask[rows[1:], -1] = True
    return np.ma.array(flat.data, mask=mask).reshape(array.shape)


def test_a_warp_without_the_rows_in_which_something_is_missing():
    source, target = holes(SOURCE, GONE[:2]), np.where(np.arange(40)[:, None] == 39, np.inf, TARGET)
    selection = mx.select_warp(source, target, missing="drop", robust=True)
    clean = mx.select_warp(SOURCE[KEPT], TARGET[KEPT], robust=True)
    np.testing.assert_array_equal(selection.warp(SOURCE), clean.warp(SOURCE))
    np.testing.assert_array_equal(selection.maps["MATCHED"], clean.maps["MATCHED"])
    assert selection.left_out.tolist() == KEPT[clean.left_out].tolist() == [30]
    assert selection.kept.tolist() == np.setdiff1d(KEPT, [30]).tolist()
    assert (np.isnan(selection.source).all(axis=1).nonzero()[0].tolist(), len(selection.target)) == (GONE, 40)
    assert np.isnan(selection.suspects().scores[GONE]).all()
    assert selection.notes == clean.notes
    np.testing.assert_array_equal(selection.warp.error(SOURCE), clean.warp.error(SOURCE))
    assert repr(selection.data) == f"Matches(40 matches, diagonal {clean.data.diagonal:g})"
    selection.plot()


@pytest.mark.parametrize("smoothing", [0, "auto"])
def test_a_surface_without_the_rows_in_which_something_is_missing(smoothing):
    values = holes(np.column_stack([DEPTH, DEPTH**2]), GONE)
    selection = mx.select_surface(SOURCE, values, missing="drop", smoothing=smoothing)
    clean = mx.select_surface(SOURCE[KEPT], np.column_stack([DEPTH, DEPTH**2])[KEPT], smoothing=smoothing)
    np.testing.assert_array_equal(selection.surface(SOURCE), clean.surface(SOURCE))
    assert (selection.criterion, selection.count) == (clean.criterion, clean.count)
    # They tell of the data by their rows.
    assert len(selection.notes) == len(clean.notes)
    plot_control_points(selection)
    assert selection.kept.tolist() == KEPT.tolist()


def test_weights_may_be_missing_too():
    weights = np.linspace(1, 2, 40)
    gaps = np.where(np.isin(np.arange(40), GONE), np.nan, weights)
    selection = mx.select_surface(SOURCE, DEPTH, weights=gaps, missing="drop")
    clean = mx.select_surface(SOURCE[KEPT], DEPTH[KEPT], weights=weights[KEPT])
    np.testing.assert_array_equal(selection.surface(SOURCE), clean.surface(SOURCE))


def test_fits():
    warp = mx.fit_warp(holes(SOURCE, GONE), TARGET, SOURCE[:6], missing="drop")
    np.testing.assert_array_equal(warp(SOURCE), mx.fit_warp(SOURCE[KEPT], TARGET[KEPT], SOURCE[:6])(SOURCE))
    surface = mx.fit_surface(SOURCE, holes(DEPTH, GONE), SOURCE[:6], missing="drop")
    expected = mx.fit_surface(SOURCE[KEPT], DEPTH[KEPT], SOURCE[:6])
    np.testing.assert_array_equal(surface(SOURCE), expected(SOURCE))
    assert len(surface.data.points) == 37


def test_nothing_missing_changes_nothing():
    both = [mx.select_surface(SOURCE, np.ma.array(DEPTH), missing=missing) for missing in ("raise", "drop")]
    np.testing.assert_array_equal(*(selection.surface(SOURCE) for selection in both))
    assert both[1].data.weights is None


@pytest.mark.parametrize("shape", [(40, 1, 2), (1, 40, 2)])
def test_points_as_opencv_has_them(shape):
    source, target = SOURCE.reshape(shape), TARGET.reshape(shape)
    warp, expected = mx.fit_warp(source, target, SOURCE[:6, None]), mx.fit_warp(SOURCE, TARGET, SOURCE[:6])
    np.testing.assert_array_equal(warp(SOURCE), expected(SOURCE))
    np.testing.assert_array_equal(warp(source), expected(SOURCE))
    np.testing.assert_array_equal(warp.inverse(target), expected.inverse(TARGET))
    gaps = mx.fit_warp(holes(SOURCE, GONE).reshape(shape), target, SOURCE[:6], missing="drop")
    np.testing.assert_array_equal(gaps(SOURCE), mx.fit_warp(SOURCE[KEPT], TARGET[KEPT], SOURCE[:6])(SOURCE))


@pytest.mark.parametrize("gap", [0, 2])
@pytest.mark.parametrize(
    ("weights", "says"),
    [
        (np.where(np.arange(40) == 10, -1.0, 1), "40 numbers of at least 0.*Given -1 for datum 10"),
        (-np.ones(40), "40 numbers of at least 0.*Given -1 for datum"),
        (np.zeros(40), "40 numbers of at least 0, one for each datum, and one above 0"),
        (np.ones((40, 1)), r"40 numbers.*Given shape \(40, 1\)"),
    ],
)
def test_messages_count_all_rows(gap, weights, says):
    values = np.where(np.arange(40) == gap, np.nan, DEPTH)
    with pytest.raises(ValueError, match=rf"^Invalid weights\. It must be {says}"):
        mx.select_surface(SOURCE, values, weights=weights, missing="drop")
    target = np.where(np.arange(40)[:, None] == gap, np.nan, TARGET)
    with pytest.raises(ValueError, match=rf"^Invalid weights\. It must be {says}"):
        mx.select_warp(SOURCE, target, weights=weights, missing="drop")
    with pytest.raises(ValueError, match=r"^Invalid target\. .*Given shape \(40, 3\)"):
        mx.select_warp(SOURCE, np.column_stack([target, values]), missing="drop")


@pytest.mark.parametrize(
    "call", [mx.select_surface, lambda *data, **how: mx.fit_surface(*data, SOURCE[:6], **how)]
)
@pytest.mark.parametrize(
    ("values", "missing", "says"),
    [
        (
            np.ma.masked_less(DEPTH, DEPTH.min() + 1e-9),
            "raise",
            'values.*missing="drop" leaves out.* 1 masked',
        ),
        (
            np.where(np.arange(40) == 3, np.nan, DEPTH),
            "raise",
            'values.*missing="drop" leaves out.*nan at row 3',
        ),
        (DEPTH[:39], "drop", "values.* as many rows as points. Given 39 for 40"),
        (np.float64(3), "drop", "values"),
        ([[1, 2], [3]], "drop", "values"),
        ("abc", "drop", "values"),
        (DEPTH * 1j, "drop", "values"),
        (DEPTH * np.nan, "drop", r"points\. There must be rows that are whole\. Given 0 of 40\."),
        (DEPTH, "keep", 'missing.* "raise" or "drop". Given \'keep\''),
        (DEPTH, True, 'missing.* "raise" or "drop". Given True'),
        (DEPTH, None, "missing"),
    ],
)
def test_what_is_refused(call, values, missing, says):
    with pytest.raises((ValueError, TypeError), match=rf"^Invalid {says}"):
        call(SOURCE, values, missing=missing)


@pytest.mark.parametrize("select", [mx.select_surface, mx.select_warp])
def test_no_data_at_all_are_refused_by_name(select):
    with pytest.raises(ValueError, match=r"^Invalid (points|source)\. .*Given shape \(0, 2\)"):
        select(np.empty((0, 2)), np.empty((0, 2)), missing="drop")
