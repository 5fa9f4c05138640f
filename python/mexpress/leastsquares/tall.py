"""A least-squares fit of rows that do not fit in memory, cross-validated a part at a time.

What some pairs hold out is near each other: it is read, and all rows elsewhere are known as one triangle R with the
same squares and products. So this part is a least-squares problem of its own, of the rows that are read and of R, whose
rows are never held out: it has the same solution, the same leverages, and the same prediction residuals.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mexpress import _core
from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.caching import cached_property
from mexpress.index_sets import singletons
from mexpress.leastsquares.cells import Cells, merged
from mexpress.leastsquares.cross_validation import CrossValidation, expect_scheme_of, warn_of_rank_loss
from mexpress.leastsquares.finished import Finished
from mexpress.leastsquares.parts import Part, Parts, data_order
from mexpress.leastsquares.rows import Rows, rows_of
from mexpress.progress import shown
from mexpress.schemes import LazyNeighbourhoods, Scheme, leave_one_out

_PART = 1 << 22
"""Numbers of the rows of a part, but for those near it: 32 MiB, of which a fit needs several."""

_CELLS = 16
"""Cells of a part."""

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
        Root mean square residual over the data.

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
    _whole: _core.Factor
    """The fit of the triangle of all rows."""

    @classmethod
    def of(cls, blocks: Any, coupling: int, directory: Any, threads: int | None) -> TallLeastSquares:
        """Read all rows once."""
        workers, stack = check.threads(threads), [np.zeros((0, 0))]

        def reduce(rows: Floats) -> None:
            above = stack.pop().reshape(-1, rows.shape[1])
            cells = _core.triangles(rows, 4096, workers).reshape(-1, rows.shape[1])
            stack.append(merged(np.concatenate([above, cells]), workers))

        rows = rows_of(blocks, coupling, directory, reduce)
        A, b = (np.ascontiguousarray(each) for each in np.split(stack[0], [rows.columns], axis=1))
        return cls(rows, _core.Factor((A, b, None, A[:0]), workers))

    def __repr__(self) -> str:
        size = f"{self.n_data} data, {len(self._rows.A)} rows, {self._rows.columns} columns, rank {self.rank}"
        return f"TallLeastSquares({size}, fit_rms={self.fit_rms:.7g})"

    @property
    def coefficients(self) -> Floats:
        """The solution x, (p,) or (p, r)."""
        coefficients = np.ascontiguousarray(self._whole.coefficients)
        return coefficients[:, 0] if self._rows.b.ndim == 1 else coefficients

    @property
    def rank(self) -> int:
        """Rank of the design with columns scaled to unit length."""
        return self._whole.rank

    @property
    def n_data(self) -> int:
        """Number of data."""
        return self._rows.n_data

    @property
    def fit_rms(self) -> float:
        """E, the root mean square residual over the data, equation (11)."""
        total = self.n_data if self._rows.weights is None else self._rows.weights.sum()
        rows = len(self._whole.residuals)
        return float(self._whole.fit_rms(singletons(rows).arrays) * np.sqrt(rows / total))

    @cached_property
    def residuals(self) -> Floats:
        """Return b - A x, (m,) or (m, r)."""
        plain = Rows(self._rows.A, self._rows.b, None, 1)
        x = self.coefficients.reshape(plain.columns, -1)
        of_both = np.vstack([-x, np.eye(plain.responses)])
        left = [_core.product(plain.take(some), of_both, check.threads(None)) for some in plain.blocks()]
        return np.concatenate(left).reshape(plain.b.shape)

    @cached_property
    def leverage(self) -> Floats:
        """The diagonal of the hat matrix, (m,); NaN if rank is lost."""
        rows = (self._rows.take(some)[:, : self._rows.columns] for some in self._rows.blocks())
        over = (self._whole.over_basis(np.ascontiguousarray(each), check.threads(None)) for each in rows)
        return np.concatenate([np.square(each).sum(axis=1) for each in over])

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
            Largest number of threads. The result does not depend on it.
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
        result = self._predicted(self._rows, scheme, check.threads(threads), progress, resume)
        warn_of_rank_loss(result, len(scheme))
        return result

    @property
    def press(self) -> float:
        """P, with every row held out on its own, equation (3)."""
        rows = self._rows
        weights = None if rows.weights is None else np.repeat(rows.weights, rows.coupling)
        alone = leave_one_out(len(rows.A))
        return self._predicted(
            Rows(rows.A, rows.b, weights, 1), alone, check.threads(None), False, None
        ).score

    def _predicted(
        self, rows: Rows, scheme: Scheme, threads: int, progress: bool | Callable[..., Any], resume: Any
    ) -> CrossValidation:
        finished = Finished(None if resume is None else check.path(resume, "resume"), self._key(scheme), 2)
        done, places = dict(finished.read()), Places.of(scheme, rows)
        residuals, undefined = np.full((len(places.rows), rows.responses), np.nan), []
        size = max(1, _PART // (_CELLS * rows.coupling * (rows.columns + rows.responses)))
        with shown(progress, "rows")([1.0] * Cells.steps(rows, size)) as step:
            cells = Cells.of(rows, data_order(scheme), size, threads, step)
        parts = Parts(scheme, cells, _CELLS, threads)
        with shown(progress, "held-out parts")([1.0] * len(parts)) as step:
            for k, pairs in enumerate(parts.pairs):
                if k not in done:
                    done[k] = _solved(rows, parts[k], cells)
                    finished.add(k, *done[k])
                found, lost = done.pop(k)
                residuals[places.of_pairs(pairs)] = found
                undefined.append(lost)
                step()
        lost = np.sort(np.concatenate([np.zeros(0, dtype=np.int64), *undefined]))
        return places.result(residuals, lost, rows)

    def _key(self, scheme: Scheme) -> NDArray[np.uint8]:
        """A digest that tells these rows, a scheme and its parts from others."""
        told: list[Any] = [self.coefficients, self.fit_rms, self.n_data, _PART, _CELLS]
        if isinstance(scheme, LazyNeighbourhoods):
            told += [scheme.how == "within", scheme.reach, scheme.places.points]
        else:
            told += [*scheme.held_out.arrays, *scheme.validated.arrays, scheme.visiting_order]
        digest = hashlib.blake2b(digest_size=16)
        for each in map(np.asarray, told):
            digest.update(repr(each.shape).encode())
            digest.update(np.ascontiguousarray(each).ravel().data)
        return np.frombuffer(digest.digest(), np.uint8)


def _solved(rows: Rows, part: Part, cells: Cells) -> tuple[Floats, Integers]:
    """Plain prediction residuals of a part, and its undefined pairs."""
    numbers = len(part.data) * rows.coupling * (rows.columns + rows.responses)
    if numbers > _MOST:
        rule = "Its pairs must hold out data near each other, or each datum once and a small share of all."
        given = f"pairs that hold out data among {len(part.data)} of {rows.n_data}"
        check.refuse("scheme", rule, given)
    block, rest = rows.take(rows.of(part.data)), cells.rest(part.cells)
    return part.residuals(block, rest, rows.coupling, rows.columns, cells.threads)


@dataclass(frozen=True, eq=False)
class Places:
    """Where the results of pairs go.

    Parameters
    ----------
    rows, pairs : (t,) int64 arrays
        The validated rows, pair after pair, and their pairs.
    ends : (k + 1,) int64 array
        Pair s has the places from ``ends[s]`` to ``ends[s + 1]``.
    """

    rows: Integers
    pairs: Integers
    ends: Integers

    @classmethod
    def of(cls, scheme: Scheme, rows: Rows) -> Places:
        """The places of all pairs of a scheme."""
        sizes = scheme.validated.sizes * rows.coupling
        pairs = np.repeat(np.arange(len(sizes)), sizes)
        return cls(rows.of(scheme.validated.indices), pairs, np.concatenate([[0], np.cumsum(sizes)]))

    def of_pairs(self, some: Integers) -> Integers:
        """Places of some pairs."""
        sizes = self.ends[some + 1] - self.ends[some]
        before = np.cumsum(sizes) - sizes
        return np.repeat(self.ends[some] - before, sizes) + np.arange(sizes.sum())

    def result(self, weighted: Floats, undefined: Integers, rows: Rows) -> CrossValidation:
        """Score and plain residuals of weighted ones, (t, r)."""
        total = float(len(self.rows) // rows.coupling)
        residuals = weighted
        if rows.weights is not None:
            total = float(rows.weights[self.rows[:: rows.coupling] // rows.coupling].sum())
            residuals = weighted / rows.roots(self.rows)
        unit = np.abs(weighted).max(initial=0.0) or 1.0
        with np.errstate(invalid="ignore", divide="ignore"):
            score = (
                float(unit * np.sqrt(np.square(weighted / unit).sum() / total))
                if not len(undefined)
                else np.nan
            )
        flat = residuals[:, 0] if rows.b.ndim == 1 else residuals
        return CrossValidation(score, flat, self.rows, self.pairs, undefined)
