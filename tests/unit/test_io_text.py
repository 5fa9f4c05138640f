import codecs
import io
import sys

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mexpress.io.clouds import read_cloud
from mexpress.io.matches import read_matches, read_points

ROWS = np.array([[1.5, 2, 3, 4], [5, 6.25, 7, 8], [9, 10, 11, -12e-1]])


def text(separator=",", mark="."):
    return "".join(separator.join(map(str, row)).replace(".", mark) + "\n" for row in ROWS.tolist())


@pytest.mark.parametrize(
    "content",
    [
        "# one\n% two\n// three\n" + text(),
        "#x1,y1,x2,y2\n" + text(),
        text().replace("\n", "\n% between\n"),
        text().replace("\n", "  # good\n"),
        text(" ").replace("\n", "\t#good\n"),
        text().replace("\n", ",left\n"),
        text(" ").replace("\n", " the left wall\n"),
        text(" ").replace("\n", " the left wall\n", 1).replace("8.0\n", "8.0 door\n"),
        text(" ").replace("8.0\n", "8.0 bad one\n"),
        "x1 y1 x2 y2\n" + text(" ").replace("8.0\n", "8.0 bad one, 7\n"),
        "# x1 y1 x2 y2\n" + text(" ").replace("\n", " the left wall\n"),
        text().replace("8.0\n", "8.0,bad\n"),
        text("\t").replace("8.0\n", "8.0\tbad one\n"),
        "x1 y1 x2 y2 what\n" + text(" ").replace("\n", " the left wall\n"),
        text("\t").replace("\n", "\tthe left wall\n"),
        text("\t").replace("\n", "\t\n"),
        text().replace("\n", ",\n"),
        "".join(f"P{k},{line}\n" for k, line in enumerate(text().splitlines())),
        "".join(f'"Doe, J.",{line}\n' for line in text().splitlines()),
        'name,x1,y1,x2,y2\n"Doe, J.",' + text().replace("\n", '\n"Doe, J.",', 2),
        '"x1" "y1" "x2" "y2"\n' + "".join(f'"{k}" {line}\n' for k, line in enumerate(text(" ").splitlines())),
        "\tx1\ty1\tx2\ty2\n" + "".join(f"{k}\t{line}\n" for k, line in enumerate(text("\t").splitlines())),
        "Unnamed: 0,a,b,c,d\n" + "".join(f"{k},{line}\n" for k, line in enumerate(text().splitlines())),
        "0,1,2,3\n" + text(),
        text(";", ","),
        text("\t", ","),
        "x1;y1;x2;y2;note\n" + text(";", ",").replace("\n", ";3.5 or so\n"),
        '"' + text('","', ",").replace("\n", '"\n"', 2).replace("\n", '"\n').replace('""', '"')[:-2] + '"\n',
    ],
)
def test_texts_that_people_write(tmp_path, content):
    (tmp_path / "m.csv").write_text(content, encoding="utf-8")
    np.testing.assert_array_equal(np.hstack(read_matches(tmp_path / "m.csv")), ROWS)


@pytest.mark.parametrize(
    "content",
    [
        'x1,y1,x2,y2\n"1,234","2,500","1,240","2,510"\n800,700,810,705\n',
        'x1,y1,x2,y2\n"1,234","2,500","1,240","2,510"\n',
        "x1\ty1\tx2\ty2\n1,234\t2,500\t1,240\t2,510\n800\t700\t810\t705\n",
        "x1;y1;x2;y2\n1,234;2,500;1,240;2,510\n800;700;810;705\n",
    ],
)
def test_commas_that_may_be_decimal_or_between_thousands(tmp_path, content):
    (tmp_path / "m.csv").write_text(content)
    says = r"thousands without a mark, .* Given '1,234' in line 2 of m\.csv, which may be 1234 or 1\.234\.$"
    with pytest.raises(ValueError, match=rf"^Invalid matches\. .*{says}"):
        read_matches(tmp_path / "m.csv")


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ('"1,234","2,5"\n"3,000","4,125"\n', [[1.234, 2.5], [3, 4.125]]),
        ('"0,234","2,500"\n"3,000","4,125"\n', [[0.234, 2.5], [3, 4.125]]),
        ("1,234;2,500\n3,000;4,125\n", [[1.234, 2.5], [3, 4.125]]),
        ("1,234;2,500\n3;4,12\n", [[1.234, 2.5], [3, 4.12]]),
        ("1,234;0\n3,000;4\n", [[1.234, 0], [3, 4]]),
    ],
)
def test_commas_that_must_be_decimal(tmp_path, content, expected):
    (tmp_path / "p.csv").write_text(content)
    np.testing.assert_array_equal(read_points(tmp_path / "p.csv"), expected)


@pytest.mark.parametrize(
    "content",
    [
        'name,x,y\n"GCP #1",1,2\n',
        'name,x,y\n"GCP #1, left",1,2  # "good"\n',
        '"Point #",x,y\n"#1",1,2\n',
        'x y name\n1 2 "GCP #1"\n',
        '1,2 # 12" from the edge\n',
        '1,2,12" #1\n',
    ],
)
def test_a_quoted_hash_begins_no_comment(tmp_path, content):
    (tmp_path / "p.csv").write_text(content)
    np.testing.assert_array_equal(read_points(tmp_path / "p.csv"), [[1, 2]])


def test_a_quoted_separator_does_not_make_up_for_a_missing_cell(tmp_path):
    (tmp_path / "m.csv").write_text('name,x1,y1,x2,y2\n"A",1,2,3,4\n"B, 1, b",5,6\n')
    with pytest.raises(ValueError, match=r"5 columns, as the first has\. Given 3 in line 3"):
        read_matches(tmp_path / "m.csv")


def test_a_comment_names_columns_in_another_order(tmp_path):
    np.savetxt(tmp_path / "m.csv", ROWS[:, ::-1], delimiter=",", header="y2,x2,y1,x1")
    np.testing.assert_array_equal(np.hstack(read_matches(tmp_path / "m.csv")), ROWS)
    (tmp_path / "c.txt").write_text("//Z Y X R\n3 2 1 0\n6 5 4 0\n9 8 7 0\n4 5 1 0\n")
    cloud = read_cloud(tmp_path / "c.txt")
    np.testing.assert_array_equal(np.column_stack([cloud.points, cloud.values])[:2], [[1, 2, 3], [4, 5, 6]])


@pytest.mark.parametrize(
    ("read", "content", "expected"),
    [
        (read_matches, "# y1,x1,y2,x2\n# written by foo 1.2\n1,2,3,4\n", [2, 1, 4, 3]),
        (read_matches, "# y1,x1,y2,x2\n# written by foo yesterday\n1,2,3,4\n", [2, 1, 4, 3]),
        (read_matches, "# matches of two images\n# y1,x1,y2,x2\n\n# 1 pair\n1,2,3,4\n", [2, 1, 4, 3]),
        (read_matches, "# y1 x1 y2 x2\n1 2 3 4 the left wall\n", [2, 1, 4, 3]),
        (read_points, "# row col\n# frame 17\n1 2\n", [2, 1]),
        (read_points, "#lat lon\n#CRS: EPSG:4326\n48 11\n", [11, 48]),
        (read_points, "#CRS: EPSG:4326\n#lat lon\n48 11\n", [11, 48]),
        (read_points, "% Columns: lat, lon\n48 11\n", [11, 48]),
        (read_points, "# two points\n# frame 17\n48 11\n", [48, 11]),
    ],
)
def test_any_comment_before_the_numbers_may_name_the_columns(tmp_path, read, content, expected):
    (tmp_path / "t.txt").write_text(content)
    np.testing.assert_array_equal(np.ravel(read(tmp_path / "t.txt")), expected)


def test_a_comment_below_the_names_of_a_cloud(tmp_path):
    (tmp_path / "c.txt").write_text("# z x y\n# exported\n3 1 2\n6 4 5\n9 7 8\n1 0 0\n")
    cloud = read_cloud(tmp_path / "c.txt")
    np.testing.assert_array_equal(np.column_stack([cloud.points, cloud.values])[:2], [[1, 2, 3], [4, 5, 6]])


@pytest.mark.parametrize(
    ("read", "content"),
    [
        (read_matches, "0,1,2,3\n10,20,11,21\n30,40,31,41\n"),
        (read_matches, "0,1,2,3\n4,5,6,7.5\n"),
        (read_matches, "0,1,2,3\n1.5,2.5,3.5,4.5\n1.5,2.5,3.5,-4\n"),
        (read_points, "0;1\n10;20\n"),
        (read_cloud, "0,1,2\n10,20,11\n30,40,31\n5,6,7\n"),
        (read_cloud, "0 1 2\n10 20 11\n30 40 31\n5 6 7\n"),
    ],
)
def test_a_first_row_that_counts_may_be_names_or_numbers(tmp_path, read, content):
    (tmp_path / "m.csv").write_text(content)
    first = content.split("\n", 1)[0]
    with pytest.raises(
        ValueError, match=rf"may be names, .*, or a row; write names .* Given '{first}' above "
    ):
        read(tmp_path / "m.csv")


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("0,1\n10.0,20.0\n-3.5,nan\n", [[10, 20]]),
        ("0,1\n", [[0, 1]]),
        ("1,0\n10,20\n", [[1, 0], [10, 20]]),
        ("0.0,1\n10,20\n", [[0, 1], [10, 20]]),
        ("# x,y\n0,1\n10,20\n", [[0, 1], [10, 20]]),
        ("x,y\n0,1\n10,20\n", [[0, 1], [10, 20]]),
    ],
)
def test_a_first_row_that_counts_and_is_clear(tmp_path, content, expected):
    (tmp_path / "p.csv").write_text(content)
    np.testing.assert_array_equal(read_points(tmp_path / "p.csv", missing="drop"), expected)


@pytest.mark.parametrize(
    ("encoding", "mark"),
    [
        ("utf-8", b""),
        ("utf-8", codecs.BOM_UTF8),
        ("utf-16-le", codecs.BOM_UTF16_LE),
        ("utf-16-be", codecs.BOM_UTF16_BE),
        ("latin-1", b""),
        ("cp1252", b""),
    ],
)
def test_encodings(tmp_path, encoding, mark):
    content = "größe;x1;y1;x2;y2\r\n" + "".join(f"süß;{line}\r\n" for line in text(";", ",").splitlines())
    (tmp_path / "m.csv").write_bytes(mark + content.encode(encoding))
    np.testing.assert_array_equal(np.hstack(read_matches(tmp_path / "m.csv")), ROWS)
    weights = {"latin-1": "größe", "cp1252": "größe"}.get(encoding, "größe")
    np.testing.assert_array_equal(
        read_matches(tmp_path / "m.csv", columns=["x1", "y1", "x2", "y2"])[0], ROWS[:, :2]
    )
    with pytest.raises(ValueError, match="'süß' in line 2"):
        read_matches(tmp_path / "m.csv", columns=[weights, "y1", "x2", "y2"])


@pytest.mark.parametrize(
    "content", ["1,2,3,4\n".encode("utf-16-le"), codecs.BOM_UTF16_LE + b"1", b"PNG\0\xff", b"1,2,3\0,4\n"]
)
def test_what_is_no_text(tmp_path, content):
    (tmp_path / "m.csv").write_bytes(content)
    with pytest.raises(ValueError, match=r"UTF-8, Latin-1, or UTF-16 with a byte-order mark. Given m\.csv"):
        read_matches(tmp_path / "m.csv")


NOTHING = ["NA", "n/a", "NaN", "nan", "-nan", "NULL", "None", "<NA>", "#N/A", "#NV", "#DIV/0!", "-", "--"]
NOTHING += ["1.#QNAN", "-1.#IND", "1.#INF00", "-nan(ind)", "nan(snan)"]


@pytest.mark.parametrize("word", ["", *NOTHING])
def test_words_for_nothing(tmp_path, word):
    (tmp_path / "c.csv").write_text(f"x,y,z\n1,2,3\n1,2,{word}\n4,5,6\n7,8,9\n5,5,5\n")
    assert read_cloud(tmp_path / "c.csv").n_missing == 1


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
@pytest.mark.parametrize("word", NOTHING)
def test_words_for_nothing_in_every_column(tmp_path, word, separator):
    rows = [[word, "2"], ["3", "4"], ["5", word], [word, word], ["7", "8"]]
    (tmp_path / "p.csv").write_text("".join(separator.join(row) + "\n" for row in rows))
    np.testing.assert_array_equal(read_points(tmp_path / "p.csv", missing="drop"), [[3, 4], [7, 8]])
    with pytest.raises(ValueError, match=r"missing=\"drop\" leaves out .* in line 1 of p\.csv"):
        read_points(tmp_path / "p.csv")


@pytest.mark.parametrize("word", ["-", "NA", "#N/A"])
def test_words_for_nothing_among_labels(tmp_path, word):
    (tmp_path / "p.csv").write_text(f"1,2,{word}\n3,4,left\n5,6,{word}\n")
    np.testing.assert_array_equal(read_points(tmp_path / "p.csv"), [[1, 2], [3, 4], [5, 6]])


def test_comments_about_words_for_nothing(tmp_path):
    (tmp_path / "p.csv").write_text("#N/A means no data\n#name x y\n1 2 #N/A is good\n")
    np.testing.assert_array_equal(read_points(tmp_path / "p.csv"), [[1, 2]])


LINES = st.lists(st.text("019.,;-+\t \"'#%/xyzeNAn\r\n\0é", max_size=20), max_size=5).map("\n".join)


@given(
    st.one_of(st.binary(max_size=60), LINES.map(str.encode), LINES.map(lambda text: text.encode("utf-16")))
)
@example(b'"' + b"1" * 200_000 + b'",2,3,4')
@example(b'1,2,3,"4')
@example(b'"')
def test_any_bytes_have_an_answer_or_an_error_of_ours(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("t") / "t.csv"
    path.write_bytes(content)
    calls = [
        lambda: np.hstack(read_matches(path, missing="drop")),
        lambda: read_points(path, columns=[1, 2], missing=["keep", 9]),
        lambda: read_cloud(path, columns=["x", "1", "2"]).points,
    ]
    for call in calls:
        try:
            assert call().dtype == np.float64
        except (ValueError, TypeError) as error:
            assert str(error).startswith("Invalid ")  # noqa: PT017


def test_standard_input(monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(text().encode())))
    np.testing.assert_array_equal(np.hstack(read_matches("-")), ROWS)
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"1,2\n")))
    with pytest.raises(ValueError, match="Given 2 columns in standard input"):
        read_matches("-")
