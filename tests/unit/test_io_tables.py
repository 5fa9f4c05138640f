import numpy as np
import pytest

from mexpress.io.clouds import read_cloud
from mexpress.io.matches import read_matches, read_points, read_weighted_matches

ROWS = np.array([[1.5, 2, 3, 4], [5, 6.25, 7, 8], [9, 10, 11, -12]])
RNG = np.random.default_rng(0)


def text(table, header="", separator=","):
    rows = [separator.join(map(str, row)) for row in np.asarray(table).tolist()]
    return "\n".join([header, *rows] if header else rows) + "\n"


@pytest.fixture
def file(tmp_path):
    def file(content, name="t.csv"):
        path = tmp_path / name
        path.write_text(content, encoding="utf-8")
        return path

    return file


@pytest.mark.parametrize(
    "header",
    [
        "src_x,src_y,dst_x,dst_y",
        "x0,y0,x1,y1",
        "X1,Y1,X2,Y2",
        '"x1","y1","x2","y2"',
        "source_x,source_y,target_x,target_y",
        "sourceX,sourceY,mapX,mapY",
        "source.x (px),source.y (px),target.x (px),target.y (px)",
        "x_left,y_left,x_right,y_right",
        "u1,v1,u2,v2",
        "img0_x,img0_y,img1_x,img1_y",
        "col1,row1,col2,row2",
        "xa,ya,xb,yb",
        "lon1,lat1,lon2,lat2",
        "c1,r1,c2,r2",
        "before_x,before_y,after_x,after_y",
        "xmin,ymin,xmax,ymax",
        "col1,col2,col3,col4",
        "column1,column2,column3,column4",
        "moving x,moving y,fixed x,fixed y",
        "x,y,x',y'",
        "甲,乙,丙,丁",
        "a,b,c,d",
    ],
)
def test_headers_of_matches(file, header):
    np.testing.assert_array_equal(np.hstack(read_matches(file(text(ROWS, header)))), ROWS)


@pytest.mark.parametrize(
    "header",
    [
        "id,src_x,src_y,dst_x,dst_y",
        "score,x0,y0,x1,y1",
        "name,X1,Y1,X2,Y2",
        ",x1,y1,x2,y2",
        ",a,b,c,d",
        ",0,1,2,3",
    ],
)
def test_matches_behind_a_column_that_is_none(file, header):
    table = np.column_stack([[7, 8, 9], ROWS])
    np.testing.assert_array_equal(np.hstack(read_matches(file(text(table, header)))), ROWS)


@pytest.mark.parametrize("order", [[2, 3, 0, 1], [1, 0, 3, 2]])
@pytest.mark.parametrize(
    "names",
    [
        "source_x,source_y,target_x,target_y",
        "lon1,lat1,lon2,lat2",
        "c1,r1,c2,r2",
        "sample_left,line_left,sample_right,line_right",
        "before_x,before_y,after_x,after_y",
        "xs,ys,xt,yt",
        "x_s,y_s,x_d,y_d",
        "lx,ly,rx,ry",
        "E1,N1,E2,N2",
        "east_old,north_old,east_new,north_new",
    ],
)
def test_the_names_decide_and_not_the_order(file, names, order):
    names = np.array(names.split(","))[order]
    path = file(text(ROWS[:, order], ",".join(names)))
    np.testing.assert_array_equal(np.hstack(read_matches(path)), ROWS)


@pytest.mark.parametrize(
    ("read", "header", "says"),
    [
        (read_matches, "i1,j1,i2,j2", "x1 may be i1 or j1"),
        (read_matches, "j,i,q,p", "x1 may be j or i"),
        (read_matches, "ymin,xmin,ymax,xmax", "x1 may be ymin or xmin"),
        (read_matches, "q after,p after,q before,p before", "x1 may be q after or q before"),
        (read_points, "i,j", "x may be i or j"),
        (read_points, "j,i", "x may be j or i"),
        (read_points, "yyy,xxx", "x may be yyy or xxx"),
        (read_points, "ys,xs", "x may be ys or xs"),
        (read_points, "ymin,xmin", "x may be ymin or xmin"),
        (read_points, "grid_row,grid_col", "x may be grid_row or grid_col"),
        (read_cloud, "i,j,depth", "x may be i or j"),
    ],
)
def test_names_that_contradict_the_order_are_refused_with_both_readings(file, read, header, says):
    width = header.count(",") + 1
    path = file(text(np.ones((5, width)), header))
    with pytest.raises(ValueError, match=rf"columns=.*Given \d columns \(.*\), where {says}, in t\.csv"):
        read(path)


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("x,y", [0, 1]),
        ("r,c", [1, 0]),
        ("line,sample", [1, 0]),
        ("b,c", [0, 1]),
        ("lon,lat", [0, 1]),
        ("lat,lon", [1, 0]),
        ("lat,long", [1, 0]),
        ("yy,xx", [1, 0]),
        ("xx,yy", [0, 1]),
        ("N,E", [1, 0]),
        ("north,east", [1, 0]),
        ("id,N [m],E [m]", [2, 1]),
        ("hoch,rechts", [1, 0]),
        ("Nord,Ost", [1, 0]),
        ("Hochwert,Rechtswert", [1, 0]),
        ("E,N,sE,sN", [0, 1]),
        ("lon,lat,sx,sy", [0, 1]),
        ("xs,ys", [0, 1]),
        ("row,col", [1, 0]),
        ("id,y,x,z", [2, 1]),
        ("name,Easting [m],Northing [m]", [1, 2]),
        ("x,y,error", [0, 1]),
        ("id,src_x,src_y", [1, 2]),
        ("id,y2,x2", [2, 1]),
    ],
)
def test_headers_of_points(file, header, expected):
    table = RNG.normal(size=(5, header.count(",") + 1))
    np.testing.assert_array_equal(read_points(file(text(table, header))), table[:, expected])


def test_matches_are_no_points_until_it_is_clear_of_which_image(file):
    path = file(text(ROWS, "x1,y1,x2,y2"))
    with pytest.raises(ValueError, match=r"^Invalid points\. .*Given x1, y1 or x2, y2 in t\.csv"):
        read_points(path)
    np.testing.assert_array_equal(read_points(path, columns=["x2", "y2"]), ROWS[:, 2:])


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("x,y,z,r,g,b", [0, 1, 2]),
        ("nx,ny,nz,x,y,z", [3, 4, 5]),
        ("u,v,x,y,z,w", [0, 1, 2, 3, 4]),
        ("U V X Y Z", [0, 1, 2, 3, 4]),
        ("lat,lon,elevation", [1, 0, 2]),
        ("elev,northing,easting", [2, 1, 0]),
        ("N,E,Z", [1, 0, 2]),
        ("id,col,row,depth", [1, 2, 3]),
        ("easting,northing,height,depth", None),
    ],
)
def test_headers_of_clouds(file, header, expected):
    separator = " " if " " in header else ","
    table = RNG.normal(size=(5, len(header.split(separator))))
    path = file(text(table, header, separator))
    if expected is None:
        with pytest.raises(
            ValueError, match=r"Given easting, northing, depth or easting, northing, height in t\.csv"
        ):
            read_cloud(path)
        return
    cloud = read_cloud(path)
    np.testing.assert_array_equal(np.column_stack([cloud.points, cloud.values]), table[:, expected])


# Narrow tables


@pytest.mark.parametrize("width", [4, 5, 6, 7, 10])
@pytest.mark.parametrize("name", ["c.npy", "c.npz", "c.txt"])
def test_a_narrow_table_is_no_depth_map_and_must_say_what_it_is(tmp_path, width, name):
    table, path = RNG.random((300, width)), tmp_path / name
    {"npy": np.save, "npz": np.savez, "txt": np.savetxt}[name[2:]](path, table)
    readings = (
        f"Given {width} columns, which may be u v x y z or x y z and others," if width > 4 else "4 columns"
    )
    with pytest.raises(
        ValueError, match=rf"^Invalid cloud\. .*columns=\[1, 2, 3\]\..*{readings} .*c\.{name[2:]}"
    ):
        read_cloud(path)
    read = np.loadtxt(path) if name == "c.txt" else table
    for columns in ([1, 2, 3], ["3", "1", "4"], range(1, 6) if width >= 5 else [4, 3, 2]):
        cloud = read_cloud(path, columns=columns)
        expected = read[:, [int(k) - 1 for k in columns]]
        np.testing.assert_array_equal(np.column_stack([cloud.points, cloud.values]), expected)
        assert cloud.image_size is None


def test_an_xyz_file_begins_with_x_y_z_whatever_follows(file):
    for width in (3, 4, 6, 7, 9):
        table = RNG.normal(size=(6, width))
        cloud = read_cloud(file(text(table, separator=" "), "c.xyz"))
        np.testing.assert_array_equal(np.column_stack([cloud.points, cloud.values]), table[:, :3])


@pytest.mark.parametrize("shape", [(6, 8), (9, 7), (39, 10), (24, 11), (300, 11)])
def test_wider_arrays_are_depth_maps(tmp_path, shape):
    np.save(tmp_path / "d.npy", np.ones(shape))
    assert read_cloud(tmp_path / "d.npy").image_size == shape[::-1]


def test_a_narrow_depth_map_is_called_so(tmp_path):
    np.savez(tmp_path / "d.npz", depth=np.ones((300, 6)))
    assert read_cloud(tmp_path / "d.npz").image_size == (6, 300)
    np.savez(tmp_path / "d.npz", z=np.ones((300, 6)))
    with pytest.raises(ValueError, match=r"A depth map of this shape must be called depth, in an \.npz"):
        read_cloud(tmp_path / "d.npz")


def test_an_array_with_fields_has_a_header(tmp_path):
    fields = [("id", "U4"), ("z", "f4"), ("x", "i2"), ("y", "f8")]
    table = np.array([("a", 1, 2, 3), ("b", 4, 5, 6), ("c", 7, 8, 9), ("d", 1, 0, 1)], fields)
    np.save(tmp_path / "c.npy", table)
    cloud = read_cloud(tmp_path / "c.npy")
    np.testing.assert_array_equal(cloud.points, [[2, 3], [5, 6], [8, 9], [0, 1]])
    np.testing.assert_array_equal(cloud.values, [1, 4, 7, 1])


# Columns that are told


@pytest.mark.parametrize(
    "columns", [["a", "b", "c", "d"], [2, 3, 4, 5], ["2", "3", "4", "5"], ["A", "b", 4, "5"], np.arange(2, 6)]
)
def test_columns_by_name_and_by_number(file, columns):
    path = file(text(np.column_stack([[7, 8, 9], ROWS, [0, 0, 0]]), "number,a,b,c,d,e"))
    np.testing.assert_array_equal(np.hstack(read_matches(path, columns=columns)), ROWS)


def test_a_name_that_is_a_number_is_a_name(file):
    path = file(text(np.column_stack([[7, 8, 9], ROWS]), ",0,1,2,3"))
    np.testing.assert_array_equal(np.hstack(read_matches(path, columns=["0", "1", "2", "3"])), ROWS)
    np.testing.assert_array_equal(np.hstack(read_matches(path, columns=[2, 3, 4, 5])), ROWS)


def test_weights_by_number(file):
    path = file(text(np.column_stack([ROWS, [1, 0.5, 2]])))
    source, target, weights, _ = read_weighted_matches(path, 5)
    np.testing.assert_array_equal(np.column_stack([source, target, weights]), np.loadtxt(path, delimiter=","))
    np.testing.assert_array_equal(read_weighted_matches(path, "1", columns=[2, 3, 4, 5]).weights, ROWS[:, 0])


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        (["a", "b", "c"], r"They must be 4 \(x1, y1, x2, y2\). Given 3, a, b, c"),
        (["a", "b", "c", "nothing"], "Given a, b, c, nothing for the columns 'a', 'b', 'c', 'd' in t.csv"),
        (["a", "b", "c", "a"], "must be different columns"),
        ([0, 1, 2, 3], "at least 1. Given 0"),
        ([1, 2, 3, 5], "by number from 1. Given 1, 2, 3, 5 for"),
        ([1.0, 2, 3, 4], "whole number"),
        ("abcd", "list of names"),
        (7, "list of names"),
    ],
)
def test_columns_that_are_refused(file, columns, says):
    with pytest.raises((ValueError, TypeError), match=rf"^Invalid columns\. .*{says}"):
        read_matches(file(text(ROWS, "a,b,c,d")), columns=columns)


@pytest.mark.parametrize(
    "arrays", [{"depth": np.ones((6, 6))}, {"points": np.eye(4, 2), "values": np.ones(4)}]
)
def test_columns_do_not_belong_to_arrays_with_names(tmp_path, arrays):
    np.savez(tmp_path / "c.npz", **arrays)
    with pytest.raises(ValueError, match=r"^Invalid columns\. They belong to a table\. Given .* for c\.npz"):
        read_cloud(tmp_path / "c.npz", columns=[1, 2, 3])


def test_columns_belong_to_tables(tmp_path):
    (tmp_path / "d.pgm").write_bytes(b"P5 6 6 255\n" + bytes(36))
    with pytest.raises(ValueError, match=r"^Invalid columns\. They belong to a table\. Given .* for d\.pgm"):
        read_cloud(tmp_path / "d.pgm", columns=[1, 2, 3])


# What is missing

HOLES = "x1,y1,x2,y2\n1,2,3,4\n5,,7,8\n9,-9999,11,12\n13,NA,15,16\n17,18,19,20\n"


@pytest.mark.parametrize(
    ("missing", "rows"),
    [("drop", [0, 2, 4]), (["drop", -9999], [0, 4]), (["drop", -9999, 20], [0]), (("drop", 1e10), [0, 2, 4])],
)
def test_rows_with_something_missing_are_left_out(file, missing, rows):
    source, target, _, known = read_weighted_matches(file(HOLES), missing=missing)
    assert known.nonzero()[0].tolist() == rows
    np.testing.assert_array_equal(source[:, 0], [[1, 5, 9, 13, 17][k] for k in rows])
    np.testing.assert_array_equal(target[:, 1], [[4, 8, 12, 16, 20][k] for k in rows])


@pytest.mark.parametrize("missing", [None, -9999, [65535, 0]])
def test_an_empty_cell_is_an_error_unless_it_is_told(file, missing):
    says = "missing=\"drop\" leaves out the rows of others. Given '' in line 3 of t.csv"
    with pytest.raises(ValueError, match=says):
        read_matches(file(HOLES), missing=missing)


def test_a_value_that_means_no_data_needs_no_more(file):
    source, _ = read_matches(file("1,2,3,4\n-9999,0,0,0\n5,6,7,65535\n8,9,10,11\n"), missing=[-9999, 65535])
    np.testing.assert_array_equal(source, [[1, 2], [8, 9]])


def test_rows_are_kept_as_nan(file):
    points = read_points(file("x,y,c\n1,2,\n3,,0\n-1,5,0\n7,8,0\n"), missing=["keep", -1])
    np.testing.assert_array_equal(points, [[1, 2], [np.nan] * 2, [np.nan] * 2, [7, 8]])


def test_other_columns_may_miss_what_they_like(file):
    path = file("x1,y1,x2,y2,note\n1,2,3,4,\n5,6,7,8,left\n9,1,2,3,NA\n")
    np.testing.assert_array_equal(read_matches(path)[0], [[1, 2], [5, 6], [9, 1]])


def test_nothing_is_left(file):
    with pytest.raises(
        ValueError, match=r"One row at least must have all of its numbers. Given none of 2 in t\.csv"
    ):
        read_matches(file("x1,y1,x2,y2\n1,2,3,NA\n1,2,,4\n"), missing="drop")


@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.int32])
def test_values_in_arrays(tmp_path, dtype):
    table = np.array([[1, 2, 3], [4, 5, -9999], [7, 8, 9], [1, 1, 1], [2, 5, 3]], dtype)
    np.save(tmp_path / "c.npy", table)
    cloud = read_cloud(tmp_path / "c.npy", missing=-9999)
    np.testing.assert_array_equal(cloud.values, [3, 9, 1, 3])
    assert cloud.n_missing == 1
    np.save(tmp_path / "c.npy", np.where(table == -9999, np.float32(-3.4e38), table.astype(np.float32)))
    assert read_cloud(tmp_path / "c.npy", missing=-3.4e38).n_missing == 1


@pytest.mark.parametrize("lowest", ["-3.4028235e+38", "-3.40282346638528860e+38", "-3.4e38"])
def test_the_lowest_float_in_short(file, lowest):
    path = file(f"x,y,z\n1,2,3\n4,5,{lowest}\n7,8,9\n1,1,1\n2,5,3.4e37\n")
    cloud = read_cloud(path, missing=-3.4e38)
    np.testing.assert_array_equal(cloud.values, [3, 9, 1, 3.4e37])


def test_clouds_leave_out_what_is_missing_and_count_it(file):
    cloud = read_cloud(
        file("x,y,z\n1,2,3\n4,5,\n7,8,NA\n1,1,null\n2,5,3\n2,6,-9999\n9,9,9\n0,0,0\n"), missing=[-9999]
    )
    np.testing.assert_array_equal(cloud.values, [3, 3, 9, 0])
    assert (cloud.n_valid, cloud.n_missing) == (4, 4)
