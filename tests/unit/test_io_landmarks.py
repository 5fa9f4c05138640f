import numpy as np
import pandas as pd
import pytest

from mexpress.io.clouds import read_cloud
from mexpress.io.matches import read_matches, read_points, read_weighted_matches

QGIS = """#CRS: PROJCRS["WGS 84 / UTM zone 33N"]
mapX,mapY,{source}X,{source}Y,enable,dX,dY,residual
500010.5,4649900.25,10.5,-20.25,1,0,0,0
500110,4649800,110,-120,0,3,4,5
500210,4649700,210,-220,1,0,0,0
"""

BIGWARP = """"Pt-0","true","10.5","20.25","110.5","120.25"
"Pt-1","false","1","2","3","4"
"Pt-2","true","30","40","130","140"
"Pt-3","false","30","40","Infinity","Infinity"
"""


@pytest.mark.parametrize("source", ["source", "pixel"])
@pytest.mark.parametrize("name", ["scan.points", "scan.csv"])
def test_qgis(tmp_path, source, name):
    (tmp_path / name).write_text(QGIS.format(source=source))
    points, target, weights, known = read_weighted_matches(tmp_path / name)
    np.testing.assert_array_equal(points, [[10, 19.75], [209.5, 219.5]])  # centres of pixels are whole
    np.testing.assert_array_equal(target, [[500010.5, 4649900.25], [500210, 4649700]])
    assert (weights, known.nonzero()[0].tolist()) == (None, [0, 2])
    assert read_weighted_matches(tmp_path / name, "residual").weights.tolist() == [0, 0]


def test_columns_that_are_told_are_as_they_are(tmp_path):
    (tmp_path / "scan.points").write_text(QGIS.format(source="source"))
    columns = ["sourceX", "sourceY", "mapX", "mapY"]
    np.testing.assert_array_equal(
        read_matches(tmp_path / "scan.points", columns=columns)[0], [[10.5, -20.25], [210, -220]]
    )


def test_qgis_of_an_image_with_coordinates_must_be_told(tmp_path):
    (tmp_path / "scan.points").write_text(QGIS.format(source="source").replace("210,-220", "210,4649700"))
    told = r'columns=\["sourceX", "sourceY", "mapX", "mapY"\]\. Given 4\.6497e\+06 in scan\.points'
    with pytest.raises(ValueError, match=rf"^Invalid matches\. sourceY must be at most 0.*{told}"):
        read_matches(tmp_path / "scan.points")
    columns = ["sourceX", "sourceY", "mapX", "mapY"]
    np.testing.assert_array_equal(
        read_matches(tmp_path / "scan.points", columns=columns)[0], [[10.5, -20.25], [210, 4649700]]
    )
    (tmp_path / "scan.points").write_text(QGIS.format(source="source").replace("110,-120,1", "110,120,0"))
    np.testing.assert_array_equal(read_matches(tmp_path / "scan.points")[0], [[10, 19.75], [209.5, 219.5]])


def test_bigwarp(tmp_path):
    (tmp_path / "landmarks.csv").write_text(BIGWARP)
    moving, fixed, weights, known = read_weighted_matches(tmp_path / "landmarks.csv")
    np.testing.assert_array_equal(moving, [[10.5, 20.25], [30, 40]])
    np.testing.assert_array_equal(fixed, [[110.5, 120.25], [130, 140]])
    assert (weights, known.nonzero()[0].tolist()) == (None, [0, 2])
    (tmp_path / "landmarks.csv").write_text(
        BIGWARP.replace('"4"\n', '"4"\n"Pt-9","true","1","2","Infinity","4"\n')
    )
    with pytest.raises(ValueError, match=r"'Infinity' in line 3 of landmarks\.csv"):
        read_matches(tmp_path / "landmarks.csv")


def test_landmarks_that_are_not_active_stay_out_of_columns_that_are_told(tmp_path):
    (tmp_path / "landmarks.csv").write_text(BIGWARP)
    moving, fixed = read_matches(tmp_path / "landmarks.csv", columns=[5, 6, 3, 4])
    np.testing.assert_array_equal(moving, [[110.5, 120.25], [130, 140]])
    np.testing.assert_array_equal(fixed, [[10.5, 20.25], [30, 40]])
    rows = '"Pt-0","true","1","2","3","4","5","6"\n"Pt-1","false","9","9","9","9","9","9"\n'
    (tmp_path / "landmarks.csv").write_text(rows)
    moving, fixed = read_matches(tmp_path / "landmarks.csv", columns=[3, 4, 6, 7])
    assert (moving.tolist(), fixed.tolist()) == ([[1, 2]], [[4, 5]])


def test_points_of_landmarks_that_are_in_use(tmp_path):
    (tmp_path / "scan.points").write_text(QGIS.format(source="source"))
    (tmp_path / "landmarks.csv").write_text(BIGWARP)
    for name, columns, kept in (
        ("scan.points", ["mapX", "mapY"], [[500010.5, 4649900.25], [np.nan] * 2, [500210, 4649700]]),
        ("landmarks.csv", [3, 4], [[10.5, 20.25], [np.nan] * 2, [30, 40], [np.nan] * 2]),
    ):
        told = {"columns": columns, "missing": "keep"}
        np.testing.assert_array_equal(read_points(tmp_path / name, **told), kept)
        used = [row for row in kept if not np.isnan(row[0])]
        np.testing.assert_array_equal(read_points(tmp_path / name, columns=columns), used)
        with pytest.raises(ValueError, match=r"^Invalid points\. .* such as columns=\[1, 2\]"):
            read_points(tmp_path / name)


def test_bigwarp_in_space(tmp_path):
    (tmp_path / "landmarks.csv").write_text('"Pt-0","true","1","2","3","4","5","6"\n')
    with pytest.raises(ValueError, match=r"BigWarp must have two dimensions\. Given three in landmarks\.csv"):
        read_matches(tmp_path / "landmarks.csv")


@pytest.mark.parametrize("switch", ["enable", "Enabled", "active"])
@pytest.mark.parametrize(("on", "off"), [("1", "0"), ("true", "FALSE"), ("yes", "no"), ("1.0", "0.0")])
def test_rows_of_any_table_that_are_not_in_use(tmp_path, switch, on, off):
    rows = "".join(f"{k},{k}.5,1,2,{off if k == 1 else on}\n" for k in range(6))
    (tmp_path / "m.csv").write_text(f"x1,y1,x2,y2,{switch}\n{rows}")
    source, _, _, known = read_weighted_matches(tmp_path / "m.csv")
    assert (source[:, 0].tolist(), known.nonzero()[0].tolist()) == ([0, 2, 3, 4, 5], [0, 2, 3, 4, 5])
    np.testing.assert_array_equal(read_points(tmp_path / "m.csv", columns=["x1", "y1"]), source)
    np.testing.assert_array_equal(
        read_matches(pd.read_csv(tmp_path / "m.csv", true_values=["yes"], false_values=["no"]))[0], source
    )
    (tmp_path / "c.csv").write_text(
        f"{switch},x,y,z\n" + "".join(f"{off if k == 1 else on},{k},1,{k}\n" for k in range(6))
    )
    cloud = read_cloud(tmp_path / "c.csv")
    assert (cloud.values.tolist(), cloud.n_missing) == ([0, 2, 3, 4, 5], 1)


@pytest.mark.parametrize("header", ["a,b,c,d,enabled", "enabled,a,b,c,d", "a,b,active,c,d"])
@pytest.mark.parametrize(("on", "off"), [("1", "0"), ("true", "false")])
def test_a_switch_is_none_of_the_columns_without_known_names(tmp_path, header, on, off):
    at = [len(name) > 1 for name in header.split(",")].index(True)
    rows = [[*"1234"], [*"5678"]]
    for row, switch in zip(rows, (on, off), strict=True):
        row.insert(at, switch)
    (tmp_path / "m.csv").write_text("".join(",".join(row) + "\n" for row in [[header], *rows]))
    np.testing.assert_array_equal(np.hstack(read_matches(tmp_path / "m.csv")), [[1, 2, 3, 4]])


def test_bigwarp_below_a_header(tmp_path):
    header = "name,active,moving x,moving y,fixed x,fixed y\n"
    (tmp_path / "landmarks.csv").write_text(header + BIGWARP)
    moving, fixed, _, known = read_weighted_matches(tmp_path / "landmarks.csv")
    np.testing.assert_array_equal(moving, [[10.5, 20.25], [30, 40]])
    np.testing.assert_array_equal(fixed, [[110.5, 120.25], [130, 140]])
    assert known.nonzero()[0].tolist() == [0, 2]


def test_a_switch_that_is_neither_on_nor_off(tmp_path):
    (tmp_path / "m.csv").write_text("x1,y1,x2,y2,enabled\n1,2,3,4,1\n5,6,7,8,perhaps\n")
    with pytest.raises(
        ValueError, match=r"^Invalid matches\. .*0 or 1.* Given 'perhaps' in line 3 of m\.csv"
    ):
        read_matches(tmp_path / "m.csv")
