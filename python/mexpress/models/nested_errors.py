"""Errors against the truth of surfaces with more and more control points."""

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _core
from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.leastsquares import LeastSquares
from mexpress.liftings import nested_basis

_BLOCK = 4000
"""Number of points whose predictions are in memory together."""


def nested_errors(
    points: ArrayLike, values: ArrayLike, control_points: ArrayLike, unseen: ArrayLike, truth: ArrayLike
) -> Floats:
    """Return the errors of the surfaces with the first 3, 4, ... control points, at points outside the fit.

    The surfaces are nested thin-plate splines without smoothing: one factorisation gives all their coefficients.

    Parameters
    ----------
    points : array_like, (n, 2)
        Positions of the data.
    values : array_like, (n,) or (n, d)
        The data.
    control_points : array_like, (l, 2)
        In their order.
    unseen : array_like, (k, 2)
        Points with known values, at least one.
    truth : array_like, (k,) or (k, d)
        True values at those points.

    Returns
    -------
    ndarray, (l - 2,)
        Root mean square errors in the unit of the values; the norm of the error if there are d values.

    Raises
    ------
    ValueError, TypeError
        If a shape does not fit, or an entry is not a finite number.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> points, unseen = rng.uniform(0, 6, (2, 200, 2))
    >>> errors = nested_errors(points, np.sin(points[:, 0]), points[:50], unseen, np.sin(unseen[:, 0]))
    >>> errors.shape, bool(errors[-1] < 0.1 < errors[0])
    ((48,), True)
    """
    unseen = check.points(unseen, "unseen")
    functions = nested_basis(points, control_points)
    measured = check.columns(values, "values", len(functions)).reshape(len(functions), -1)
    fit = LeastSquares(functions, measured)
    if fit.rank < functions.shape[1]:
        rule = "The points must determine a model with all of them."
        check.refuse("control_points", rule, f"{functions.shape[1]}, of which {fit.rank} are determined")
    basis = np.ascontiguousarray(fit._weighted_basis.T)
    coefficients = _core.product(basis, np.ascontiguousarray(measured), check.threads(None))
    expected = check.columns(truth, "truth", len(unseen)).reshape(len(unseen), -1)
    if expected.shape[1] != measured.shape[1]:
        rule = f"It must have as many columns as values, {measured.shape[1]}."
        check.refuse("truth", rule, f"{expected.shape[1]}")
    total = np.zeros(functions.shape[1])
    for start in range(0, len(unseen), _BLOCK):
        some = slice(start, start + _BLOCK)
        # Columns orthonormal over the data: a model of l control points has the first l columns.
        columns = fit._over_basis(nested_basis(unseen[some], control_points)).T
        for along, wanted in zip(coefficients.T, expected[some].T, strict=True):
            predicted = np.cumsum(columns * along[:, None], axis=0)
            total += ((predicted - wanted) ** 2).sum(axis=1)
    return np.asarray(np.sqrt(total[2:] / len(unseen)))
