"""Image warps: linear in a lifting, or fractional (deformable perspective)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _validation as check
from mexpress import notebook
from mexpress._validation import Floats
from mexpress.caching import cached_property
from mexpress.geometry import Region, check_extent, diagonal, hull, inside, lattice, nearest
from mexpress.liftings import ThinPlateSpline
from mexpress.models.base import nearest_constant, row_by_row
from mexpress.models.dense import dense
from mexpress.models.design import CardinalBasis, Design, fractional_design, linear_design
from mexpress.models.expectation import EXTRAPOLATE, FittedModel, check_outside
from mexpress.models.itk import check_plane, displacement_transform
from mexpress.models.observations import Observations
from mexpress.placement import farthest_order
from mexpress.resampling import check_fill, check_image, check_pixels, check_size, resampled

_SAMPLES = 1000
"""Number of sample points of the domain, for medians over it and for the starts of `inverse`."""

_HORIZON = 1e-3
"""A denominator below this fraction of its median over the domain is near zero."""

_TOLERANCE, _ROUNDING = 1e-11, 16
"""What `inverse` accepts: a fraction of the size of the domain's image, but so many units in the last place."""

_FEWEST, _SHARE, _MOST = 3, 4, 100
"""Control points of an estimate: one for every four matches, from three to a hundred."""


@dataclass(frozen=True, eq=False, repr=False)
class Warp(FittedModel):
    """A map from points of a source image to points of a target image.

    The deformable perspective warp (eqs. 16-21) is q' = (nu . p_1, nu . p_2) / (nu . p_3), with the lifting nu and the
    columns p_a of the parameters; with three control points it is a homography. With two columns there is no
    denominator.

    Parameters
    ----------
    lifting : Lifting
        A lifting with l control points in the source image.
    parameters : array_like, (l, 3) or (l, 2)
        Parameters of the two numerators, in pixels of the target image, and of the denominator, with mean 1 (eq. 19).
        With most liftings they are values at the control points. A common factor of all three columns has no effect.
    domain : array_like, (k, 2), or Region
        Points of the fit in the source image, or the region that they cover. The warp keeps their convex hull and
        extrapolates outside it.
    smoothing : float
        Weight of the bending energy in its fit.
    data : Observations, optional
        The data of its fit, for `error`, `covers` and `interval`.

    Raises
    ------
    TypeError
        If the lifting is not a `Lifting`.
    ValueError
        If the shapes do not fit, a number is not finite, or the domain has no area.

    Notes
    -----
    `warp.remap(target_image, (width, height), inverse=True)`,
    `cv2.remap(target_image, *warp.dense_map(width, height), cv2.INTER_LINEAR)` and
    `skimage.transform.warp(target_image, warp, output_shape=(height, width))` all resample the target image in the
    frame of the source image: they read the target image at the image of every source pixel. Beyond the horizon, where
    positions are NaN, the first two have their fill or border value; skimage has NaN, but 0 with order 0. With
    `warp.inverse` in the place of `warp`, skimage resamples the source image in the frame of the target image.

    Examples
    --------
    >>> import mexpress as mx
    >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
    >>> warp = mx.fit_warp(square, [[10, 0], [110, 0], [10, 200], [110, 200]], square[:3], fractional=False)
    >>> warp
    Warp(tps, 3 control points)
    >>> warp([[50, 50]]).round(6)
    array([[ 60., 100.]])
    >>> warp.jacobian([[50, 50]]).round(6) + 0.0
    array([[[1., 0.], [0., 2.]]])
    """

    kind: ClassVar[str] = "warp"

    def _checked_parameters(self) -> Floats:
        parameters = check.matrix(self.parameters, "parameters")
        count = len(self.control_points)
        if parameters.shape not in {(count, 2), (count, 3)}:
            rule = f"Their shape must be ({count}, 2) or ({count}, 3) for {count} control points."
            check.refuse("parameters", rule, f"{parameters.shape}")
        return parameters

    def __repr__(self) -> str:
        form = "fractional " if self.fractional else ""
        return f"Warp({form}{self._description()})"

    def _form(self) -> str:
        return f"a warp with{'' if self.fractional else 'out'} a denominator"

    def _picture(self) -> str:
        bent = [self(line, outside="nan") for line in self._lines()]
        return notebook.wires("the warped grid", [[(float(x), float(y)) for x, y in line] for line in bent])

    @classmethod
    def from_estimate(
        cls, source: ArrayLike, target: ArrayLike, count: int | None = None, *, fractional: bool = True
    ) -> Self | None:
        """Fit a thin-plate warp to matches at once, without selection, as `skimage.measure.ransac` asks for.

        `ransac((source, target), mexpress.Warp, ...)` takes the class as it is (scikit-image 0.26 or later): few
        matches give a homography, many a warp that bends. `select_warp` chooses the number of control points by
        cross-validation instead, and with `robust=True` finds wrong matches by itself.

        Parameters
        ----------
        source, target : array_like, (n, 2)
            Matched points in pixels of either image, x then y.
        count : int, optional
            Number of control points, at source points that are spread evenly; by default one for every four matches,
            from 3 to 100, and fewer if matches share a place.
        fractional : bool
            Whether the warp has a denominator.

        Returns
        -------
        Warp or None
            None if the matches do not determine the warp: they are on a line, or there are too few of them. `count`
            control points need (3 count - 1) / 2 matches, or `count` without a denominator, at as many places.

        Raises
        ------
        ValueError, TypeError
            If the points are not finite, not of shape (n, 2), or not as many in either image.

        Examples
        --------
        >>> import mexpress as mx
        >>> square = np.array([[0, 0], [100, 0], [0, 100], [100, 100]])
        >>> mx.Warp.from_estimate(square, 2 * square)
        Warp(fractional tps, 3 control points)
        >>> mx.Warp.from_estimate(square[:3], 2 * square[:3]) is None
        True
        """
        wanted = None if count is None else check.count(count, "count", _FEWEST)
        make = fractional_design if check.flag(fractional, "fractional") else linear_design
        if not len(check.queries(source, "source")) and not len(check.queries(target, "target")):
            return None
        points, values = check.points(source, "source").copy(), check.points(target, "target").copy()
        check.as_many(values, points)
        check_extent(values, "target")
        try:
            domain = Region(hull(points, "source"))
        except ValueError:  # fewer than three places, or on a line
            return None
        order = farthest_order(points, wanted or min(max(len(points) // _SHARE, _FEWEST), _MOST))
        if wanted is not None and len(order) < wanted:
            return None
        basis = CardinalBasis(ThinPlateSpline(points[order]))
        design: Design[Self] = make(basis, points, values, domain, cls)
        fit = design.fit()
        return design.model(fit.coefficients) if fit.rank == design.A.shape[1] else None

    def residuals(self, source: ArrayLike, target: ArrayLike) -> Floats:
        """Return how far the images of source points are from target points.

        Parameters
        ----------
        source, target : array_like, (k, 2)
            Matched points in pixels of either image.

        Returns
        -------
        ndarray, (k,)
            Distances in pixels of the target image: infinite where the warp vanishes, NaN where a position is not
            known.

        Raises
        ------
        ValueError, TypeError
            If the points are not as many in either image, or not of shape (k, 2).

        Examples
        --------
        >>> import mexpress as mx
        >>> square = np.array([[0, 0], [100, 0], [0, 100], [100, 100]])
        >>> mx.Warp.from_estimate(square, 2 * square).residuals([[10, 10]], [[23, 24]]).round(6)
        array([5.])
        """
        points, values = check.queries(source, "source"), check.queries(target, "target")
        check.as_many(values, points)
        distances = _norm(values - self(points))
        known = ~np.isnan(points).any(axis=1) & ~np.isnan(values).any(axis=1)
        return np.where(known & np.isnan(distances), np.inf, distances)

    @property
    def fractional(self) -> bool:
        """Whether the warp has a denominator.

        Examples
        --------
        >>> import mexpress as mx
        >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
        >>> warp = mx.fit_warp(square, [[0, 0], [100, 0], [20, 100], [80, 100]], square[:3])
        >>> warp.fractional
        True
        """
        return bool(self.parameters.shape[1] == 3)

    def __call__(self, points: ArrayLike, *, outside: str = EXTRAPOLATE) -> Floats:
        """Map points of the source image to the target image.

        Parameters
        ----------
        points : array_like, (k, 2)
            Positions in pixels of the source image, x then y.
        outside : {"extrapolate", "nan"}
            What to return outside the domain, the convex hull of the matches.

        Returns
        -------
        ndarray, (k, 2)
            Positions in pixels of the target image; NaN where the warp vanishes, and where a position is not known:
            NaN, infinite or beyond 1e100.

        Examples
        --------
        >>> import mexpress as mx
        >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
        >>> warp = mx.fit_warp(square, [[0, 0], [200, 0], [0, 100], [200, 100]], square[:3], fractional=False)
        >>> warp([[50, 50]]).round(6)
        array([[100.,  50.]])
        >>> warp([[50, 50], [500, 50]], outside="nan").round(6)
        array([[100.,  50.],
               [ nan,  nan]])
        """
        return self._valued(check.queries(points, "points"), self._image, outside)

    def jacobian(self, points: ArrayLike) -> Floats:
        """Return the derivatives of the target position by the source position.

        Parameters
        ----------
        points : array_like, (k, 2)
            Positions in pixels of the source image.

        Returns
        -------
        ndarray, (k, 2, 2)
            Element [i, a, b] is d target_a / d source_b at point i; NaN where the warp vanishes, and where a position
            is not known.

        Examples
        --------
        >>> import mexpress as mx
        >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
        >>> warp = mx.fit_warp(square, [[0, 0], [200, 0], [0, 100], [200, 100]], square[:3], fractional=False)
        >>> warp.jacobian([[50, 50]]).round(6) + 0.0
        array([[[2., 0.], [0., 1.]]])
        """
        return row_by_row(self._meaningful(points), self._jacobian)

    def denominator(self, points: ArrayLike) -> Floats:
        """Return the denominator nu . p_3 at points of the source image; ones for a warp without a denominator.

        Parameters
        ----------
        points : array_like, (k, 2)
            Positions in pixels of the source image.

        Returns
        -------
        ndarray, (k,)
            Values without a unit; the parameters have mean 1. They are numbers where the warp vanishes too, since they
            tell where that is. NaN where a position is not known.

        Examples
        --------
        >>> import mexpress as mx
        >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
        >>> warp = mx.fit_warp(square, [[0, 0], [100, 0], [20, 100], [80, 100]], square[:3])
        >>> values = warp.denominator([[0, 0], [0, 100]])
        >>> float((values[1] / values[0]).round(6))
        1.666667
        """
        return row_by_row(check.queries(points, "points"), self._denominator)

    def vanishes(self, points: ArrayLike, tolerance: float = _HORIZON) -> NDArray[np.bool_]:
        """Find where the warp maps points to infinity or beyond, so that its values are meaningless.

        Parameters
        ----------
        points : array_like, (k, 2)
            Positions in pixels of the source image.
        tolerance : float
            A denominator below this fraction of its median over the domain is near zero.

        Returns
        -------
        ndarray of bool, (k,)
            True where the denominator is near zero, or its sign differs from that of its median over the domain; and
            where a position is not known, since its image means nothing either.

        Examples
        --------
        >>> import mexpress as mx
        >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
        >>> warp = mx.fit_warp(square, [[0, 0], [100, 0], [20, 100], [80, 100]], square[:3])
        >>> warp.vanishes([[50, 50], [50, -300]])
        array([False,  True])
        """
        tolerance = check.positive(tolerance, "tolerance")
        return self._is_beyond(self.denominator(points), tolerance)

    def folds(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Find where the warp folds: where the sign of the Jacobian's determinant is not that of most of the domain.

        Parameters
        ----------
        points : array_like, (k, 2)
            Positions in pixels of the source image.

        Returns
        -------
        ndarray of bool, (k,)
            True where the determinant vanishes (to 1e-9 of the Jacobian's squared norm), is undefined, as it is where a
            position is not known, or has the opposite sign.

        Examples
        --------
        >>> import mexpress as mx
        >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
        >>> warp = mx.fit_warp(square, [[0, 0], [100, 0], [0, 100], [20, 20]], square, fractional=False)
        >>> warp.folds([[10, 10], [95, 95]])
        array([False,  True])
        """
        orientation = self._turning(self._samples).sum()
        return np.asarray(row_by_row(check.queries(points, "points"), self._turning, 0) * orientation <= 0)

    def inverse(self, points: ArrayLike, tolerance: float | None = None, max_steps: int = 50) -> Floats:
        """Find points of the source image that map to given points of the target image.

        The method is Newton's with halved steps, started at the sample of the domain with the nearest image. If the
        warp folds, there are several solutions, and one of them is found. Where a piecewise affine warp has exactly one
        inside its triangles, that is found without steps.

        Parameters
        ----------
        points : array_like, (k, 2)
            Positions in pixels of the target image.
        tolerance : float, optional
            Distance in the unit of the target image at which a solution is accepted; by default 1e-11 of the median
            distance of the domain's image to its middle. Where the coordinates of either image have no such digits,
            because they are far from zero, 16 units in their last place are accepted.
        max_steps : int
            Largest number of steps.

        Returns
        -------
        ndarray, (k, 2)
            Positions in pixels of the source image, inside the domain or not; NaN without a solution, where the warp
            vanishes, or where a position is not known.

        Examples
        --------
        >>> import mexpress as mx
        >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
        >>> warp = mx.fit_warp(square, [[0, 0], [100, 10], [0, 100], [70, 60]], square[:3])
        >>> warp.inverse(warp([[30, 40]])).round(6)
        array([[30., 40.]])
        """
        points, max_steps = check.queries(points, "points"), check.count(max_steps, "max_steps", 0)
        tolerance = None if tolerance is None else check.positive(tolerance, "tolerance")
        return row_by_row(points, lambda known: self._inverse(known, tolerance, max_steps))

    def _inverse(self, points: Floats, tolerance: float | None, max_steps: int) -> Floats:
        usable = self._samples[~self.vanishes(self._samples)]
        if not len(usable):
            return np.full_like(points, np.nan)
        images = self._map(usable)
        if tolerance is None:
            tolerance = _TOLERANCE * float(np.median(_norm(images - np.median(images, axis=0))))
        targets, front = points - self._centred[0], np.sign(self._usual)
        sources = self.lifting.preimages(targets, front * self._centred[1], _HORIZON * front * self._usual)
        near = _norm(targets - row_by_row(sources, self._map_about)) <= tolerance
        far = ~near  # also where there is none, at a distance of NaN
        if far.any():
            sources[far] = self._search(points[far], usable, images, tolerance, max_steps)
        return sources

    def _search(
        self, points: Floats, usable: Floats, images: Floats, tolerance: float, max_steps: int
    ) -> Floats:
        """Return what Newton's method finds from the samples with the nearest images."""
        start, stretch = nearest(points, images)[0], np.linalg.norm(self._jacobian(usable), axis=(1, 2))
        sources, targets = usable[start], points - self._centred[0]
        rounding = _ulp(points) + stretch[start] * _ulp(sources)
        error = targets - self._map_about(sources)
        damping = np.ones(len(points))
        for _ in range(max_steps):
            far = np.flatnonzero(_norm(error) > np.maximum(tolerance, rounding))
            if not len(far):
                break
            trial = sources[far] + damping[far, None] * self._newton_step(sources[far], error[far])
            trial_error = targets[far] - self._map_about(trial)
            better = _norm(trial_error) < _norm(error[far])  # False for NaN
            sources[far[better]], error[far[better]] = trial[better], trial_error[better]
            damping[far] = np.where(better, np.minimum(1, 2 * damping[far]), damping[far] / 2)
        sources[(_norm(error) > np.maximum(tolerance, _ROUNDING * rounding)) | self.vanishes(sources)] = (
            np.nan
        )
        return sources

    def dense_map(
        self, width: int, height: int, tolerance: float = 0.05, *, outside: str = EXTRAPOLATE
    ) -> NDArray[np.floating]:
        """Return the target position of every pixel of the source image, for `cv2.remap`.

        Parameters
        ----------
        width, height : int
            Size of the source image in pixels.
        tolerance : float
            Largest error in pixels of the source image, whose images have a side of sqrt(abs(det J)) in the median over
            the domain, with the Jacobian J. With 0, every pixel is mapped by itself.
        outside : {"extrapolate", "nan"}
            What to return outside the domain.

        Returns
        -------
        ndarray, (2, height, width)
            Target x, then target y: `cv2.remap(target_image, *warp.dense_map(width, height), cv2.INTER_LINEAR)`. NaN
            where the warp vanishes; `cv2.remap` puts its border value there. The type is float32, or float64 if the
            image of the domain is so far from zero that float32 has steps of more than a tenth of a pixel.

        Raises
        ------
        ValueError, TypeError
            If an argument is none of these, or the image has more than 10^10 pixels.

        Notes
        -----
        Positions are interpolated bicubically in blocks of up to 128 x 128 pixels, from exact values. The interpolation
        is compared with others, and blocks are cut until they agree.

        Examples
        --------
        >>> import mexpress as mx
        >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
        >>> shift = mx.fit_warp(square, [[7, 0], [107, 0], [7, 100], [107, 100]], square[:3], fractional=False)
        >>> shift.dense_map(3, 2).round(3)[0]
        array([[7., 8., 9.],
               [7., 8., 9.]], dtype=float32)
        """
        known = check_outside(outside)
        width, height = check_pixels(width, height)
        share = check.number(tolerance, "tolerance", "It must be a number of at least 0.", 0.0)
        dtype = _sufficient(self._map(self._samples), self._pixel)
        positions = dense(self._image, width, height, share * self._pixel, self.control_points, dtype)
        if known:
            x, y = np.arange(float(width)), np.arange(float(height))[:, None]
            positions[:, ~inside(self.domain, x, y)] = np.nan
        return positions

    def inverse_map(
        self, width: int, height: int, tolerance: float = 0.05, *, outside: str = EXTRAPOLATE
    ) -> NDArray[np.floating]:
        """Return the source position of every pixel of the target image, for `cv2.remap`.

        Parameters
        ----------
        width, height : int
            Size of the target image in pixels.
        tolerance : float
            Largest distance from what `inverse` returns, in pixels of the target image, see `dense_map`. Where the warp
            folds, a single pixel may have another of its sources, or none.
        outside : {"extrapolate", "nan"}
            What to return for source positions outside the domain.

        Returns
        -------
        ndarray, (2, height, width)
            Source x, then source y: `cv2.remap(source_image, *warp.inverse_map(width, height), cv2.INTER_LINEAR)`. NaN
            where nothing is mapped to. The type is as for `dense_map`.

        Raises
        ------
        ValueError, TypeError
            If an argument is none of these, or the image has more than 10^10 pixels.

        Examples
        --------
        >>> import mexpress as mx
        >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
        >>> shift = mx.fit_warp(square, [[7, 0], [107, 0], [7, 100], [107, 100]], square[:3], fractional=False)
        >>> shift.inverse_map(3, 2).round(3)[0]
        array([[-7., -6., -5.],
               [-7., -6., -5.]], dtype=float32)
        """
        known = check_outside(outside)
        width, height = check_pixels(width, height)
        share = check.number(tolerance, "tolerance", "It must be a number of at least 0.", 0.0)
        if not self._pixel > 0:  # nothing has an inverse
            return np.full((2, height, width), np.nan, dtype=np.float32)
        details = self._image(self.control_points)
        dtype = _sufficient(self.domain, 1 / self._pixel)
        positions = dense(self.inverse, width, height, share / self._pixel, details, dtype)
        if known:
            for row in positions.swapaxes(0, 1):
                row[:, ~inside(self.domain, *row)] = np.nan
        return positions

    def remap(
        self,
        image: ArrayLike,
        size: tuple[int, int] | None = None,
        *,
        inverse: bool = False,
        fill: ArrayLike = 0,
        tolerance: float = 0.05,
        outside: str = EXTRAPOLATE,
    ) -> NDArray[Any]:
        """Move an image as the warp moves points: a source image into the frame of the target image.

        Parameters
        ----------
        image : array_like, (h, w) or (h, w, c)
            The source image, of any type of real numbers; the target image if `inverse`.
        size : tuple of int, optional
            Width and height of the result; by default those of the image.
        inverse : bool
            Whether to move the target image into the frame of the source image instead.
        fill : float or array_like, (c,)
            Value of pixels that come from nowhere in the image, of its type.
        tolerance, outside
            As for `inverse_map`, or `dense_map` if `inverse`. What is outside is filled.

        Returns
        -------
        ndarray, (height, width) or (height, width, c)
            The image in its other frame, of the same type; bilinear between the centres of its pixels. Nothing warns of
            pixels that are filled, not even if all are, as where the other image's coordinates are metres.

        Examples
        --------
        >>> import mexpress as mx
        >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
        >>> shift = mx.fit_warp(square, [[1, 0], [101, 0], [1, 100], [101, 100]], square[:3], fractional=False)
        >>> shift.remap([[1, 2, 3], [4, 5, 6]])
        array([[0, 1, 2],
               [0, 4, 5]])
        >>> shift.remap([[1, 2, 3], [4, 5, 6]], inverse=True, fill=9)
        array([[2, 3, 9],
               [5, 6, 9]])
        """
        pixels = check_image(image, "image")
        width, height = pixels.shape[1::-1] if size is None else check_size(size, "size")
        positions_of = self.dense_map if check.flag(inverse, "inverse") else self.inverse_map
        value = check_fill(fill, pixels)
        return resampled(pixels, positions_of(width, height, tolerance, outside=outside), value)

    def displacement_field(
        self,
        width: int,
        height: int,
        tolerance: float = 0.05,
        *,
        inverse: bool = False,
        outside: str = EXTRAPOLATE,
    ) -> Floats:
        """Return how far every pixel of the source image is moved.

        Parameters
        ----------
        width, height : int
            Size of the source image in pixels; of the target image if `inverse`.
        tolerance, outside
            As for `dense_map`, or `inverse_map` if `inverse`.
        inverse : bool
            Whether pixels of the target image are moved, to the source image, instead.

        Returns
        -------
        ndarray, (height, width, 2)
            Vectors in pixels, x then y: a field of ITK as `sitk.GetImageFromArray(field, isVector=True)` takes it, for
            images without spacing, origin and direction. NaN where there is no position.

        Raises
        ------
        ValueError, TypeError
            If an argument is none of these, or the image has more than 10^10 pixels.

        See Also
        --------
        to_sitk : The transform of SimpleITK for images that have a place in space.

        Examples
        --------
        >>> import mexpress as mx
        >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
        >>> shift = mx.fit_warp(square, [[7, 0], [107, 0], [7, 100], [107, 100]], square[:3], fractional=False)
        >>> shift.displacement_field(2, 1).round(3) + 0.0
        array([[[7., 0.], [7., 0.]]])
        """
        positions_of = self.inverse_map if check.flag(inverse, "inverse") else self.dense_map
        x, y = positions_of(width, height, tolerance, outside=outside).astype(np.float64)
        return np.stack([x - np.arange(x.shape[1]), y - np.arange(len(y))[:, None]], axis=-1)

    def to_sitk(
        self,
        fixed: Any,
        moving: Any = None,
        tolerance: float = 0.05,
        *,
        inverse: bool = False,
        outside: str = EXTRAPOLATE,
    ) -> Any:
        """Return the warp as a transform of SimpleITK, a displacement field (extra ``simpleitk``).

        `sitk.Resample(moving, fixed, transform)` then resamples the moving image in the frame of the fixed image.

        Parameters
        ----------
        fixed : sitk.Image
            The source image, or the target image if `inverse`: its size, spacing, origin and direction.
        moving : sitk.Image, optional
            The other image, of which only spacing, origin and direction are used; by default they are those of `fixed`.
        tolerance, outside
            As for `dense_map`, or `inverse_map` if `inverse`.
        inverse : bool
            Whether the target image is the fixed one.

        Returns
        -------
        sitk.DisplacementFieldTransform
            From points of the fixed image to points of the moving image, both in ITK's physical space; NaN where there
            is no position, for which `sitk.Resample` has its default value.

        Raises
        ------
        TypeError, ValueError
            If an image is none of SimpleITK with two dimensions.
        ImportError
            If SimpleITK is not installed.

        Examples
        --------
        >>> import mexpress as mx
        >>> import SimpleITK as sitk
        >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
        >>> shift = mx.fit_warp(square, [[7, 0], [107, 0], [7, 100], [107, 100]], square[:3], fractional=False)
        >>> image = sitk.Image(30, 20, sitk.sitkFloat32)
        >>> np.round(shift.to_sitk(image).TransformPoint((2, 3)), 3).tolist()
        [9.0, 3.0]
        """
        here = check_plane(fixed, "fixed")
        there = here if moving is None else check_plane(moving, "moving")
        positions_of = self.inverse_map if check.flag(inverse, "inverse") else self.dense_map
        width, height = here.GetSize()
        return displacement_transform(here, there, positions_of(width, height, tolerance, outside=outside))

    @cached_property
    def _samples(self) -> Floats:
        return lattice(self.domain, _SAMPLES)

    @cached_property
    def _usual(self) -> float:
        """The denominator's median over the domain."""
        return float(np.median(self._denominator(self._samples)))

    @cached_property
    def _pixel(self) -> float:
        """Side of the image of a square of side 1, in the median over the domain; 0 if all of it vanishes."""
        usable = self._samples[~self.vanishes(self._samples)]
        return float(np.sqrt(np.median(np.abs(_determinant(self._jacobian(usable)))))) if len(usable) else 0.0

    def _design(self, data: Observations) -> Design[Self]:
        given = CardinalBasis(self.lifting), data.points, data.values, Region(self.domain), type(self)
        if self.fractional:
            return fractional_design(*given, data.over_data).weighted(data.weights)
        return linear_design(*given).weighted(data.weights)

    def _units(self, points: Floats) -> Floats:
        # An algebraic error is the transfer error times the denominator.
        return np.abs(self._denominator(points))

    def _meaningful(self, points: ArrayLike) -> Floats:
        positions = super()._meaningful(points)
        if not self.fractional:
            return positions
        lost = np.isnan(row_by_row(positions, self._image)).any(axis=1)
        return np.where(lost[:, None], np.nan, positions)

    def _denominator(self, points: Floats) -> Floats:
        if not self.fractional:
            return np.ones(len(points))
        return self.lifting.values(points, self.parameters[:, 2:])[:, 0]

    @cached_property
    def _centred(self) -> tuple[Floats, Floats]:
        """Return a centre of the target image, and the parameters of the warp to positions relative to it."""
        numerators, denominators = self.parameters[:, :2], self.parameters[:, 2:]
        if not self.fractional:
            denominators = np.ones((len(numerators), 1))
        centre = nearest_constant(numerators, denominators)
        about = numerators - denominators * centre
        return centre, np.column_stack([about, denominators]) if self.fractional else about

    def _map(self, points: Floats) -> Floats:
        return np.asarray(self._centred[0] + self._map_about(points))

    def _image(self, points: Floats) -> Floats:
        """Return target positions; NaN where the warp vanishes."""
        values = self.lifting.values(points, self._centred[1])
        if not self.fractional:
            return np.asarray(self._centred[0] + values)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            images = self._centred[0] + values[:, :2] / values[:, 2:]
        images[self._is_beyond(values[:, 2], _HORIZON)] = np.nan
        return np.asarray(images)

    def _is_beyond(self, denominators: Floats, tolerance: float) -> NDArray[np.bool_]:
        return np.asarray(~(denominators * np.sign(self._usual) > tolerance * np.abs(self._usual)))  # NaN is

    def _map_about(self, points: Floats) -> Floats:
        """Return positions relative to the centre of the target image."""
        values = self.lifting.values(points, self._centred[1])
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            return values[:, :2] / values[:, 2:] if self.fractional else values

    def _jacobian(self, points: Floats) -> Floats:
        derivatives = self.lifting.slopes(points, self._centred[1])
        if not self.fractional:
            return derivatives
        values = self.lifting.values(points, self._centred[1])
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            target = values[:, :2, None] / values[:, 2:, None]
            return np.asarray((derivatives[:, :2] - target * derivatives[:, 2:]) / values[:, 2:, None])

    def _turning(self, points: Floats) -> NDArray[np.int64]:
        """Return the sign of the Jacobian's determinant, 0 where it vanishes or is undefined."""
        jacobian = self._jacobian(points)
        with np.errstate(invalid="ignore", over="ignore"):
            determinant = _determinant(jacobian)
            sizeable = np.abs(determinant) > 1e-9 * (jacobian**2).sum(axis=(1, 2))
            return np.where(sizeable, np.where(determinant > 0, 1, -1), 0)

    def _newton_step(self, points: Floats, error: Floats) -> Floats:
        """Return J^-1 error by Cramer's rule: 0 where J is singular, and never longer than the domain."""
        jacobian = self._jacobian(points)
        (a, b), (c, d) = jacobian.transpose(1, 2, 0)
        u, v = error.T
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            step = np.column_stack([d * u - b * v, a * v - c * u]) / _determinant(jacobian)[:, None]
        step[~np.isfinite(step).all(axis=1)] = 0
        longest = diagonal(self.domain)
        return np.asarray(step * (longest / np.maximum(_norm(step), longest))[:, None])


def _determinant(matrices: Floats) -> Floats:
    return np.asarray(matrices[:, 0, 0] * matrices[:, 1, 1] - matrices[:, 0, 1] * matrices[:, 1, 0])


def _norm(vectors: Floats) -> Floats:
    return np.asarray(np.hypot(vectors[:, 0], vectors[:, 1]))


def _ulp(points: Floats) -> Floats:
    return np.asarray(np.spacing(np.abs(points).max(axis=1)))


def _sufficient(positions: Floats, pixel: float) -> type[np.floating]:
    """Return float32, if it tells positions a tenth of a pixel apart."""
    known = np.abs(positions[np.isfinite(positions)])
    with np.errstate(over="ignore"):
        largest = np.float32(known.max(initial=0))
    coarse = np.isinf(largest) or np.spacing(largest) > 0.1 * pixel > 0
    return np.float64 if coarse else np.float32
