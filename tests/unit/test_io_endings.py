"""What is said to somebody who has a file of another kind."""

import re
import shlex

import numpy as np
import pytest
from rasters import png

from mexpress.cli import main
from mexpress.io.clouds import read_cloud
from mexpress.io.images import read_image
from mexpress.io.matches import read_matches, read_points

CLOUDS = r"Endings that are read: \.png, \.tif, \.pgm, \.pfm, \.asc, \.npy, \.npz, \.ply, \.obj, \.parquet, or text"
TABLES = r"Endings that are read: \.csv, \.txt or other text, \.npz, \.npy or \.parquet\."


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("depth.exr", "cv2.imread"),
        ("scan.las", "pdal translate scan.las scan.ply"),
        ("scan.LAZ", "pdal translate scan.LAZ scan.ply"),
        ("a b.e57", "a b.ply"),
        ("scan.pcd", "pcl_pcd2ply scan.pcd scan.ply"),
        ("m.mat", "scipy.io.loadmat"),
        ("m.yml", "cv2.FileStorage"),
        ("m.yaml", "cv2.FileStorage"),
        ("m.h5", "h5py"),
        ("m.pt", "torch.load"),
        ("m.xlsx", ".csv"),
        ("mesh.stl", "save it as .ply"),
        ("photo.jpg", "JPEG changes numbers"),
    ],
)
@pytest.mark.parametrize("content", [b"", b"1 2 3\n" * 9, b"\x00\xff\x80"])
def test_known_kinds_are_refused_with_a_way_out_whatever_is_in_them(tmp_path, name, says, content):
    (tmp_path / name).write_bytes(content)
    for read, kind, readable in [(read_cloud, "cloud", CLOUDS), (read_matches, "matches", TABLES)]:
        with pytest.raises(
            ValueError, match=rf"^Invalid {kind}\. {readable}.* Given {re.escape(name)}; .*{re.escape(says)}"
        ):
            read(tmp_path / name)


@pytest.mark.parametrize("name", ["mesh.ply", "mesh.obj"])
def test_meshes_are_clouds_and_nothing_else(tmp_path, name):
    (tmp_path / name).write_text("v 1 2 3\n")
    for read in (read_matches, read_points):
        with pytest.raises(ValueError, match=rf"{TABLES} Given {name}; read_cloud and mexpress surface read"):
            read(tmp_path / name)


def test_files_of_any_other_kind_say_what_is_read(tmp_path):
    path = tmp_path / "scan.xyzrgb"
    path.write_bytes(b"\x01\x00\x02\x00")
    for read, readable in [(read_cloud, CLOUDS), (read_matches, TABLES), (read_points, TABLES)]:
        with pytest.raises(ValueError, match=rf"{readable}.* Given scan\.xyzrgb, which is not\.$"):
            read(path)
    with pytest.raises(
        ValueError, match=r"^Invalid image\. .* that are read: \.png, \.jpg .*\.pfm\. Given scan\.xyzrgb: "
    ):
        read_image(path)


def test_the_command_line_says_it_in_one_line(tmp_path, capsys):
    (tmp_path / "scan.las").write_bytes(b"LASF")
    assert main(shlex.split(f"surface '{tmp_path}/scan.las' --out '{tmp_path}/out'")) == 2
    errors = capsys.readouterr().err
    assert re.fullmatch(rf"mexpress: error: Invalid cloud\. {CLOUDS}.*pdal translate scan\.las.*\n", errors)


def test_an_image_may_have_the_ending_of_another(tmp_path):
    (tmp_path / "a.jpg").write_bytes(png(np.eye(3, dtype=np.uint8)))
    np.testing.assert_array_equal(read_image(tmp_path / "a.jpg"), np.eye(3))
