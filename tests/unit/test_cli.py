import contextlib
import csv
import io
import json
import subprocess
import sys

import numpy as np
import pytest
from matplotlib.image import imsave
from PIL import Image
from rasters import png

import mexpress as mx
from mexpress.cli import main
from mexpress.cli.report import table
from mexpress.io.image_writing import write_image
from mexpress.io.images import read_image
from mexpress.io.matches import read_points, write_matches
from mexpress.liftings import ThinPlateSpline
from mexpress.progress import bar
from mexpress.versions import versions

RNG = np.random.default_rng(1)
SOURCE = RNG.uniform(0, 1, (80, 2)) * [640, 480]
TARGET = 0.9 * SOURCE + 15 * np.sin(SOURCE[:, ::-1] / 150) + RNG.normal(0, 0.3, SOURCE.shape)
PAPER = ("--smoothing", "0")
COMMANDS = ["warp", "surface", "apply", "info", "suspects", "reproduce"]
SIZE = ["--image-size", "640x480"]


@pytest.fixture
def matches(tmp_path):
    path = tmp_path / "matches.csv"
    write_matches(path, SOURCE, TARGET)
    return str(path)


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "warp.npz"
    mx.fit_warp(SOURCE, TARGET, SOURCE[:6]).save(path)
    return path


def selected_here(**options):
    return mx.select_warp(SOURCE, TARGET, image_size=(640, 480), **{"smoothing": 0} | options)


def test_files_hold_what_the_library_returns(matches, run, tmp_path):
    out = tmp_path / "made" / "here"
    status, text, errors = run(
        "warp", matches, *PAPER, *SIZE, "--criteria", "FIT,ER5,BIC", "--counts", "3:18", "--out", out
    )
    assert status == 0, errors
    expected = selected_here(criteria=["FIT", "ER5", "BIC"], counts=range(3, 19))
    assert f"ER10 selects {expected.count} control points" in text
    assert "selection.json, curves.csv, warp.npz, curves.png, warp.png" in text
    with (out / "curves.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["count"]) for row in rows] == expected.counts.tolist()
    said = json.loads((out / "selection.json").read_text())
    assert said["versions"] == versions()
    assert said["selected"] == expected.selected
    assert said["count"] == expected.count
    assert said["command"]["counts"] == list(range(3, 19))
    assert said["image_size"] == [640, 480]
    for name, curve in expected.curves.items():
        np.testing.assert_array_equal([float(row[name]) for row in rows], curve)
        np.testing.assert_array_equal(np.array(said["curves"][name], dtype=float), curve)
    np.testing.assert_array_equal(mx.load(out / "warp.npz")(SOURCE), expected.warp(SOURCE))
    for name in ("curves.png", "warp.png"):
        assert (out / name).stat().st_size > 10_000


def test_options_reach_the_library(matches, run, tmp_path):
    options = [
        "--criterion",
        "cmpress",
        "--no-fractional",
        "--counts",
        "3,9,12",
        "--smoothing",
        "2",
        "--seed",
        "5",
        "--threads",
        "1",
    ]
    status, _, errors = run("warp", matches, *PAPER, *options, "--no-plots", "--quiet", "--out", tmp_path)
    assert status == 0, errors
    expected = mx.select_warp(
        SOURCE, TARGET, criterion="CMPRESS", fractional=False, counts=[3, 9, 12], smoothing=2, seed=5
    )
    said = json.loads((tmp_path / "selection.json").read_text())
    assert said["criterion"] == "CMPRESS"
    assert said["curves"]["CMPRESS"] == expected.curves["CMPRESS"].tolist()
    assert not said["warp"]["fractional"]
    assert not list(tmp_path.glob("*.png"))


def test_images(matches, run, tmp_path):
    images = RNG.random((480, 640)), RNG.random((400, 500, 3))
    names = [tmp_path / "left.png", tmp_path / "right.png"]
    for name, image in zip(names, images, strict=True):
        imsave(name, image)
    pair = ["--source-image", names[0], "--target-image", names[1]]
    status, text, errors = run("warp", matches, *PAPER, *pair, "--counts", "3:8", "--out", tmp_path)
    assert status == 0, errors
    assert (tmp_path / "registered.png").stat().st_size > 10_000
    assert "registered.png" in text
    # The size comes from the image.
    assert json.loads((tmp_path / "selection.json").read_text())["image_size"] == [640, 480]


def test_undefined_scores_are_null_and_told(run, tmp_path):
    # Two clusters: without one of them, nothing is left to say how the plane bends there.
    clusters = np.vstack([SOURCE[:40] / 20, SOURCE[40:] / 20 + [600, 440]])
    write_matches(tmp_path / "m.csv", clusters, 1.1 * clusters + RNG.normal(0, 0.1, clusters.shape))
    options = ["--criteria", "FIT,CMPRESS", "--criterion", "CMPRESS", "--counts", "3:50"]
    status, text, errors = run("warp", tmp_path / "m.csv", *PAPER, *options, "--quiet", "--out", tmp_path)
    said = json.loads((tmp_path / "selection.json").read_text())
    assert status == 0, errors
    assert None in said["curves"]["CMPRESS"]
    assert " -" in text
    assert "CMPRESS has no score " in errors


def test_without_matplotlib_the_numbers_are_written(matches, run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    status, _, errors = run("warp", matches, *PAPER, "--counts", "3:5", "--out", tmp_path)
    assert status == 0
    assert "pip install 'mexpress[plot]'" in errors
    assert (tmp_path / "selection.json").exists()


def test_without_an_image_reader_the_extra_is_named(matches, run, tmp_path, monkeypatch):
    (tmp_path / "left.png").write_bytes(png(np.eye(9, dtype=np.uint8)))
    monkeypatch.setitem(sys.modules, "PIL", None)
    pair = ["--source-image", tmp_path / "left.png", "--target-image", "right.png"]
    status, _, errors = run("warp", matches, *PAPER, *pair, "--out", tmp_path / "out")
    assert status == 2
    assert "pip install 'mexpress[image]'" in errors
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--image-size", "640"], "must be WIDTHxHEIGHT"),
        (["--image-size", "0x480"], "must be WIDTHxHEIGHT"),
        (["--image-size", "nanx480"], "must be WIDTHxHEIGHT"),
        (["--image-size", "-640x480"], "--image-size"),
        (["--criterion", "WISDOM"], "Invalid --criterion"),
        (["--criteria", "FIT,WISDOM"], "Invalid --criteria"),
        (["--counts", "3:2"], "--counts"),
        (["--counts", "a:b"], "--counts"),
        (["--counts", "3:9:0"], "--counts"),
        (["--counts", "3:4:5:6"], "--counts"),
        (["--counts", "2:9"], "Invalid --counts"),
        (["--counts", "200:200"], "Invalid --counts"),
        (["--lifting", "rubber"], "Invalid --lifting"),
        (["--placement", "anywhere"], "Invalid --placement"),
        (["--smoothing", "-1"], "Invalid --smoothing"),
        (["--threads", "0"], "--threads: must be a whole number of at least 1"),
        (["--seed", "-1"], "--seed: must be a whole number of at least 0"),
        (["--seed", "x"], "--seed"),
        (["--source-image", "left.png"], "belong together"),
        (["--source-image", "no.png", "--target-image", "no.png"], "no.png: No such file"),
        (["--wisdom"], "unrecognized arguments"),
    ],
)
def test_bad_options_are_one_line(matches, run, tmp_path, options, says):
    status, text, errors = run("warp", matches, *PAPER, *options, "--quiet", "--out", tmp_path / "out")
    assert (status, text) == (2, "")
    assert says in errors
    assert errors.startswith("mexpress: error: ")
    assert errors.count("\n") == 1


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (None, "No such file"),
        ("", "Invalid matches"),
        ("1,2,3\n", "3 columns in m.csv"),
        ("1,2,3,4\n1,nan,3,4\n", "line 2"),
        ("1,2,3,4\n1,oops,3,4\n", "line 2"),
        ("1,2,3,4\n", "Invalid source"),
        ("1,2,3,4\n5,6,7,8\n9,10,1,2\n4,5,6,7\n", "not on a line"),
    ],
)
def test_bad_matches_are_one_line(run, tmp_path, content, says):
    path = tmp_path / "m.csv"
    if content is not None:
        path.write_text(content)
    status, text, errors = run("warp", path, *PAPER, "--quiet", "--out", tmp_path / "out")
    assert (status, text) == (2, "")
    assert says in errors
    assert errors.count("\n") == 1


def test_damaged_images_are_one_line(matches, run, tmp_path):
    (tmp_path / "left.png").write_bytes(b"not a picture")
    pair = ["--source-image", tmp_path / "left.png", "--target-image", tmp_path / "left.png"]
    status, _, errors = run("warp", matches, *PAPER, *pair, "--out", tmp_path / "out")
    assert status == 2
    assert "Invalid image" in errors
    assert errors.count("\n") == 1


def test_an_output_that_is_a_file_is_one_line(matches, run):
    status, _, errors = run("warp", matches, *PAPER, "--out", matches)
    assert status == 2
    assert errors.endswith("matches.csv: a file, where a directory should be\n")


def test_faults_of_ours_keep_their_traceback(matches, run, tmp_path, monkeypatch):
    def fault(*_, **__):
        raise ValueError("operands could not be broadcast together")

    monkeypatch.setattr("mexpress.cli.warp.select_warp", fault)
    with pytest.raises(ValueError, match="broadcast"):
        run("warp", matches, *PAPER, "--out", tmp_path)


def test_interruption_is_no_traceback(matches, run, tmp_path, monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("mexpress.cli.warp.select_warp", interrupt)
    assert run("warp", matches, *PAPER, "--out", tmp_path) == (130, "", "mexpress: error: interrupted\n")


def test_apply_is_the_warp(run, tmp_path, model):
    np.savetxt(tmp_path / "p.csv", SOURCE, delimiter=",", fmt="%.17g")
    status, text, _ = run("apply", model, tmp_path / "p.csv")
    assert status == 0
    (tmp_path / "mapped.csv").write_text(text)
    np.testing.assert_array_equal(read_points(tmp_path / "mapped.csv"), mx.load(model)(SOURCE))
    status, text, _ = run(
        "apply", model, tmp_path / "mapped.csv", "--inverse", "--out", tmp_path / "back.csv"
    )
    assert (status, text) == (0, "")
    np.testing.assert_allclose(read_points(tmp_path / "back.csv"), SOURCE, atol=1e-6)


def test_apply_tells_where_it_extrapolates(run, tmp_path, model):
    (tmp_path / "p.csv").write_text("320 240\n-50 10\n")
    status, text, errors = run("apply", model, tmp_path / "p.csv")
    assert status == 0
    assert len(text.splitlines()) == 3
    assert "1 of 2 points are outside the region of the matches" in errors


@pytest.mark.parametrize("inverse", [False, True])
def test_apply_moves_an_image(run, tmp_path, model, inverse):
    photo = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    write_image(tmp_path / "photo.PNG", photo)
    command = "apply", model, tmp_path / "photo.PNG", "--out", tmp_path / "aligned.png", "--size", "80x50"
    status, text, errors = run(*command, *(["--inverse"] if inverse else []))
    assert (status, text) == (0, "")
    expected = mx.load(model).remap(photo, (80, 50), inverse=inverse)
    assert expected.any()
    marks = mx.load(model).remap(np.ones((48, 64)), (80, 50), inverse=inverse, fill=np.nan)
    lost = np.isnan(marks).sum()
    assert 0 < lost < 4000
    assert errors == f"mexpress: {lost} of 4000 pixels come from nowhere in the image, and are 0\n"
    np.testing.assert_array_equal(read_image(tmp_path / "aligned.png"), expected)


def test_apply_tells_which_pixels_come_from_nowhere(run, tmp_path):
    spline = ThinPlateSpline([[0, 0], [1, 0], [0, 1]])
    parameters = np.column_stack([[1.0, 2, 1], [1.0, 1, 2], [1.0, 0, 1]])  # the denominator is 1 - x
    mx.Warp(spline, parameters, [[0, 0], [0.5, 0], [0, 0.5]]).save(tmp_path / "horizon.npz")
    write_image(tmp_path / "photo.jpg", np.full((4, 6), 9, np.uint8))
    command = (
        "apply",
        tmp_path / "horizon.npz",
        tmp_path / "photo.jpg",
        "--inverse",
        "--out",
        tmp_path / "out.tif",
    )
    status, text, errors = run(*command)
    assert (status, text) == (0, "")
    assert errors == "mexpress: 21 of 24 pixels come from nowhere in the image, and are 0\n"
    assert (read_image(tmp_path / "out.tif")[:, 1:] == 0).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "--out must be given for an image"),
        (["--out", "aligned.csv"], "--out must be given for an image, and end in one of .bmp"),
        (["--out", "aligned.png", "--size", "5"], "must be WIDTHxHEIGHT in pixels"),
        (["--out", "aligned.png", "--size", "0x5"], "must be WIDTHxHEIGHT in pixels"),
        (
            ["--out", "aligned.jpg"],
            "Invalid --out. It must end as a format that holds such an image. Given aligned.jpg",
        ),
    ],
)
def test_apply_refuses_images_that_it_cannot_write(run, tmp_path, model, options, message):
    write_image(tmp_path / "photo.png", np.full((4, 6), 9, np.uint16))
    options = [tmp_path / name if name.startswith("aligned") else name for name in options]
    status, text, errors = run("apply", model, tmp_path / "photo.png", *options)
    assert (status, text) == (2, "")
    assert message in errors
    assert {file.name for file in tmp_path.iterdir()} >= {"photo.png"}
    assert not list(tmp_path.glob("aligned*"))


@pytest.mark.parametrize("inverse", [False, True])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_apply_tells_where_an_image_is_that_is_not_in_the_result(run, tmp_path, inverse, channels):
    square = np.array([[0, 0], [100, 0], [0, 100], [100, 100]])
    utm = square * [0.5, -0.5] + [500_000, 5_000_000]
    mx.fit_warp(square, utm, square[:3], fractional=False).save(tmp_path / "utm.npz")
    write_image(tmp_path / "photo.png", np.full((48, 64, *channels), 9, np.uint8))
    command = "apply", tmp_path / "utm.npz", tmp_path / "photo.png", "--out", tmp_path / "out.png"
    status, _, errors = run(*command, *(["--inverse"] if inverse else []))
    lost = "3072 of 3072 pixels come from nowhere in the image, and are 0"
    what = "they would be at" if inverse else "it is moved to"
    expected = f"{lost}: {what} x 500000 to 500031.5, y 4999976.5 to 5000000"
    assert (status, errors) == (0, f"mexpress: {expected}\n")
    assert read_image(tmp_path / "out.png").shape == (48, 64, *channels)
    assert not read_image(tmp_path / "out.png").any()


@pytest.mark.parametrize(
    ("file", "options", "message"),
    [
        ("p.csv", ["--size", "6x4"], "--size belongs to an image, and POINTS is none"),
        (
            "photo.png",
            ["--columns", "1,2"],
            "--columns and --missing belong to points, and POINTS is an image",
        ),
        ("photo.png", ["--missing", "0"], "--columns and --missing belong to points, and POINTS is an image"),
    ],
)
def test_apply_ignores_no_option(run, tmp_path, model, file, options, message):
    (tmp_path / "p.csv").write_text("1,2\n")
    write_image(tmp_path / "photo.png", np.full((4, 6), 9, np.uint8))
    status, text, errors = run("apply", model, tmp_path / file, "--out", tmp_path / "out.tif", *options)
    assert (status, text, (tmp_path / "out.tif").exists()) == (2, "", False)
    assert message in errors


def test_warnings_of_apply_count_the_same_points(run, tmp_path):
    spline = ThinPlateSpline([[0, 0], [1, 0], [0, 1]])
    parameters = np.column_stack([[1.0, 2, 1], [1.0, 1, 2], [1.0, 0, 1]])  # the denominator is 1 - x
    mx.Warp(spline, parameters, [[0, 0], [0.5, 0], [0, 0.5]]).save(tmp_path / "horizon.npz")
    (tmp_path / "p.csv").write_text("x,y\n0.1,0.1\nnan,0\n2,0\n3,0\n0.2,0.2\n")
    errors = run("apply", tmp_path / "horizon.npz", tmp_path / "p.csv")[2].splitlines()
    assert [line[:23] for line in errors] == [f"mexpress: {n} of 5 points" for n in (1, 2, 2)]


def test_the_error_of_a_point_without_an_image_is_nan(run, tmp_path):
    random = np.random.default_rng(0)
    source = random.uniform(0, 400, (80, 2))
    target = source / (1 - source[:, :1] / 600) + random.normal(0, 0.1, source.shape)
    mx.fit_warp(source, target, source[:3]).save(tmp_path / "warp.npz")
    (tmp_path / "p.csv").write_text("x,y\n900,100\n200,200\n")
    lines = run("apply", tmp_path / "warp.npz", tmp_path / "p.csv")[1].splitlines()
    assert lines[:2] == ["x,y,error", "nan,nan,nan"]
    assert "nan" not in lines[2]


def test_what_nothing_is_mapped_to_has_no_origin(run, tmp_path):
    square = [[0, 0], [1, 0], [0, 1], [1, 1]]
    flat = mx.Warp(ThinPlateSpline(square[:3]), [[0.0, 0], [1, 0], [0, 0]], square)
    flat.save(tmp_path / "flat.npz")
    (tmp_path / "p.csv").write_text("x,y\n0.5,3\nnan,0\n")
    _, text, errors = run("apply", tmp_path / "flat.npz", tmp_path / "p.csv", "--inverse")
    assert text.splitlines()[1:] == ["nan,nan", "nan,nan"]
    assert "mexpress: 1 of 2 points have no origin" in errors


@pytest.mark.parametrize(
    "name", ["al.png", "al.JPG", "al.gif", "r.npy", "w.npz", "r.parquet", "r.json", "r.ply"]
)
def test_apply_writes_no_points_under_the_name_of_something_else(run, tmp_path, model, name):
    (tmp_path / "p.csv").write_text("1,2\n")
    (tmp_path / name).write_bytes(b"an image")
    status, text, errors = run("apply", model, tmp_path / "p.csv", "--out", tmp_path / name)
    assert (status, text) == (2, "")
    assert f"--out must be text, such as points.csv, for points, not {name}" in errors
    assert (tmp_path / name).read_bytes() == b"an image"


@pytest.mark.parametrize("name", ["photo.gif", "photo.pfm"])
def test_apply_reads_images_that_it_does_not_write(run, tmp_path, model, name):
    pixels = np.random.default_rng(0).integers(0, 256, (48, 64), dtype=np.uint8)
    if name.endswith("gif"):
        Image.fromarray(pixels).save(tmp_path / name)
    else:
        rows = pixels[::-1].astype("<f4").tobytes()
        (tmp_path / name).write_bytes(b"Pf 64 48 -1.0 " + rows)
    status, _, errors = run("apply", model, tmp_path / name, "--out", tmp_path / "out.tif")
    assert (status, errors.count("\n")) == (0, 1)  # some pixels come from nowhere
    image = read_image(tmp_path / name)
    np.testing.assert_array_equal(read_image(tmp_path / "out.tif"), mx.load(model).remap(image))


@pytest.mark.parametrize("white", [100, 255, 4095, 65535])
@pytest.mark.parametrize(("kind", "ending"), [("P5", ".pgm"), ("P6", ".ppm")])
def test_apply_keeps_what_is_white(run, tmp_path, white, kind, ending):
    shape = (5, 7) if kind == "P5" else (5, 7, 3)
    pixels = np.random.default_rng(0).integers(0, white + 1, shape).astype("u1" if white < 256 else ">u2")
    (tmp_path / f"photo{ending}").write_bytes(f"{kind} 7 5 {white}\n".encode() + pixels.tobytes())
    square = np.array([[0, 0], [4, 0], [0, 4], [4, 4]])
    mx.fit_warp(square, square, square[:3], fractional=False).save(tmp_path / "same.npz")
    out = tmp_path / f"out{ending}"
    assert run("apply", tmp_path / "same.npz", tmp_path / f"photo{ending}", "--out", out)[0] == 0
    assert out.read_bytes() == f"{kind}\n7 5\n{white}\n".encode() + pixels.tobytes()
    run("apply", tmp_path / "same.npz", tmp_path / f"photo{ending}", "--out", tmp_path / "out.png")
    if pixels.dtype == np.uint8 or kind == "P5":  # samples of formats that do not say what is white
        np.testing.assert_array_equal(read_image(tmp_path / "out.png"), pixels)


def test_an_image_that_nobody_reads_is_called_an_image(run, tmp_path, model):
    (tmp_path / "photo.exr").write_bytes(b"\x76\x2f\x31\x01")
    status, _, errors = run("apply", model, tmp_path / "photo.exr", "--out", tmp_path / "out.tif")
    assert status == 2
    assert "Invalid image. It must be a whole image. Endings that are read: .png, .jpg" in errors
    assert "photo.exr" in errors


def test_apply_moves_no_image_by_a_surface(run, tmp_path):
    square = [[0, 0], [2, 0], [0, 2], [2, 2]]
    mx.fit_surface(square, [0, 1, 2, 3], square).save(tmp_path / "surface.npz")
    write_image(tmp_path / "photo.png", np.full((4, 6), 9, np.uint8))
    status, _, errors = run(
        "apply", tmp_path / "surface.npz", tmp_path / "photo.png", "--out", tmp_path / "a.png"
    )
    assert status == 2
    assert "an image is moved by a warp" in errors


@pytest.mark.parametrize("content", [None, b"", b"PK\x03\x04", b"1,2\n"])
def test_apply_with_a_bad_model_is_one_line(run, tmp_path, content):
    (tmp_path / "p.csv").write_text("1,2\n")
    if content is not None:
        (tmp_path / "m.npz").write_bytes(content)
    status, text, errors = run("apply", tmp_path / "m.npz", tmp_path / "p.csv")
    assert (status, text) == (2, "")
    assert errors.count("\n") == 1


@pytest.mark.parametrize("arguments", [[], ["wrap"], ["warp"], ["apply", "m.npz"]])
def test_incomplete_commands_are_one_line(run, arguments):
    status, _, errors = run(*arguments)
    assert status == 2
    assert errors.count("\n") == 1


@pytest.mark.parametrize(
    "arguments",
    [["--version"], ["--help"], ["warp", "--help"], ["surface", "--help"], ["apply", "--help"]],
)
def test_help(arguments, capsys):
    with pytest.raises(SystemExit) as left:
        main(arguments)
    assert left.value.code == 0
    assert "mexpress" in capsys.readouterr().out


def test_as_a_process_whose_reader_leaves(tmp_path, model):
    np.savetxt(tmp_path / "p.csv", np.tile(SOURCE, (1000, 1)))
    command = [sys.executable, "-m", "mexpress", "apply", str(model), str(tmp_path / "p.csv")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "x,y,error\n"
        process.stdout.close()
        assert process.stderr.read() == ""


def test_table_marks_minima_and_always_shows_them():
    selection = selected_here(counts=range(3, 41))
    text = table(selection, most_rows=10)
    header, *rows, note = text.splitlines()
    assert header.split() == ["points", "FIT", "PRESS", "CMPRESS", "ER10"]
    assert note == f"({len(rows)} of 38 numbers of control points; all are in the curves)"
    shown = {int(row.split()[0]): row.split()[1:] for row in rows}
    assert {3, 40} <= shown.keys()
    for column, (name, count) in enumerate(selection.selected.items()):
        assert shown[count][column].endswith("*"), name
    assert text.count("*") == 4
    assert len(table(selection, most_rows=38).splitlines()) == 39


def test_a_long_table_is_shortened_and_keeps_its_ends():
    counts = np.arange(3, 176)
    curves = {f"ER{k}": (counts - 10.0 * k) ** 2 + 1 for k in range(1, 12)}
    rows = table(mx.Selection("ER1", counts, curves, {})).splitlines()[1:-1]
    shown = [int(row.split()[0]) for row in rows]
    assert len(shown) <= 25
    assert {3, 175, *range(10, 111, 10)} <= set(shown)
    assert max(np.diff(shown)) < 60


def test_a_wide_table_is_broken_between_criteria():
    counts = np.arange(3, 6)
    curves = {f"ER{k}": np.full(3, 1.0 + k) for k in range(1, 12)}
    lines = table(mx.Selection("ER1", counts, curves, {}), width=60).splitlines()
    assert max(map(len, lines)) <= 60
    headers = [line.split() for line in lines if "points" in line]
    assert len(headers) > 1
    assert all(header[0] == "points" for header in headers)
    assert [name for header in headers for name in header[1:]] == list(curves)
    assert len(table(mx.Selection("ER1", counts, curves, {}), width=3).splitlines()) == 11 * 5 - 1


def terminal():
    stream = io.StringIO()
    stream.isatty = lambda: True
    return stream


def progress_of(stream, seconds, costs=None):
    """Return what is written during steps of the given durations."""
    now = [0.0]
    with bar(costs or [1] * len(seconds), "warp", stream, lambda: now[0]) as step:
        for duration in seconds:
            now[0] += duration
            step()
    return stream.getvalue()


def test_short_work_shows_no_progress():
    assert progress_of(terminal(), [0.01] * 50) == ""
    assert progress_of(io.StringIO(), [0.01] * 50) == ""


def test_a_terminal_has_one_line_that_is_wiped():
    text = progress_of(terminal(), [0.25] * 40)
    assert "\n" not in text
    assert "warp: 20 of 40, 5 s left" in text
    assert text.split("\r")[-2].strip() == ""


def test_the_time_left_is_what_the_costs_left_will_take():
    seconds = [0.01 * count**2 for count in range(1, 60)]
    total, done = sum(seconds), 0.0
    lines = iter(progress_of(io.StringIO(), seconds, costs=[7 * s for s in seconds]).splitlines())
    line = next(lines)
    for k, second in enumerate(seconds, 1):
        done += second
        if line.startswith(f"warp: {k} of 59, "):
            minutes, left = divmod(round(total - done), 60)
            assert line.endswith(f", {f'{minutes} min ' if minutes else ''}{left} s left")
            line = next(lines, "")
    assert not line


def test_a_sweep_knows_that_more_control_points_cost_more(monkeypatch):
    costs, steps = [], []

    @contextlib.contextmanager
    def recorded(given, label):
        costs.extend(given)
        yield lambda: steps.append(label)

    monkeypatch.setattr("mexpress.progress.bar", recorded)
    source, target = np.random.default_rng(0).uniform(0, 100, (2, 60, 2))
    mx.select_warp(
        source, target, "FIT", counts=[3, 6, 12], smoothing=[1, 2], placement="lloyd", progress=True
    )
    assert len(costs) == len(steps) == 6
    assert costs[1] < costs[3] < costs[5]
    assert costs[::2] == [3 * cost for cost in costs[1::2]]  # the first comes with the basis of both


def test_a_log_has_few_lines():
    lines = progress_of(io.StringIO(), [0.5] * 400).splitlines()
    assert len(lines) == 40
    assert lines[0] == "warp: 2 of 400, 3 min 19 s left"


def test_no_stream_no_progress(monkeypatch, capsys):
    monkeypatch.setattr(sys, "stderr", None)
    times = iter([0.0, 9.0])
    with bar([1], "warp", clock=times.__next__) as step:
        step()
    assert list(times) == []  # the step was taken
    assert capsys.readouterr() == ("", "")


def test_weights_are_tabulated_and_written(matches, tmp_path, capsys):
    out = tmp_path / "out"
    code = main(
        [
            "warp",
            str(matches),
            "--out",
            str(out),
            "--counts",
            "3,9",
            "--smoothing",
            "0,100,1e4",
            "--criterion",
            "CMPRESS",
            "--criteria",
            "FIT",
            "--no-plots",
            "--quiet",
        ]
    )
    assert code == 0
    selection = mx.select_warp(
        SOURCE, TARGET, criterion="CMPRESS", criteria=["FIT"], counts=[3, 9], smoothing=[0, 100, 1e4]
    )
    said = capsys.readouterr().out
    assert f"control points and smoothing {selection.smoothing:.3g}" in said
    heads = [line.split()[:2] for line in said.splitlines()[2:6]]
    k = selection.place[0]
    expected = [
        [f"{w:.3g}", f"{p:.1f}"] for w, p in zip(selection.weights, selection.parameters[k], strict=True)
    ]
    assert heads == [["smoothing", "parameters"], *expected]
    table = np.genfromtxt(out / "curves.csv", delimiter=",", names=True)
    np.testing.assert_array_equal(table["count"], np.repeat([3, 9], 3))
    np.testing.assert_array_equal(table["smoothing"], np.tile([0, 100, 1e4], 2))
    np.testing.assert_array_equal(table["CMPRESS"], selection.maps["CMPRESS"].ravel())
    summary = json.loads((out / "selection.json").read_text())
    assert summary["smoothing"] == selection.smoothing
    assert summary["maps"]["FIT"] == selection.maps["FIT"].tolist()
    assert summary["weights"] == [0, 100, 1e4]


@pytest.mark.parametrize("weights", ["abc", "1,x", ""])
def test_weights_that_are_none(weights, matches, tmp_path, capsys):
    assert main(["warp", str(matches), "--out", str(tmp_path), "--smoothing", weights]) == 2
    assert "must be a weight" in capsys.readouterr().err


@pytest.fixture
def commands_of_others(tmp_path, monkeypatch):
    """Another package in the environment, which brings a command, one that is broken, and one that has our name."""
    package = tmp_path / "acme-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: acme\nVersion: 1.0\n")
    points = ("shout = acme:add_shout", "broken = acme_that_is_gone:add", "warp = acme:add_warp")
    (package / "entry_points.txt").write_text("\n".join(["[mexpress.commands]", *points, ""]))
    (tmp_path / "acme.py").write_text(
        "def add_shout(commands):\n"
        "    parser = commands.add_parser('shout', help='say it loudly')\n"
        "    parser.set_defaults(run=lambda arguments: print('HELLO'))\n"
        "def add_warp(commands):\n"
        "    commands.add_parser('warp', help='engage')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)


def commands_in_help(text):
    """Return the names below the title "commands", in their order."""
    return [line.split()[0] for line in text.partition("COMMAND\n")[2].splitlines() if line[4] != " "]


def test_commands_have_an_order_of_their_own(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    assert commands_in_help(capsys.readouterr().out) == COMMANDS


@pytest.mark.usefixtures("commands_of_others")
def test_other_packages_have_commands_and_a_broken_one_costs_no_other(run, matches, tmp_path, capsys):
    with pytest.raises(SystemExit) as left:
        main(["--help"])
    captured = capsys.readouterr()
    assert left.value.code == 0
    assert commands_in_help(captured.out) == [*COMMANDS, "shout"]
    assert captured.err.splitlines()[0] == (
        "mexpress: no command broken. ModuleNotFoundError: No module named 'acme_that_is_gone'"
    )
    assert run("shout") == (0, "HELLO\n", "")
    status, _, errors = run("broken")
    assert status == 2
    assert "no command broken. ModuleNotFoundError" in errors
    status, text, errors = run(
        "warp", matches, *PAPER, "--counts", "3:5", "--no-plots", "--out", tmp_path / "out"
    )
    assert status == 0
    assert "80 matches" in text
    assert "no command warp. ArgumentError" in errors


def test_what_no_command_asks_for_is_not_imported():
    script = (
        "import sys, mexpress.cli\n"
        "mexpress.cli.main(['apply', 'a.npz', 'b.csv'])\n"
        "print([name for name in sys.modules if name.startswith(('mexpress.paper', 'mexpress.cli.warp'))])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
    assert done.stderr == "mexpress: error: a.npz: No such file or directory\n"


SMALL = np.random.default_rng(0).uniform(0, 1, (20, 2)) * [640, 480]
AFFINE = SMALL @ [[1.1, 0.1], [-0.1, 0.9]] + np.random.default_rng(1).normal(0, 1, SMALL.shape)
CALM = ("--quiet", "--no-plots")


def test_a_plain_map_is_said_and_written(run, tmp_path):
    write_matches(tmp_path / "m.csv", SMALL, AFFINE)
    expected = mx.select_warp(SMALL, AFFINE)
    assert expected.rival == "affine map"
    status, text, _ = run("warp", tmp_path / "m.csv", *CALM, "--out", tmp_path)
    assert status == 0
    grid = expected.maps["MATCHED"][expected.place]
    assert f"MATCHED selects the affine map: MATCHED {expected.score:.4g}; it is {grid:.4g} with " in text
    (row,) = (line for line in text.splitlines() if line.startswith("affine map"))
    assert row.split()[-1].endswith("*")
    assert text.count("*", text.index("MATCHED")) >= 1
    said = json.loads((tmp_path / "selection.json").read_text())
    assert said["rival"] == "affine map"
    scores = {name: of[0, 0] for name, of in expected.rivals["affine map"].maps.items()}
    assert said["rivals"] == {"affine map": scores}
    assert (said["notes"], said["left_out"]) == ([], [])


def test_a_plain_map_that_is_not_selected_has_a_line(run, matches, tmp_path):
    status, text, _ = run("warp", matches, *CALM, "--out", tmp_path)
    assert status == 0
    (row,) = (line for line in text.splitlines() if line.lstrip().startswith("affine map"))
    assert "*" not in row
    assert json.loads((tmp_path / "selection.json").read_text())["rival"] is None


@pytest.mark.parametrize("how", ["file", "rectangle", "image"])
def test_queries(run, matches, tmp_path, how):
    where = np.array([[2000.0, 0.0], [2100.0, 300.0]])
    np.savetxt(tmp_path / "q.txt", where)
    option, queries = {
        "file": (tmp_path / "q.txt", where),
        "rectangle": ("0,0,900.5,2000", (0, 0, 900.5, 2000)),
        "image": ("image", "image"),
    }[how]
    status, _, errors = run("warp", matches, *CALM, *SIZE, "--queries", option, "--out", tmp_path)
    assert status == 0, errors
    expected = mx.select_warp(SOURCE, TARGET, image_size=(640, 480), queries=queries)
    said = json.loads((tmp_path / "selection.json").read_text())
    assert said["curves"]["MATCHED"] == expected.curves["MATCHED"].tolist()
    assert said["rivals"].keys() == expected.rivals.keys()


@pytest.mark.parametrize("options", [[], ["--missing", "drop"], ["--missing", "-9999"]])
def test_queries_that_are_not_known_are_left_out(run, matches, tmp_path, options):
    gap = "-9999,3" if "-9999" in options else "nan,nan"
    (tmp_path / "q.csv").write_text(f"x,y\n2000,0\n{gap}\n2100,300\n")
    options = [*options, "--queries", tmp_path / "q.csv", "--out", tmp_path]
    status, _, errors = run("warp", matches, *CALM, *SIZE, *options)
    assert status == 0, errors
    assert "mexpress: 1 of 3 queries are not known, and left out\n" in errors
    where = [[2000.0, 0.0], [2100.0, 300.0]]
    expected = mx.select_warp(SOURCE, TARGET, image_size=(640, 480), queries=where)
    said = json.loads((tmp_path / "selection.json").read_text())
    assert said["curves"]["MATCHED"] == expected.curves["MATCHED"].tolist()
    (tmp_path / "q.csv").write_text(f"x,y\n{gap}\n{gap}\n")
    status, _, errors = run("warp", matches, *CALM, *SIZE, *options)
    assert status == 2
    assert errors.endswith("queries. One point at least must be known. Given none of 2 in q.csv.\n")


@pytest.mark.parametrize(
    ("option", "says"),
    [
        ("no.txt", "no.txt: No such file"),
        ("9,9,3,3", "Invalid --queries"),
        ("1,2,3", "must be a file, X0,Y0,X1,Y1 or image, not '1,2,3'"),
        ("image", "Invalid --image-size. It must be given with --queries image"),
    ],
)
def test_bad_queries_are_one_line(run, matches, tmp_path, option, says):
    status, text, errors = run("warp", matches, *CALM, "--queries", option, "--out", tmp_path)
    assert (status, text) == (2, "")
    assert says in errors
    assert errors.count("\n") == 1


def weighted(path, name, column):
    table = np.column_stack([SOURCE, TARGET, column])
    np.savetxt(path, table, delimiter=",", header=f"x1,y1,x2,y2,{name}", comments="", fmt="%.17g")
    return path


@pytest.mark.parametrize(
    ("name", "options", "power"),
    [("weight", [], 1), ("confidence", ["--weights", "confidence"], 1), ("sd", ["--sigma", "sd"], -2)],
)
def test_weights_of_matches(run, tmp_path, name, options, power):
    column = np.random.default_rng(3).uniform(0.5, 2, 80)
    path = weighted(tmp_path / "w.csv", name, column)
    status, _, errors = run("warp", path, *PAPER, *CALM, *options, "--counts", "3:9", "--out", tmp_path)
    assert status == 0, errors
    expected = mx.select_warp(SOURCE, TARGET, smoothing=0, counts=range(3, 10), weights=column**power)
    said = json.loads((tmp_path / "selection.json").read_text())
    assert said["curves"]["ER10"] == pytest.approx(expected.curves["ER10"].tolist(), rel=1e-12)


def test_a_match_of_weight_zero_is_absent(run, tmp_path):
    column = np.ones(80)
    column[3] = 0
    path = weighted(tmp_path / "w.csv", "weight", column)
    status, _, errors = run("warp", path, *PAPER, "--quiet", "--counts", "3:9", "--out", tmp_path)
    assert status == 0, errors
    warp = mx.load(tmp_path / "warp.npz")
    errors = np.delete(np.hypot(*(TARGET - warp(SOURCE)).T), 3)
    said = json.loads((tmp_path / "selection.json").read_text())
    assert said["warp"]["transfer_error"]["rms"] == pytest.approx(np.sqrt((errors**2).mean()))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--weights", "trust"], "'trust', which is not in w.csv"),
        (["--sigma", "trust"], "'trust', which is not in w.csv"),
        (["--sigma", "sd"], "--sigma sd must be above 0, not 0"),
        (["--sigma", "sd", "--weights", "sd"], "not allowed with argument"),
    ],
)
def test_bad_weights_are_one_line(run, tmp_path, options, says):
    path = weighted(tmp_path / "w.csv", "sd", np.arange(80.0))
    status, text, errors = run("warp", path, *CALM, *options, "--out", tmp_path)
    assert (status, text) == (2, "")
    assert says in errors
    assert errors.count("\n") == 1


def test_notes_are_printed_with_options_and_written_with_arguments(run, tmp_path):
    target = TARGET.copy()
    target[5] += 300
    write_matches(tmp_path / "m.csv", SOURCE[:, ::-1], target)
    status, _, errors = run("warp", tmp_path / "m.csv", *PAPER, *SIZE, *CALM, "--out", tmp_path)
    assert status == 0
    notes = mx.select_warp(SOURCE[:, ::-1], target, smoothing=0, image_size=(640, 480)).notes
    assert json.loads((tmp_path / "selection.json").read_text())["notes"] == list(notes)
    assert any("robust=True" in note for note in notes)
    assert any("image_size=SIZE" in note for note in notes)
    lines = errors.splitlines()
    assert len(lines) == len(notes)
    assert "--robust if matches may be wrong" in errors
    assert "--image-size SIZE." in errors
    assert "=" not in errors


# Tables as people have them


def written(path, table, header=""):
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.17g")
    return path


QUICK = (*PAPER, "--counts", "3:5", "--no-plots", "--quiet", "--out")
MATCHES = np.hstack([SOURCE, TARGET])


@pytest.mark.parametrize(
    ("header", "columns", "options"),
    [
        ("id,src_x,src_y,dst_x,dst_y", [4, 0, 1, 2, 3], []),
        ("dst_x,dst_y,src_x,src_y", [2, 3, 0, 1], []),
        ("a,b,c,d,e,f", [0, 0, 1, 2, 3, 3], ["--columns", "2,3,4,5"]),
        ("a,b,c,d,e,f", [0, 0, 1, 2, 3, 3], ["--columns", "b,c,d,e"]),
        ("", [0, 0, 1, 2, 3, 3], ["--columns", "2,3,4,5"]),
    ],
)
def test_columns_of_matches(run, tmp_path, header, columns, options):
    table = np.column_stack([MATCHES, np.arange(80)])[:, columns]
    path = written(tmp_path / "m.csv", table, header)
    status, text, errors = run("warp", path, *options, *QUICK, tmp_path)
    assert status == 0, errors
    expected = mx.select_warp(SOURCE, TARGET, smoothing=0, counts=range(3, 6))
    np.testing.assert_array_equal(mx.load(tmp_path / "warp.npz")(SOURCE), expected.warp(SOURCE))
    assert text.startswith("80 matches")


def test_columns_that_could_be_others_are_refused_in_one_line(run, tmp_path):
    path = written(tmp_path / "m.csv", np.ones((9, 6)))
    status, _, errors = run("warp", path, *QUICK, tmp_path)
    assert (status, errors.count("\n")) == (2, 1)
    assert "by number from 1, such as --columns 1,2,3,4. Given 6 columns in m.csv" in errors


def test_a_message_says_the_remedy_once(run, tmp_path):
    (tmp_path / "m.csv").write_text("x1,y1,x2,y2\n1,2,3,\n")
    _, _, errors = run("warp", tmp_path / "m.csv", *QUICK, tmp_path)
    assert (
        "Cells must be finite numbers; --missing drop leaves out the rows of others. Given '' in line 2"
        in errors
    )
    (tmp_path / "m.csv").write_text("x1,y1,x2,y2,x2\n1,2,3,4,5\n")
    _, _, errors = run("warp", tmp_path / "m.csv", *QUICK, tmp_path)
    assert (
        "say which are meant by their numbers from 1, such as --columns 1,2,3,4. Given x2 twice in m.csv"
        in errors
    )


@pytest.mark.parametrize(
    "options", [["--missing", "-9999"], ["--missing=-9999,65535"], ["--missing", "drop"]]
)
def test_matches_with_something_missing(run, tmp_path, options):
    table = np.insert(MATCHES, 7, np.nan if "drop" in options else -9999, axis=0)
    path = written(tmp_path / "m.csv", table)
    status, text, errors = run("warp", path, *options, *QUICK, tmp_path)
    assert status == 0, errors
    assert text.startswith("80 matches")
    expected = mx.select_warp(SOURCE, TARGET, smoothing=0, counts=range(3, 6))
    np.testing.assert_array_equal(mx.load(tmp_path / "warp.npz")(SOURCE), expected.warp(SOURCE))
    said = json.loads((tmp_path / "selection.json").read_text())
    assert said["n_missing"] == 1


def test_indices_are_of_the_rows_of_the_file(run, tmp_path):
    wrong = MATCHES.copy()
    wrong[20, 2:] += 60
    path = written(tmp_path / "m.csv", np.insert(wrong, 7, -9999, axis=0))
    options = ["--missing", "-9999", "--robust", "--quiet", "--out", tmp_path]
    status, _, errors = run("warp", path, *options)
    assert status == 0, errors
    assert json.loads((tmp_path / "selection.json").read_text())["left_out"] == [21]
    assert (tmp_path / "warp.png").stat().st_size > 10_000


def test_standard_input(run, tmp_path, monkeypatch, model):
    lines = b"id;x;y\n1;10,5;20\n2;30;40\n"
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(lines)))
    status, text, errors = run("apply", model, "-")
    assert status == 0, errors
    rows = list(csv.DictReader(text.splitlines()))
    expected = mx.load(model)([[10.5, 20], [30, 40]])
    np.testing.assert_array_equal([[float(row["x"]), float(row["y"])] for row in rows], expected)


def test_columns_of_points(run, tmp_path, model):
    path = written(tmp_path / "p.csv", [[7, 20, 10], [8, 40, 30]], "id,y,x")
    (_, text, _), (_, swapped, _) = run("apply", model, path), run("apply", model, path, "--columns", "2,3")
    for written_text, points in ((text, [[10, 20], [30, 40]]), (swapped, [[20, 10], [40, 30]])):
        row = next(csv.DictReader(written_text.splitlines()))
        np.testing.assert_array_equal([float(row["x"]), float(row["y"])], mx.load(model)(points)[0])
