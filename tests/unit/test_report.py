"""The page of a selection says what the selection says, is whole, and needs nothing from elsewhere."""

import base64
import io
import json
import re
import sys
from html.parser import HTMLParser

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from PIL import Image

import mexpress as mx
from mexpress.cli import main
from mexpress.report.maps import FIELD, Map, colours_of, png
from mexpress.report.scales import Scale

RNG = np.random.default_rng(3)
SOURCE = RNG.uniform(0, 1, (70, 2)) * [160, 100]
TARGET = SOURCE + 4 * np.sin(SOURCE[:, ::-1] / 30) + RNG.normal(0, 0.2, SOURCE.shape)
WRONG = TARGET + 25 * (np.arange(70) == 7)[:, None]
POINTS = RNG.uniform(0, 1, (150, 2))
DEPTHS = np.sin(5 * POINTS[:, 0]) + RNG.normal(0, 0.02, 150)
SHEET = np.column_stack([POINTS, DEPTHS])
SECTIONS = ["Notes", "What was asked", "Scores of the models that were tried", "Criteria", "Data to look at"]
SECTIONS += ["How to make it again", "Versions"]
HOSTILE = "<script>alert('&')</script>"
ALONE = {"meta", "link", "img", "input", "path", "circle", "rect", "image"}


class Page(HTMLParser):
    """A page as its elements: (tag, attributes, text directly in it); tags must be closed where they belong."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.open = [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        """Take an element."""
        self.elements.append((tag, dict(attrs), []))
        if tag not in ALONE:
            self.open.append(self.elements[-1])

    def handle_startendtag(self, tag, attrs):
        """Take an element without content."""
        self.elements.append((tag, dict(attrs), []))

    def handle_endtag(self, tag):
        """Close the last element."""
        if tag not in ALONE:
            assert self.open.pop()[0] == tag
        # A circle is closed where it holds what is said of it.

    def handle_data(self, data):
        """Take text."""
        if self.open:
            self.open[-1][2].append(data)

    def texts(self, tag):
        """Return the texts of the elements of a kind."""
        return ["".join(text) for name, _, text in self.elements if name == tag]

    def data(self, name):
        """Return what an attribute holds, of all elements that have it."""
        return [json.loads(attributes[name]) for _, attributes, _ in self.elements if name in attributes]


@pytest.fixture
def page(tmp_path):
    def page(selection, *arguments, **options):
        selection.report(tmp_path / "report.html", *arguments, **options)
        return Page((tmp_path / "report.html").read_text(encoding="utf-8"))

    return page


@pytest.fixture(scope="module")
def warps():
    return mx.select_warp(SOURCE, WRONG, criteria=["FIT", "ER10", "AIC"], robust=True, image_size=(160, 100))


@pytest.fixture(scope="module")
def surfaces():
    return mx.select_surface(POINTS, DEPTHS)


def check_whole(shown):
    """Nothing is loaded from elsewhere, and everything that is seen has words."""
    for tag, attributes, _ in shown.elements:
        for name in ("src", "href"):
            assert attributes.get(name, "data:").startswith("data:"), (tag, attributes[name][:80])
        assert not [name for name in attributes if name.startswith("on")]
        if tag == "img":
            assert attributes["alt"]
        if attributes.get("role") == "img":
            assert attributes["aria-label"]
    style = "".join(shown.texts("style"))
    assert "url(" not in style
    assert "@import" not in style


def test_the_page_of_a_warp_is_whole_and_in_order(warps, page, tmp_path):
    shown = page(warps)
    check_whole(shown)
    headings = shown.texts("h2")
    assert [name for name in headings if name in SECTIONS] == SECTIONS
    assert headings[3] == "The warp"
    assert shown.texts("h1") == [
        f"MATCHED selects {warps.count} control points and smoothing {warps.smoothing:.3g}: {warps.score:.4g} pixels"
    ]
    assert shown.texts("dd")[:2] == ["69", "1"]
    assert (tmp_path / "report.html").stat().st_size < 1_000_000


def test_notes_come_first_and_are_those_of_the_selection(page):
    selection = mx.select_warp(SOURCE, TARGET, image_size=(100, 50))
    assert selection.notes
    shown = page(selection)
    assert shown.texts("h2")[0] == "Notes"
    assert shown.texts("li")[: len(selection.notes)] == list(selection.notes)
    assert "None: no check found anything doubtful." not in shown.texts("p")
    assert "None: no check found anything doubtful." in page(mx.select_warp(SOURCE, TARGET)).texts("p")


def test_curves_hold_every_score(warps, page):
    of_unit, unitless, _ = page(warps).data("data-curves")
    k, w = warps.place
    assert of_unit["chosen"] == unitless["chosen"] == w
    for content, names in ((of_unit, ["MATCHED", "FIT", "ER10"]), (unitless, ["AIC"])):
        for name, values in zip(names, content["values"], strict=True):
            assert values == [
                f"{score:.4g}" if np.isfinite(score) else "undefined" for score in warps.maps[name][k]
            ]
    heights = np.array([y for y in of_unit["y"][0] if y is not None])
    assert np.argmax(heights) == np.nanargmin(warps.maps["MATCHED"][k])  # y points down
    assert np.all(np.diff(of_unit["x"]) > 0)
    assert f"smoothing {warps.weights[w]:.3g}" in of_unit["names"][w]


def test_curves_over_counts_have_the_best_weight_of_each(page):
    selection = mx.select_warp(SOURCE, TARGET, "ER10", ["FIT"], counts=range(3, 12), smoothing=[0, 10.0])
    content = page(selection).data("data-curves")[0]
    assert content["values"][0] == [f"{score:.4g}" for score in selection.curves["ER10"]]
    assert content["chosen"] == selection.counts.tolist().index(selection.count)
    words = f"{selection.count} control points, smoothing {selection.smoothing:.3g}"
    assert content["names"][content["chosen"]].startswith(words)


def test_one_model_alone_has_no_curve(page):
    shown = page(mx.select_warp(SOURCE, TARGET, counts=[5], smoothing=0))
    assert "One model was tried." in shown.texts("p")


def test_maps_answer_with_the_displacement_and_the_error(warps, page):
    moves, errors = page(warps).data("data-map")
    area = Map.over(warps.warp.domain, y_down=True)
    for content, values in (
        (moves, lambda points: np.hypot(*(warps.warp(points, outside="nan") - points).T)),
        (errors, warps.warp.error),
    ):
        rows = np.array(content["rows"], dtype=float)
        high, wide = rows.shape
        assert max(high, wide) > 20
        x = area.x.low + (np.arange(wide) + 0.5) / wide * (area.x.high - area.x.low)
        y = area.y.low + (np.arange(high) + 0.5) / high * (area.y.high - area.y.low)
        expected = values(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)).reshape(rows.shape)
        both = np.isfinite(rows) & np.isfinite(expected)
        assert both.mean() > 0.6
        usual = np.median(np.abs(rows - expected)[both])
        assert usual < 0.05 * np.median(expected[both])  # a cell is asked where it is, to a cell's size


def test_the_matches_and_what_was_left_out_are_marked(warps, page):
    shown = page(warps)
    marks = [text for text in shown.texts("title") if text.startswith("match ")]
    assert len(marks) == 70
    errors = warps.warp.residuals(SOURCE, WRONG)
    assert f"match 7: {errors[7]:.3g} pixels, left out" in marks
    assert f"match 8: {errors[8]:.3g} pixels" in marks
    assert "Left out as wrong: 1" in shown.texts("h3")


@pytest.mark.parametrize(
    "options",
    [
        {"criteria": ["FIT", "ER10"], "robust": True, "image_size": (160, 100)},
        {"criterion": "ER05", "criteria": [], "counts": range(4, 12, 2), "smoothing": 0, "fractional": False},
        {"smoothing": [0.1, 10.0], "queries": [0, 0, 300, 100], "seed": 3, "weights": np.arange(70) % 3},
    ],
)
def test_the_call_on_the_page_gives_the_same_selection(options, page):
    selection = mx.select_warp(SOURCE, WRONG, **options)
    (call,) = page(selection).texts("code")
    names = {"source": SOURCE, "target": WRONG, "weights": options.get("weights")}
    exec(call, names)
    again = names["sel"]
    assert repr(again) == repr(selection)
    assert again.maps.keys() == selection.maps.keys()
    for name, scores in selection.maps.items():
        np.testing.assert_array_equal(again.maps[name], scores)
    np.testing.assert_array_equal(again.left_out, selection.left_out)


def test_the_call_of_a_surface_gives_the_same_selection(page):
    values = DEPTHS.copy()
    values[5] = np.nan
    selection = mx.select_surface(POINTS, values, "ER10", max_count=20, smoothing=0, missing="drop")
    (call,) = page(selection).texts("code")
    names = {"points": POINTS, "values": values}
    exec(call, names)
    np.testing.assert_array_equal(names["sel"].surface.parameters, selection.surface.parameters)


def test_long_arguments_are_called_by_their_names(page):
    queries = RNG.uniform(0, 160, (80, 2))
    shown = page(
        mx.select_warp(SOURCE, TARGET, queries=queries, criteria={HOSTILE: mx.schemes.k_fold(70, 5)})
    )
    (call,) = shown.texts("code")
    assert "queries=queries," in call
    assert f"criteria={{{HOSTILE!r}: ...}}" in call


def test_a_mesh_is_the_surface(surfaces, page):
    shown = page(surfaces, unit="m")
    check_whole(shown)
    (mesh,) = shown.data("data-mesh")
    vertices = np.array(mesh["vertices"], dtype=float).reshape(mesh["rows"] * mesh["columns"], 3)
    inside = np.isfinite(vertices).all(axis=1)
    assert 0.7 < inside.mean() <= 1
    grid = surfaces.surface.grid(shape=(mesh["rows"], mesh["columns"]))
    places = np.column_stack([grid.points, grid.values.ravel()])[inside]
    for k in range(3):  # each axis is moved and scaled, no more
        slope, _ = np.polyfit(places[:, k], vertices[inside, k], 1)
        assert slope > 0
        assert np.corrcoef(places[:, k], vertices[inside, k])[0, 1] > 1 - 1e-6
    low, high = np.nanmin(vertices, axis=0), np.nanmax(vertices, axis=0)
    np.testing.assert_allclose(high, mesh["half"], atol=2e-4)
    np.testing.assert_allclose(low, -np.array(mesh["half"]), atol=2e-4)
    assert mesh["ends"][2] == [f"{np.nanmin(grid.values):.3g}", f"{np.nanmax(grid.values):.3g}"]
    assert max(mesh["rows"], mesh["columns"]) <= 60


def test_a_depth_map_has_y_downwards(surfaces, page):
    up, down = (page(surfaces, **size).data("data-mesh")[0] for size in ({}, {"image_size": (1, 1)}))
    assert down["ends"][1] == up["ends"][1][::-1]
    y = [np.array(mesh["vertices"], dtype=float)[1::3] for mesh in (up, down)]
    np.testing.assert_allclose(y[0], -y[1], atol=1e-4)


@pytest.mark.parametrize("wrong", [{"unit": 3}, {"command": b"mexpress"}, {"image_size": "large"}])
def test_what_is_no_text_or_size_is_refused(wrong, surfaces, tmp_path):
    with pytest.raises(TypeError, match=f"^Invalid {next(iter(wrong))}\\."):
        surfaces.report(tmp_path / "report.html", **wrong)


def test_surfaces_of_other_dimensions(page):
    sheet = page(mx.select_surface(POINTS, SHEET))
    assert len(sheet.data("data-mesh")) == 1
    flat = page(mx.select_surface(POINTS, SHEET[:, :2]))
    assert flat.data("data-mesh") == []
    assert "Residuals at the data" in flat.texts("h3")


@pytest.mark.parametrize("constant", [0.0, 3.0])
def test_a_flat_surface_is_shown(constant, page):
    with np.errstate(all="raise"):
        shown = page(mx.select_surface(POINTS, np.full(150, constant)))
    assert len(shown.data("data-mesh")) == 1


def test_the_images_are_those_of_the_warp(warps, page):
    y, x = np.mgrid[:100, :160]
    first = np.stack([120 + 100 * np.sin(x / 5), 120 + 100 * np.sin(y / 6), 0 * x], axis=-1).astype(np.uint8)
    second = np.roll(first, 5, axis=1)
    shown = page(warps, first, second)
    check_whole(shown)
    pictures = {
        attributes["class"]: np.asarray(
            Image.open(io.BytesIO(base64.b64decode(attributes["src"].split(",")[1])))
        )
        for tag, attributes, _ in shown.elements
        if tag == "img"
    }
    assert np.abs(pictures["source"].astype(float) - first).mean() < 3
    expected = warps.warp.remap(second, inverse=True, size=(160, 100)).astype(float)
    inner = (slice(10, -10), slice(10, -10))
    off = {name: np.abs(picture - expected)[inner].mean(axis=2) for name, picture in pictures.items()}
    assert np.median(off["right registered"]) < 6
    assert np.median(off["right taken"]) > 20
    assert np.abs(pictures["right taken"].astype(float) - second)[inner].mean() < 6


def test_one_image_alone_is_refused(warps, tmp_path):
    for images in ({"source_image": np.zeros((9, 9))}, {"target_image": np.zeros((9, 9))}):
        with pytest.raises(ValueError, match=r"^Invalid (source|target)_image\. Both images must be given"):
            warps.report(tmp_path / "report.html", **images)
    with pytest.raises(ValueError, match=r"^Invalid target_image\."):
        warps.report(tmp_path / "report.html", np.zeros((9, 9)), np.zeros(9))
    with pytest.raises(TypeError, match=r"^Invalid path\."):
        warps.report(3)
    with pytest.raises(TypeError, match=r"^Invalid command\."):
        warps.report(tmp_path / "report.html", command=["mexpress"])
    assert list(tmp_path.iterdir()) == []


def test_images_need_pillow_and_the_rest_does_not(warps, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "PIL", None)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    warps.report(tmp_path / "report.html")
    with pytest.raises(ImportError, match=r"mexpress\[image\]"):
        warps.report(tmp_path / "other.html", np.zeros((9, 9)), np.zeros((9, 9)))
    assert [file.name for file in tmp_path.iterdir()] == ["report.html"]


def test_hostile_names_are_text(page):
    frame = pd.DataFrame(POINTS, columns=[HOSTILE, '"><img src=x>'])
    scheme = {HOSTILE: mx.schemes.k_fold(150, 5)}
    selection = mx.select_surface(frame, DEPTHS, HOSTILE, scheme)
    shown = page(selection, unit=HOSTILE, command=f"mexpress {HOSTILE}")
    assert len(shown.texts("script")) == 1
    assert [tag for tag, _, _ in shown.elements].count("img") == 0
    check_whole(shown)
    assert HOSTILE in shown.texts("h1")[0]
    assert f"mexpress {HOSTILE}" in shown.texts("code")
    content = shown.data("data-curves")[0]
    assert len(content["values"]) == len(selection.maps)


def test_the_page_says_no_more_than_the_selection_and_what_was_saved(warps, tmp_path):
    warps.report(tmp_path / "first.html")
    warps.report(tmp_path / "second.html")
    warps.save(tmp_path / "selection.npz")
    mx.load(tmp_path / "selection.npz").report(tmp_path / "third.html")
    first, second, third = ((tmp_path / f"{name}.html").read_text() for name in ("first", "second", "third"))
    assert first == second
    assert first == third


@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_units_change_nothing_but_numbers(scale, page):
    shown = page(mx.select_surface(POINTS * scale + 1e3 * scale, DEPTHS * scale))
    assert len(shown.data("data-map")) == 1
    assert not any("nan" in attributes.get("d", "") for _, attributes, _ in shown.elements)


def test_vanishing_warps_have_a_page(page):
    corners = np.array(
        [[0, 0], [100, 0], [0, 100], [100, 100], [50, 40], [20, 70], [70, 20], [80, 60]], dtype=float
    )
    far = np.array(
        [[0, 0], [100, 0], [0, 100], [-900, -900], [80, 60], [20, 70], [75, 20], [400, 300]], dtype=float
    )
    shown = page(mx.select_warp(corners, far, counts=[3, 4], smoothing=0, criterion="FIT", criteria=[]))
    check_whole(shown)


def test_many_matches_make_no_large_page(tmp_path):
    source = RNG.uniform(0, 1000, (6000, 2))
    target = source + RNG.normal(0, 1, source.shape)
    selection = mx.select_warp(source, target, "GCV", [], counts=[3, 6], smoothing=0)
    selection.report(tmp_path / "report.html")
    shown = Page((tmp_path / "report.html").read_text())
    assert (tmp_path / "report.html").stat().st_size < 1_500_000
    marks = [text for text in shown.texts("title") if text.startswith("match ")]
    assert len(marks) == 2500
    worst = int(np.argmax(selection.warp.residuals(source, target)))
    assert any(mark.startswith(f"match {worst}:") for mark in marks)
    assert any("3500 matches of small errors are not shown" in text for text in shown.texts("figcaption"))


def test_colours_are_those_of_matplotlib():
    values = np.linspace(0, 1, 101)
    expected = 255 * mpl.colormaps["viridis"](values)[:, :3]
    assert np.abs(colours_of(values, 0, 1, FIELD) - expected).max() < 7  # between anchors


def test_pixels_are_read_as_they_were_written():
    pixels = RNG.integers(0, 256, (5, 7, 4), dtype=np.uint8)
    with Image.open(io.BytesIO(base64.b64decode(png(pixels).split(",")[1]))) as image:
        np.testing.assert_array_equal(np.asarray(image), pixels)


@pytest.mark.parametrize("low", [-3e-7, 0.0, 1.0, 12345.6])
@pytest.mark.parametrize("span", [1e-9, 0.37, 1.0, 99.0, 4e12])
def test_ticks_are_few_and_inside(low, span):
    ticks = Scale(low, low + span, 0, 1).ticks()
    assert 2 <= len(ticks) <= 8
    assert all(low - 1e-6 * span <= tick <= low + (1 + 1e-6) * span for tick in ticks)
    positive = Scale(1e-3 + abs(low), 2 + abs(low) + span, 0, 1, logarithmic=True)
    assert len(positive.ticks()) <= 10


@pytest.fixture
def matches(tmp_path):
    path = tmp_path / "m & n.csv"
    np.savetxt(path, np.hstack([SOURCE, WRONG]), delimiter=",", header="x1,y1,x2,y2", comments="")
    return path


def test_the_command_line_writes_a_page_with_what_was_typed(matches, tmp_path, capsys):
    for name in ("a.png", "b.png"):
        Image.fromarray(np.zeros((100, 160), np.uint8)).save(tmp_path / name)
    images = ["--source-image", f"{tmp_path}/a.png", "--target-image", f"{tmp_path}/b.png"]
    words = ["warp", f"{matches}", "--out", f"{tmp_path}/out", "--no-plots", "--quiet", *images]
    words += ["--report", f"{tmp_path}/report.html"]
    assert main(words) == 0
    assert f"{tmp_path}/report.html: all of it on one page" in capsys.readouterr().out
    shown = Page((tmp_path / "report.html").read_text())
    assert shown.texts("code")[0] == f"mexpress warp '{matches}' " + " ".join(words[2:])
    assert "Registration" in shown.texts("h3")
    command = json.loads((tmp_path / "out" / "selection.json").read_text())["command"]
    assert command["report"] == f"{tmp_path}/report.html"
    assert "typed" not in command


def test_the_command_line_prints_json_alone(tmp_path, capsys):
    np.savetxt(tmp_path / "s.csv", SHEET, delimiter=",", header="x,y,z", comments="")
    words = [
        "surface",
        f"{tmp_path}/s.csv",
        "--out",
        f"{tmp_path}/out",
        "--no-plots",
        "--quiet",
        "--unit",
        "cm",
    ]
    assert main([*words, "--json", "--report", f"{tmp_path}/report.html"]) == 0
    json.loads(capsys.readouterr().out)
    assert re.search(r": [\d.]+ cm$", Page((tmp_path / "report.html").read_text()).texts("h1")[0])


def test_a_page_that_cannot_be_written_is_an_error(matches, tmp_path, capsys):
    words = ["warp", f"{matches}", "--out", f"{tmp_path}/out", "--no-plots", "--quiet"]
    assert main([*words, "--report", f"{tmp_path}/none/report.html"]) == 2
    assert "there is no directory" in capsys.readouterr().err
