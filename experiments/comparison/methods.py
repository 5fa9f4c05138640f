"""What is compared: a function each, from a problem to its predictions at the test points."""

from functools import partial

import numpy as np
from scipy.interpolate import RBFInterpolator
from skimage.transform import ProjectiveTransform, ThinPlateSplineTransform

import mexpress as mx

FOLDS = 10
WEIGHTS = np.logspace(-8, 1, 28)
"""Smoothing that cross-validation chooses from, in units of n D^2 with D the root mean square distance of the data to
their mean: from nearly an interpolant to nearly an affine map."""


def nearest_homography(problem):
    """Fit a homography by the normalised DLT."""
    return ProjectiveTransform.from_estimate(problem.source, problem.target)(problem.test_source)


def nearest_plane(problem):
    """Fit a plane by least squares."""
    train, test = (np.column_stack([x, np.ones(len(x))]) for x in (problem.source, problem.test_source))
    return test @ np.linalg.lstsq(train, problem.target, rcond=None)[0]


def interpolating_spline(problem):
    """Interpolate by scikit-image's thin-plate spline."""
    return ThinPlateSplineTransform.from_estimate(problem.source, problem.target)(problem.test_source)


def kernel(points):
    """Return r^2 log r between all points."""
    squared = ((points[:, None] - points) ** 2).sum(axis=2)
    return 0.5 * squared * np.log(squared, out=np.zeros_like(squared), where=squared > 0)


class HeldOut:
    """The residuals of data that `RBFInterpolator` predicts when it is fitted to the others, without any fit.

    A spline's coefficients are W values, with W = Z (Z^T K Z + smoothing)^-1 Z^T and Z an orthonormal basis of what is
    orthogonal to affine functions. The residuals e of data F that are held out are those with W_FF e = (W values)_F.
    """

    def __init__(self, points, values):
        about = points - points.mean(axis=0)
        affine = np.column_stack([np.ones(len(points)), about / np.abs(about).max()])
        beyond = np.linalg.qr(affine, mode="complete")[0][:, 3:]
        self.spectrum, turned = np.linalg.eigh(beyond.T @ kernel(points) @ beyond)
        self.basis, self.values = beyond @ turned, values

    def __call__(self, smoothing, folds):
        """Return the residuals, in the order of the data; folds are arrays of indices."""
        scaled = self.basis / (self.spectrum.clip(0) + smoothing)  # below 0 by rounding alone
        weights = scaled @ (self.basis.T @ self.values)
        residuals = np.empty_like(self.values)
        for fold in folds:
            residuals[fold] = np.linalg.solve(scaled[fold] @ self.basis[fold].T, weights[fold])
        return residuals


def cross_validated_spline(problem, folds=None):
    """Fit scipy's smoothing spline, with the weight that cross-validation chooses; leave-one-out if no folds."""
    points, values = problem.source, problem.target
    n, held_out = len(points), HeldOut(points, values)
    parts = np.array_split(np.random.default_rng(0).permutation(n), folds or n)
    unit = n * ((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()
    scores = [(held_out(unit * weight, parts) ** 2).sum() for weight in WEIGHTS]
    best = unit * WEIGHTS[np.argmin(scores)]
    return RBFInterpolator(points, values, kernel="thin_plate_spline", smoothing=best)(problem.test_source)


def automatic_spline(problem):
    """Fit the smoothing spline of treverhines-rbf, which finds its weight itself."""
    from rbf.interpolate import RBFInterpolant  # noqa: PLC0415  only here, so that all else runs without

    fitted = RBFInterpolant(problem.source, problem.target, sigma="auto", phi="phs2", order=1)
    return fitted(problem.test_source)


def selected(problem, queries=False, **how):
    """Fit the warp or the surface that mexpress selects; all NaN if its criterion has no score at any count."""
    data, asked = (problem.source, problem.target), {"queries": problem.test_source} if queries else {}
    try:
        if problem.is_warp:
            return mx.select_warp(*data, image_size=problem.image_size, **asked, **how).warp(
                problem.test_source
            )
        return mx.select_surface(*data, **asked, **how).surface(problem.test_source)
    except ValueError as refusal:
        if not any(sign in str(refusal) for sign in ("Invalid criterion.", " must determine a ")):
            raise
        return np.full_like(problem.test_target, np.nan)


ONLY_WARPS = {
    "homography": nearest_homography,
    "affine map": nearest_plane,
    "scikit-image TPS": interpolating_spline,
}
ONLY_SURFACES = {"plane": nearest_plane}
SPLINES = {
    "scipy RBF leave-one-out": cross_validated_spline,
    "scipy RBF 10-fold": partial(cross_validated_spline, folds=FOLDS),
    "treverhines-rbf auto": automatic_spline,
}
DEFAULT = {"mexpress": selected}
OTHERWISE = {
    "mexpress bspline": partial(selected, lifting="bspline"),
    "mexpress affine": partial(selected, lifting="affine"),
    "mexpress smoothing=0": partial(selected, smoothing=0),
}
IN_GAPS = {
    "mexpress, queries": partial(selected, queries=True),
    "mexpress CMPRESS": partial(selected, criterion="CMPRESS"),
}
METHODS = ONLY_WARPS | ONLY_SURFACES | SPLINES | DEFAULT | OTHERWISE | IN_GAPS


def error(problem, method):
    """Return a method's root mean square error at the test points, the norm where values are vectors."""
    apart = method(problem) - problem.test_target
    squared = (apart.reshape(len(apart), -1) ** 2).sum(axis=1)
    return float(
        np.sqrt(np.where(np.isnan(squared), np.inf, squared).mean())
    )  # NaN: the denominator vanished
