"""What every design has, whatever its solution is.

Examples
--------
See `mexpress.models`.
"""

from typing import Protocol, TypeVar

from numpy.typing import ArrayLike

from mexpress._validation import Floats

__all__ = ["Design", "NestedDesign"]

Model_co = TypeVar("Model_co", covariant=True)


class Design(Protocol[Model_co]):
    """Minimise ||b - A x||^2 + weight ||Z x||^2.

    Examples
    --------
    See `WarpDesign` and `SurfaceDesign`.
    """

    @property
    def A(self) -> Floats:  # noqa: N802 - the paper's name
        """Design matrix, (m, p)."""

    @property
    def b(self) -> Floats:
        """Responses, (m,) or (m, r)."""

    @property
    def coupling(self) -> int:
        """Rows of A per datum."""

    @property
    def count(self) -> int:
        """Number of control points."""

    def bending(self) -> Floats:
        """Z, (k, p): ||Z x||^2 is the bending energy."""

    def model(self, coefficients: ArrayLike, smoothing: float = 0.0) -> Model_co:
        """The warp or surface of a solution x, and the weight it was found with."""


class NestedDesign(Protocol[Model_co]):
    """Designs for more and more control points, each of them the first columns of the next.

    Examples
    --------
    See `NestedWarpDesign` and `NestedSurfaceDesign`.
    """

    @property
    def A(self) -> Floats:  # noqa: N802 - the paper's name
        """Design matrix of the largest, (m, p)."""

    @property
    def b(self) -> Floats:
        """Responses, (m,) or (m, r)."""

    @property
    def coupling(self) -> int:
        """Rows of A per datum."""

    def columns(self, count: int) -> int:
        """How many columns belong to the first control points."""

    def bending(self) -> Floats:
        """Z, (k, p), of which leading columns are those of the smaller designs."""

    def model(self, coefficients: ArrayLike, count: int, smoothing: float = 0.0) -> Model_co:
        """The warp or surface of a solution of the first columns."""
