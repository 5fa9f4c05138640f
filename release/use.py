"""Use mexpress as installed: run in an environment that has nothing but it and numpy, `python -I release/use.py`.

Numbers are compared with refits by numpy, which knows no closed form.
"""

import csv
import json
import subprocess
import sys
import sysconfig
import tempfile
from importlib.metadata import files, version
from pathlib import Path

import numpy as np

import mexpress as mx

RNG = np.random.default_rng(5)


def refitted_score(A: np.ndarray, b: np.ndarray, held_out: list[np.ndarray]) -> float:
    """Root mean square error at row i of a fit to all rows but those of `held_out[i]`."""
    errors = []
    for i, rows in enumerate(held_out):
        solution = np.linalg.lstsq(np.delete(A, rows, axis=0), np.delete(b, rows, axis=0), rcond=None)[0]
        errors.append(b[i] - A[i] @ solution)
    return float(np.sqrt(np.sum(np.square(errors)) / len(errors)))


def splines(points: np.ndarray, control_points: np.ndarray) -> np.ndarray:
    """Thin-plate splines at points: the plane, and bumps of r^2 log r whose weights are orthogonal to planes."""
    squares = np.sum((points[:, None] - control_points[None]) ** 2, axis=2)
    bumps = 0.5 * squares * np.log(np.where(squares > 0, squares, 1.0))
    planes = np.column_stack([np.ones(len(control_points)), control_points])
    orthogonal = np.linalg.qr(planes, mode="complete")[0][:, 3:]
    return np.column_stack([np.ones(len(points)), points, bumps @ orthogonal])


def everything_but_one(n: int) -> list[np.ndarray]:
    """The rows that leave-one-out holds out for each row."""
    return [np.array([i]) for i in range(n)]


def installed() -> None:
    """What runs is the package in this environment, with its compiled module and its licences."""
    package, packages = Path(mx.__file__).resolve(), Path(sysconfig.get_path("platlib")).resolve()
    assert packages in package.parents, package
    licences = {file.name for file in files("mexpress") or [] if "licenses" in file.parts}
    assert {"LICENSE", "NOTICE"} <= licences, licences
    said = subprocess.check_output([sys.executable, "-I", "-m", "mexpress", "--version"], text=True)
    assert said.split() == ["mexpress", version("mexpress")], said


def least_squares() -> None:
    """Local exclusion of any least-squares problem."""
    points = RNG.uniform(0, 1, (60, 2))
    A, b = RNG.normal(size=(60, 7)), RNG.normal(size=60)
    near = [np.flatnonzero(np.hypot(*(points - point).T) <= 0.2) for point in points]
    cv = mx.LeastSquares(A, b).cross_validate(mx.schemes.exclusion_radius(points, 0.2))
    np.testing.assert_allclose(cv.score, refitted_score(A, b, near), rtol=1e-9)


def warp(folder: Path) -> None:
    """The warp between two images of a bent sheet: its scores, what it predicts, its file."""
    source = RNG.uniform(0, 500, (120, 2))
    truth = source @ [[1.1, 0.1], [-0.2, 0.9]] + 15 * np.sin(source[:, ::-1] / 90)
    target = truth + RNG.normal(0, 0.2, source.shape)
    counts = range(3, 61, 3)
    paper = mx.select_warp(source, target, criterion="CMPRESS", counts=counts, fractional=False, smoothing=0)
    A = splines(source / 500, paper.warp.control_points / 500)
    score = refitted_score(A, target, everything_but_one(len(A)))
    np.testing.assert_allclose(np.nanmin(paper.curves["CMPRESS"]), score, rtol=1e-7)
    best = mx.select_warp(source, target)
    inside = RNG.uniform(50, 450, (200, 2))
    expected = inside @ [[1.1, 0.1], [-0.2, 0.9]] + 15 * np.sin(inside[:, ::-1] / 90)
    assert np.sqrt(np.mean((best.warp(inside) - expected) ** 2)) < 0.5
    best.report(folder / "report.html")  # with the style and the script that are files of the package
    best.warp.save(folder / "warp.npz")
    np.testing.assert_array_equal(mx.load(folder / "warp.npz")(inside), best.warp(inside))


def surface(folder: Path) -> None:
    """A surface, from Python and from the command line: the same one."""
    points = RNG.uniform(0, 100, (200, 2))
    values = 10 * np.sin(points[:, 0] / 20) + 0.1 * points[:, 1] + RNG.normal(0, 0.5, 200)
    sel = mx.select_surface(points, values, smoothing=0, criterion="CMPRESS", max_count=40)
    A = splines(points / 100, sel.surface.control_points / 100)
    score = refitted_score(A, values, everything_but_one(len(A)))
    np.testing.assert_allclose(np.nanmin(sel.curves["CMPRESS"]), score, rtol=1e-7)
    rows = np.column_stack([points, values])
    np.savetxt(folder / "cloud.csv", rows, fmt="%.17g", delimiter=",", header="x,y,z", comments="")
    options = "--smoothing 0 --criterion CMPRESS --max-count 40 --no-plots"
    command(folder, "surface", "cloud.csv", *options.split(), "--out", "out")
    assert json.loads((folder / "out/selection.json").read_text())["count"] == sel.count
    command(folder, "apply", "out/surface.npz", "cloud.csv", "--out", "applied.csv")
    with (folder / "applied.csv").open(newline="") as lines:
        applied = [float(row["z"]) for row in csv.DictReader(lines)]
    np.testing.assert_allclose(applied, sel.surface(points), rtol=1e-9, atol=1e-9)


def command(folder: Path, *arguments: str) -> None:
    """Run the command that was installed, in a folder."""
    program = Path(sysconfig.get_path("scripts")) / "mexpress"
    subprocess.run([program, *arguments], cwd=folder, check=True, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    installed()
    least_squares()
    with tempfile.TemporaryDirectory() as scratch:
        warp(Path(scratch))
        surface(Path(scratch))
    print(
        f"mexpress {version('mexpress')} works with Python {sys.version.split()[0]} and numpy {np.__version__}."
    )
