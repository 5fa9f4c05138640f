import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mexpress import fit_warp
from mexpress.io.clouds import read_cloud
from mexpress.io.matches import (
    read_matches,
    read_points,
    read_weighted_matches,
    write_matches,
    write_points_csv,
)

SOURCE = np.array([[1.0, 2.0], [5.0, 6.5], [9.0, -1e-3]])
TARGET = np.array([[3.0, 4.0], [7.0, 8.0], [0.1, 1e20]])
SQUARE = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
TABLE = np.hstack([SOURCE, TARGET])


def lines(separator):
    return "".join(separator.join(map(repr, row)) + "\n" for row in TABLE.tolist())


@pytest.mark.parametrize("first", ["sep=;", '"sep=;"', "SEP=;"])
def test_a_first_line_that_tells_excel_the_separator(tmp_path, first):
    (tmp_path / "m.csv").write_text(f"{first}\nx2;y2;x1;y1\n1,5;2;3;4\n")
    source, target = read_matches(tmp_path / "m.csv")
    assert (source.tolist(), target.tolist()) == ([[3, 4]], [[1.5, 2]])


@pytest.mark.parametrize("batch", [False, True])
def test_archives_of_matchers(tmp_path, batch):
    def save(**arrays):
        np.savez(
            tmp_path / "m.npz", **{key: array[None] if batch else array for key, array in arrays.items()}
        )
        return read_weighted_matches(tmp_path / "m.npz")[:3]

    source, target, _ = save(mkpts0=SOURCE, mkpts1=TARGET)
    np.testing.assert_array_equal(np.hstack([source, target]), TABLE)
    for weights in (None, np.array([0.1, 0.2, 0.3])):
        more = {} if weights is None else {"weights": weights}
        source, target, found = save(
            keypoints0=SOURCE, keypoints1=TARGET, matches0=np.array([2, -1, 0]), **more
        )
        np.testing.assert_array_equal(
            np.hstack([source, target]), np.hstack([SOURCE[[0, 2]], TARGET[[2, 0]]])
        )
        assert found is None or found.tolist() == [0.1, 0.3]
    source, target, _ = save(keypoints0=SOURCE, keypoints1=TARGET, matches=np.array([[2, 1]]))
    np.testing.assert_array_equal(np.hstack([source, target]), np.hstack([SOURCE[[2]], TARGET[[1]]]))


@pytest.mark.parametrize("read", [read_matches, read_points, read_cloud])
def test_a_saved_model_is_no_data(tmp_path, read):
    fit_warp(SQUARE, SQUARE + 1, [[1, 0], [0, 1], [0, 0]]).save(tmp_path / "warp.npz")
    says = r"\. The file must hold data\. Given warp\.npz, a saved model, which mexpress\.load reads\.$"
    with pytest.raises(ValueError, match=says):
        read(tmp_path / "warp.npz")


@pytest.mark.parametrize(
    "text",
    [
        lines(","),
        lines(" , "),
        lines(";"),
        lines("\t"),
        lines("   "),
        "\ufeff" + lines(","),
        "x1,y1,x2,y2\n" + lines(","),
        '"a","b","c","d"\n' + lines(","),
        "# by hand\n\n" + lines(",").replace("\n", "\r\n") + "\n\n",
        lines(",").replace("5.0", "'5.0'"),
    ],
)
def test_texts_that_people_write(tmp_path, text):
    (tmp_path / "m.csv").write_text(text, encoding="utf-8")
    source, target = read_matches(tmp_path / "m.csv")
    np.testing.assert_array_equal(source, SOURCE)
    np.testing.assert_array_equal(target, TARGET)


def test_named_columns_are_found_in_any_order_among_others(tmp_path):
    rows = "".join(f"{i};{d};{c};{b};{a}\n" for i, (a, b, c, d) in enumerate(TABLE.tolist()))
    (tmp_path / "m.txt").write_text("score;Y2;X2;Y1;X1\n" + rows)
    source, target = read_matches(str(tmp_path / "m.txt"))
    np.testing.assert_array_equal(np.hstack([source, target]), TABLE)


@given(
    st.lists(
        st.tuples(*[st.floats(allow_nan=False, allow_infinity=False, min_value=-1e100, max_value=1e100)] * 4),
        min_size=1,
        max_size=8,
    )
)
def test_what_is_written_is_read_bit_for_bit(tmp_path_factory, rows):
    path, table = tmp_path_factory.mktemp("m") / "m.csv", np.array(rows)
    write_matches(path, table[:, :2], table[:, 2:])
    np.testing.assert_array_equal(np.hstack(read_matches(path)), table)


@pytest.mark.parametrize(
    "arrays",
    [
        {"source": SOURCE, "target": TARGET},
        {"source": SOURCE, "target": TARGET, "scores": np.ones(3)},
        {"anything": TABLE},
        {"matches": TABLE, "scores": np.ones(3)},
        {"tentative": TABLE, "image": np.zeros((4, 4))},
    ],
)
def test_archives(tmp_path, arrays):
    np.savez(tmp_path / "m.npz", **arrays)
    np.testing.assert_array_equal(np.hstack(read_matches(tmp_path / "m.npz")), TABLE)


def test_plain_arrays(tmp_path):
    np.save(tmp_path / "m.npy", TABLE.astype(np.float32))
    np.testing.assert_array_equal(np.hstack(read_matches(tmp_path / "m.npy")), TABLE.astype(np.float32))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "which has none"),
        ("\n# nothing\n", "which has none"),
        ("x1,y1,x2,y2\n", "must have rows"),
        ("a,b,c,d\n", "'a' with nothing below it"),
        ("1,2,3\n", r"4 columns \(x1, y1, x2, y2\).*such as columns=\[1, 2, 3, 4\]\. Given 3 columns in"),
        ("1,2,3,4,5\n", r"Given 5 columns in"),
        ("1,2,3,4,five,6,seven\n", r"Given 6 columns in m.csv, besides 'seven' in line 1"),
        ("id,a,b,c\n1,2,3,4\n", r"Given 4 columns \(id, a, b, c\) in"),
        ("x2,y2,x,y\n1,2,3,4\n", r"Given 4 columns \(x2, y2, x, y\) in"),
        ("x0,y0,xa,ya,x1,y1,xb,yb\n1,2,3,4,5,6,7,8\n", "Given x0, y0, x1, y1 or xa, ya, xb, yb in"),
        ("x1,y1,x2,y2,x1\n1,2,3,4,5\n", "Given x1 twice in"),
        ("1,2,3,4\n1,2,3,4,5\n", "5 in line 2"),
        ("1,2,3,4\n\n1,2,nan,4\n", "'nan' in line 3"),
        ("1,2,3,4\n1,2,-Inf,4\n", "'-Inf' in line 2"),
        ("1,2,3,4\n1,2,three,4\n", "'three' in line 2"),
        ("1,2,x,4\n", "numbers. Given 'x' in line 1"),
        ("1,2,3,4\n1,2,,4\n", "'' in line 2"),
        ("1,2,3,4\n1,2,1_000,4\n", "'1_000' in line 2"),
        ("1,2,3,4\n1,2,٣,4\n", "in line 2"),
        ("1,2,3,4\n1,2,1e999,4\n", "'1e999' in line 2"),
        ("1;2,5;3;4\n1;2.5;3;4\n", "decimal comma that others have. Given '2.5' in line 2"),
        ("1;2;3;4\n1.000,5;2;3;4\n", "'1.000,5' in line 2"),
        ("1 2 3 4\n1 2 3 4 5 left\n", "4 columns, as the first has. Given 6 in line 2"),
        ("1 2 3 4\n1 2 3 left\n", "numbers. Given 'left' in line 2"),
        ("1 2 3 4\n1 2 3 left wall\n", "numbers. Given 'left' in line 2"),
        ("1,2,3,4\n1,2,3,4,-\n", "4 columns, as the first has. Given 5 in line 2"),
        (
            "name,x1,y1,x2,y2\nDoe,1,2,3,4\nDoe, J.,5,6,7,8\n",
            "5 columns, as the first has. Given 6 in line 3",
        ),
        ("x1,y1,x2,y2,s\n1,2,3,4\n", "5 columns, as the first has. Given 4 in line 2"),
        (
            "x1,y1,x2,y2\n1,2,3,4\n1,2,,4\n",
            "missing=\"drop\" leaves out .* Given '' in line 3",
        ),
        ("x1,y1,x2,y2\n1,2,3,4\n1,2,NA,4\n", "'NA' in line 3"),
    ],
)
def test_texts_that_are_refused(tmp_path, text, says):
    (tmp_path / "m.csv").write_text(text, encoding="utf-8")
    with pytest.raises(
        ValueError, match=rf"^Invalid matches\. .*{says}.*m\.csv|^Invalid matches\. .*m\.csv.*{says}"
    ):
        read_matches(tmp_path / "m.csv")


@pytest.mark.parametrize(
    ("arrays", "says"),
    [
        ({}, "no arrays"),
        ({"a": TABLE, "b": TABLE}, r"a \(3, 4\), b \(3, 4\)"),
        ({"a": SOURCE}, r"2 columns in a in m\.npz of shape \(3, 2\)"),
        ({"source": SOURCE}, r"2 columns in source in m\.npz of shape \(3, 2\)"),
        ({"source": SOURCE, "target": TARGET[:2]}, "2 for 3"),
        ({"source": SOURCE, "target": TARGET * np.nan}, "nan at row 0"),
        ({"matches": TABLE * np.inf}, "inf at row 0"),
        ({"matches": np.array([["1"] * 4])}, "real numbers"),
        ({"matches": TABLE, "weights": np.ones(2)}, r"weights\. .*3 numbers.*\(2,\)"),
        ({"a": np.ones((3, 5))}, r"columns=\[1, 2, 3, 4\].*5 columns in a in m\.npz of shape \(3, 5\)"),
        ({"matches": np.array([[None] * 4])}, "arrays of numbers"),
    ],
)
def test_archives_that_are_refused(tmp_path, arrays, says):
    np.savez(tmp_path / "m.npz", **arrays)
    with pytest.raises((ValueError, TypeError), match=rf"^Invalid .*{says}"):
        read_matches(tmp_path / "m.npz")


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 nonsense", bytes(range(256))])
@pytest.mark.parametrize("name", ["m.npz", "m.npy", "m.csv"])
def test_damaged_files(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=r"^Invalid matches\."):
        read_matches(tmp_path / name)


def test_points(tmp_path):
    with (tmp_path / "p.csv").open("w") as file:
        write_points_csv(file, SOURCE)
    np.testing.assert_array_equal(read_points(tmp_path / "p.csv"), SOURCE)
    np.savez(tmp_path / "p.npz", points=SOURCE, other=TARGET)
    np.testing.assert_array_equal(read_points(tmp_path / "p.npz"), SOURCE)
    (tmp_path / "p.csv").write_text("1,2,3,4\n")
    with pytest.raises(ValueError, match=r"^Invalid points\. .*2 columns"):
        read_points(tmp_path / "p.csv")


def test_points_without_an_image_are_written(tmp_path):
    file = io.StringIO()
    write_points_csv(file, np.array([[np.nan, np.inf]]))
    assert file.getvalue() == "x,y\nnan,inf\n"


WEIGHTED = "x1,y1,x2,y2,weight,score\n1,2,3,4,0.5,9\n5,6,7,8,0,8\n"


def test_weights_are_a_column_by_name(tmp_path):
    path = tmp_path / "m.csv"
    path.write_text(WEIGHTED)
    assert read_weighted_matches(path)[2].tolist() == [0.5, 0]
    assert read_weighted_matches(path, "Score")[2].tolist() == [9, 8]
    np.testing.assert_array_equal(np.hstack(read_weighted_matches(path)[:2]), np.hstack(read_matches(path)))
    path.write_text("x1,y1,x2,y2,confidence\n1,2,3,4,5\n")
    assert read_weighted_matches(path)[2] is None  # other names must be given
    path.write_text("1,2,3,4\n")
    assert read_weighted_matches(path)[2] is None
    path.write_text("1,2,3,4,5\n")  # without names, five columns are no matches
    with pytest.raises(ValueError, match=r"^Invalid matches\. .* 4 columns"):
        read_weighted_matches(path)


@pytest.mark.parametrize("arrays", [{"source": SOURCE, "target": TARGET}, {"anything": TABLE}])
def test_weights_are_an_array_by_name(tmp_path, arrays):
    weights = np.array([1.0, 0.0, 2.0])
    np.savez(tmp_path / "m.npz", **arrays, weights=weights)
    source, target, found, known = read_weighted_matches(tmp_path / "m.npz")
    assert known.tolist() == [True] * 3
    np.testing.assert_array_equal(np.hstack([source, target]), TABLE)
    np.testing.assert_array_equal(found, weights)
    np.savez(tmp_path / "m.npz", **arrays, sigma=weights)
    np.testing.assert_array_equal(read_weighted_matches(tmp_path / "m.npz", "sigma")[2], weights)
    np.savez(tmp_path / "m.npz", **arrays)
    assert read_weighted_matches(tmp_path / "m.npz")[2] is None


def test_weights_that_are_not_there(tmp_path):
    (tmp_path / "m.csv").write_text(WEIGHTED)
    np.savez(tmp_path / "m.npz", source=SOURCE, target=TARGET)
    for name in ("m.csv", "m.npz"):
        with pytest.raises(ValueError, match=rf"^Invalid weights\. .*'sigma', which is not in {name}"):
            read_weighted_matches(tmp_path / name, "sigma")
    (tmp_path / "m.csv").write_text("x1,y1,x2,y2,weight\n1,2,3,4,much\n")
    with pytest.raises(ValueError, match=r"^Invalid matches\. .*'much' in line 2"):
        read_weighted_matches(tmp_path / "m.csv")


@pytest.mark.parametrize("shape", [(-1, 1, 2), (1, -1, 2)])
def test_points_in_files_may_have_the_shape_of_opencv(tmp_path, shape):
    source, target = np.arange(8.0).reshape(4, 2), np.arange(8.0).reshape(4, 2) ** 2
    np.save(tmp_path / "p.npy", source.reshape(shape))
    np.savez(tmp_path / "p.npz", source.reshape(shape))
    np.savez(tmp_path / "m.npz", source=source.reshape(shape), target=target.reshape(shape))
    np.testing.assert_array_equal(read_points(tmp_path / "p.npy"), source)
    np.testing.assert_array_equal(read_points(tmp_path / "p.npz"), source)
    np.testing.assert_array_equal(read_matches(tmp_path / "m.npz"), (source, target))


def test_a_constant_among_points_is_noted(tmp_path):
    points = np.vstack([np.random.default_rng(0).uniform(0, 300, (40, 2)), np.full((4, 2), -9999.0)])
    np.save(tmp_path / "p.npy", points)
    with pytest.warns(UserWarning, match=r"4 of 44 values in p\.npy are -9999"):
        read_points(tmp_path / "p.npy")
