"""All leading models of one design at once: model l has the first l columns.

With an unpivoted factor of ``I - Q_K^T Q_K`` the predictions of all models are cumulative sums, so the whole curve of a
criterion costs as much as the largest model. A surface adds one control point, that is one column, at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _core
from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.index_sets import IndexSets, singletons
from mexpress.leastsquares.problem import Problem, penalty_rows
from mexpress.schemes import LazyNeighbourhoods, Scheme, leave_one_out

_BLOCK = 2048
"""Neighbourhoods in one call of the core; progress is shown between calls."""


@dataclass(frozen=True, eq=False, repr=False)
class FitSummaries:
    """E (equation 11), trace(H) and the rank of every model."""

    rms: Floats
    parameters: Floats
    rank: Integers


@dataclass(frozen=True, eq=False, repr=False)
class NestedCurve:
    """Scores of one scheme for every model, NaN where undefined, and the number of defined models of every pair."""

    scores: Floats
    defined: Integers


class Nested:
    """A least-squares problem whose leading columns are models; see `mexpress.LeastSquares` for the parameters."""

    def __init__(
        self,
        A: ArrayLike,
        b: ArrayLike,
        coupling: int | ArrayLike = 1,
        weights: ArrayLike | None = None,
        penalty: ArrayLike | None = None,
        *,
        threads: int | None = None,
    ) -> None:
        problem = Problem.of(A, b, coupling, weights, penalty)
        design, responses, roots, rows = problem.arrays
        # Sums of squares must neither overflow nor vanish; scaling by a power of two is exact.
        exponent = int(np.frexp(np.abs(responses).max())[1])
        scaled = np.ldexp(responses, -exponent)
        self._core = _core.Nested((design, scaled, roots, rows), check.threads(threads))
        self._unit = exponent
        self._flat = problem.responses.ndim == 1
        self._coupling = problem.coupling
        self._row_weights = problem.row_weights
        self.n_rows, self.n_columns = design.shape
        self.n_responses = responses.shape[1]
        self.n_data = len(problem.coupling)

    def coefficients(self, size: int) -> Floats:
        """Solution x of the model of the first columns, (size,) or (size, r)."""
        x = np.ldexp(np.ascontiguousarray(self._core.coefficients(size)), self._unit)
        return x[:, 0] if self._flat else x

    def fits(self, sizes: Integers, threads: int | None = None) -> FitSummaries:
        """Fit the models of these numbers of columns."""
        squares, parameters, rank = self._core.fits(sizes.view(np.uintp), check.threads(threads))
        total = self._total(np.arange(self.n_data), self._coupling)
        return FitSummaries(self._rms(squares, total), parameters, rank)

    def curves(
        self,
        schemes: Mapping[str, Scheme],
        sizes: Integers,
        threads: int | None = None,
        on_step: Callable[[], None] | None = None,
    ) -> dict[str, NestedCurve]:
        """Cross-validate the models of these numbers of columns, increasing, by schemes over the data.

        The core takes all listed schemes in one call, and all neighbourhoods in blocks; `on_step` is called after
        each call, `steps(n_data)` times in all.
        """
        lazy = {name: scheme for name, scheme in schemes.items() if isinstance(scheme, LazyNeighbourhoods)}
        listed = {name: scheme for name, scheme in schemes.items() if name not in lazy}
        curves = self._listed(listed, self._coupling, sizes, threads)
        if on_step is not None:
            on_step()
        curves |= self._lazy(lazy, sizes, threads, on_step)
        return {name: curves[name] for name in schemes}

    def press(self, sizes: Integers, threads: int | None = None) -> NestedCurve:
        """Hold out every row on its own, equation (3)."""
        alone = {"": leave_one_out(self.n_rows)}
        return self._listed(alone, singletons(self.n_rows), sizes, threads)[""]

    def _listed(
        self, schemes: Mapping[str, Scheme], rows: IndexSets, sizes: Integers, threads: int | None
    ) -> dict[str, NestedCurve]:
        pairs = [(s.sets, s.visiting_order.view(np.uintp)) for s in schemes.values()]
        sums = self._core.curves(pairs, rows.arrays, sizes.view(np.uintp), check.threads(threads))
        curves = {}
        for (name, scheme), (squares, visited) in zip(schemes.items(), sums, strict=True):
            defined = np.empty_like(visited)
            defined[scheme.visiting_order] = visited
            total = self._total(scheme.validated.indices, rows)
            curves[name] = NestedCurve(self._rms(squares, total), defined)
        return curves

    def _lazy(
        self,
        schemes: Mapping[str, LazyNeighbourhoods],
        sizes: Integers,
        threads: int | None,
        on_step: Callable[[], None] | None,
    ) -> dict[str, NestedCurve]:
        squares = {name: np.zeros(len(sizes)) for name in schemes}
        defined = {name: np.empty(self.n_data, dtype=np.int64) for name in schemes}
        for first in range(0, self.n_data, _BLOCK):
            blocks = [(s.search, s.order[first : first + _BLOCK].view(np.uintp)) for s in schemes.values()]
            sums = self._core.curves(
                blocks, self._coupling.arrays, sizes.view(np.uintp), check.threads(threads)
            )
            for name, (_, order), (part, visited) in zip(schemes, blocks, sums, strict=True):
                squares[name] += part
                defined[name][order.view(np.int64)] = visited
            if on_step is not None:
                on_step()
        total = self._total(np.arange(self.n_data), self._coupling)
        return {name: NestedCurve(self._rms(squares[name], total), defined[name]) for name in schemes}

    def _total(self, data: Integers, rows: IndexSets) -> float:
        """Sum of the weights of data, each given by its rows."""
        if self._row_weights is None:
            return float(len(data))
        return float(self._row_weights[rows.indices[rows.offsets[data]]].sum())

    @np.errstate(over="ignore")
    def _rms(self, squares: Floats, total: float) -> Floats:
        if total == 0:
            return np.full(len(squares), np.nan)
        return np.ldexp(np.sqrt(squares / total), self._unit)


def steps(n_data: int) -> int:
    """How many times `Nested.curves` calls `on_step`."""
    return 1 + -(-n_data // _BLOCK)


def cross_validate_nested(
    A: ArrayLike,
    b: ArrayLike,
    sizes: ArrayLike,
    schemes: Mapping[str, Scheme],
    coupling: int | ArrayLike = 1,
    *,
    weights: ArrayLike | None = None,
    penalty: ArrayLike | None = None,
    threads: int | None = None,
) -> dict[str, Floats]:
    """Cross-validate nested models by any schemes: the model of size s has the first s columns of the design.

    The result equals ``LeastSquares(A[:, :s], b, ...).cross_validate(scheme).score`` for every size and scheme, at
    about the cost of the largest size alone.

    Parameters
    ----------
    A : (m, p) array
        Design matrix, its columns in the order in which the models take them.
    b : (m,) or (m, r) array
        Responses; r responses share the design (equation 4).
    sizes : increasing list of int, from 1 to p
        Numbers of columns.
    schemes : mapping of str to Scheme
        Schemes by any names. Schemes that validate the same data are computed together and share work.
    coupling, weights, penalty, threads : optional
        As for `LeastSquares`; a model takes the same first columns of the penalty.

    Returns
    -------
    dict of str to (k,) array
        P of every size, in the responses' unit, by the names of the schemes. NaN where the training rows of a pair do
        not determine the model, and for all larger sizes.

    Raises
    ------
    ValueError, TypeError
        If the problem, a size or a scheme is invalid.

    Notes
    -----
    With M = I - Q_K^T Q_K = L L^T for all p columns, u = L^-1 q_i and v = L^-1 (Q^T b - Q_K^T b_K), model l predicts
    ``sum_{j<=l} u_j v_j`` at row i, since leading blocks of L factor leading blocks of M.

    Examples
    --------
    >>> import mexpress as mx
    >>> import numpy as np
    >>> x = np.linspace(0, 1, 200)
    >>> noisy = np.sin(8 * x) + np.random.default_rng(0).normal(0, 0.1, 200)
    >>> near = {"ER5": mx.schemes.exclusion_radius(x[:, None], 0.05)}
    >>> curves = mx.cross_validate_nested(np.vander(x, 13, increasing=True), noisy, range(2, 14), near)
    >>> range(2, 14)[int(np.nanargmin(curves["ER5"]))]
    7
    """
    by_name = _checked_schemes(schemes)
    design = check.matrix(A, "A")
    columns = _checked_sizes(sizes, design.shape[1])
    rows = None if penalty is None else penalty_rows(penalty, design.shape[1])[:, : columns[-1]]
    nested = Nested(design[:, : columns[-1]], b, coupling, weights, rows, threads=threads)
    for name, scheme in by_name.items():
        if scheme.n_data != nested.n_data:
            rule = f"They must be over the design's {nested.n_data} data."
            check.refuse("schemes", rule, f"a scheme {name!r} over {scheme.n_data} data")
    return {name: curve.scores for name, curve in nested.curves(by_name, columns, threads).items()}


def _checked_schemes(schemes: Any) -> dict[str, Scheme]:
    rule = 'They must be schemes by name, such as {"CMPRESS": mexpress.schemes.leave_one_out(n)}.'
    if not isinstance(schemes, Mapping):
        check.refuse("schemes", rule, check.describe(schemes), TypeError)
    for name, scheme in schemes.items():
        if not (isinstance(name, str) and isinstance(scheme, Scheme)):
            check.refuse("schemes", rule, check.describe({name: scheme}), TypeError)
    return dict(schemes)


def _checked_sizes(sizes: Any, columns: int) -> Integers:
    rule = f"They must be one or more increasing numbers of columns, from 1 to {columns}."
    numbers = check.integers(list(sizes) if isinstance(sizes, range) else sizes, "sizes", rule)
    if numbers.size == 0 or numbers[0] < 1 or numbers[-1] > columns or (np.diff(numbers) <= 0).any():
        check.refuse("sizes", rule, check.describe(sizes))
    return numbers
