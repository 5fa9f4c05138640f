"""What plots need to know of what they show, whoever has it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from mexpress._validation import Floats, Integers
from mexpress.models.surface import Surface


class SelectionLike(Protocol):
    """Scores of models and what they choose, as `mexpress.Selection` has them; one of warps has a `warp` too."""

    @property
    def criterion(self) -> str:
        """The criterion that selects."""

    @property
    def counts(self) -> Integers:
        """Numbers of control points, (k,), increasing."""

    @property
    def weights(self) -> Floats:
        """Weights of the bending energy, (w,), increasing."""

    @property
    def maps(self) -> Mapping[str, Floats]:
        """By criterion, its score of every count and weight, (k, w); NaN where undefined."""

    @property
    def curves(self) -> Mapping[str, Floats]:
        """By criterion, its score of every count at the weight that is best there, (k,)."""

    @property
    def parameters(self) -> Floats | None:
        """Effective numbers of parameters, (k, w)."""

    @property
    def selected(self) -> Mapping[str, int | None]:
        """By criterion, the count that it would choose; None without a score."""

    @property
    def selected_smoothing(self) -> Mapping[str, float | None]:
        """By criterion, the weight that it would choose; None without a score."""

    @property
    def count(self) -> int:
        """The selected count."""

    @property
    def selected_rival(self) -> Mapping[str, str | None]:
        """By criterion, the other model that it would choose, such as an affine map; None for a count and a weight."""

    @property
    def rival(self) -> str | None:
        """The other model that is selected, if one is."""

    @property
    def score(self) -> float:
        """The criterion's score of the selected model."""

    @property
    def place(self) -> tuple[int, int]:
        """Positions of the best count and weight, whether or not a rival is better."""


class SurfaceSelectionLike(SelectionLike, Protocol):
    """One of surfaces, with its data and the control points in their order, as `mexpress.SurfaceSelection` has it."""

    @property
    def surface(self) -> Surface:
        """The selected surface."""

    @property
    def points(self) -> Floats:
        """Where the data are, (n, 2)."""

    @property
    def values(self) -> Floats:
        """The data, (n,) or (n, d)."""

    @property
    def control_points(self) -> Floats:
        """All control points, (l, 2), of which a surface with k has the first k."""

    @property
    def placement(self) -> str:
        """How the control points were placed; "residual" is where the surface so far was wrong."""
