"""Which files are read, said to somebody who has another: by its ending, which are, and how to make one of it.

Examples
--------
>>> refuse_foreign(Path("scan.laz"), "cloud")
Traceback (most recent call last):
    ...
ValueError: Invalid cloud. Endings that are read: .png, .tif, .pgm, .pfm, .asc, .npy, .npz, .ply, .obj, .parquet, or
text such as .csv, .txt and .xyz. Given scan.laz; pdal translate scan.laz scan.ply makes a .ply.
"""

from pathlib import Path

from mexpress import _validation as check

_TABLES = ".csv, .txt or other text, .npz, .npy or .parquet"
_READ = {
    "cloud": ".png, .tif, .pgm, .pfm, .asc, .npy, .npz, .ply, .obj, .parquet, or text such as .csv, .txt and .xyz",
    "image": ".png, .jpg and whatever else Pillow knows, .tif, .pgm, .ppm or .pfm",
}
_IMAGES = {
    *(
        ".bmp",
        ".exr",
        ".gif",
        ".jp2",
        ".jpeg",
        ".jpg",
        ".pbm",
        ".pfm",
        ".pgm",
        ".png",
        ".pnm",
        ".ppm",
        ".tif",
        ".tiff",
    ),
    ".webp",
}
_PDAL = "pdal translate {file} {stem}.ply makes a .ply"
_ARRAYS = "{library} reads it in Python, and numpy.savez writes its arrays to an .npz"
_MESH = "save it as .ply, as MeshLab, CloudCompare and Open3D can"
_SHEET = "save the sheet as .csv"
_FOREIGN = {
    ".exr": 'cv2.imread("{file}", cv2.IMREAD_UNCHANGED) reads it in Python, and numpy.save writes an .npy',
    **dict.fromkeys([".las", ".laz", ".e57"], _PDAL),
    ".pcd": "pcl_pcd2ply {file} {stem}.ply makes a .ply",
    **dict.fromkeys([".ply", ".obj"], "read_cloud and mexpress surface read its vertices"),
    **dict.fromkeys([".stl", ".glb", ".gltf", ".off"], _MESH),
    ".mat": _ARRAYS.format(library="scipy.io.loadmat"),
    **dict.fromkeys([".yml", ".yaml", ".xml"], _ARRAYS.format(library="cv2.FileStorage")),
    **dict.fromkeys([".h5", ".hdf5"], _ARRAYS.format(library="h5py")),
    ".nc": 'in Python read_cloud takes xarray.open_dataset("{file}")["name"], one of its variables',
    **dict.fromkeys([".pt", ".pth"], _ARRAYS.format(library="torch.load")),
    **dict.fromkeys([".pkl", ".pickle"], _ARRAYS.format(library="pickle.load")),
    ".json": _ARRAYS.format(library="json.load"),
    **dict.fromkeys([".xls", ".xlsx", ".ods"], _SHEET),
    **dict.fromkeys([".jpg", ".jpeg"], "JPEG changes numbers: save depths as .png of 16 bits or as .tif"),
}


def is_image(path: Path) -> bool:
    """Tell whether a file's name has the ending of an image, which may be one that is not read or not written.

    Examples
    --------
    >>> is_image(Path("photo.JPG")), is_image(Path("points.csv"))
    (True, False)
    """
    return path.suffix.lower() in _IMAGES


def is_text(path: Path) -> bool:
    """Tell whether a file's name has no ending of another kind than text.

    Examples
    --------
    >>> is_text(Path("points.csv")), is_text(Path("points")), is_text(Path("points.npy"))
    (True, True, False)
    """
    return path.suffix.lower() not in {*_IMAGES, *_FOREIGN, ".npy", ".npz", ".parquet", ".pq"}


def readable(name: str) -> str:
    """Return the sentence that says which endings are read.

    Parameters
    ----------
    name : str
        What is wanted: a cloud, an image, or any kind of table.

    Examples
    --------
    >>> readable("matches")
    'Endings that are read: .csv, .txt or other text, .npz, .npy or .parquet.'
    """
    return f"Endings that are read: {_READ.get(name, _TABLES)}."


def refuse_foreign(path: Path, name: str) -> None:
    """Refuse a file whose ending is known to be one that is not read.

    Parameters
    ----------
    path : path
        Name of the file.
    name : str
        What messages call what is wanted.

    Raises
    ------
    ValueError
        If it is; the message tells how to make a file of it that is read.

    Examples
    --------
    >>> refuse_foreign(Path("cloud.csv"), "cloud")
    >>> refuse_foreign(Path("M.MAT"), "matches")
    Traceback (most recent call last):
        ...
    ValueError: Invalid matches. Endings that are read: .csv, .txt or other text, .npz, .npy or .parquet. Given M.MAT;
    scipy.io.loadmat reads it in Python, and numpy.savez writes its arrays to an .npz.
    """
    remedy = _FOREIGN.get(path.suffix.lower())
    if remedy is not None:
        check.refuse(name, readable(name), f"{path.name}; {remedy.format(file=path.name, stem=path.stem)}")
