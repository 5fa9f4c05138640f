import math
import re
import sys
from xml.etree import ElementTree

import numpy as np
import pytest

import mexpress as mx
from mexpress import notebook

RNG = np.random.default_rng(0)
SOURCE = RNG.uniform(0, 1, (60, 2)) * [160, 100]
TARGET = SOURCE + 4 * np.sin(SOURCE[:, ::-1] / 30) + RNG.normal(0, 0.2, SOURCE.shape)
HOSTILE = "<script>alert('&')</script>"


def parsed(html):
    """HTML as a tree: it must be well formed, and need nothing from elsewhere."""
    assert not re.search(r"<script|<style|https?:|src=|href=", html)
    return ElementTree.fromstring(html)


def text(html):
    return " ".join("".join(parsed(html).itertext()).split())


def cells(html):
    """The rows of the last table, by their first cell."""
    rows = list(parsed(html).iter("table"))[-1].iter("tr")
    return {words[0]: words[1:] for words in ([cell.text or "" for cell in row] for row in rows)}


def corners(path):
    """The places of a path, a list for each line without a gap."""
    lines = path.get("d").split("M")[1:]
    return [np.array([place.split() for place in line.split("L")], dtype=float) for line in lines]


@pytest.mark.parametrize(
    "html",
    [
        notebook.card(HOSTILE, notebook.notes([HOSTILE]), notebook.facts({HOSTILE: HOSTILE})),
        notebook.table([HOSTILE, HOSTILE], [[HOSTILE, HOSTILE]], [HOSTILE]),
        notebook.curve(HOSTILE, [0, 1], [2.0, 1.0], 1, [HOSTILE] * 3, HOSTILE),
        notebook.wires(HOSTILE, [[(0.0, 0.0), (1.0, 1.0)]]),
    ],
)
def test_all_text_is_escaped(html):
    assert HOSTILE in "".join(parsed(html).itertext())


def test_a_curve_is_drawn_to_scale_with_gaps():
    y = [math.nan, 3.0, 2.0, math.inf, 2.5, 2.2]
    tree = parsed(notebook.curve("score", [3, 4, 5, 6, 7, 9], y, 2, ["3", "5", "9"], "control points"))
    axes, line = tree.iter("path")
    ((left, top), (_, bottom), (right, _)) = corners(axes)[0]
    found = np.vstack(corners(line))
    assert [len(part) for part in corners(line)] == [2, 2]
    known = np.array([1, 2, 4, 5])
    np.testing.assert_allclose(
        found[:, 0], left + (np.array([4, 5, 7, 9]) - 3) * (right - left) / 6, atol=0.06
    )
    np.testing.assert_allclose(found[:, 1], bottom + (np.array(y)[known] - 2) * (top - bottom), atol=0.06)
    (mark,) = tree.iter("circle")
    np.testing.assert_allclose([float(mark.get("cx")), float(mark.get("cy"))], found[1])
    assert {"score", "2", "3", "5", "9", "control points"} <= {each.text for each in tree.iter("text")}


def test_a_curve_over_decades_is_logarithmic_and_ends_above_the_chosen():
    tree = parsed(notebook.curve("score", [0, 1, 2, 3], [1000.0, 4.0, 2.0, 1.0], 3, ["0", "3", "3"], ""))
    heights = np.vstack(corners(list(tree.iter("path"))[1]))[:, 1]
    np.testing.assert_allclose(np.diff(heights), heights[1] - heights[0], atol=0.11)  # 8, 4, 2, 1


@pytest.mark.parametrize("y", [[1.0, 1.0], [0.0, 0.0], [-5.0, -7.0], [0.0, 1.0], [math.nan, 2.0]])
def test_curves_of_all_kinds(y):
    chosen = int(np.nanargmin(y))
    tree = parsed(notebook.curve("AIC", [3, 4], y, chosen, ["3", str(3 + chosen), "4"], "x"))
    assert "nan" not in ElementTree.tostring(tree, "unicode")


def test_nothing_to_draw_is_no_picture():
    assert notebook.wires("nothing", [[(math.nan, 0.0)]]) == ""
    assert notebook.notes([]) == ""
    assert "nan" not in notebook.wires("a point", [[(1.0, 1.0)]])


def test_a_selection_shows_what_each_criterion_selects():
    selection = mx.select_warp(SOURCE, TARGET, criteria=["FIT", "AIC"], counts=range(3, 20), smoothing=0)
    html = selection._repr_html_()
    rows = cells(html)
    assert rows["criterion"] == ["selects", "smoothing", "parameters", "score (pixels of the target image)"]
    for name, scores in selection.maps.items():
        count = selection.selected[name]
        k = selection.counts.tolist().index(count)
        unit = " (no unit)" if name == "AIC" else ""
        parameters = f"{selection.parameters[k, 0]:.1f}"
        assert rows[name] == [str(count), "0", parameters, f"{scores[k, 0]:.4g}{unit}"]
    bold = [row[0].text for row in parsed(html).iter("tr") if "bold" in row.get("style", "")]
    assert bold == [selection.criterion]
    assert f"ER10 selects {selection.count} control points" in text(html)
    assert all(note in text(html) for note in selection.notes)
    assert {str(selection.count), "3", "19"} <= {each.text for each in parsed(html).iter("text")}


def test_a_selection_of_weights_is_drawn_against_them():
    selection = mx.select_surface(SOURCE, TARGET[:, 0])
    html = selection._repr_html_()
    assert f"smoothing, at {selection.count} control points" in text(html)
    assert f"{selection.smoothing:.3g}" in {each.text for each in parsed(html).iter("text")}
    assert cells(html)[selection.criterion][:2] == [str(selection.count), f"{selection.smoothing:.3g}"]


def test_notes_and_data_that_are_left_out_are_shown():
    target = TARGET.copy()
    target[7] += 40
    spoiled = mx.select_warp(SOURCE, target)
    assert [each.text for each in parsed(spoiled._repr_html_()).iter("li")] == list(spoiled.notes)
    assert spoiled.notes
    assert "59 in the fit, 1 left out" in text(mx.select_warp(SOURCE, target, robust=True)._repr_html_())


def test_a_rival_that_is_selected_is_named():
    source = RNG.uniform(0, 1, (20, 2)) * [640, 480]
    selection = mx.select_warp(source, source @ [[1.1, 0.1], [-0.1, 0.9]] + RNG.normal(0, 1, source.shape))
    assert selection.rival == "affine map"
    html = selection._repr_html_()
    assert "MATCHED selects the affine map" in text(html)
    assert cells(html)["MATCHED"][0] == "affine map"
    tree = parsed(html)
    assert f"affine map: {selection.score:.4g}" in {each.text for each in tree.iter("text")}
    (across,) = (path for path in tree.iter("path") if path.get("stroke-dasharray"))
    ((_, level), (_, same)) = corners(across)[0]
    (mark,) = tree.iter("circle")
    assert mark.get("fill") == "none"
    best = selection.maps["MATCHED"][selection.place]
    assert level == same
    assert (level > float(mark.get("cy"))) == (selection.score < best)


def test_a_rival_is_drawn_to_the_curve_s_scale():
    for value in (0.5, 1.5, 3.0, 6.0):
        tree = parsed(
            notebook.curve("score", [3, 4, 5], [3.0, 1.0, 2.0], 1, ["3", "4", "5"], "x", ("plane", value))
        )
        (across,) = (path for path in tree.iter("path") if path.get("stroke-dasharray"))
        (mark,) = tree.iter("circle")
        axes, line, *_ = (corners(path)[0] for path in tree.iter("path"))
        (left, top), (_, bottom), (right, _) = axes
        low, high = min(value, 1.0), max(value, 3.0)
        share = np.log(value / low) / np.log(high / low) if high > 3 * low else (value - low) / (high - low)
        np.testing.assert_allclose(
            corners(across)[0],
            [[left, bottom + share * (top - bottom)], [right, bottom + share * (top - bottom)]],
            atol=0.1,
        )
        np.testing.assert_allclose(float(mark.get("cy")), line[1][1], atol=0.1)


def test_criteria_without_a_score_select_nothing():
    maps = {"FIT": np.array([2.0, 1.0]), HOSTILE: np.full(2, np.nan)}
    html = mx.Selection("FIT", np.array([3, 4]), maps, {})._repr_html_()
    assert cells(html)[HOSTILE] == ["none", "", "", ""]
    assert "score (unit of the data)" in text(html)
    one = mx.Selection("FIT", np.array([3]), {"FIT": np.array([2.0])}, {})._repr_html_()
    assert not list(parsed(one).iter("svg"))


def test_models_show_what_they_are_without_matplotlib(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    warp = mx.fit_warp(SOURCE, TARGET, SOURCE[:9], fractional=False, smoothing=2.0)
    errors = np.hypot(*(warp(SOURCE) - TARGET).T)
    shown = text(warp._repr_html_())
    assert f"residuals: RMS {np.sqrt((errors**2).mean()):.3g}, median {np.median(errors):.3g}" in shown
    assert "a warp without a denominator" in shown
    assert len(list(parsed(warp._repr_html_()).iter("path"))) == 26
    for width, pictures in ((1, 1), (2, 0), (3, 1)):
        values = RNG.normal(size=(60, width))
        surface = mx.fit_surface(SOURCE, values, SOURCE[:9])
        assert len(list(parsed(surface._repr_html_()).iter("svg"))) == pictures
    flat = mx.fit_surface(SOURCE, np.ones(60), SOURCE[:9])._repr_html_()
    assert "nan" not in flat
    assert "residuals" not in text(mx.Surface(flat_lifting(), np.ones(3), SOURCE)._repr_html_())


def flat_lifting():
    return mx.fit_surface(SOURCE, np.ones(60), SOURCE[:3]).lifting
