"""The interface of liftings, and the registry of their names."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _core
from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.caching import cached_property
from mexpress.geometry import NEAR_LINE, Region, check_extent, covered_region, thinness
from mexpress.placement import COINCIDENT, lloyd

_CHUNK = 1 << 14
"""Numbers in one block of a temporary array, 128 KiB: blocks that stay in cache are fastest."""


@dataclass(frozen=True, eq=False, repr=False)
class Lifting(ABC):
    """Functions of the plane, one per control point: nu maps a point q to l numbers, and f(q) = nu(q) . x.

    The functions sum to one everywhere, so equal parameters give a constant function; f can be any affine function. A
    subclass defines `name`, `basis`, `derivatives` and `bending`, and may override the rest with better or faster
    methods. `register` adds it by its name.

    Parameters
    ----------
    control_points : array_like, (l, 2)
        Positions c_k, x then y; l is 3 or more.

    Attributes
    ----------
    name : str
        Name of the class for `fit_warp`, `select_warp` and files.

    Raises
    ------
    ValueError
        If there are fewer than three control points, if two coincide (are nearer than 1e-5 of the largest distance to
        the mean), or if all are on a line (their spread across it is below 1e-6 of the spread along it). Both rules
        compare distances, so the unit has no effect.

    Examples
    --------
    >>> lifting: Lifting = make_lifting("tps", [[0, 0], [1, 0], [0, 1], [1, 1]])
    >>> lifting.name, lifting.basis([[0, 0]]).shape, lifting.bending().shape
    ('tps', (1, 4), (1, 4))
    """

    control_points: Floats
    name: ClassVar[str]

    def __init_subclass__(cls) -> None:
        # A class that has a `basis` or a `place` of its own means it wherever ours are bypassed by what checks no more.
        for checked, trusted in (("basis", "at"), ("place", "place_over")):
            if checked in vars(cls) and trusted not in vars(cls):
                setattr(cls, trusted, vars(Lifting)[trusted])

    def __post_init__(self) -> None:
        points = check.points(self.control_points, "control_points").copy()
        check_spread(points)
        points.flags.writeable = False
        object.__setattr__(self, "control_points", points)

    def __reduce__(self) -> tuple[type[Self], tuple[Floats]]:
        # Caches are not pickled, and unpickled arrays are read-only again.
        return type(self), (self.control_points,)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({len(self.control_points)} control points)"

    @abstractmethod
    def basis(self, points: ArrayLike) -> Floats:
        """Return the l functions at n points.

        Parameters
        ----------
        points : array_like, (n, 2)
            Positions, in the unit of the control points.

        Returns
        -------
        ndarray, (n, l)
            Row i holds nu(q_i).

        Examples
        --------
        >>> make_lifting("tps", [[0, 0], [2, 0], [0, 2]]).basis([[1, 1]]).round(6) + 0.0
        array([[0. , 0.5, 0.5]])
        """

    def at(self, points: Floats) -> Floats:
        """Return the basis at checked points, (n, l); a class whose `basis` checks its points overrides this."""
        return self.basis(points)

    @abstractmethod
    def derivatives(self, points: ArrayLike) -> Floats:
        """Return the derivatives of the l functions at n points.

        Parameters
        ----------
        points : array_like, (n, 2)
            Positions, in the unit of the control points.

        Returns
        -------
        ndarray, (n, l, 2)
            Element [i, k, b] is the derivative of function k along coordinate b at point i, per unit of the points.

        Examples
        --------
        >>> make_lifting("tps", [[0, 0], [2, 0], [0, 2]]).derivatives([[1, 1]]).round(6) + 0.0
        array([[[-0.5, -0.5],
                [ 0.5,  0. ],
                [ 0. ,  0.5]]])
        """

    @abstractmethod
    def bending(self) -> Floats:
        """Return the rows Z of the bending energy ||Z x||^2 of f = nu . x.

        8 pi ||Z x||^2 is, or approximates, the integral of f_xx^2 + 2 f_xy^2 + f_yy^2, so a weight gives about the same
        stiffness for every lifting. The energy is in (unit of f)^2 per (unit of the points)^2.

        Returns
        -------
        ndarray, (k, l)
            Any number k of rows; Z x is zero if and only if f is affine.

        Examples
        --------
        >>> make_lifting("tps", [[0, 0], [1, 0], [0, 1]]).bending().shape
        (0, 3)
        """

    @cached_property
    def span(self) -> Floats:
        """Corners of the convex region outside which the lifting extrapolates, (c, 2), counter-clockwise.

        Examples
        --------
        >>> make_lifting("tps", [[0, 0], [2, 0], [0, 2], [0.5, 0.5]]).span
        array([[0., 0.], [2., 0.], [0., 2.]])
        """
        return covered_region(self.control_points, "control_points")

    def values(self, points: Floats, parameters: Floats) -> Floats:
        """Return nu(q_i) . x for every column x of the parameters.

        Parameters
        ----------
        points : ndarray, (n, 2)
            Positions. No (n, l) array is made, so there may be millions.
        parameters : ndarray, (l, r)
            One column per function.

        Returns
        -------
        ndarray, (n, r)
            Values, in the unit of the parameters.

        Examples
        --------
        >>> plane = make_lifting("tps", [[0, 0], [1, 0], [0, 1]])
        >>> plane.values(np.array([[2.0, 0.5]]), np.array([[1.0], [2.0], [3.0]])).round(6)
        array([[4.]])
        """
        values = np.empty((len(points), parameters.shape[1]))
        for rows in blocks(len(points), len(parameters)):
            values[rows] = self.at(points[rows]) @ parameters
        return values

    def slopes(self, points: Floats, parameters: Floats) -> Floats:
        """Return the derivatives of nu(q) . x, for every column x of the parameters.

        Parameters
        ----------
        points : ndarray, (n, 2)
            Positions. No (n, l, 2) array is made, so there may be millions.
        parameters : ndarray, (l, r)
            One column per function.

        Returns
        -------
        ndarray, (n, r, 2)
            Element [i, a, b] is the derivative of function a along coordinate b at point i.

        Examples
        --------
        >>> plane = make_lifting("tps", [[0, 0], [1, 0], [0, 1]])
        >>> plane.slopes(np.array([[2.0, 0.5]]), np.array([[1.0], [2.0], [3.0]])).round(6)
        array([[[1., 2.]]])
        """
        slopes = np.empty((len(points), parameters.shape[1], 2))
        for rows in blocks(len(points), 2 * len(parameters)):
            slopes[rows] = (self.derivatives(points[rows]).transpose(0, 2, 1) @ parameters).transpose(0, 2, 1)
        return slopes

    def preimages(self, positions: Floats, parameters: Floats, least: float) -> Floats:
        """Return the points that a map takes to positions, as far as the lifting can tell without search.

        Parameters
        ----------
        positions : ndarray, (n, 2)
            Values of the map.
        parameters : ndarray, (l, 2) or (l, 3)
            The map: two functions, or two that are divided by a third.
        least : float
            A number above zero; points with a denominator up to that are no solutions. Without denominators they are 1.

        Returns
        -------
        ndarray, (n, 2)
            Points to within rounding; NaN where there is none, where there are several, and where it is not known: by
            default, everywhere.

        Examples
        --------
        >>> plane = make_lifting("tps", [[0, 0], [1, 0], [0, 1]])
        >>> plane.preimages(np.array([[2.0, 0.5]]), plane.control_points, 0.5)
        array([[nan, nan]])
        """
        return np.full((len(positions), 2), np.nan)

    @classmethod
    def counts(cls, region: Floats, largest: int) -> list[int]:
        """Return the possible numbers of control points over a region, increasing.

        Parameters
        ----------
        region : ndarray, (k, 2)
            Corners of the convex hull of the data.
        largest : int
            Limit of the numbers; the first number may exceed it.

        Examples
        --------
        >>> type(make_lifting("tps", [[0, 0], [1, 0], [0, 1]])).counts(np.eye(3)[:, :2], 6)
        [3, 4, 5, 6]
        """
        return list(range(3, max(3, largest) + 1))

    @classmethod
    def place(cls, points: ArrayLike, count: int, seed: int = 0, threads: int | None = None) -> Floats:
        """Return control points over the region that the data cover.

        Parameters
        ----------
        points : array_like, (n, 2)
            Positions of the data, or only the corners of their convex hull.
        count : int
            Desired number of control points; exact if it is one of `counts`.
        seed : int
            Seed of random choices.
        threads : int, optional
            Largest number of threads; the result does not depend on it.

        Returns
        -------
        ndarray, (l, 2)
            Control points; the default method is `mexpress.placement.lloyd`.

        Examples
        --------
        >>> ThinPlateSpline = LIFTINGS["tps"]
        >>> ThinPlateSpline.place([[0, 0], [4, 0], [4, 4], [0, 4]], 5).shape
        (5, 2)
        """
        return lloyd(points, count, seed, threads)

    @classmethod
    def place_over(cls, region: Region, count: int, seed: int = 0, threads: int | None = None) -> Floats:
        """Return the control points of `place` over a known region; a class whose `place` finds it overrides this."""
        return cls.place(region.corners, count, seed, threads)


LIFTINGS: dict[str, type[Lifting]] = {}
"""Liftings by name; `register` adds them."""

Class = TypeVar("Class", bound=type[Lifting])


def register(lifting: Class) -> Class:
    """Add a lifting to `LIFTINGS`; used as a class decorator.

    After that, every function that takes the name of a lifting accepts it, and models with it load from files.

    Raises
    ------
    TypeError
        If it is not a subclass of `Lifting` with a name.
    ValueError
        If another class has this name.

    Examples
    --------
    >>> from mexpress.liftings import ThinPlateSpline
    >>> register(ThinPlateSpline) is ThinPlateSpline is LIFTINGS["tps"]
    True
    """
    rule = "It must be a subclass of Lifting with a name."
    if not (isinstance(lifting, type) and issubclass(lifting, Lifting)):
        check.refuse("lifting", rule, check.describe(lifting), TypeError)
    name = getattr(lifting, "name", None)
    if not isinstance(name, str) or not name:
        check.refuse("lifting", rule, f"{lifting.__name__} with the name {name!r}", TypeError)
    known = LIFTINGS.get(name, lifting)
    # The same class comes again from a reloaded module, or a notebook cell that is run twice.
    if (known.__module__, known.__qualname__) != (lifting.__module__, lifting.__qualname__):
        check.refuse("name", "No other lifting must have it.", f"{name!r}, the name of {known.__qualname__}")
    LIFTINGS[name] = lifting
    return lifting


def lifting_named(name: str) -> type[Lifting]:
    """Return the lifting of a name.

    Raises
    ------
    ValueError
        If no lifting has this name.

    Examples
    --------
    >>> lifting_named("tps").name
    'tps'
    """
    if not isinstance(name, str) or name not in LIFTINGS:
        rule = f"It must be one of {', '.join(LIFTINGS)}, or a name that `mexpress.liftings.register` has entered."
        check.refuse("lifting", rule + check.nearest_name(name, LIFTINGS), check.describe(name))
    return LIFTINGS[name]


def make_lifting(name: str, control_points: ArrayLike) -> Lifting:
    """Return the lifting of a name over control points, (l, 2).

    Raises
    ------
    ValueError
        If no lifting has this name, or the control points do not suit it.

    Examples
    --------
    >>> make_lifting("tps", [[0, 0], [1, 0], [0, 1]])
    ThinPlateSpline(3 control points)
    """
    return lifting_named(name)(check.points(control_points, "control_points"))


def check_lifting(value: object) -> None:
    """Refuse a value that is not a lifting.

    Examples
    --------
    >>> check_lifting("tps")
    Traceback (most recent call last):
    TypeError: Invalid lifting. It must be a Lifting, as `make_lifting` returns it. Given 'tps'.
    """
    if not isinstance(value, Lifting):
        rule = "It must be a Lifting, as `make_lifting` returns it."
        check.refuse("lifting", rule, check.describe(value), TypeError)


def blocks(n: int, width: int) -> Iterator[slice]:
    """Cut n rows of a temporary array into slices that stay in cache.

    Examples
    --------
    >>> list(blocks(20_000, 1))
    [slice(0, 16384, None), slice(16384, 32768, None)]
    """
    step = max(1, _CHUNK // width)
    return (slice(first, first + step) for first in range(0, n, step))


def check_spread(points: Floats) -> None:
    """Refuse fewer than three control points, control points on a line, coincident ones, and those too close for areas.

    Examples
    --------
    >>> check_spread(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 1.0]]))
    Traceback (most recent call last):
    ValueError: Invalid control_points. They must be farther apart than 1e-05 of their extent. Given [0.0, 1.0] at 2 ...
    """
    name = "control_points"
    if len(points) < 3:
        check.refuse(name, "There must be 3 or more.", f"{len(points)}")
    check_extent(points, name)
    if thinness(points) <= NEAR_LINE:
        rule = f"They must not lie on a line, to within {NEAR_LINE:g} of their extent."
        check.refuse(name, rule, f"{len(points)} points on a line")
    size = np.hypot(*(points - points.mean(axis=0)).T).max()
    pairs: Integers = _core.neighbours_nearest(points / size, 2, 1)[1].reshape(-1, 2)
    near = np.hypot(*np.diff(points[pairs] / size, axis=1)[:, 0].T) <= COINCIDENT
    if near.any():
        rule = f"They must be farther apart than {COINCIDENT:g} of their extent."
        first, second = pairs[near.argmax()]
        check.refuse(
            name, rule, f"{points[first].tolist()} at {first} and {points[second].tolist()} at {second}"
        )
