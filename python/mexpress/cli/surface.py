"""`mexpress surface`: select and fit a surface to a depth map or a point cloud."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mexpress import plotting
from mexpress._validation import Floats
from mexpress.cli import common
from mexpress.io.clouds import Cloud, read_cloud
from mexpress.selection import SurfaceSelection, select_surface

_DATA = 10_000
"""As many data as the paper's depth maps have."""


def add_surface(commands: argparse._SubParsersAction[common.Parser]) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "surface",
        help="select and fit a surface to a depth map or a point cloud",
        description="Fit surfaces from stiff to flexible to a depth map or a point cloud, and select one: by default "
        "of those that many weights of the bending energy give. The output directory gets selection.json, curves.csv, "
        "surface.npz, meshes surface.ply and surface.obj, and curves.png, surface.png, residuals.png and "
        "control_points.png.",
    )
    add = parser.add_argument
    add(
        "input",
        metavar="INPUT",
        type=Path,
        help="depth map as .png, .tif, .pgm, .pfm, .asc, .npy or .npz; or points as .ply, .obj, .npy, .npz, .parquet "
        "or text with columns x y z or u v x y z, and weight if there; - is standard input",
    )
    common.add_table(parser, "x,y,z")
    add(
        "--scale",
        type=float,
        metavar="S",
        help="a depth map's units per metre (default: 1000 for images of whole numbers)",
    )
    add(
        "--intrinsics",
        type=_intrinsics,
        metavar="FX,FY,CX,CY",
        help="the camera in pixels: fit points in space instead of depths, in metres",
    )
    add("--unit", metavar="NAME", help="of the values, for texts and plots (default: m if there is a scale)")
    number = parser.add_mutually_exclusive_group()
    number.add_argument(
        "--data",
        type=common.whole(1),
        default=_DATA,
        metavar="N",
        help=f"draw so many of the data at random if there are more (default: {_DATA})",
    )
    number.add_argument("--all", action="store_true", help="use every datum")
    add(
        "--max-count",
        type=common.whole(3),
        metavar="N",
        help="largest number of control points (default: as many as data, at most 900; 175 without --smoothing auto)",
    )
    add(
        "--min-distance",
        type=float,
        metavar="D",
        help="of control points to each other; with residual placement alone (default: 2.5 %% of the diagonal)",
    )
    common.add_selection(
        parser, "nested, residual or lloyd (default: nested, or residual without --smoothing auto)"
    )
    parser.set_defaults(run=_run)


def _intrinsics(text: str) -> tuple[float, ...]:
    try:
        fx, fy, cx, cy = map(float, text.split(","))
    except ValueError:
        message = f"must be FX,FY,CX,CY in pixels, such as 525,525,319.5,239.5, not {text!r}"
        raise argparse.ArgumentTypeError(message) from None
    return fx, fy, cx, cy


def _run(arguments: argparse.Namespace) -> None:
    most = None if arguments.all else arguments.data
    column = arguments.weights or arguments.sigma
    with common.warnings_as_lines():
        cloud = read_cloud(
            arguments.input,
            arguments.scale,
            arguments.intrinsics,
            most,
            arguments.seed,
            column,
            **common.table_options(arguments),
        )
    unit = arguments.unit or cloud.unit
    arguments.out.mkdir(parents=True, exist_ok=True)
    options = common.selection_options(arguments)
    if isinstance(options["queries"], str):
        options["queries"] = _image(cloud)
    selection = select_surface(
        cloud.points,
        cloud.values,
        weights=common.as_weights(arguments, cloud.weights),
        max_count=arguments.max_count,
        min_distance=arguments.min_distance,
        **options,
    )
    selection = replace(selection, axes=cloud.axes)
    fit = _fit(selection)
    if not arguments.json:
        _print(selection, cloud, unit, fit["residuals"])
    common.warn_of_notes(selection)
    more = {
        "n_data": len(cloud.points),
        "n_valid": cloud.n_valid,
        "n_missing": cloud.n_missing,
        "image_size": cloud.image_size,
        "unit": unit,
        "surface": fit,
        "control_points": selection.control_points.tolist(),
    }
    written = common.write_selection(arguments, selection, more)
    selection.surface.save(arguments.out / "surface.npz")
    written += ["surface.npz", *_write_meshes(arguments.out, selection, cloud)]
    written += common.draw(arguments, _plots(selection, cloud, unit))
    common.write_report(arguments, partial(selection.report, image_size=cloud.image_size, unit=unit))
    common.print_end(arguments, "selection.json", written)


def _image(cloud: Cloud) -> tuple[float, ...]:
    """Return the rectangle of the depth map's pixels."""
    if cloud.image_size is None:
        raise common.UsageError(
            "--queries image belongs to depth maps: for points, give X0,Y0,X1,Y1 or a file"
        )
    return 0.0, 0.0, *cloud.image_size


def _fit(selection: SurfaceSelection) -> dict[str, Any]:
    """Return what there is to know about a surface besides its score."""
    kept = selection.kept
    residuals = selection.values[kept] - selection.surface(selection.points[kept])
    sizes = np.linalg.norm(residuals.reshape(len(residuals), -1), axis=1)
    return {
        "file": "surface.npz",
        "dimension": _dimension(selection.values),
        "control_points": selection.count,
        "residuals": common.sizes_summary(sizes),
    }


def _dimension(values: Floats) -> int:
    return 1 if values.ndim == 1 else values.shape[1]


def _print(selection: SurfaceSelection, cloud: Cloud, unit: str | None, residuals: dict[str, float]) -> None:
    total = f" of {cloud.n_valid}" if cloud.n_valid > len(cloud.points) else ""
    missing = common.missing_text(cloud.n_missing)
    dimension, counts = _dimension(cloud.values), selection.counts
    one = "depths" if cloud.image_size else "values"
    kind = one if dimension == 1 else f"points in R^{dimension}"
    print(
        f"{len(cloud.points)}{total} {kind}{missing}, surfaces with {counts[0]} to {counts[-1]} control points; "
        f"{unit or 'unit of the data'}; * smallest\n"
    )
    common.print_selection(selection, "selection.json")
    sizes = common.sizes_text(residuals)
    print(f"Residuals of the surface, in {unit or 'the unit of the data'}: {sizes}.")


def _write_meshes(out: Path, selection: SurfaceSelection, cloud: Cloud) -> list[str]:
    """Write what has a place in space; return the names of the files."""
    if _dimension(cloud.values) not in {1, 3}:
        common.warn("no meshes and no surface.png: they need depths or points in space.")
        return []
    names = ["surface.ply", "surface.obj"]
    for name in names:
        selection.surface.write_mesh(out / name)
    if cloud.image_size and _dimension(cloud.values) == 1:
        common.warn("the meshes have x and y in pixels; with --intrinsics they are in metres like the depth.")
    return names


def _plots(selection: SurfaceSelection, cloud: Cloud, unit: str | None) -> dict[str, Callable[[Path], Any]]:
    look: dict[str, Any] = {"image_size": cloud.image_size, "unit": unit}
    plots: dict[str, Callable[[Path], Any]] = {
        "curves.png": partial(plotting.plot_selection, selection, unit=unit),
        "surface.png": partial(selection.plot_surface, **look),
        "residuals.png": partial(selection.plot_residuals, **look),
        "control_points.png": partial(selection.plot_control_points, **look),
    }
    if _dimension(cloud.values) not in {1, 3}:
        del plots["surface.png"]
    return plots
