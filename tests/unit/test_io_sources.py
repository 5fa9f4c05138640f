import builtins

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.parquet
import pytest

from mexpress.io.clouds import read_cloud
from mexpress.io.matches import read_matches, read_points, read_weighted_matches

COLUMNS = {
    "name": ["a", "b", None, "d", "e"],
    "dst_y": [4.0, 8, None, 16, 20],
    "src_x": [1, 5, 9, 13, 17],
    "src_y": [2, 6, 10, 14, 18],
    "dst_x": [3, 7, 11, 15, 19],
    "w": [1, 2, 3, None, 5],
}
EXPECTED = np.array([[1, 2, 3, 4], [5, 6, 7, 8], [13, 14, 15, 16], [17, 18, 19, 20]])


def nullable(columns):
    return pd.DataFrame(columns).convert_dtypes()


def arrow(columns):
    return pd.DataFrame(columns).convert_dtypes(dtype_backend="pyarrow")


@pytest.mark.parametrize("frame", [pd.DataFrame, nullable, arrow, pl.DataFrame, pa.table])
def test_frames(frame):
    table = frame(COLUMNS)
    source, target, weights, known = read_weighted_matches(table, missing="drop")
    np.testing.assert_array_equal(np.hstack([source, target]), EXPECTED)
    assert (weights, known.nonzero()[0].tolist()) == (None, [0, 1, 3, 4])
    assert read_weighted_matches(table, "w", missing="drop").known.nonzero()[0].tolist() == [0, 1, 4]
    with pytest.raises(ValueError, match=r"missing=\"drop\".*row 2 of the frame"):
        read_matches(table)
    np.testing.assert_array_equal(
        read_points(table, columns=["src_y", 3]), np.array([COLUMNS["src_y"], COLUMNS["src_x"]]).T
    )
    cloud = read_cloud(table, columns=["src_x", "src_y", "dst_y"])
    assert (cloud.values.tolist(), cloud.n_missing) == ([4, 8, 16, 20], 1)
    with pytest.raises(ValueError, match=r"^Invalid points\. Columns must hold numbers"):
        read_points(table, columns=["name", "src_x"])


def test_parquet(tmp_path):
    pa.parquet.write_table(pa.table(COLUMNS), tmp_path / "m.parquet")
    np.testing.assert_array_equal(np.hstack(read_matches(tmp_path / "m.parquet", missing="drop")), EXPECTED)
    assert read_cloud(tmp_path / "m.parquet", columns=["src_x", "src_y", "dst_y"]).n_missing == 1
    (tmp_path / "m.parquet").write_bytes(b"PAR1 and nothing else")
    with pytest.raises(ValueError, match=r"^Invalid matches\. It must be a Parquet file\. Given m\.parquet"):
        read_matches(tmp_path / "m.parquet")


def test_parquet_needs_its_extra(tmp_path, monkeypatch):
    real = builtins.__import__

    def absent(name, *args, **kwargs):
        if name.startswith("pyarrow"):
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", absent)
    with pytest.raises(ImportError, match=r"pip install 'mexpress\[parquet\]'"):
        read_matches(tmp_path / "m.parquet")
