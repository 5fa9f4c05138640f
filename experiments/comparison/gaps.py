"""Gaps in the data of a problem, which is then judged inside of them."""

from dataclasses import replace

import numpy as np

DISCS, RADIUS = 2, 0.14
"""Discs that are cut out, around data, and their radius in diagonals of the data's bounding box."""

SHARE = 0.3
"""Share of the data beyond a side that is cut off."""


def discs(points, random):
    """Return a function that tells which points are in discs around some points."""
    radius = RADIUS * np.hypot(*np.ptp(points, axis=0))
    centres = points[random.choice(len(points), DISCS, replace=False)]
    return lambda asked: (np.hypot(*np.moveaxis(asked[:, None] - centres, 2, 0)) < radius).any(axis=1)


def side(points, random):
    """Return a function that tells which points are beyond a line in a random direction."""
    angle = random.uniform(0, 2 * np.pi)
    direction = np.array([np.cos(angle), np.sin(angle)])
    limit = np.quantile(points @ direction, 1 - SHARE)
    return lambda asked: asked @ direction > limit


def with_gaps(scene, cut, draw):
    """Leave out the data in gaps of a scene, and judge there only."""
    given = scene(draw)
    inside = cut(given.source, np.random.default_rng((3, draw)))
    lost, asked = inside(given.source), inside(given.test_source)
    return replace(
        given,
        source=given.source[~lost],
        target=given.target[~lost],
        test_source=given.test_source[asked],
        test_target=given.test_target[asked],
    )
