"""Two views of a sheet with a known motion: flat, rigid and curved, or deformed."""

from __future__ import annotations

import numpy as np

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.simulation.cameras import FOCAL
from mexpress.simulation.developable import HEIGHT, WIDTH, Sheet, sheets
from mexpress.simulation.pairs import Correspondences, match, stream
from mexpress.simulation.poses import random_camera

KINDS = ("flat", "rigid", "deformable")
PROJECTIONS = ("affine", "perspective")


def scene(kind: str, projection: str, n: int, noise: float = 1.0, seed: int = 0) -> Correspondences:
    """Matches between two views of a sheet, and the images of a contour on it.

    The directions of the views are drawn in the same way for all kinds, and do not depend on the number of points.

    Parameters
    ----------
    kind : {"flat", "rigid", "deformable"}
        A flat sheet, a curved sheet, or a curved sheet with another bending in the second view.
    projection : {"affine", "perspective"}
        Weak-perspective or perspective cameras.
    n : int
        Number of matches, at least 1.
    noise : float, default 1
        Standard deviation in pixels of every coordinate of every image point in both images.
    seed : int, default 0
        Seed of everything random.

    Returns
    -------
    Correspondences
        The matches, and the images of the contour.

    Raises
    ------
    ValueError, TypeError
        If an argument is invalid.

    Examples
    --------
    >>> from mexpress import simulation
    >>> simulation.scene("rigid", "affine", 51).contour_source.shape
    (400, 2)
    """
    index, affine = _choice(kind, "kind", KINDS), _choice(projection, "projection", PROJECTIONS) == 0
    n, seed = check.count(n, "n", 1), check.count(seed, "seed", 0)
    noise = check.number(noise, "noise", "It must be a number of at least 0.", 0.0)
    rng = stream(seed, 3)
    focal = float(rng.uniform(*FOCAL))
    flat = Sheet(np.zeros(1), np.zeros(1), np.zeros(1))
    first, second = sheets(seed)[4:6]
    pair = {"flat": (flat, flat), "rigid": (first, first), "deformable": (first, second)}[kind]
    source, target = ((sheet, random_camera(sheet, focal, rng, affine)) for sheet in pair)
    return match((source, target), n, noise, stream(seed, 4, index, int(affine), n), _contour())


def _choice(value: str, name: str, choices: tuple[str, ...]) -> int:
    """Index of a choice."""
    if not isinstance(value, str) or value not in choices:
        rule = f"It must be one of {', '.join(choices)}."
        check.refuse(name, rule, check.describe(value), ValueError if isinstance(value, str) else TypeError)
    return choices.index(value)


def _contour() -> Floats:
    """A wavy ellipse that encloses about half of the sheet, (400, 2)."""
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    radius = 0.4 * (1 + 0.12 * np.cos(5 * angle))
    return np.column_stack([np.cos(angle), np.sin(angle)]) * radius[:, None] * (WIDTH, HEIGHT)
