"""What goes wrong for newcomers, and the message that names their argument, the cause, and what to do."""

import io
import os
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from inputs import in_form, refused

import mexpress as mx
from mexpress.cli import main
from mexpress.io.archives import read_arrays, replacing
from mexpress.io.matches import write_matches

RNG = np.random.default_rng(0)
SOURCE = RNG.uniform(0, 640, (60, 2))
TARGET = 1.2 * SOURCE + 8 * np.sin(SOURCE / 100) + RNG.normal(0, 0.5, SOURCE.shape)
DEPTH = np.sin(SOURCE[:, 0] / 100)
LINE = np.column_stack([np.arange(60.0), 2 * np.arange(60.0)])
STRIP = SOURCE * [1, 3e-6]
WARP = mx.fit_warp(SOURCE, TARGET, SOURCE[:12])
SURFACE = mx.fit_surface(SOURCE, DEPTH, SOURCE[:12])
A, B = RNG.normal(size=(40, 5)), RNG.normal(size=40)
MODEL = mx.LeastSquares(A, B)
PAPER = {"smoothing": 0}
SIZE = {"image_size": (640, 480)}


class Tensor:
    """An array of another library, which says itself why it is no array of numpy's."""

    shape = (60, 2)

    def __init__(self, error):
        self.error = error

    def __array__(self, dtype=None, copy=None):
        raise self.error


GRADIENT = RuntimeError(
    "Can't call numpy() on Tensor that requires grad. Use tensor.detach().numpy() instead."
)
ON_GPU = TypeError("can't convert cuda:0 device type tensor to numpy. Use Tensor.cpu() to copy it first.")


def objects(change=None):
    """Return the source points as Python objects, one of them something else."""
    entries = SOURCE.astype(object)
    if change is not None:
        entries[4, 1] = change[0]
    return entries


def places(n, source=SOURCE):
    """Return 60 source points in n places."""
    return np.resize(source[:n], source.shape)


def warp(source=SOURCE, target=TARGET, **options):
    return lambda: mx.select_warp(source, target, **options)


def surface(points=SOURCE, values=DEPTH, **options):
    return lambda: mx.select_surface(points, values, **options)


CASES = {
    # Arrays
    "a transposed array": (warp(SOURCE.T, TARGET.T), "source", "transpose it, a row is a point", "(2, 60)"),
    "transposed targets": (warp(SOURCE, TARGET.T), "target", "transpose it", "(2, 60)"),
    "transposed values": (surface(SOURCE, np.ones((3, 60))), "values", "transpose it", "(3, 60)"),
    "a table of matches": (
        warp(np.hstack([SOURCE, TARGET])),
        "source",
        "table[:, :2] and target table[:, 2:]",
    ),
    "homogeneous points": (warp(np.insert(SOURCE, 2, 1, axis=1)), "source", "take the columns x and y alone"),
    "x alone": (warp(SOURCE[:, 0]), "source", "np.column_stack([x, y])", "(60,)"),
    "one point": (lambda: WARP([1.0, 2.0]), "points", "one point is [[x, y]]"),
    "no points": (warp([], []), "source", "at least one", "(0,)"),
    "other lengths": (warp(SOURCE, TARGET[:50]), "target", "50 for 60"),
    "a count": (lambda: mx.fit_warp(SOURCE, TARGET, 12), "control_points", "(n, 2)", "Given 12"),
    "a file's name": (warp("a.csv", "b.csv"), "source", "a file must be read first", "'a.csv'"),
    "text": (warp(SOURCE.astype(str)), "source", "astype(float)", "<U32"),
    "nothing": (warp(None), "source", "array of real numbers", "Given None"),
    "complex numbers": (warp(SOURCE @ [1, 1j]), "source", "real and imaginary parts as columns"),
    "objects": (warp(objects()), "source", "type object, which astype(float) converts"),
    "text among objects": (warp(objects(["a"])), "source", "Given 'a' at row 4, column 1"),
    "None among objects": (warp(objects([None])), "source", "Given None at row 4, column 1"),
    "a mapping in a list": (warp([{"x": 1}]), "source", "Given {'x': 1} at row 0"),
    "objects in three dimensions": (warp(np.full((1, 1, 2), None)), "source", "Given None at [0, 0, 0]"),
    "ragged rows": (warp([[1, 2], [3, 4, 5]]), "source", "2 entries in row 0 and 3 in row 1"),
    "a number among rows": (warp([[1, 2], 3]), "source", "2 entries in row 0 and 1 in row 1"),
    "a gradient": (warp(Tensor(GRADIENT)), "source", "Tensor of shape (60, 2), which says", "detach()"),
    "a tensor on a GPU": (warp(SOURCE, Tensor(ON_GPU)), "target", "Use Tensor.cpu() to copy it first"),
    "one row that is not finite": (
        lambda: mx.fit_warp(np.where(DEPTH[:, None] == DEPTH[3], np.nan, SOURCE), TARGET, SOURCE[:4]),
        "source",
        "nan at row 3, column 0.",
    ),
    "rows that are not finite": (
        surface(SOURCE, np.where(DEPTH > 0.5, np.nan, DEPTH)),
        "values",
        f"and others in {(DEPTH > 0.5).sum() - 1} more rows",
    ),
    # Data
    "three matches": (warp(SOURCE[:3], TARGET[:3]), "source", "four matches at least", "Given 3"),
    "three matches with a weight": (
        warp(weights=np.arange(60) < 3),
        "source",
        "not counting those that are dropped or of weight 0",
        "Given 3",
    ),
    "four matches": (
        warp(SOURCE[:4], TARGET[:4], **PAPER),
        "source",
        "All but one",
        'take more matches, or smoothing="auto", or fractional=False.',
        "Given 4 matches",
    ),
    "three places": (
        warp(places(3), places(3, TARGET)),
        "source",
        "take more matches",
        "60 matches in 3 places",
    ),
    "three samples": (surface(SOURCE[:3], DEPTH[:3]), "points", "take more data", "Given 3 data"),
    "matches on a line": (warp(LINE), "source", "must cover a region", "60 points on a line"),
    "nearly on a line": (
        warp(SOURCE * [1, 1e-7]),
        "source",
        "spread across a line is",
        "1e-07 of that along it",
    ),
    "one place": (warp(places(1)), "source", "must cover a region", "60 points in one place"),
    "two places": (surface(places(2)), "points", "must cover a region", "60 points in two places"),
    "equal targets": (
        warp(SOURCE, places(1, TARGET), **PAPER),
        "target",
        "not all be equal",
        "fractional=False",
    ),
    # Control points that nobody gave
    "a strip": (warp(STRIP, **PAPER), "source", 'placement="nested"', "60 points whose spread"),
    "a strip with B-splines": (
        warp(STRIP, lifting="bspline"),
        "source",
        "scale x and y",
        "60 points whose spread",
    ),
    "a strip of samples": (surface(STRIP, lifting="affine"), "points", "try fewer", "60 points whose spread"),
    # Criteria
    "a wide radius": (
        warp(criterion="ER50", **PAPER),
        "criterion",
        "a smaller radius, such as ER10, or more matches.",
        "ER50, which leaves 2 of 60 matches",
    ),
    "a wide radius, smoothed": (
        surface(criterion="ER60"),
        "criterion",
        "such as ER10",
        "leaves 0 of 60 data",
    ),
    "too many neighbours": (
        warp(criterion="NN100PCT"),
        "criterion",
        "a smaller percentage",
        "leaves 0 of 60",
    ),
    "too many control points": (
        warp(counts=[30], criterion="KF02", **PAPER),
        "criterion",
        "more folds",
        "fewer control points",
        "KF02, which leaves 30 of 60",
    ),
    "a scheme of one's own": (
        warp(criterion="all", criteria={"all": mx.schemes.from_sets([range(60)])}),
        "criterion",
        "another, such as CMPRESS",
        "all, which leaves 0 of 60",
    ),
    "several weights": (
        lambda: mx.fit_surface(SOURCE, DEPTH, SOURCE[:9], smoothing=[1, 2], criterion="ER90"),
        "criterion",
        "a surface of 9 control points",
        "such as ER10",
    ),
    "normalised coordinates": (
        warp(SOURCE / 640, TARGET / 640, **PAPER, **SIZE),
        "image_size",
        "all matches within 80",
        "give points in pixels, or leave it out",
        "640 x 480 with points that extend over 1.4",
    ),
    "a radius wider than the image": (
        warp(criterion="ER120", image_size=(640, 640), **PAPER),
        "criterion",
        "a smaller radius, such as ER9.9",
        "leaves 0 of 60",
    ),
    "a typing error": (warp(criterion="CMPRES"), "criterion", "Is it CMPRESS"),
    "a letter too many": (warp(criterion="ERR7.5"), "criterion", "Is it ER7.5"),
    "no number": (warp(criterion="KF"), "criterion", "Is it KF10"),
    "no unit": (warp(criterion="NN10"), "criterion", "Is it NN10PTS or NN10PCT"),
    "a sign": (warp(criterion="er10%"), "criterion", "Is it ER10"),
    "another name": (warp(criterion="LOO"), "criterion", "CMPRESS (leave-one-out)"),
    "an error in the list": (warp(criteria=["ER10", "GVC"]), "criteria", "Is it GCV", "'GVC'"),
    "more folds than data": (warp(criterion="KF61"), "criterion", "In KF61, k must be", "2 to 60"),
    "more folds in the list": (warp(criteria=["KF61"]), "criteria", "In KF61, k must be"),
    "a number": (warp(criterion=10), "criterion", "ERxx (within xx % of the diagonal)"),
    # Options
    "a lifting's case": (warp(lifting="TPS"), "lifting", "Is it tps?"),
    "a lifting's plural": (warp(lifting="bsplines"), "lifting", "Is it bspline?"),
    "a placement's case": (warp(placement="Lloyd"), "placement", "Is it lloyd?"),
    "automatic": (warp(smoothing="automatic"), "smoothing", "Is it auto?"),
    "one count": (warp(counts=20), "counts", "such as [20]"),
    "counts with a point": (
        warp(counts=[3.0, 20.0]),
        "counts",
        "whole numbers",
        "from 3 to the number of matches, 60",
    ),
    "equal counts": (warp(counts=[3, 3]), "counts", "different"),
    "more counts than matches": (
        warp(counts=range(3, 101)),
        "counts",
        "the number of matches, 60",
        "Given 100",
    ),
    "an image's shape": (warp(image_size=(480, 640, 3)), "image_size", "image.shape[1::-1]"),
    "queries over no image": (warp(queries="image"), "image_size", 'queries="image"'),
    "a surface's image": (surface(queries="image"), "queries", "points or a rectangle", "'image'"),
    "other queries": (warp(queries="images"), "queries", "Is it image?"),
    "a rectangle from right to left": (warp(queries=(640, 0, 0, 480)), "queries", "left < right"),
    "a huge weight": (warp(smoothing=10**400), "smoothing", "number of at least 0"),
    # Least squares
    "a ridge": (lambda: mx.LeastSquares(A, B, penalty=0.1), "penalty", "sqrt(w) * np.eye(5)", "Given 0.1"),
    "folds as a number": (
        lambda: MODEL.cross_validate(5),
        "scheme",
        "mexpress.schemes, such as leave_one_out(40)",
    ),
    "schemes in a list": (
        lambda: mx.cross_validate_nested(A, B, [1, 2], [mx.schemes.leave_one_out(40)]),
        "schemes",
        'such as {"CMPRESS": mexpress.schemes.leave_one_out(n)}',
    ),
    # Files
    "a number for a file": (lambda: WARP.save(3), "path", "the name of a file", "Given 3"),
    "an empty name": (lambda: WARP.save(""), "path", "the name of a file", "Given ''"),
    "no file": (lambda: mx.load(None), "path", "the name of a file", "Given None"),
    "another mesh": (lambda: SURFACE.write_mesh("a.stl"), "path", "end in .ply or .obj", "'a.stl'"),
    "another figure": (
        lambda: mx.select_warp(SOURCE, TARGET, counts=[3], smoothing=0).plot("a.xyz"),
        "path",
        ".png",
        "'a.xyz'",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_a_message_names_the_cause_and_the_remedy(case):
    call, name, *parts = CASES[case]
    text = refused(call, name)
    assert text.count("Given") == 1
    for part in parts:
        assert part in text
    # Nothing of numpy's own, of names within the library, or of a second line.
    assert not re.search(r"allow_pickle|inhomogeneous|setting an array|_core|\n|[^.]\.\.$", text)


@pytest.mark.parametrize("fault", [GRADIENT, ON_GPU])
def test_the_reason_of_another_library_is_the_cause(fault):
    with pytest.raises(TypeError) as caught:
        mx.LeastSquares(Tensor(fault), B)
    assert caught.value.__context__ is fault


WRITERS = {
    "model": WARP.save,
    "mesh.ply": lambda path: SURFACE.write_mesh(path, shape=(5, 5)),
    "mesh.obj": lambda path: SURFACE.write_mesh(path, shape=(5, 5)),
}


@pytest.mark.parametrize("name", WRITERS)
def test_files_that_cannot_be_written_have_the_name_that_was_given(name, tmp_path):
    nowhere = tmp_path / "nowhere" / name
    with pytest.raises(FileNotFoundError) as caught:
        WRITERS[name](nowhere)
    assert (caught.value.filename, caught.value.filename2) == (str(nowhere), None)
    (tmp_path / name).mkdir()
    with pytest.raises(OSError, match=re.escape(f"{tmp_path / name}'") + "$"):
        WRITERS[name](tmp_path / name)
    assert os.listdir(tmp_path) == [name]


def test_a_full_disk_is_said_of_the_file_that_was_named(tmp_path):
    with pytest.raises(OSError, match="No space left") as caught, replacing(tmp_path / "a") as _:
        raise OSError(28, "No space left on device")
    assert caught.value.filename == str(tmp_path / "a")


def test_a_fault_of_another_file_keeps_its_name(tmp_path):
    with pytest.raises(FileNotFoundError) as caught, replacing(tmp_path / "a") as _:
        (tmp_path / "b").read_bytes()
    assert caught.value.filename == str(tmp_path / "b")


@pytest.mark.parametrize(
    ("content", "says"),
    [(b"", "which is empty"), (b"1,2\n3,4\n", "another kind of file"), (b"PK\3\4", "damaged")],
)
def test_files_of_arrays_say_what_they_are_instead(content, says, tmp_path):
    path = tmp_path / "a.npz"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"Invalid matches\. .* Given a\.npz, which is ") as caught:
        read_arrays(path, "matches")
    in_form(caught.value)
    assert says in str(caught.value)
    assert "pickle" not in str(caught.value)


def test_arrays_of_objects_are_refused_without_advice_to_trust_them(tmp_path):
    np.save(tmp_path / "a.npy", np.array([None]), allow_pickle=True)
    with pytest.raises(ValueError, match=r"a\.npy, with objects") as caught:
        read_arrays(tmp_path / "a.npy", "cloud")
    assert "pickle" not in str(caught.value)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A directory with files of each kind, in which the command line runs."""
    monkeypatch.chdir(tmp_path)
    write_matches("m.csv", SOURCE, TARGET)
    write_matches("three.csv", SOURCE[:3], TARGET[:3])
    write_matches("four.csv", SOURCE[:4], TARGET[:4])
    write_matches("line.csv", LINE, TARGET)
    write_matches("unit.csv", SOURCE / 640, TARGET / 640)
    np.savetxt("p.csv", SOURCE[:5], delimiter=",")
    np.save("p.npy", SOURCE[:5])
    np.savez("other.npz", a=np.ones(3))
    np.savetxt("c.csv", np.column_stack([SOURCE, DEPTH]), delimiter=",")
    (tmp_path / "empty.npz").touch()
    WARP.save("warp.npz")
    SURFACE.save("surface.npz")
    return tmp_path


RUN = ["--quiet", "--no-plots", "--out", "out"]
FIT = [*RUN, "--smoothing", "0"]
COMMANDS = {
    "files in the wrong order": (["apply", "p.csv", "warp.npz"], "Invalid MODEL.", "come first", "'p.csv'"),
    "arrays in the wrong order": (["apply", "p.npy", "warp.npz"], "Invalid MODEL.", "come first", "array (5, 2)"),
    "another archive": (["apply", "other.npz", "p.csv"], "Invalid MODEL.", "which holds a (3,)"),
    "an empty model": (["apply", "empty.npz", "p.csv"], "Invalid MODEL.", "'empty.npz'"),
    "no such model": (["apply", "no.npz", "p.csv"], "error: no.npz: No such file"),
    "no such points": (["apply", "warp.npz", "no.csv"], "error: no.csv: No such file"),
    "a directory": (["apply", "warp.npz", "."], "Is a directory"),
    "an inverse surface": (["apply", "surface.npz", "p.csv", "--inverse"], "a surface has no inverse"),
    "no directory": (["apply", "warp.npz", "p.csv", "--out", "no/p.csv"], "no/p.csv: there is no directory no"),
    "a file for a directory": (["warp", "m.csv", "--out", "p.csv"], "p.csv: a file, where a directory should be"),
    "within a file": (["warp", "m.csv", "--out", "p.csv/out"], "p.csv/out: a file, where a directory should be"),
    "three matches": (["warp", "three.csv", *RUN], "Invalid source in three.csv.", "four matches at least"),
    "four matches": (["warp", "four.csv", *FIT], "in four.csv.", "or --smoothing auto, or --no-fractional."),
    "a line": (["warp", "line.csv", *RUN], "Invalid source in line.csv.", "60 points on a line"),
    "columns": (["warp", "p.csv", *RUN], "Invalid matches.", "in p.csv"),
    "a wide radius": (["warp", "m.csv", *FIT, "--criterion", "ER60"], "Invalid --criterion.", "such as ER10"),
    "normalised": (["warp", "unit.csv", *FIT, "--image-size", "640x480"], "Invalid --image-size.", "in pixels"),
    "queries": (["warp", "m.csv", *RUN, "--queries", "image"], "Invalid --image-size.", "with --queries image"),
    "counts": (["warp", "m.csv", *RUN, "--counts", "3:99"], "Invalid --counts.", "number of matches, 60", "Given 99"),
    "an underscore": (["warp", "m.csv", *RUN, "--image_size", "6x4"], "Is it --image-size?", "mexpress warp --help"),
    "an option's ending": (["warp", "m.csv", *RUN, "--criterium=ER10"], "--criteria or --criterion?"),
    "threads": (["warp", "m.csv", *RUN, "--threads", "all"], "must be a whole number of at least 1, not 'all'"),
    "a seed": (["surface", "c.csv", *RUN, "--seed", "-1"], "--seed: must be a whole number of at least 0, not '-1'"),
    "an image of points": (["surface", "c.csv", *RUN, "--queries", "image"], "for points, give X0,Y0,X1,Y1"),
    "the data option": (["surface", "c.csv", *RUN, "--data", "2"], "Invalid --data."),
}  # fmt: skip


@pytest.mark.parametrize("case", COMMANDS)
def test_the_command_line_names_files_and_options_as_they_were_typed(case, folder, capsys):
    words, *parts = COMMANDS[case]
    assert main(words) == 2
    said = capsys.readouterr().err
    assert said.startswith("mexpress: error: ")
    assert said.count("\n") == 1
    for part in parts:
        assert part in said
    assert not re.search(r"pickle|\.part|image_size=|smoothing=|max_data", said)


def test_a_speck_of_an_image_is_noted():
    note = mx.select_warp(SOURCE / 640, TARGET / 640, **SIZE).notes[0]
    assert note.startswith("The source points extend over 1.4 only, in an image of 640 x 480 pixels.")
    assert mx.select_warp(SOURCE, TARGET, image_size=(640, 640)).notes == ()


def test_a_file_in_the_place_of_a_folder_is_named(tmp_path):
    (tmp_path / "p.csv").write_text("1,2")
    with pytest.raises(NotADirectoryError) as caught, replacing(tmp_path / "p.csv" / "x.npz"):
        pass
    assert caught.value.filename == str(tmp_path / "p.csv" / "x.npz")


def test_the_longest_name_is_written(tmp_path):
    with replacing(tmp_path / (251 * "a" + ".npz")) as file:
        file.write(b"all")
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"all"]


def test_a_link_stays_one_and_what_is_no_file_is_written_as_it_comes(tmp_path):
    (tmp_path / "far").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "far" / "file")
    for content in (b"old", b"new"):
        with replacing(tmp_path / "link") as file:
            file.write(content)
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "far" / "file").read_bytes() == b"new"
    assert len(list((tmp_path / "far").iterdir())) == 1
    with replacing(os.devnull) as file:
        file.write(b"gone")
    assert not Path(os.devnull).is_file()


@pytest.mark.parametrize("given", [np.ones((48, 64)), [[1.0, 2.0]], None, io.StringIO("1,2"), {"x": [1]}])
@pytest.mark.parametrize("read", [mx.io.read_matches, mx.io.read_points, mx.read_cloud])
def test_what_is_no_file_needs_no_reading(read, given):
    with pytest.raises(TypeError, match=r"name of a file, or a frame; arrays need no reading\. Given"):
        read(given)


def test_columns_of_a_frame_are_not_taken_in_another_order_than_x_and_y():
    frame = pd.DataFrame({"y": [0.0, 0, 1, 1], "x": [0.0, 1, 0, 1]})
    warp = mx.fit_warp(frame[["x", "y"]], frame[["x", "y"]], frame[["x", "y"]][:3])
    np.testing.assert_allclose(warp(pd.DataFrame({"x": [0.5], "y": [0.25]})), [[0.5, 0.25]])
    for ask in (warp, warp.inverse, lambda points: mx.select_warp(points, points)):
        with pytest.raises(ValueError, match=r"x first: \[\['x', 'y'\]\] turns them\. Given y, x\."):
            ask(frame)


@pytest.mark.parametrize("kind", ["Float64", "Int64", "double[pyarrow]", object])
def test_frames_of_types_that_know_na(kind):
    points = np.round(SOURCE)
    frame = pd.DataFrame(points).astype(kind)
    expected = mx.select_warp(points, TARGET, smoothing=0, counts=[4, 5])
    found = mx.select_warp(frame, pd.DataFrame(TARGET), smoothing=0, counts=[4, 5])
    np.testing.assert_array_equal(found.maps["FIT"], expected.maps["FIT"])
    frame.iloc[2, 1] = None
    with pytest.raises(
        ValueError, match=r'missing="drop" leaves out the rows of others\. Given nan at row 2, column 1'
    ):
        mx.select_warp(frame, TARGET)
    rest = np.arange(60) != 2
    expected = mx.select_warp(points[rest], TARGET[rest], smoothing=0, counts=[4, 5])
    found = mx.select_warp(frame, TARGET, smoothing=0, counts=[4, 5], missing="drop")
    np.testing.assert_array_equal(found.maps["FIT"], expected.maps["FIT"])


def test_text_in_a_frame_is_not_taken_for_numbers():
    with pytest.raises(TypeError, match="'1' at row 0, column 0"):
        mx.select_warp(pd.DataFrame([["1", "2"]] * 60), TARGET)
