"""`mexpress warp`, `surface` and `apply` on every kind of file that they read: the model of the numbers in it."""

import io
import sys

import numpy as np
import pandas as pd
import pytest
from rasters import png, tiff

import mexpress as mx
from mexpress.cli import main
from mexpress.io.images import read_image
from mexpress.io.matches import read_points, write_matches
from mexpress.io.meshes import write_obj, write_ply

RNG = np.random.default_rng(5)
SOURCE = np.round(8 * RNG.uniform(0, 1, (30, 2)) * [640, 480]) / 8  # floats of 32 bits can hold them
TARGET = np.round(8 * (0.9 * SOURCE + 15 * np.sin(SOURCE[:, ::-1] / 150))) / 8
MATCHES = np.hstack([SOURCE, TARGET])
NAMES = ["x1", "y1", "x2", "y2"]
WARP = mx.select_warp(SOURCE, TARGET, counts=[5], smoothing=0).warp

HIGH, WIDE = 9, 12
Y, X = np.mgrid[:HIGH, :WIDE]
DEPTHS = 1500 + np.round(60 * np.sin(X / 4) + 9 * Y).astype(np.uint16)
PIXELS = np.column_stack([X.ravel(), Y.ravel()]).astype(float)
HEIGHTS = np.round(8 * np.hypot(*SOURCE.T)) / 8
SPACE = np.column_stack([SOURCE, HEIGHTS])


@pytest.fixture
def run(capsys):
    def run(*arguments):
        status = main([str(argument) for argument in arguments])
        errors = capsys.readouterr().err
        assert status == 0, errors
        return errors

    return run


def lines(rows, header="", between=",", comma=False):
    """Text of a table."""
    text = header + "\n" if header else ""
    for row in rows:
        cells = [f"{cell:.17g}" if isinstance(cell, float) else str(cell) for cell in row]
        text += between.join(cell.replace(".", ",") if comma else cell for cell in cells) + "\n"
    return text


def packed(**arrays):
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def saved(array):
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def parquet(rows, names):
    file = io.BytesIO()
    pd.DataFrame(rows, columns=names).to_parquet(file)
    return file.getvalue()


def grid_of(depths):
    return f"ncols {WIDE}\nnrows {HIGH}\ncellsize 30\n" + lines(depths.tolist(), between=" ")


def mesh(write, tmp_path):
    write(tmp_path / "mesh", SPACE, [[0, 1, 2]])
    return (tmp_path / "mesh").read_bytes()


LABELLED = [[k, *row, "good"] for k, row in enumerate(MATCHES.tolist())]
QGIS = np.column_stack([TARGET, (SOURCE + 0.5) * [1, -1], np.ones(30)])
WITH_ONE_OFF = [*QGIS.tolist(), [9.0, 9.0, 9.0, -9.0, 0.0]]
QGIS_NAMES = "mapX,mapY,sourceX,sourceY,enable"
MATCHED = {
    "csv": ("m.csv", lines(MATCHES.tolist(), "x1,y1,x2,y2"), []),
    "no header": ("m.txt", lines(MATCHES.tolist(), between=" "), []),
    "header of others": ("m.csv", lines(LABELLED, "id,src_x,src_y,dst_x,dst_y,note"), []),
    "swapped": ("m.csv", lines(MATCHES[:, [2, 3, 0, 1]].tolist(), "target_x,target_y,source_x,source_y"), []),
    "by number": ("m.csv", lines(LABELLED, "k,a,b,c,d,e"), ["--columns", "2,3,4,5"]),
    "by name": ("m.csv", lines(LABELLED, "k,a,b,c,d,e"), ["--columns", "a,b,c,d"]),
    "decimal commas": ("m.csv", lines(MATCHES.tolist(), "x1;y1;x2;y2", ";", comma=True), []),
    "tabs": ("m.tsv", lines(MATCHES.tolist(), "x1\ty1\tx2\ty2", "\t", comma=True), []),
    "pandas": ("m.csv", pd.DataFrame(MATCHES, columns=NAMES).to_csv(), []),
    "comments": ("m.txt", "% made by hand\n// x1 y1 x2 y2\n" + lines(MATCHES.tolist(), between=" "), []),
    "byte-order mark": ("m.csv", lines(MATCHES.tolist(), "x1,y1,x2,y2").encode("utf-8-sig"), []),
    "UTF-16": ("m.csv", lines(MATCHES.tolist(), "x1,y1,x2,y2").encode("utf-16"), []),
    "Latin-1": ("m.csv", lines(LABELLED, "n\xb0,x1,y1,x2,y2,gr\xf6\xdfe").encode("latin-1"), []),
    "empty cells": ("m.csv", lines(MATCHES.tolist(), "x1,y1,x2,y2") + "1,2,,4\n", ["--missing", "drop"]),
    "a constant": (
        "m.csv",
        lines([*MATCHES.tolist(), [1.0, 2.0, -9999.0, -9999.0]]),
        ["--missing", "-9999,65535"],
    ),
    "QGIS": ("m.points", lines(WITH_ONE_OFF, QGIS_NAMES), []),
    "BigWarp": (
        "m.csv",
        lines(
            [[f"Pt-{k}", str(k < 30).lower(), *row] for k, row in enumerate([*MATCHES.tolist(), 4 * [9.0]])]
        ),
        [],
    ),
    "npy": ("m.npy", saved(MATCHES), []),
    "npz": ("m.npz", packed(source=SOURCE, target=TARGET), []),
    "LoFTR": ("m.npz", packed(mkpts0=SOURCE.astype(np.float32), mkpts1=TARGET.astype(np.float32)), []),
    "SuperGlue": (
        "m.npz",
        packed(
            keypoints0=np.vstack([SOURCE, [[1, 1]]]).astype(np.float32),
            keypoints1=TARGET[::-1].astype(np.float32),
            matches=np.append(np.arange(30)[::-1], -1),
        ),
        [],
    ),
    "LightGlue": (
        "m.npz",
        packed(
            keypoints0=SOURCE, keypoints1=TARGET[::-1], matches=np.column_stack([np.r_[:30], np.r_[29:-1:-1]])
        ),
        [],
    ),
    "parquet": ("m.parquet", parquet(MATCHES, NAMES), []),
    "standard input": ("-", lines(MATCHES.tolist(), "x1,y1,x2,y2"), []),
}


def put(folder, name, content, monkeypatch):
    """Write a file, or standard input; return its name."""
    data = content.encode() if isinstance(content, str) else content
    if name == "-":
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(data)))
        return name
    (folder / name).write_bytes(data)
    return folder / name


@pytest.mark.parametrize("kind", MATCHED)
def test_warp(kind, run, tmp_path, monkeypatch):
    name, content, options = MATCHED[kind]
    file = put(tmp_path, name, content, monkeypatch)
    once = ["--counts", "5", "--smoothing", "0", "--no-plots", "--quiet"]
    run("warp", file, *options, *once, "--out", tmp_path / "out")
    found = mx.load(tmp_path / "out" / "warp.npz")
    np.testing.assert_array_equal(found.parameters, WARP.parameters)
    np.testing.assert_array_equal(found.control_points, WARP.control_points)


METRES, AS_IT_IS = 1000.0, 1.0
GEO = (33550, 12, [30.0, 30.0, 0.0])
MAPS = {
    "png": ("d.png", png(DEPTHS), METRES, []),
    "pgm of 12 bits": (
        "d.pgm",
        b"P5 %d %d 4095\n" % (WIDE, HIGH) + DEPTHS.astype(">u2").tobytes(),
        METRES,
        [],
    ),
    "plain pgm": ("d.pgm", f"P2 {WIDE} {HIGH} 4095\n" + lines(DEPTHS.tolist(), between=" "), METRES, []),
    "pfm": (
        "d.pfm",
        b"Pf %d %d -1.0\n" % (WIDE, HIGH) + DEPTHS[::-1].astype("<f4").tobytes(),
        AS_IT_IS,
        [],
    ),
    "tif": ("d.tif", tiff(DEPTHS), METRES, []),
    "LZW tif": ("d.tif", tiff(DEPTHS, compression=5, predictor=2), METRES, []),
    "tif with a scale": ("d.tif", tiff(DEPTHS), 200.0, ["--scale", "200"]),
    "floats": ("d.tiff", tiff(DEPTHS.astype("f4"), compression=8, predictor=3), AS_IT_IS, []),
    "signed": ("d.tif", tiff(DEPTHS.astype("i2")), AS_IT_IS, []),
    "GeoTIFF": ("d.tif", tiff(DEPTHS, tags=[GEO]), AS_IT_IS, []),
    "ESRI": ("d.asc", grid_of(DEPTHS), AS_IT_IS, []),
    "npy": ("d.npy", saved(DEPTHS), AS_IT_IS, []),
    "npz": ("d.npz", packed(depth=DEPTHS), AS_IT_IS, []),
}
SPATIAL = SPACE.tolist()
CLOUDS = {
    "csv": ("c.csv", lines(SPATIAL, "x,y,z"), []),
    "xyz and more": ("c.xyz", lines([[*row, 255, 0, 0] for row in SPATIAL], between=" "), []),
    "names": ("c.csv", lines([row[::-1] for row in SPATIAL], "elevation;lat;lon", ";"), []),
    "columns": ("c.csv", lines([[7, *row, 1.0] for row in SPATIAL]), ["--columns", "2,3,4"]),
    "gaps": ("c.csv", lines([*SPATIAL, [1.0, 2.0, -9999.0], [1.0, 2.0, "NA"]]), ["--missing", "-9999"]),
    "npy": ("c.npy", saved(SPACE), []),
    "npz": ("c.npz", packed(points=SOURCE, values=HEIGHTS), []),
    "parquet": ("c.parquet", parquet(SPACE, list("xyz")), []),
    "ply": ("c.ply", lambda folder: mesh(write_ply, folder), []),
    "obj": ("c.obj", lambda folder: mesh(write_obj, folder), []),
    "standard input": ("-", lines(SPATIAL, "x,y,z"), []),
}


def surface_of(file, run, folder, options):
    once = ["--max-count", "6", "--smoothing", "0", "--no-plots", "--quiet"]
    run("surface", file, *options, *once, "--out", folder / "out")
    return mx.load(folder / "out" / "surface.npz")


def same_surface(found, points, values):
    expected = mx.select_surface(points, values, max_count=6, smoothing=0).surface
    np.testing.assert_array_equal(found.parameters, expected.parameters)
    np.testing.assert_array_equal(found.control_points, expected.control_points)


@pytest.mark.parametrize("kind", MAPS)
def test_surface_of_a_map(kind, run, tmp_path, monkeypatch):
    name, content, scale, options = MAPS[kind]
    found = surface_of(put(tmp_path, name, content, monkeypatch), run, tmp_path, options)
    same_surface(found, PIXELS, DEPTHS.ravel() / scale)


@pytest.mark.parametrize("kind", CLOUDS)
def test_surface_of_a_cloud(kind, run, tmp_path, monkeypatch):
    name, content, options = CLOUDS[kind]
    made = content(tmp_path) if callable(content) else content
    found = surface_of(put(tmp_path, name, made, monkeypatch), run, tmp_path, options)
    same_surface(found, SOURCE, HEIGHTS)


def test_the_meshes_of_a_surface_are_clouds(run, tmp_path):
    (tmp_path / "c.csv").write_text(lines(SPATIAL, "x,y,z"))
    surface = surface_of(tmp_path / "c.csv", run, tmp_path, [])
    clouds = [
        mx.read_cloud(tmp_path / "out" / f"surface.{ending}", max_data=None) for ending in ("ply", "obj")
    ]
    for cloud in clouds:
        np.testing.assert_allclose(cloud.values, surface(cloud.points), rtol=1e-12)
    np.testing.assert_array_equal(clouds[0].values, clouds[1].values)
    again = surface_of(tmp_path / "out" / "surface.obj", run, tmp_path, ["--all"])
    same_surface(again, clouds[0].points, clouds[0].values)


POINTS = SOURCE[:9]
UNKNOWN = np.vstack([POINTS, [[np.nan, np.nan]]])
PLACED = {
    "csv": ("p.csv", lines(POINTS.tolist(), "x,y"), POINTS, []),
    "no header": ("p.txt", lines(POINTS.tolist(), between=" "), POINTS, []),
    "decimal commas": ("p.csv", lines(POINTS.tolist(), "X;Y", ";", comma=True), POINTS, []),
    "UTF-16": ("p.csv", lines(POINTS.tolist(), "x,y").encode("utf-16"), POINTS, []),
    "columns": ("p.csv", lines(SPACE[:9].tolist(), "a,b,c"), POINTS, ["--columns", "a,b"]),
    "a gap": ("p.csv", lines([*POINTS.tolist(), [1.0, ""]], "x,y"), UNKNOWN, []),
    "a constant": ("p.csv", lines([*POINTS.tolist(), [1.0, 1e10]], "x,y"), UNKNOWN, ["--missing", "1e10"]),
    "QGIS": (
        "p.points",
        lines([*WITH_ONE_OFF[:9], WITH_ONE_OFF[-1]], QGIS_NAMES),
        (UNKNOWN + 0.5) * [1, -1],
        ["--columns", "sourceX,sourceY"],
    ),
    "QGIS, dropped": (
        "p.points",
        lines([WITH_ONE_OFF[-1], *WITH_ONE_OFF[:9]], QGIS_NAMES),
        (POINTS + 0.5) * [1, -1],
        ["--columns", "sourceX,sourceY", "--missing", "drop"],
    ),
    "matches": ("m.csv", lines(MATCHES[:9].tolist(), "x1,y1,x2,y2"), POINTS, ["--columns", "x1,y1"]),
    "npy": ("p.npy", saved(POINTS), POINTS, []),
    "npz": ("p.npz", packed(points=POINTS), POINTS, []),
    "parquet": ("p.parquet", parquet(POINTS, ["x", "y"]), POINTS, []),
    "standard input": ("-", lines(POINTS.tolist(), "x,y"), POINTS, []),
    "only a header": ("p.csv", "x,y\n", POINTS[:0], []),
}


@pytest.mark.parametrize("kind", PLACED)
def test_apply(kind, run, tmp_path, monkeypatch):
    name, content, points, options = PLACED[kind]
    WARP.save(tmp_path / "warp.npz")
    file = put(tmp_path, name, content, monkeypatch)
    errors = run("apply", tmp_path / "warp.npz", file, *options, "--out", tmp_path / "there.csv")
    np.testing.assert_array_equal(read_points(tmp_path / "there.csv", missing="keep"), WARP(points))
    assert ("1 of 10 points are not known" in errors) == (points is UNKNOWN or len(points) == 10)
    run("apply", tmp_path / "warp.npz", tmp_path / "there.csv", "--inverse", "--out", tmp_path / "back.csv")
    back = read_points(tmp_path / "back.csv", missing="keep")
    np.testing.assert_allclose(back, points, rtol=0, atol=1e-6)


@pytest.mark.parametrize("ending", ["png", "tif", "pgm", "ppm"])
def test_apply_to_images(ending, run, tmp_path):
    samples = RNG.integers(1, 255, (48, 64, 3) if ending == "ppm" else (48, 64)).astype(np.uint8)
    head = b"P%d 64 48 255\n" % (6 if ending == "ppm" else 5)
    content = {"png": png, "tif": tiff}.get(ending, lambda image: head + image.tobytes())(samples)
    (tmp_path / f"photo.{ending}").write_bytes(content)
    warp = mx.fit_warp(SOURCE / 10, TARGET / 10, SOURCE[:4] / 10)
    warp.save(tmp_path / "warp.npz")
    run("apply", tmp_path / "warp.npz", tmp_path / f"photo.{ending}", "--out", tmp_path / "moved.png")
    np.testing.assert_array_equal(read_image(tmp_path / "moved.png"), warp.remap(samples))


@pytest.mark.parametrize("constant", [-9999, 65535, 1e10])
def test_a_constant_among_matches_is_named(run, tmp_path, constant):
    lost = [[100, 200], [90, 210], [300, 4]]
    write_matches(tmp_path / "m.csv", np.vstack([SOURCE, lost]), np.vstack([TARGET, [[300, constant]] * 3]))
    options = ["--counts", "5", "--smoothing", "0", "--no-plots", "--quiet", "--out", tmp_path / "out"]
    errors = run("warp", tmp_path / "m.csv", *options)
    says = f"3 of 33 values in m.csv are {constant:.17g}, far from all others"
    assert says in errors
    assert f"if it means no data, say --missing {constant:.17g}." in errors
    assert says not in run("warp", tmp_path / "m.csv", "--missing", f"{constant:.17g}", *options)
    found = mx.load(tmp_path / "out" / "warp.npz")
    np.testing.assert_array_equal(found.parameters, WARP.parameters)


@pytest.mark.parametrize(
    ("command", "header", "says"),
    [
        ("warp", "x1,y1,x2,y2", "Invalid matches. It must have rows. Given none.csv, which has none."),
        ("surface", "x,y,z", "Given no rows in none.csv."),
        ("warp", "a,b,c,d", "Given 0 columns in none.csv, besides 'a' with nothing below it."),
    ],
)
def test_a_header_alone_has_no_rows(command, header, says, tmp_path, capsys):
    (tmp_path / "none.csv").write_text(header + "\n")
    assert main([command, str(tmp_path / "none.csv"), "--out", str(tmp_path / "out")]) == 2
    assert says in capsys.readouterr().err
