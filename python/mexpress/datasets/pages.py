"""A printed page, a photo of it while it is bent, and matches between both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.datasets.photography import PHOTO, photo, photographed
from mexpress.datasets.printing import PAGE, Image, printed
from mexpress.geometry import grid_points

LATTICE = 12
"""Distance in pixels between the dense points."""

FARTHEST = 400.0
"""Largest distance in pixels of a wrong match from where it should be, in x and in y."""


@dataclass(frozen=True, eq=False, repr=False)
class BentPage:
    """A printed page and a photo of it, with matches and with the truth.

    Pixels have their centres at whole numbers: the centre of the first one is (0, 0), as for `Warp.remap`.

    Parameters
    ----------
    source : (n, 2) array
        Matches on the page in pixels, x then y.
    target : (n, 2) array
        The same in the photo, with noise.
    wrong : (n,) array of bool
        Which matches are wrong.
    dense_source, dense_target : (6930, 2) array
        A lattice on the page, row after row of 99 points, and where its points are in the photo: the truth.
    image_size : (float, float)
        Width and height of the page in pixels.

    Examples
    --------
    >>> import mexpress as mx
    >>> import numpy as np
    >>> bent = mx.datasets.bent_page()
    >>> sel = mx.select_warp(bent.source, bent.target)
    >>> errors = np.hypot(*(sel.warp(bent.dense_source) - bent.dense_target).T)
    >>> bool(np.median(errors) < 1)
    True
    >>> bent.page.shape, bent.photo.shape
    ((840, 1188, 3), (720, 1280, 3))
    """

    source: Floats
    target: Floats
    wrong: NDArray[np.bool_]
    dense_source: Floats
    dense_target: Floats
    image_size: tuple[float, float] = PAGE

    def __repr__(self) -> str:
        sizes = "page {} x {}, photo {} x {}".format(*PAGE, *PHOTO)
        return f"BentPage({len(self.source)} matches, {self.wrong.sum()} of them wrong, {sizes})"

    @property
    def page(self) -> Image:
        """The page as it was printed, (840, 1188, 3) of uint8; it cannot be written to."""
        return printed()

    @property
    def photo(self) -> Image:
        """The photo, (720, 1280, 3) of uint8; it cannot be written to."""
        return photo()


def bent_page(n: int = 200, noise: float = 1.0, outliers: int = 0, seed: int = 0) -> BentPage:
    """A printed page, a photo of it while it is bent, and matches between both.

    All is simulated: a page that bends but does not stretch, and a pinhole camera that looks at it obliquely. Matches
    are where there is print, as a detector would find them, so the margins have none. The page and the photo do not
    depend on the arguments.

    Parameters
    ----------
    n : int, default 200
        Number of matches, at least 1.
    noise : float, default 1
        Standard deviation in pixels of both coordinates of a match in the photo.
    outliers : int, default 0
        How many of the matches are wrong: somewhere else in the photo, up to 400 pixels off.
    seed : int, default 0
        Seed of the places of the matches, of the noise, and of what is wrong.

    Returns
    -------
    BentPage
        The matches, the truth, and both images.

    Raises
    ------
    ValueError, TypeError
        If an argument is invalid.

    Examples
    --------
    >>> import mexpress as mx
    >>> bent = mx.datasets.bent_page(noise=0.5, outliers=20)
    >>> sel = mx.select_warp(bent.source, bent.target, robust=True)
    >>> sorted(set(sel.left_out) & set(bent.wrong.nonzero()[0])) == list(bent.wrong.nonzero()[0])
    True
    """
    n, seed = check.count(n, "n", 1), check.count(seed, "seed", 0)
    noise = check.number(noise, "noise", "It must be a number of at least 0.", 0.0)
    outliers = check.count(outliers, "outliers", 0, n)
    rng = np.random.default_rng(seed)
    source = detected(n, rng)
    target = photographed(source) + noise * rng.normal(size=(n, 2))
    wrong = np.zeros(n, dtype=bool)
    wrong[rng.permutation(n)[:outliers]] = True
    target[wrong] += rng.uniform(-FARTHEST, FARTHEST, (outliers, 2))
    dense = lattice()
    return BentPage(source, target, wrong, dense, photographed(dense))


def detected(n: int, rng: np.random.Generator) -> Floats:
    """Return random points of the page where gray changes, (n, 2)."""
    gray = printed().mean(axis=2)
    down, across = np.gradient(gray)
    change = np.cumsum(np.hypot(down, across))
    y, x = np.divmod(np.searchsorted(change, rng.uniform(0, change[-1], n)), PAGE[0])
    return np.column_stack([x, y]) + rng.uniform(-0.5, 0.5, (n, 2))


def lattice() -> Floats:
    """Return the centres of square blocks of the page, (k, 2), row after row."""
    x, y = (np.arange(LATTICE / 2 - 0.5, size, LATTICE) for size in PAGE)
    return grid_points(x, y)
