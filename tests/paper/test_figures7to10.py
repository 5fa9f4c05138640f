"""Figures 7 to 10: simulated and supplied depth maps and embeddings, what is written, and the truth."""

import csv
import importlib
import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from rasters import png
from scipy.interpolate import LinearNDInterpolator

import mexpress as mx
from mexpress import simulation
from mexpress.cli import main
from mexpress.io.clouds import read_cloud
from mexpress.paper import EXPERIMENTS, Options
from mexpress.paper.figures7to10 import CRITERIA
from mexpress.paper.plot_panels import PanelFit, plot_fits
from mexpress.paper.surface_data import Subject, read_subject, simulated_depth, simulated_embedding

DATA = Path(__file__).parents[3] / "shared" / "data"
FIGURES = ("figure7", "figure8", "figure9", "figure10")


def run(name, out, data=None, **options):
    return EXPERIMENTS[name].run(Options(data, out, quick=True, progress=False, **options))


def drawn(outcome, out):
    for name, draw in outcome.plots.items():
        draw(out / name)
    return outcome


def choices(outcome):
    return {name: choice["count"] for name, choice in outcome.summary["choices"].items()}


def written(out):
    return sorted(path.name for path in out.iterdir())


@pytest.fixture(scope="module")
def depth(tmp_path_factory):
    """A depth map with holes, as a file; so small that a sweep takes no time."""
    y, x = np.mgrid[:30, :40]
    values = 2 + 0.1 * np.sin(x / 5) + 0.05 * np.cos(y / 4)
    values += 0.01 * np.random.default_rng(0).normal(size=values.shape)
    values[5:9, 10:15] = np.nan
    path = tmp_path_factory.mktemp("data") / "depth.npy"
    np.save(path, values)
    return path


@pytest.fixture(scope="module")
def bent(tmp_path_factory):
    """A half cylinder, as a file."""
    uv = np.random.default_rng(1).uniform(0, 3, (250, 2))
    places = np.column_stack([np.cos(uv[:, 0]), uv[:, 1], np.sin(uv[:, 0])])
    path = tmp_path_factory.mktemp("data") / "bent.npz"
    np.savez(path, uv=uv, points3d=places + 0.01 * np.random.default_rng(2).normal(size=places.shape))
    return path


# ----------------------------------------------------------------------------------------------------- subjects


@pytest.mark.parametrize("simulated", [simulated_depth, simulated_embedding])
def test_the_seed_decides_what_is_simulated(simulated):
    one, same, other = (simulated(300, seed=seed) for seed in (3, 3, 4))
    for name in ("points", "values", "true_points", "true_values"):
        np.testing.assert_array_equal(getattr(one, name), getattr(same, name))
    assert np.abs(one.values - other.values).max() > 0.01


@pytest.mark.parametrize("seed", range(5))
def test_a_simulated_depth_map_has_noise_and_holes(seed):
    subject = simulated_depth(10**6, seed)
    wide, high = map(int, subject.image_size)
    assert 0.85 * wide * high < len(subject.points) < 0.99 * wide * high
    column, row = subject.points.astype(int).T
    truth = subject.true_values.reshape(high, wide)[row, column]
    ratio = (subject.values - truth) / (0.0015 * truth**2)
    assert ratio.std() == pytest.approx(1, abs=0.03)
    assert abs(ratio.mean()) < 0.03
    assert 1.0 < subject.true_values.min() < subject.true_values.max() < 5.0
    seen = np.zeros((high, wide), dtype=bool)
    seen[row, column] = True
    # A hole is a disc: somewhere a whole square is missing, not single pixels.
    assert any(not seen[y : y + 8, x : x + 8].any() for y in range(high - 8) for x in range(wide - 8))


def test_a_simulated_embedding_is_a_sheet_with_noise():
    subject = simulated_embedding(5000, seed=0)
    across = (np.ptp(subject.true_points[:, 1]) / 33, np.ptp(subject.true_points[:, 0]) / 59)
    rows = subject.true_values.reshape(34, 60, 3)
    for axis, step in enumerate(across):  # paper does not stretch
        np.testing.assert_allclose(np.linalg.norm(np.diff(rows, axis=axis), axis=2), step, rtol=5e-3)
    grid = LinearNDInterpolator(subject.true_points, subject.true_values)(subject.points)
    noise = (subject.values - grid)[np.isfinite(grid).all(axis=1)]
    np.testing.assert_allclose(noise.std(axis=0), 0.004, rtol=0.05)


def test_the_embedding_is_a_sheet_of_its_own(monkeypatch):
    """Those of table 1 bend as they must there."""
    module = importlib.import_module(simulation.sheets.__module__)
    monkeypatch.setattr(module, "_sheets", lambda *_: pytest.fail("table 1's sheets are asked for"))
    assert simulated_embedding(50, seed=0).values.shape == (50, 3)


@pytest.mark.parametrize("number", [3, 0, -5, 2.5, "9", None])
@pytest.mark.parametrize("simulated", [simulated_depth, simulated_embedding])
def test_numbers_of_data_that_are_none_are_refused(simulated, number):
    with pytest.raises((ValueError, TypeError), match=r"Invalid number\. .* Given "):
        simulated(number, 0)


def test_the_kind_is_told_from_the_file(depth, bent):
    one, other = (read_subject(path, 200, seed=0) for path in (depth, bent))
    assert (one.dimension, one.image_size, len(one.points)) == (1, (40, 30), 200)
    assert (other.dimension, other.image_size, len(other.points)) == (3, None, 200)
    assert len(one.true_points) == len(other.true_points) == 0
    np.testing.assert_array_equal(one.values, read_cloud(depth, max_data=200, seed=0).values)


# -------------------------------------------------------------------------------------------------------- truth


def test_surfaces_with_too_many_control_points_are_worse_and_the_criteria_see_it(tmp_path):
    outcome = run("figure10", tmp_path, plots=False)
    errors = {name: choice["true_rms"] for name, choice in outcome.summary["choices"].items()}
    assert choices(outcome)["FIT"] == outcome.summary["largest_count"] == 100
    assert errors["TRUTH"] == min(errors.values())
    assert errors["FIT"] > 1.15 * errors["TRUTH"]
    for name in ("GCV", "CMPRESS", "KF10", "ER01", "ER05", "NN01PCT", "DELAUNAY"):
        assert errors[name] < 1.15 * errors["TRUTH"], name
        assert choices(outcome)[name] < 60, name


def test_wide_exclusion_smooths_where_data_are_dense(tmp_path):
    chosen = choices(run("figure8", tmp_path, plots=False))
    assert chosen["NN10PCT"] <= chosen["ER10"] < chosen["ER05"] < chosen["CMPRESS"] <= chosen["FIT"] == 100


# ------------------------------------------------------------------------------------------------- what is written


@pytest.mark.parametrize("name", FIGURES)
def test_every_figure_runs_without_data_from_the_command_line(name, tmp_path, capsys):
    assert not main(["reproduce", name, "--out", str(tmp_path), "--quick", "--quiet"])
    plots = ["_curves.png", "_control_points.png"] if name in ("figure7", "figure9") else [".png"]
    assert written(tmp_path) == sorted(name + ending for ending in (".csv", ".json", *plots))
    for ending in plots:
        assert imread(tmp_path / (name + ending))[..., :3].std() > 0.05
    said = capsys.readouterr().out
    assert "simulated" in said
    assert "true RMS" in said
    summary = json.loads((tmp_path / f"{name}.json").read_text())
    assert set(summary["choices"]) == {*CRITERIA, "TRUTH"}
    assert summary["n_data"] == (2000 if name in ("figure7", "figure8") else 300)


def test_the_table_has_every_criterion_at_every_number(tmp_path, bent):
    outcome = run("figure9", tmp_path, bent, plots=False)
    with (tmp_path / "figure9.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["count", *CRITERIA]
    assert [int(row["count"]) for row in rows] == list(range(3, outcome.summary["largest_count"] + 1))
    for name, choice in outcome.summary["choices"].items():
        curve = np.array([float(row[name]) for row in rows])
        assert choice["count"] == 3 + np.nanargmin(curve)
        assert choice["FIT"] == float(rows[choice["count"] - 3]["FIT"])
        assert np.isnan(choice["true_rms"])
    assert "TRUTH" not in outcome.report


@pytest.mark.parametrize("name", FIGURES)
def test_either_kind_of_file_will_do(name, tmp_path, depth, bent):
    for path, kind in ((depth, "depths"), (bent, "points in R^3")):
        outcome = drawn(run(name, tmp_path, path), tmp_path)
        assert kind in outcome.report
        assert {*outcome.files, *outcome.plots} <= set(written(tmp_path))
        assert len(outcome.plots) == (2 if name in ("figure7", "figure9") else 1)


def test_values_that_have_no_place_in_space_are_not_drawn(tmp_path):
    points = np.random.default_rng(0).uniform(0, 1, (100, 2))
    np.savez(tmp_path / "flow.npz", points=points, values=np.sin(points))
    out = tmp_path / "out"
    out.mkdir()
    outcome = run("figure8", out, tmp_path / "flow.npz")
    assert outcome.files == written(out) == ["figure8.csv"]
    assert not outcome.plots
    assert "R^2 cannot be drawn" in outcome.report


def test_a_criterion_that_is_undefined_everywhere_selects_nothing(tmp_path):
    """All but two of the data are in one small place: without it no plane is determined."""
    random = np.random.default_rng(0)
    points = np.vstack([random.uniform(0, 0.5, (40, 2)), [[50.0, 0.0], [0.0, 50.0]]])
    np.savez(tmp_path / "crowd.npz", points=points, values=random.normal(size=42))
    outcome = drawn(run("figure7", tmp_path, tmp_path / "crowd.npz"), tmp_path)
    assert outcome.summary["choices"]["ER10"] == {"count": None, "FIT": None, "true_rms": None}
    # The two others can be held out: the crowd still determines a plane.
    assert outcome.summary["undefined"]["ER10"] == {"from": 3, "data": 40}
    assert "ER10       -  undefined at every number" in outcome.report
    assert "figure7_curves.png" in written(tmp_path)


def test_an_image_is_said_to_be_in_thousandths(tmp_path):
    depths = np.arange(1000, 2200).astype(np.uint16).reshape(30, 40)
    (tmp_path / "depth.png").write_bytes(png(depths))
    assert "divided by 1000" in run("figure8", tmp_path, tmp_path / "depth.png", plots=False).report


def test_the_number_of_threads_changes_nothing(tmp_path, bent):
    one, two = (run("figure10", tmp_path, bent, threads=n, plots=False) for n in (1, 2))
    np.testing.assert_equal(two.summary, one.summary)  # NaN is NaN


# ---------------------------------------------------------------------------------------------------------- panels


def fits(subject, *selected):
    data = subject.points, subject.values
    return [
        PanelFit((name,), count, 0.5, np.nan, mx.fit_surface(*data, subject.points[:count]))
        for name, count in selected
    ]


def test_the_report_says_which_surfaces_share_a_panel(tmp_path):
    """Else a reader looks for the panels of criteria that have none of their own."""
    outcome = run("figure8", tmp_path)
    said = outcome.report.splitlines()
    (line,) = (line for line in said if line.startswith("The one with ") and "FIT 100" in line)
    assert f"CMPRESS {choices(outcome)['CMPRESS']}" in line
    assert "8%" in outcome.report
    assert "share a panel" not in run("figure8", tmp_path, plots=False).report
    assert "share a panel" not in run("figure7", tmp_path).report


def test_all_panels_have_the_same_size_and_colours_are_explained_once():
    subject = simulated_depth(300, seed=0)
    chosen = [("NN10PCT", 5), ("NN05PCT", 10), ("ER10", 20), ("ER05", 40), ("FIT", 80)]
    figure = plot_fits(subject, fits(subject, *chosen))
    figure.canvas.draw()
    maps = [axes for axes in figure.axes if axes.images]
    assert len(maps) == 5
    sizes = np.array([axes.get_position().size for axes in maps])
    assert np.ptp(sizes, axis=0).max() < 1e-6
    assert len({round(axes.get_position().x0, 6) for axes in maps}) == 3
    assert sum(bool(axes.get_ylabel()) for axes in figure.axes) == 2


def titles(figure):
    return [text for axes in figure.axes if (text := axes.get_title(loc="left"))]


def test_surfaces_that_look_alike_share_a_panel():
    subject = simulated_embedding(200, seed=0)
    figure = plot_fits(subject, fits(subject, ("FIT", 50), ("ER10", 20), ("CMPRESS", 48), ("ER05", 21)))
    assert titles(figure) == ["ER10 20, ER05 21\nwith 20: FIT 0.5", "CMPRESS 48, FIT 50\nwith 48: FIT 0.5"]


def test_depths_are_beside_the_data():
    subject = simulated_depth(300, seed=0)
    figure = plot_fits(subject, fits(subject, ("ER10", 10), ("FIT", 30)))
    assert titles(figure) == ["simulated depth map\n300 data", "ER10 10\nFIT 0.5 m", "FIT 30\nFIT 0.5 m"]
    maps = [axes for axes in figure.axes if axes.images]
    assert len(maps) == 2
    assert all(axes.yaxis_inverted() for axes in maps)
    assert not np.allclose(*(np.resize(axes.images[0].get_array(), 1000) for axes in maps))


def test_a_flat_surface_has_the_colours_of_its_depth():
    """No shade on what is level."""
    points = np.random.default_rng(0).uniform(0, 10, (60, 2))
    subject = Subject("plane", points, np.full(60, 5.0), None, None, np.zeros((0, 2)), np.zeros(0))
    figure = plot_fits(subject, fits(subject, ("ER10", 5)))
    shown = next(axes.images[0].get_array() for axes in figure.axes if axes.images)
    inside = shown[shown[..., 3] > 0]
    assert len(inside) > 1000
    assert np.ptp(inside, axis=0).max() < 1e-3


# ------------------------------------------------------------------------------------------------------- real data


@pytest.mark.skipif(not DATA.is_dir(), reason=f"there is no folder {DATA.parts[-2:]} beside the checkout")
@pytest.mark.parametrize(
    ("name", "file", "fewest"),
    [
        ("figure8", "depth/TUM_depth.png", 90),
        ("figure7", "depth/depth_00000.png", 90),
        ("figure10", "sheets/bent_paper_239.npz", 40),
        ("figure9", "sheets/bent_paper_239.npz", 40),
    ],
)
def test_real_data(name, file, fewest, tmp_path):
    outcome = drawn(run(name, tmp_path, DATA / file), tmp_path)
    print(outcome.report)
    chosen = choices(outcome)
    assert chosen["FIT"] == outcome.summary["largest_count"] == 100
    assert chosen["CMPRESS"] >= fewest
    assert chosen["NN10PCT"] <= chosen["NN05PCT"] < chosen["CMPRESS"]
    assert {*outcome.files, *outcome.plots} <= set(written(tmp_path))
