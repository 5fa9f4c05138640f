import csv
import io
import json
import sys

import numpy as np
import pytest
from rasters import png

import mexpress as mx
from mexpress.cli import main
from mexpress.io.clouds import read_cloud
from mexpress.io.matches import read_points

RNG = np.random.default_rng(2)
ROWS, COLUMNS = np.mgrid[:30, :40]
DEPTH = (2000 + 300 * np.sin(COLUMNS / 6) + 5 * ROWS + RNG.normal(0, 5, ROWS.shape)).astype(np.uint16)
DEPTH[:5, :8] = 0
SHEET = np.column_stack([RNG.uniform(0, 1, (150, 2)), RNG.uniform(0, 1, (150, 3))])
PAPER = ("--smoothing", "0")
FAST = ["--max-count", "12", "--criteria", "FIT,CMPRESS", "--quiet"]


@pytest.fixture
def depth_map(tmp_path):
    path = tmp_path / "depth.png"
    path.write_bytes(png(DEPTH))
    return path


@pytest.fixture
def sheet(tmp_path):
    path = tmp_path / "sheet.csv"
    np.savetxt(path, SHEET, delimiter=",", header="u,v,x,y,z", comments="", fmt="%.17g")
    return path


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "surface.npz"
    mx.fit_surface(SHEET[:, :2], SHEET[:, 2], SHEET[:6, :2]).save(path)
    return path


def test_files_hold_what_the_library_returns(depth_map, run, tmp_path):
    out = tmp_path / "made" / "here"
    options = ["--scale", "500", "--data", "400", "--criterion", "ER5", "--criteria", "FIT,AIC"]
    status, text, errors = run("surface", depth_map, *PAPER, *options, "--max-count", "20", "--out", out)
    assert status == 0, errors
    cloud = read_cloud(depth_map, scale=500, max_data=400)
    expected = mx.select_surface(
        cloud.points,
        cloud.values,
        criterion="ER5",
        criteria=["FIT", "AIC"],
        max_count=20,
        smoothing=0,
    )
    names = ["selection.json", "curves.csv", "surface.npz", "surface.ply", "surface.obj"]
    names += ["curves.png", "surface.png", "residuals.png", "control_points.png"]
    assert text.splitlines()[-1] == f"{out}: {', '.join(names)}"
    assert {path.name for path in out.iterdir()} == set(names)
    assert text.startswith(
        "400 of 1160 depths (40 more are missing), surfaces with 3 to 20 control points; m;"
    )
    assert f"ER5 selects {expected.count} control points" in text
    with (out / "curves.csv").open() as file:
        rows = list(csv.DictReader(file))
    said = json.loads((out / "selection.json").read_text())
    for name, curve in expected.curves.items():
        np.testing.assert_array_equal([float(row[name]) for row in rows], curve)
        np.testing.assert_array_equal(said["curves"][name], curve)
    assert said["selected"] == expected.selected
    assert said["control_points"] == expected.control_points.tolist()
    assert (said["n_data"], said["n_valid"], said["n_missing"]) == (400, 1160, 40)
    assert (said["unit"], said["image_size"]) == ("m", [40, 30])
    residuals = cloud.values - expected.surface(cloud.points)
    assert said["surface"]["residuals"]["rms"] == pytest.approx(np.sqrt((residuals**2).mean()))
    saved = mx.load(out / "surface.npz")
    np.testing.assert_array_equal(saved(cloud.points), expected.surface(cloud.points))
    for name in names[-4:]:
        assert (out / name).stat().st_size > 10_000
    assert "with --intrinsics they are in metres" in errors


def test_options_reach_the_library(sheet, run, tmp_path):
    options = ["--criterion", "kf4", "--criteria", "FIT", "--max-count", "15", "--min-distance", "0.1"]
    options += [
        "--smoothing",
        "0.01",
        "--seed",
        "7",
        "--threads",
        "1",
        "--no-plots",
        "--quiet",
        "--unit",
        "cm",
    ]
    status, text, errors = run("surface", sheet, *PAPER, *options, "--out", tmp_path / "out")
    assert status == 0, errors
    expected = mx.select_surface(
        SHEET[:, :2],
        SHEET[:, 2:],
        criterion="KF4",
        criteria=["FIT"],
        max_count=15,
        min_distance=0.1,
        smoothing=0.01,
        seed=7,
    )
    said = json.loads((tmp_path / "out" / "selection.json").read_text())
    assert said["curves"]["KF4"] == expected.curves["KF4"].tolist()
    assert said["surface"]["dimension"] == 3
    assert not list((tmp_path / "out").glob("*.png"))
    assert text.startswith("150 points in R^3, surfaces with")
    assert "Residuals of the surface, in cm:" in text


def test_every_datum(depth_map, run, tmp_path):
    status, text, errors = run("surface", depth_map, *PAPER, "--all", *FAST, "--no-plots", "--out", tmp_path)
    assert status == 0, errors
    assert text.startswith("1160 depths (40 more are missing)")


def test_points_of_space_by_intrinsics(depth_map, run, tmp_path):
    camera = ["--intrinsics", "50,50,19.5,14.5"]
    status, text, errors = run("surface", depth_map, *PAPER, *camera, *FAST, "--no-plots", "--out", tmp_path)
    assert status == 0, errors
    assert "1160 points in R^3" in text
    assert "; m;" in text
    assert "--intrinsics" not in errors
    centre = mx.load(tmp_path / "surface.npz")([[19.5, 14.5]])[0]
    assert abs(centre[:2]).max() < 0.1
    assert 1.5 < centre[2] < 2.6


def test_values_that_have_no_place_in_space(run, tmp_path):
    np.savez(tmp_path / "d.npz", points=SHEET[:, :2], values=SHEET[:, :4])
    status, text, errors = run("surface", tmp_path / "d.npz", *PAPER, *FAST, "--out", tmp_path / "out")
    assert status == 0, errors
    assert "no meshes and no surface.png" in errors
    assert "surface.ply" not in text
    assert {path.suffix for path in (tmp_path / "out").glob("*.*")} == {".json", ".csv", ".npz", ".png"}


def test_what_limits_the_number_is_told(sheet, run, tmp_path):
    command = ["surface", sheet, *PAPER, "--criterion", "FIT", "--no-plots", "--out", tmp_path]
    _, _, errors = run(*command, "--max-count", "9")
    assert "9 control points are selected, the largest number tried" in errors
    assert "more may be better, see --max-count N and --min-distance D." in errors
    _, _, errors = run(*command, "--placement", "nested", "--max-count", "9")
    assert "more may be better, see --max-count N." in errors


def test_where_scores_end_is_told(run, tmp_path):
    # Two clusters: without one of them, nothing is left to say how the surface goes on there.
    clusters = np.vstack([SHEET[:75, :3] / [20, 20, 1], SHEET[75:, :3] / [20, 20, 1] + [1, 1, 0]])
    np.savetxt(tmp_path / "c.txt", clusters)
    options = ["--min-distance", "0.001", "--max-count", "60", "--quiet", "--no-plots", "--out", tmp_path]
    status, text, errors = run(
        "surface", tmp_path / "c.txt", *PAPER, *options, "--criteria", "ER2", "--criterion", "CMPRESS"
    )
    assert status == 0, errors
    assert " -" in text
    assert "ER2 has no score from " in errors
    assert "does not determine the surface for datum" in errors


def test_without_matplotlib_the_numbers_are_written(sheet, run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    status, _, errors = run("surface", sheet, *PAPER, *FAST, "--out", tmp_path)
    assert status == 0
    assert "pip install 'mexpress[plot]'" in errors
    assert (tmp_path / "surface.npz").exists()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--data", "10", "--all"], "not allowed with argument"),
        (["--data", "3"], "Invalid --data"),
        (["--scale", "0"], "Invalid --scale"),
        (["--scale", "x"], "--scale"),
        (["--intrinsics", "1,2,3"], "must be FX,FY,CX,CY"),
        (["--intrinsics", "0,0,1,1"], "Invalid --intrinsics"),
        (["--max-count", "2"], "--max-count: must be a whole number of at least 3"),
        (["--min-distance", "-1"], "Invalid --min-distance"),
        (["--smoothing", "-1"], "Invalid --smoothing"),
        (["--criterion", "WISDOM"], "Invalid --criterion"),
        (["--counts", "3:9"], "unrecognized arguments"),
        (["--seed", "-1"], "--seed: must be a whole number of at least 0"),
    ],
)
def test_bad_options_are_one_line(depth_map, run, tmp_path, options, says):
    unit = [] if "--scale" in options else ["--scale", "1000"]
    status, text, errors = run(
        "surface", depth_map, *PAPER, *options, *unit, "--quiet", "--out", tmp_path / "out"
    )
    assert (status, text) == (2, "")
    assert says in errors
    assert errors.startswith("mexpress: error: ")
    assert errors.count("\n") == 1


@pytest.mark.parametrize("name", ["no.png", "empty.png", "empty.npy", "empty.npz", "empty.ply", "empty.csv"])
def test_bad_input_is_one_line(run, tmp_path, name):
    if name != "no.png":
        (tmp_path / name).write_bytes(b"")
    status, text, errors = run("surface", tmp_path / name, *PAPER, "--out", tmp_path / "out")
    assert (status, text) == (2, "")
    assert name in errors
    assert errors.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_faults_of_ours_keep_their_traceback(sheet, run, tmp_path, monkeypatch):
    def fault(*_, **__):
        raise ValueError("operands could not be broadcast together")

    monkeypatch.setattr("mexpress.cli.surface.select_surface", fault)
    with pytest.raises(ValueError, match="broadcast"):
        run("surface", sheet, *PAPER, "--out", tmp_path)


@pytest.mark.parametrize("width", [1, 2, 3, 4])
def test_apply_is_the_surface(run, tmp_path, width):
    surface = mx.fit_surface(SHEET[:, :2], SHEET[:, 1 : 1 + width], SHEET[:8, :2])
    surface.save(tmp_path / "s.npz")
    np.savetxt(tmp_path / "p.csv", SHEET[:9, :2], delimiter=",", fmt="%.17g")
    status, text, errors = run("apply", tmp_path / "s.npz", tmp_path / "p.csv")
    assert (status, errors) == (0, "")
    header, *rows = text.splitlines()
    names = {1: "x,y,z", 2: "x,y", 3: "x,y,z", 4: "value1,value2,value3,value4"}
    assert header == names[width] + ",error"
    table = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    values = table[:, 2:-1] if width == 1 else table[:, :-1]
    np.testing.assert_array_equal(values, surface(SHEET[:9, :2]))
    if width == 1:
        np.testing.assert_array_equal(table[:, :2], SHEET[:9, :2])
    np.testing.assert_array_equal(table[:, -1], surface.error(SHEET[:9, :2]))
    status, text, _ = run("apply", tmp_path / "s.npz", tmp_path / "p.csv", "--out", tmp_path / "v.csv")
    assert (status, text) == (0, "")
    if width == 2:
        np.testing.assert_array_equal(read_points(tmp_path / "v.csv"), values)


def test_apply_of_a_depth(run, tmp_path, model):
    (tmp_path / "p.csv").write_text("0.5 0.5\n-3 0.1\n")
    status, text, errors = run("apply", model, tmp_path / "p.csv")
    assert status == 0
    surface, points = mx.load(model), [[0.5, 0.5], [-3, 0.1]]
    (near, far), (expected, guess) = surface(points), surface.error(points)
    assert text == f"x,y,z,error\n0.5,0.5,{near},{expected}\n-3.0,0.1,{far},{guess}\n"
    assert "1 of 2 points are outside the region of the data: the surface extrapolates there" in errors


def test_a_surface_has_no_inverse(run, tmp_path, model):
    (tmp_path / "p.csv").write_text("0.5 0.5\n")
    status, text, errors = run("apply", model, tmp_path / "p.csv", "--inverse")
    assert (status, text) == (2, "")
    assert "--inverse belongs to a warp" in errors
    assert errors.count("\n") == 1


def test_queries_all_over_a_depth_map(depth_map, run, tmp_path):
    out = tmp_path / "out"
    options = ["--data", "150", "--quiet", "--no-plots", "--out", out]
    status, _, errors = run("surface", depth_map, *options, "--queries", "image")
    assert status == 0, errors
    cloud = read_cloud(depth_map, 1000, max_data=150)
    expected = mx.select_surface(cloud.points, cloud.values, queries=(0, 0, 40, 30))
    said = json.loads((out / "selection.json").read_text())
    assert said["curves"]["MATCHED"] == expected.curves["MATCHED"].tolist()


def test_points_have_no_image_for_queries(sheet, run, tmp_path):
    status, _, errors = run("surface", sheet, "--quiet", "--queries", "image", "--out", tmp_path)
    assert status == 2
    assert "--queries image belongs to depth maps" in errors
    assert errors.count("\n") == 1


def test_standard_deviations_of_depths(run, tmp_path):
    sigma = np.random.default_rng(4).uniform(0.5, 2, 150)
    sigma_of = np.column_stack([SHEET[:, :3], sigma])
    np.savetxt(tmp_path / "c.csv", sigma_of, delimiter=",", header="x,y,z,sd", comments="", fmt="%.17g")
    status, _, errors = run(
        "surface", tmp_path / "c.csv", *PAPER, *FAST, "--sigma", "sd", "--no-plots", "--out", tmp_path
    )
    assert status == 0, errors
    expected = mx.select_surface(
        SHEET[:, :2], SHEET[:, 2], criteria=["CMPRESS"], max_count=12, smoothing=0, weights=sigma**-2
    )
    said = json.loads((tmp_path / "selection.json").read_text())
    assert said["curves"]["CMPRESS"] == pytest.approx(expected.curves["CMPRESS"].tolist(), rel=1e-12)


def test_queries_in_a_file(sheet, run, tmp_path):
    (tmp_path / "q.csv").write_text("x,y\n0.2,0.3\n0.9,0.8\n")
    few = ["--max-count", "9", "--no-plots", "--quiet"]
    status, _, errors = run("surface", sheet, "--queries", tmp_path / "q.csv", *few, "--out", tmp_path)
    assert status == 0, errors
    status, _, errors = run("surface", sheet, "--queries", "1,2,3", "--out", tmp_path)
    assert (status, "must be a file, X0,Y0,X1,Y1 or image" in errors) == (2, True)


@pytest.mark.parametrize(
    "values", [[0.0, 1, 2, 3], [[0.0], [1], [2], [3]], [[0.0, 0, 1], [1, 0, 2], [0, 1, 2], [1, 1, 4]]]
)
def test_apply_a_surface_to_no_points(tmp_path, capsys, values):
    square = [[0, 0], [1, 0], [0, 1], [1, 1]]
    mx.fit_surface(square, values, square[:3]).save(tmp_path / "surface.npz")
    (tmp_path / "none.csv").write_text("x,y\n")
    assert main(["apply", str(tmp_path / "surface.npz"), str(tmp_path / "none.csv")]) == 0
    assert capsys.readouterr().out == "x,y,z,error\n"


def test_a_message_names_standard_input(tmp_path, capsys, monkeypatch, model):
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(b"")))
    assert main(["apply", str(model), "-"]) == 2
    errors = capsys.readouterr().err
    assert "standard input" in errors
    assert "surface.npz" not in errors


def test_degrees_are_noted(run, tmp_path):
    points = RNG.uniform([10, 47], [11, 48], (80, 2))
    rows = np.column_stack([points, np.sin(6 * points[:, 0])])
    np.savetxt(tmp_path / "stations.csv", rows, delimiter=",", header="lon,lat,elevation", comments="")
    status, _, errors = run(
        "surface", tmp_path / "stations.csv", "--no-plots", *FAST, "--out", tmp_path / "out"
    )
    assert status == 0, errors
    said = json.loads((tmp_path / "out" / "selection.json").read_text())["notes"]
    assert [note for note in said if "longitudes and latitudes in degrees" in note]
    assert "Project the points first" in errors
