"""Matches of two images and of maps: simulated, tracked, and of planes whose homography is known."""

import xml.etree.ElementTree as ET
from functools import lru_cache

import numpy as np
from skimage.transform import ProjectiveTransform

from comparison.fields import random_surface, shared_noise
from comparison.problem import Problem
from mexpress.simulation import Configuration, correspondences

SIZE = (640.0, 480.0)
GRAF_SIZE = (800.0, 640.0)
STRONG = 2.0
"""By what factor denominators differ at least, over the points, where perspective is said to be strong."""

REACH = 0.05
"""Length in which noise that neighbours share is alike, in diagonals."""

CLUSTERS, CROWD = 6, 10
"""How many clusters there are, and of how many times as many matches they are taken."""

RIGHT = 5.0
"""Pixels from a match to where the homography puts it, if it is right."""


def rectangle(size):
    """Return the corners of an image."""
    return np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * size


def denominators(homography, points):
    """Return the ratio of the largest to the least denominator of a homography at points; inf if one is 0."""
    below = np.column_stack([points, np.ones(len(points))]) @ homography.params[2]
    below = below / below[0]
    return below.max() / below.min() if below.min() > 0 else np.inf


def strong_homography(random):
    """Draw a homography of an image whose denominators differ by a factor of 2 to 4."""
    strength, corners = 0.0, rectangle(SIZE)
    while not STRONG < strength < 2 * STRONG:
        moved = corners + random.uniform(0, 0.45, (4, 2)) * SIZE * np.sign(0.5 * np.array(SIZE) - corners)
        truth = ProjectiveTransform.from_estimate(corners, moved)
        strength = denominators(truth, corners)
    return truth


def homography(number, draw):
    """Match points of a plane under strong perspective, with noise of 1 px in both images."""
    random = np.random.default_rng(draw)
    truth = strong_homography(random)
    source, unseen = random.uniform(0, 1, (number, 2)) * SIZE, random.uniform(0, 1, (1000, 2)) * SIZE
    noise = random.normal(size=(2, number, 2))
    return Problem(source + noise[0], truth(source) + noise[1], unseen, truth(unseen), SIZE)


def graf(path, number, draw):
    """Match points of graf1 to graf3, that both images have, with noise of 1 px in both."""
    random = np.random.default_rng(draw)
    truth = ProjectiveTransform(
        np.array(ET.parse(path).find("H13/data").text.split(), dtype=float).reshape(3, 3)
    )
    places = random.uniform(0, 1, (CROWD * (number + 1000), 2)) * GRAF_SIZE
    seen = places[((truth(places) > 0) & (truth(places) < GRAF_SIZE)).all(axis=1)]
    source, unseen = seen[:number], seen[number : number + 1000]
    noise = random.normal(size=(2, number, 2))
    return Problem(source + noise[0], truth(source) + noise[1], unseen, truth(unseen), GRAF_SIZE)


def inliers(path, draw):
    """Take two thirds of the matches of a plane that its homography confirms; the others judge, as measured."""
    with np.load(path) as arrays:
        matches, truth = np.unique(arrays["tentative"], axis=0), ProjectiveTransform(arrays["H_A_to_B"])
    right = matches[np.hypot(*(truth(matches[:, :2]) - matches[:, 2:]).T) < RIGHT]
    train, test = thirds(len(right), np.random.default_rng(draw))
    return Problem(right[train, :2], right[train, 2:], right[test, :2], right[test, 2:])


def thirds(number, random):
    """Return two thirds of the indices, and the rest."""
    return np.split(random.permutation(number), [round(2 * number / 3)])


def two_views(path, random):
    """Return the points of a sheet that deforms, in two of its views."""
    with np.load(path) as arrays:
        views = arrays["image_points"]
    return views[random.choice(len(views), 2, replace=False)]


def tracked(path, noise, size, draw):
    """Match two views of a sheet that deforms; a third of the points judges, as measured."""
    random = np.random.default_rng(draw)
    first, second = two_views(path, random)
    train, test = thirds(len(first), random)
    noisy = second[train] + noise * random.normal(size=(len(train), 2))
    return Problem(first[train], noisy, first[test], second[test], size)


def all_tracked(path, size, draw):
    """Match two views of a sheet; all points are fitted and judge, as measured, until gaps are made."""
    first, second = two_views(path, np.random.default_rng(draw))
    return Problem(first, second, first, second, size)


@lru_cache(maxsize=1)
def strong_view(draw):
    """Draw two sheets and a view whose denominators differ by a factor of 2 at least, the same for any number."""
    random, strength = np.random.default_rng(draw), 0.0
    while strength < STRONG:
        pair = random.choice(10, 2, replace=False)
        where = Configuration(int(pair[0]), int(pair[1]), int(random.integers(5)))
        seen = correspondences(where, 1, seed=draw)
        nearest = ProjectiveTransform.from_estimate(seen.dense_source, seen.dense_target)
        strength = denominators(nearest, seen.dense_source)
    return where


def sheet(number, draw):
    """Match two images of a simulated sheet, under strong perspective, with noise of 1 px in both."""
    matches = correspondences(strong_view(draw), number, seed=draw)
    dense = matches.dense_source, matches.dense_target
    return Problem(matches.source, matches.target, *dense, matches.image_size)


def old_map(kind, number, draw):
    """Match control points of an old map to the ground, with errors of 0.3 % of its width.

    The map is turned and stretched, kind "affine"; also drawn in slight perspective, or also bent by 1 % of its width.
    """
    random = np.random.default_rng(draw)
    corners, width = rectangle(SIZE), SIZE[0]
    moved = corners @ (np.eye(2) + random.uniform(-0.3, 0.3, (2, 2)))
    if kind == "perspective":
        moved = moved + random.normal(0, 0.03, (4, 2)) * SIZE
    plane = ProjectiveTransform.from_estimate(corners, moved)
    bends = [random_surface(random, 0.5) for _ in range(2)]

    def truth(points):
        bend = 0.01 * width * np.column_stack([bend(points / width) for bend in bends])
        return plane(points) + bend if kind == "bent" else plane(points)

    source, unseen = random.uniform(0, 1, (number, 2)) * SIZE, random.uniform(0, 1, (1000, 2)) * SIZE
    noise = 0.003 * width * random.normal(size=(number, 2))
    return Problem(source, truth(source) + noise, unseen, truth(unseen), SIZE)


def clustered(scene, number, draw):
    """Keep those matches of a scene that are the nearest to the centres of a few clusters, as features crowd."""
    crowd, random = scene(CROWD * number, draw), np.random.default_rng((1, draw))
    centres = crowd.source[random.choice(len(crowd.source), CLUSTERS, replace=False)]
    away = np.sqrt(((crowd.source[:, None] - centres) ** 2).sum(axis=2).min(axis=1))
    kept = np.argsort(away)[:number]
    return Problem(
        crowd.source[kept], crowd.target[kept], crowd.test_source, crowd.test_target, crowd.image_size
    )


def shaken(scene, number, draw):
    """Add noise of 2 px to the target points of a scene that neighbours share."""
    given, random = scene(number, draw), np.random.default_rng((2, draw))
    length = REACH * np.hypot(*given.image_size)
    noise = [2 * shared_noise(given.source, length, random) for _ in range(2)]
    target = given.target + np.column_stack(noise)
    return Problem(given.source, target, given.test_source, given.test_target, given.image_size)
