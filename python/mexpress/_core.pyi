from collections.abc import Sequence
from typing import TypeAlias, final

import numpy as np
from numpy.typing import NDArray

_Floats: TypeAlias = NDArray[np.float64]
_Integers: TypeAlias = NDArray[np.int64]
_Sets: TypeAlias = tuple[_Integers, _Integers]

__all__ = [
    "Factor",
    "LazyNeighbourhoods",
    "LocalFunctions",
    "Nested",
    "PenaltyPath",
    "find_not_finite",
    "hilbert_order",
    "lloyd",
    "neighbours_delaunay",
    "neighbours_matched",
    "neighbours_nearest",
    "neighbours_within",
    "place_by_residual",
    "preimages",
    "spline_slopes",
    "spline_values",
    "spread",
]

@final
class Factor:
    def __new__(
        cls,
        design: _Floats,
        responses: _Floats,
        root_weights: _Floats | None,
        penalty: _Floats,
        threads: int,
    ) -> Factor: ...
    @property
    def rank(self) -> int: ...
    @property
    def coefficients(self) -> _Floats: ...
    @property
    def residuals(self) -> _Floats: ...
    @property
    def leverage(self) -> _Floats: ...
    def predict(
        self, schemes: list[tuple[_Sets, _Sets, _Integers | None]], rows: _Sets, threads: int
    ) -> tuple[_Floats, _Integers, _Integers, _Integers]: ...
    def spread(self, held: _Sets, validated: _Sets, rows: _Sets, threads: int) -> _Floats: ...
    def hat_blocks(self, rows: _Sets, threads: int) -> _Floats: ...

@final
class LocalFunctions:
    @staticmethod
    def bsplines(
        x: tuple[float, float, int], y: tuple[float, float, int], order: _Integers
    ) -> LocalFunctions: ...
    @staticmethod
    def hats(
        points: _Floats, corners: _Integers, gradients: _Floats, triangles: _Integers, sides: _Integers
    ) -> LocalFunctions: ...
    def values(self, points: _Floats, parameters: _Floats, threads: int) -> _Floats: ...
    def slopes(self, points: _Floats, parameters: _Floats, threads: int) -> _Floats: ...
    def elements(self, points: _Floats, order: int) -> tuple[_Integers, _Floats]: ...

@final
class Nested:
    def __new__(
        cls,
        design: _Floats,
        responses: _Floats,
        root_weights: _Floats | None,
        penalty: _Floats,
        threads: int,
    ) -> Nested: ...
    def coefficients(self, size: int) -> _Floats: ...
    def fits(self, sizes: _Integers, threads: int) -> tuple[_Floats, _Floats, _Integers]: ...
    def curves(
        self,
        schemes: Sequence[tuple[tuple[_Sets, _Sets] | LazyNeighbourhoods, _Integers]],
        rows: _Sets,
        sizes: _Integers,
        threads: int,
    ) -> list[tuple[_Floats, _Integers]]: ...

@final
class LazyNeighbourhoods:
    @staticmethod
    def within(points: _Floats, radius: float, threads: int) -> LazyNeighbourhoods: ...
    @staticmethod
    def nearest(points: _Floats, k: int, threads: int) -> LazyNeighbourhoods: ...
    @property
    def mean(self) -> float: ...

@final
class PenaltyPath:
    def __new__(
        cls,
        design: _Floats,
        responses: _Floats,
        root_weights: _Floats | None,
        penalty: _Floats,
        threads: int,
    ) -> PenaltyPath: ...
    @property
    def determined(self) -> bool: ...
    @property
    def rank(self) -> int: ...
    def fit(self, weight: float, threads: int) -> tuple[Factor, _Floats]: ...

def find_not_finite(values: _Floats) -> tuple[int, int] | None: ...
def hilbert_order(points: _Floats, threads: int) -> _Integers: ...
def neighbours_within(points: _Floats, radius: float, threads: int) -> _Sets: ...
def neighbours_nearest(points: _Floats, k: int, threads: int) -> _Sets: ...
def neighbours_matched(points: _Floats, queries: _Floats, most: int, threads: int) -> _Sets: ...
def neighbours_delaunay(points: _Floats) -> _Sets: ...
def lloyd(samples: _Floats, start: _Floats, max_steps: int, tolerance: float, threads: int) -> _Floats: ...
def preimages(positions: _Floats, corners: _Floats, least: float, threads: int) -> _Floats: ...
def spline_slopes(points: _Floats, centres: _Floats, weights: _Floats, threads: int) -> _Floats: ...
def spline_values(points: _Floats, centres: _Floats, weights: _Floats, threads: int) -> _Floats: ...
def spread(samples: _Floats, draws: _Floats) -> _Integers: ...
def place_by_residual(
    points: _Floats,
    values: _Floats,
    first: tuple[int, int, int],
    max_count: int,
    least: tuple[float, float],
    threads: int,
) -> _Integers: ...
