"""`mexpress info`: what is in the file of a model or of a selection."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from mexpress.cli import common
from mexpress.cli import report as reports
from mexpress.geometry import lattice
from mexpress.models import FittedModel, Warp
from mexpress.selection.files import read, rebuilt
from mexpress.selection.fitted import FittedSelection

_PLACES = 1000
"""Places all over the region of the data at which the error to expect is asked for."""


def add_info(commands: argparse._SubParsersAction[common.Parser]) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "info",
        help="tell what is in the file of a model or of a selection",
        description="Tell what a saved warp, surface or selection is: its functions, control points and smoothing, the "
        "region and the number of its data, and the error to expect in that region; of a selection also what was "
        "tried, and its notes.",
    )
    parser.add_argument("file", metavar="FILE", type=Path, help="warp.npz, surface.npz, or a saved selection")
    common.add_json(parser)
    parser.set_defaults(run=_run)


def _run(arguments: argparse.Namespace) -> None:
    header = read(arguments.file)
    loaded = rebuilt(header, arguments.file)
    of_selection = isinstance(loaded, FittedSelection)
    content = {
        "file": str(arguments.file),
        "kind": loaded.kind,
        "format": int(header["version"]),
        "mexpress": str(header["mexpress"]) if "mexpress" in header else None,
        "model": describe(common.model_of(loaded)),
        **({"selection": loaded.to_dict()} if of_selection else {}),
    }
    if arguments.json:
        print(reports.as_json(content))
        return
    print(f"{arguments.file}: a {loaded.kind}, of mexpress {content['mexpress'] or '0.1.0 or older'}")
    print("\n".join(f"{name:16}{text}" for name, text in _lines(content["model"])))
    if of_selection:
        print()
        common.print_selection(loaded, "--json")
        common.warn_of_notes(loaded)


def describe(model: FittedModel) -> dict[str, Any]:
    """Return what there is to know about a model as plain values.

    Returns
    -------
    dict
        ``form`` is the text that the model prints as; ``fractional`` is of warps; ``domain`` is the rectangle around
        its region, as (left, top, right, bottom); ``data`` the number of data of its fit; ``error`` the ``median`` and
        the ``largest`` of the errors to expect all over the region, and ``covered`` the share of it where they have
        been tested. ``data`` and ``error`` are None if the model has no data.

    Examples
    --------
    >>> import mexpress as mx
    >>> points = np.random.default_rng(0).uniform(0, 9, (40, 2))
    >>> told = describe(mx.fit_surface(points, points[:, 0], points[:6]))
    >>> told["form"], told["data"], told["error"]["covered"] > 0.9
    ('Surface(depth, tps, 6 control points)', 40, True)
    """
    error = None
    if model.data is not None:
        places = lattice(model.domain, _PLACES)
        errors = model.error(places)
        errors[np.isnan(errors)] = np.inf  # where a warp vanishes
        error = {
            "median": float(np.median(errors)),
            "largest": float(errors.max()),
            "covered": float(model.covers(places).mean()),
        }
    return {
        "form": repr(model),
        "lifting": model.lifting.name,
        "control_points": len(model.control_points),
        "smoothing": model.smoothing,
        **({"fractional": model.fractional} if isinstance(model, Warp) else {}),
        "data": None if model.data is None else len(model.data.points),
        "domain": [*model.domain.min(axis=0).tolist(), *model.domain.max(axis=0).tolist()],
        "error": error,
    }


def _lines(model: dict[str, Any]) -> list[tuple[str, str]]:
    """Return what there is to know about a model as texts by name."""
    left, top, right, bottom = model["domain"]
    data, error = "not in the file", "not known without the data"
    if model["data"] is not None:
        data = str(model["data"])
        sizes = common.sizes_text({name: model["error"][name] for name in ("median", "largest")})
        unit = " pixels" if "fractional" in model else ""
        error = f"{sizes}{unit}; tested in {100 * model['error']['covered']:.0f} % of the region"
    return [
        ("model", model["form"]),
        ("data", data),
        ("region", f"x {left:.6g} to {right:.6g}, y {top:.6g} to {bottom:.6g}"),
        ("expected error", error),
    ]
