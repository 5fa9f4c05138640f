"""Many least-squares problems, given as stacks or as lists, as the core takes them: by kind."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.caching import cached_property
from mexpress.index_sets import IndexSets
from mexpress.leastsquares.problem import WEIGHT_RATIO, Problem, couple, scaled_weights
from mexpress.schemes import Scheme, expect_scheme

Schemes: TypeAlias = Scheme | Sequence[Scheme] | Callable[[int], Scheme]

_Shape: TypeAlias = tuple[int, int, int, bool]
"""Rows, columns and responses of a problem, and whether these were given as (m,)."""


@dataclass(frozen=True, eq=False)
class Kind:
    """Problems of one shape that hold out the same."""

    shape: _Shape
    data: IndexSets
    scheme: Scheme

    @cached_property
    def places(self) -> tuple[Integers, Integers]:
        """The validated rows, pair after pair, and their pairs."""
        validated = self.scheme.validated
        rows = self.data.some(validated.indices)
        pairs = np.repeat(np.arange(len(validated)), validated.sizes)
        return rows.indices, np.repeat(pairs, rows.sizes)

    @property
    def n_validated(self) -> int:
        """How many rows are validated."""
        return int(self.data.sizes[self.scheme.validated.indices].sum())


@dataclass(frozen=True, eq=False)
class Problems:
    """Problems as stacks, (k, ...), or as lists of arrays; what is wrong with numbers the core tells."""

    A: Floats | list[Floats]
    b: Floats | list[Floats]
    coupling: int | ArrayLike
    weights: Floats | list[Floats] | None

    @classmethod
    def of(cls, A: Any, b: Any, coupling: int | ArrayLike, weights: Any) -> Problems:
        """Check the shapes of what was given."""
        if hasattr(A, "__array__"):
            return cls._stacks(A, b, coupling, weights)
        designs = check.items(A, "A", "It must have shape (k, m, p), or be a list of k matrices.")
        if not designs:
            check.refuse("A", "It must have one matrix at least.", "none")
        rule = f"It must be a list of {len(designs)}, one for each matrix of A."
        others = {"b": check.items(b, "b", rule)}
        if weights is not None:
            others["weights"] = check.items(weights, "weights", rule)
        for name, given in others.items():
            if len(given) != len(designs):
                check.refuse(name, rule, f"{len(given)} items")
        return cls(designs, others["b"], coupling, others.get("weights"))._in_order()

    @classmethod
    def _stacks(cls, A: Any, b: Any, coupling: int | ArrayLike, weights: Any) -> Problems:
        designs, responses = check.real(A, "A"), check.real(b, "b")
        if designs.ndim != 3 or not designs.size:
            rule = "It must have shape (k, m, p), or be a list of k matrices."
            check.refuse("A", rule, f"shape {designs.shape}")
        k, m, _ = designs.shape
        if responses.ndim not in (2, 3) or responses.shape[:2] != (k, m) or not responses.size:
            check.refuse("b", f"It must have shape ({k}, {m}) or ({k}, {m}, r).", f"shape {responses.shape}")
        if weights is None:
            return cls(designs, responses, coupling, None)
        shares, n = check.real(weights, "weights"), len(couple(coupling, m))
        if shares.shape not in ((n,), (k, n)):
            check.refuse("weights", f"It must have shape ({k}, {n}) or ({n},).", f"shape {shares.shape}")
        return cls(designs, responses, coupling, np.broadcast_to(shares, (k, n)))

    def _in_order(self) -> Problems:
        """Lists of float64 arrays whose shapes fit."""
        sizes: dict[int, int] = {}
        for i in range(len(self)):
            if not (_is_plain(self.A[i], 2) and _is_plain(self.b[i], 1, 2)):
                problem = self._problem(i)
                self.A[i], self.b[i] = problem.design, problem.responses
            m = len(self.A[i])
            if len(self.b[i]) != m:
                self._problem(i)
            if isinstance(self.weights, list):
                if m not in sizes:
                    sizes[m] = len(couple(self.coupling, m))
                given: Any = self.weights[i]
                self.weights[i] = np.ones(sizes[m]) if given is None else check.real(given, "weights")
                if self.weights[i].shape != (sizes[m],):
                    self._problem(i)
        return self

    def __len__(self) -> int:
        return len(self.A)

    def _problem(self, i: int) -> Problem:
        """Check problem i as if it were alone."""
        try:
            return Problem.of(
                self.A[i], self.b[i], self.coupling, None if self.weights is None else self.weights[i]
            )
        except (TypeError, ValueError) as error:
            raise type(error)(f"{error} That is problem {i}.") from None

    def refuse(self) -> None:
        """Raise the error of the first problem that is not valid."""
        for i in range(len(self)):
            self._problem(i)

    def shapes(self) -> tuple[list[_Shape], Integers]:
        """The shapes that there are, and the number of each problem's."""
        if isinstance(self.A, np.ndarray):
            return [_shape(self.A[0], self.b[0])], np.zeros(len(self), dtype=np.int64)
        numbers: dict[_Shape, int] = {}
        given = zip(self.A, self.b, strict=True)
        shape_of = [numbers.setdefault(_shape(*each), len(numbers)) for each in given]
        return list(numbers), np.array(shape_of)

    def run(self, some: Integers, kind: Kind) -> _Run:
        """Problems of a kind as the core takes them."""
        m, _, width, _ = kind.shape
        held_out = kind.scheme.arguments, kind.data.arrays
        responses = _stacked(self.b, some).reshape(len(some), m, width)
        return _stacked(self.A, some), responses, self._root_weights(some, kind.data), *held_out

    def _root_weights(self, some: Integers, data: IndexSets) -> Floats | None:
        if self.weights is None:
            return None
        shares = _stacked(self.weights, some)
        if not (shares.min() > 0 and (shares.max(axis=1) <= WEIGHT_RATIO * shares.min(axis=1)).all()):
            self.refuse()
        return np.sqrt(scaled_weights(shares, data)[0])


_Run: TypeAlias = tuple[Any, ...]


def _is_plain(array: Any, *dimensions: int) -> bool:
    """Whether something is an array as the core takes it, so that thousands of them are not looked at for long."""
    if type(array) is not np.ndarray or array.dtype != np.float64 or array.ndim not in dimensions:
        return False
    return array.size > 0 and array.flags.c_contiguous and array.flags.aligned


def _shape(design: Floats, responses: Floats) -> _Shape:
    return (*design.shape, responses[0].size, responses.ndim == 1)


def _stacked(given: Floats | list[Floats], some: Integers) -> Floats:
    """Arrays of one shape, (g, ...)."""
    if isinstance(given, np.ndarray):
        return given if len(some) == len(given) else given[some]
    arrays = [given[i] for i in some]
    return np.concatenate(arrays).reshape(len(arrays), *arrays[0].shape)  # np.stack takes twice as long


def kinds_of(given: Problems, scheme: Schemes) -> tuple[list[Kind], Integers]:
    """The kinds of problems that there are, and the number of each problem's."""
    shapes, shape_of = given.shapes()
    data = {m: couple(given.coupling, m) for m in {shape[0] for shape in shapes}}
    sizes = [len(data[shape[0]]) for shape in shapes]
    schemes, scheme_of = _schemes(scheme, np.array(sizes)[shape_of])
    distinct, kind_of = np.unique(shape_of * len(schemes) + scheme_of, return_inverse=True)
    kinds = []
    for code in distinct:
        shape, held_out = shapes[code // len(schemes)], schemes[code % len(schemes)]
        kinds.append(Kind(shape, data[shape[0]], held_out))
    return kinds, kind_of


def _schemes(scheme: Schemes, sizes: Integers) -> tuple[list[Scheme], Integers]:
    """The schemes that there are, and the number of the one of each problem, which has so many data."""
    if isinstance(scheme, Scheme):
        given, which = [scheme], np.zeros(len(sizes), dtype=np.int64)
    elif callable(scheme):
        counts, which = np.unique(sizes, return_inverse=True)
        given = [scheme(int(n)) for n in counts]
    else:
        rule = f"It must be a Scheme, a function of the number of data, or a list of {len(sizes)} Schemes."
        each = check.items(scheme, "scheme", rule)
        if len(each) != len(sizes):
            check.refuse("scheme", rule, f"{len(each)} items")
        numbers: dict[int, int] = {}
        which = np.array([numbers.setdefault(id(one), len(numbers)) for one in each])
        given = [each[i] for i in np.unique(which, return_index=True)[1]]
    for one in given:
        expect_scheme(one, f"leave_one_out({sizes[0]})")
    lengths = np.array([one.n_data for one in given])[which]
    if (lengths != sizes).any():
        i = int((lengths != sizes).argmax())
        rule = f"It must be over the {sizes[i]} data of problem {i}."
        check.refuse("scheme", rule, f"a scheme over {lengths[i]} data")
    return given, which
