"""A least-squares fit of rows that do not fit in memory, cross-validated a part at a time.

What some pairs hold out is near each other: it is read, and all rows elsewhere are known as one triangle R with the
same squares and products. So this part is a least-squares problem of its own, of the rows that are read and of R, whose
rows are never held out: it has the same solution, the same leverages, and the same prediction residuals.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NoReturn

import numpy as np

from mexpress import _core
from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.caching import cached_property
from mexpress.index_sets import IndexSets, singletons
from mexpress.leastsquares.cells import Cells, merged, reduced
from mexpress.leastsquares.cross_validation import CrossValidation, expect_scheme_of, warn_of_rank_loss
from mexpress.leastsquares.dask_rows import DaskRows
from mexpress.leastsquares.finished import Finished
from mexpress.leastsquares.leads import Leads
from mexpress.leastsquares.parts import Part, Parts, data_order, predicted
from mexpress.leastsquares.rows import Rows, read_only, rows_of
from mexpress.progress import shown
from mexpress.schemes import LazyNeighbourhoods, Scheme, leave_one_out

_PART = 1 << 22
"""Numbers of the rows of a part, but for those near it: 32 MiB, of which a fit needs several."""

_CELLS = 64
"""Cells of a part: whole ones are read around it, so that fewer mean more rows to read."""

_CELL = 8
"""Rows of a cell for each of its columns, if it can be: the triangle that is kept of it is so much smaller."""

_MOST = 1 << 27
"""Numbers of the rows that a part may read: 1 GiB."""


@dataclass(frozen=True, eq=False, repr=False)
class TallLeastSquares:
    """A least-squares fit of rows that are read a block at a time: what `LeastSquares.from_blocks` returns.

    Attributes
    ----------
    coefficients : (p,) or (p, r) array
        The solution.
    residuals, leverage : (m,) or (m, r) array, and (m,) array
        b - A x, and the diagonal of the hat matrix; each is a pass over the rows, when it is first asked for.
    rank, n_data : int
        Rank of the design, and number of data.
    fit_rms : float
        Root mean square residual over the data. Where a response is mostly one column, such as a large mean, this, the
        coefficients and the residuals take another pass, which keeps the digits of what that column leaves.

    Examples
    --------
    >>> import mexpress as mx
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> A, b = rng.normal(size=(1000, 3)), rng.normal(size=1000)
    >>> model = mx.LeastSquares.from_blocks((A[i : i + 100], b[i : i + 100]) for i in range(0, 1000, 100))
    >>> model
    TallLeastSquares(1000 data, 1000 rows, 3 columns, rank 3, fit_rms=1.005841)
    >>> cv = model.cross_validate(mx.schemes.leave_one_out(1000))
    >>> bool(np.isclose(cv.score, mx.LeastSquares(A, b).press))
    True
    """

    _rows: Rows
    _triangle: Floats
    """The triangle of all rows."""
    _threads: int | None = None

    @classmethod
    def of(cls, blocks: Any, coupling: int, directory: Any, threads: int | None) -> TallLeastSquares:
        """Read all rows once."""
        workers, g, stack = check.threads(threads), check.count(coupling, "coupling", 1), [np.zeros((0, 0))]
        if DaskRows.have(blocks):
            dask_rows = DaskRows.checked(blocks, g)
            dask_rows = dask_rows.weighing(dask_rows.weights)
            return cls(dask_rows, dask_rows.triangle(DaskRows.threads(threads)), threads)

        def reduce(rows: Floats) -> None:
            above = stack.pop().reshape(-1, rows.shape[1])
            stack.append(merged(np.concatenate([above, reduced(rows, workers)]), workers))

        rows = rows_of(blocks, g, directory, reduce)
        return cls(rows, stack[0], threads)

    def __repr__(self) -> str:
        size = f"{self.n_data} data, {len(self._rows.A)} rows, {self._rows.columns} columns, rank {self.rank}"
        return f"TallLeastSquares({size}, fit_rms={self.fit_rms:.7g})"

    def __reduce__(self) -> NoReturn:
        rule = "It cannot be pickled or copied: build it again from the blocks."
        check.refuse("model", rule, repr(self), TypeError)

    @cached_property
    def _whole(self) -> _core.Factor:
        """The fit of the triangle of all rows."""
        return _fit_of(self._triangle, self._rows.columns, len(self._rows.A), check.threads(self._threads))

    @cached_property
    def _led(self) -> Rows:
        """All rows, without multiples of columns that take most of the responses: predictions err as much."""
        leads = Leads.of(self._triangle, self._rows.columns)
        return self._rows if leads is None else replace(self._rows, leads=leads)

    @cached_property
    def _rest(self) -> _core.Factor:
        """The fit of these rows: another pass over them, unless nothing is taken."""
        rows = self._led
        if rows.leads is None:
            return self._whole
        triangle, threads = self._triangle[:0], check.threads(self._threads)
        calls = ((some, rows.threads(self._threads)) for some in rows.blocks())
        for block in rows.each(reduced, calls):
            triangle = merged(np.concatenate([triangle, block]), threads)
        return _fit_of(triangle, rows.columns, len(rows.A), threads)

    @property
    def coefficients(self) -> Floats:
        """The solution x, (p,) or (p, r)."""
        if self.rank < self._rows.columns:
            # Of columns that depend on others, the shortest solution is not that of the rest and a multiple.
            coefficients = np.array(self._whole.coefficients, order="C")
        else:
            leads, coefficients = self._led.leads, np.array(self._rest.coefficients, order="C")
            if leads is not None:
                coefficients[leads.columns, np.arange(len(leads.columns))] += leads.multiples
        return read_only(coefficients[:, 0] if self._rows.b.ndim == 1 else coefficients)

    @property
    def rank(self) -> int:
        """Rank of the design with columns scaled to unit length, by the rule of `numpy.linalg.matrix_rank`."""
        return self._whole.rank

    @property
    def n_data(self) -> int:
        """Number of data."""
        return self._rows.n_data

    @property
    def fit_rms(self) -> float:
        """E, the root mean square residual over the data, equation (11)."""
        total = self.n_data if self._rows.weights is None else self._rows.weights.sum()
        rows = len(self._rest.residuals)
        return float(self._rest.fit_rms(singletons(rows).arrays) * np.sqrt(rows / total))

    @cached_property
    def residuals(self) -> Floats:
        """Return b - A x, (m,) or (m, r)."""
        plain, x = replace(self._led, weights=None, coupling=1), self._rest.coefficients
        of_both = np.vstack([-x, np.eye(plain.responses)])
        calls = ((some, of_both, plain.threads(self._threads)) for some in plain.blocks())
        return read_only(np.concatenate([*plain.each(_core.product, calls)]).reshape(plain.b.shape))

    @cached_property
    def leverage(self) -> Floats:
        """The diagonal of the hat matrix, (m,); NaN if rank is lost."""
        rows = self._rows
        size = rows.columns, len(rows.A), rows.threads(self._threads)
        calls = ((some, self._triangle, *size) for some in rows.blocks())
        return read_only(np.concatenate([*rows.each(_leverage, calls)]))

    def cross_validate(
        self,
        scheme: Scheme,
        threads: int | None = None,
        *,
        progress: bool | Callable[..., Any] = False,
        resume: Any = None,
    ) -> CrossValidation:
        """Predict the validated data of every pair of a scheme from the data that the pair does not hold out.

        Parameters
        ----------
        scheme : Scheme
            A scheme whose pairs hold out data near each other, such as `exclusion_radius`, or each datum once, such as
            `leave_one_out` and `k_fold`.
        threads : int, optional
            Largest number of threads; with dask arrays, those of a task, one by default. The result does not depend
            on it.
        progress : bool or callable, default False
            Show progress on standard error; or a callable that makes a bar, such as ``tqdm.tqdm``.
        resume : str or Path, optional
            A file in which finished parts are kept: the same call goes on after them.

        Returns
        -------
        CrossValidation
            As of `LeastSquares.cross_validate`.

        Raises
        ------
        ValueError
            If the data that some pairs hold out are so far apart that a part would have to read most rows.
        """
        expect_scheme_of(self.n_data, scheme)
        result = self._predicted(self._led, scheme, self._rows.threads(threads), progress, resume)
        warn_of_rank_loss(result, len(scheme))
        return result

    @property
    def press(self) -> float:
        """P, with every row held out on its own, equation (3)."""
        rows = self._led
        weights = None if rows.weights is None else np.repeat(rows.weights, rows.coupling)
        alone = leave_one_out(len(rows.A))
        return self._predicted(
            replace(rows, weights=weights, coupling=1), alone, rows.threads(self._threads), False, None
        ).score

    def _predicted(
        self, rows: Rows, scheme: Scheme, threads: int, progress: bool | Callable[..., Any], resume: Any
    ) -> CrossValidation:
        finished = Finished(None if resume is None else check.path(resume, "resume"), self._key(scheme))
        done, places = dict(finished.read()), Places.of(scheme, rows)
        residuals, undefined = np.full((len(places.rows), rows.responses), np.nan), []
        together = rows.together(_PART)
        count = max(1, min(_CELLS, together // (_CELL * (rows.columns + rows.responses))))
        size = max(1, together // (count * rows.coupling))
        with shown(progress, "rows")([1.0] * -(-rows.n_data // (size * count))) as step:
            cells = Cells.of(rows, data_order(scheme), size, count, threads, step)
        parts = Parts(scheme, cells, count, threads)
        left = [k for k in range(len(parts)) if k not in done]
        solved = rows.each(predicted, (_call(rows, parts[k], cells) for k in left))
        with shown(progress, "held-out parts")([1.0] * len(parts)) as step:
            for k, pairs in enumerate(parts.pairs):
                if k not in done:
                    done[k] = next(solved)
                    finished.add(k, *done[k])
                found, lost = done.pop(k)
                residuals[places.of_pairs.some(pairs).indices] = found
                undefined.append(lost)
                step()
        lost = np.sort(np.concatenate([np.zeros(0, dtype=np.int64), *undefined]))
        return places.result(residuals, lost, rows)

    def _key(self, scheme: Scheme) -> str:
        """A digest that tells these rows, a scheme and its parts from others."""
        told: list[Any] = [self._triangle, self.n_data, _PART, _CELLS, _CELL]
        if isinstance(scheme, LazyNeighbourhoods):
            told += [scheme.how == "within", scheme.reach, scheme.places.points]
        else:
            told += [*scheme.held_out.arrays, *scheme.validated.arrays, scheme.visiting_order]
        digest = hashlib.blake2b(digest_size=16)
        for each in map(np.asarray, told):
            digest.update(repr(each.shape).encode())
            digest.update(np.ascontiguousarray(each).ravel().data)
        return digest.hexdigest()


def _call(rows: Rows, part: Part, cells: Cells) -> tuple[Any, ...]:
    """Rows of a part, and further arguments of `predicted`."""
    numbers = len(part.data) * rows.coupling * (rows.columns + rows.responses)
    if numbers > _MOST:
        rule = "Its pairs must hold out data near each other, or each datum once and a small share of all."
        given = f"pairs that hold out data among {len(part.data)} of {rows.n_data}"
        check.refuse("scheme", rule, given)
    others = part.pairs, part.held, rows.coupling, rows.columns, len(rows.A), cells.threads
    return rows.of(part.data), cells.rest(part.cells), *others


def _fit_of(triangle: Floats, columns: int, counted: int, threads: int) -> _core.Factor:
    """The fit of the rows of a triangle, which stands for so many."""
    A, b = (np.ascontiguousarray(each) for each in np.split(triangle, [columns], axis=1))
    return _core.Factor((A, b, None, A[:0]), threads, counted)


def _leverage(block: Floats, triangle: Floats, columns: int, counted: int, threads: int) -> Floats:
    """The leverage of some rows in the fit of a triangle."""
    over = _fit_of(triangle, columns, counted, threads).over_basis(
        np.ascontiguousarray(block[:, :columns]), threads
    )
    leverage: Floats = np.square(over).sum(axis=1)
    return leverage


@dataclass(frozen=True, eq=False)
class Places:
    """Where the results of pairs go.

    Parameters
    ----------
    rows, pairs : (t,) int64 arrays
        The validated rows, pair after pair, and their pairs.
    of_pairs : IndexSets
        The places of each pair.
    """

    rows: Integers
    pairs: Integers
    of_pairs: IndexSets

    @classmethod
    def of(cls, scheme: Scheme, rows: Rows) -> Places:
        """The places of all pairs of a scheme."""
        sizes = scheme.validated.sizes * rows.coupling
        pairs = np.repeat(np.arange(len(sizes)), sizes)
        places = IndexSets(np.concatenate([[0], np.cumsum(sizes)]), np.arange(len(pairs)))
        return cls(rows.of(scheme.validated.indices), pairs, places)

    def result(self, weighted: Floats, undefined: Integers, rows: Rows) -> CrossValidation:
        """Score and plain residuals of weighted ones, (t, r)."""
        roots, data = rows.roots(self.rows), self.rows[:: rows.coupling] // rows.coupling
        residuals = weighted if roots is None else weighted / roots
        total = float(len(data) if rows.weights is None else rows.weights[data].sum())
        unit = np.abs(weighted).max(initial=0.0) or 1.0
        with np.errstate(invalid="ignore", divide="ignore"):
            score = float(unit * np.sqrt(np.square(weighted / unit).sum() / total))
        flat = residuals[:, 0] if rows.b.ndim == 1 else residuals
        return CrossValidation(np.nan if len(undefined) else score, flat, self.rows, self.pairs, undefined)
