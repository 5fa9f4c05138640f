"""Sheets of paper, bent but not stretched.

A developable surface is ruled: through each of its points goes a straight line along which its normal does not turn.
Folding a flat sheet by a small angle about each of many rulings moves the strips between them rigidly, so that lengths
on the sheet are kept to rounding, whatever the angles. See `Sheet`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.simulation.cameras import FOCAL, facing, look

COUNT = 10
"""Sheets in a set, as in the paper."""

WIDTH, HEIGHT = 1.6, 0.9
"""Of every sheet; the shape of the camera's image."""

RULINGS = 400
"""So many that a facet is flat to less than a tenth of a pixel."""

BEND = (2.2, 2.4)
"""Least and greatest bending in radians that a set starts with: how far a sheet's normal swings in all."""

WAVES = 8
"""The shortest of the normal's waves has so many halves along the width."""

DECAY = -0.5
"""Amplitudes of the normal's waves fall as this power of their number: they rise."""

SKEW = 0.1
"""Amplitude of the waves of the logarithm of the rulings' spacing, on either edge."""

MARGIN = 0.22
"""Least cosine between normals and rays in the frontal view that each sheet has to have."""


@dataclass(frozen=True, eq=False, repr=False)
class Sheet:
    """A rectangle that is folded by small angles about rulings, and so bent without being stretched.

    The rulings join two opposite edges of the sheet's bounding box in a frame that is turned within the sheet. Their
    ends follow each other in the same order on both edges, so they do not cross in the box, nor in the sheet.

    Parameters
    ----------
    lower, upper : array_like, (k,)
        Where the rulings meet the edges of the box, along them from their middle; both increase.
    angles : array_like, (k,)
        By how much the sheet is folded about every ruling, in radians.
    turn : float, default 0
        Angle in radians from the sheet's x axis to the edges that the rulings join.
    width, height : float, default 1.6 and 0.9
        Of the sheet.

    Raises
    ------
    ValueError, TypeError
        If the lengths differ, ends do not increase, or a number is not finite.

    Examples
    --------
    >>> from mexpress.simulation import Sheet
    >>> folded = Sheet([0.0], [0.0], [np.pi / 2], width=2.0, height=1.0)
    >>> left, middle, right = folded([[-1, 0], [0, 0], [1, 0]])
    >>> [round(float(np.linalg.norm(left - point)), 6) for point in (middle, right)]
    [1.0, 1.414214]
    """

    lower: Floats
    upper: Floats
    angles: Floats
    turn: float = 0.0
    width: float = WIDTH
    height: float = HEIGHT

    def __post_init__(self) -> None:
        for name in ("lower", "upper", "angles"):
            array = check.real(getattr(self, name), name).copy()
            if array.ndim != 1 or array.size == 0 or array.shape != np.shape(self.lower):
                check.refuse(name, "It must be one number for each of the rulings.", f"shape {array.shape}")
            check.finite(array, name)
            if name != "angles" and (np.diff(array) <= 0).any():
                check.refuse(name, "Rulings must not cross: their ends must increase.", check.describe(array))
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        rule = "It must be a number."
        object.__setattr__(self, "turn", check.number(self.turn, "turn", rule, -np.inf))
        for name in ("width", "height"):
            object.__setattr__(self, name, check.positive(getattr(self, name), name))

    def __repr__(self) -> str:
        return f"Sheet({self.width:g} x {self.height:g}, {len(self.angles)} rulings, bent by {self.bend:.3g} rad)"

    @property
    def bend(self) -> float:
        """How far the sum of the angles swings, in radians."""
        sums = np.concatenate([[0.0], np.cumsum(self.angles)])
        return float(np.ptp(sums))

    def __call__(self, points: ArrayLike) -> Floats:
        """Positions in space of points on the sheet.

        Parameters
        ----------
        points : array_like, (k, 2)
            In the sheet's own coordinates: x to the right and y down from its middle.

        Returns
        -------
        ndarray, (k, 3)
            Turned and moved so that they are near (x, y, 0).

        Raises
        ------
        ValueError, TypeError
            If a point is not on the sheet.

        Examples
        --------
        >>> from mexpress.simulation import Sheet
        >>> Sheet([0.0], [0.0], [0.0])([[0.5, 0.25]]).round(6) + 0.0
        array([[0.5 , 0.25, 0.  ]])
        """
        where = self._on_sheet(points)
        rotations, offsets = self._placed
        strips = self.strips(where)
        return np.asarray(np.einsum("kij,kj->ki", rotations[strips][:, :, :2], where) + offsets[strips])

    def normals(self, points: ArrayLike) -> Floats:
        """Unit normals at points on the sheet, near (0, 0, 1).

        Parameters
        ----------
        points : array_like, (k, 2)
            In the sheet's own coordinates.

        Returns
        -------
        ndarray, (k, 3)

        Raises
        ------
        ValueError, TypeError
            If a point is not on the sheet.

        Examples
        --------
        >>> from mexpress.simulation import Sheet
        >>> Sheet([0.0], [0.0], [0.0]).normals([[0.5, 0.25]]).round(6) + 0.0
        array([[0., 0., 1.]])
        """
        rotations, _ = self._placed
        return rotations[self.strips(self._on_sheet(points))][:, :, 2]

    def grid(self, columns: int = 60, rows: int = 34) -> Floats:
        """Middles of the cells of a regular division of the sheet, (columns * rows, 2).

        Parameters
        ----------
        columns, rows : int, default 60 and 34
            Numbers of cells.

        Returns
        -------
        ndarray, (columns * rows, 2)
            Row after row.

        Examples
        --------
        >>> from mexpress.simulation import Sheet
        >>> Sheet([0.0], [0.0], [0.0], width=2, height=1).grid(2, 1)
        array([[-0.5,  0. ], [ 0.5,  0. ]])
        """
        columns, rows = check.count(columns, "columns", 1), check.count(rows, "rows", 1)
        x = (np.arange(columns) + 0.5) / columns - 0.5
        y = (np.arange(rows) + 0.5) / rows - 0.5
        return np.column_stack([np.tile(x * self.width, rows), np.repeat(y * self.height, columns)])

    def border(self, count: int = 40) -> Floats:
        """Points on the sheet's edge, in order and count on each of its four sides, (4 count, 2).

        Parameters
        ----------
        count : int, default 40
            Points on each side.

        Returns
        -------
        ndarray, (4 * count, 2)
            The first is a corner, and is not repeated at the end.

        Examples
        --------
        >>> from mexpress.simulation import Sheet
        >>> Sheet([0.0], [0.0], [0.0], width=2, height=1).border(1)
        array([[-1. , -0.5], [ 1. , -0.5], [ 1. ,  0.5], [-1. ,  0.5]])
        """
        count = check.count(count, "count", 1)
        corners = 0.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (self.width, self.height)
        along = (np.arange(count) / count)[:, None]
        ends = np.roll(corners, -1, axis=0)
        return np.concatenate([a + along * (b - a) for a, b in zip(corners, ends, strict=True)])

    @cached_property
    def samples(self) -> tuple[Floats, Floats]:
        """Positions and normals all over the sheet, its border included, (k, 3) each."""
        where = np.concatenate([self.grid(), self.border()])
        return self(where), self.normals(where)

    def _on_sheet(self, points: ArrayLike) -> Floats:
        where = check.points(points, "points")
        outside = (np.abs(where) > 0.5 * (1 + 1e-9) * np.array([self.width, self.height])).any(axis=1)
        if outside.any():
            rule = (
                f"They must lie on the sheet, within ({self.width / 2:g}, {self.height / 2:g}) of its middle."
            )
            check.refuse("points", rule, f"{where[outside.argmax()].tolist()}")
        return where

    @property
    def _axes(self) -> Floats:
        """Columns: the direction of the edges that the rulings join, and across."""
        cosine, sine = np.cos(self.turn), np.sin(self.turn)
        return np.array([[cosine, -sine], [sine, cosine]])

    @property
    def _depth(self) -> float:
        """Half the distance between the edges that the rulings join."""
        return float(np.abs(self._axes[:, 1]) @ (self.width, self.height)) / 2

    def strips(self, points: Floats) -> Integers:
        """Between which rulings points are: how many rulings come before each, (k,)."""
        along, across = (points @ self._axes).T
        share = (across / self._depth + 1)[:, None] / 2
        # Rulings do not cross, so at every height their abscissae stand in order.
        before = self.lower * (1 - share) + self.upper * share < along[:, None]
        return np.asarray(before.sum(axis=1), dtype=np.int64)

    @cached_property
    def _placed(self) -> tuple[Floats, Floats]:
        """How the strips move: rotations (k + 1, 3, 3) and offsets (k + 1, 3), near the identity in the mean."""
        rotations, offsets = self._folded()
        where = self.grid()
        strips = self.strips(where)
        flat = np.column_stack([where, np.zeros(len(where))])
        bent = np.einsum("kij,kj->ki", rotations[strips], flat) + offsets[strips]
        middle = bent.mean(axis=0)
        left, _, right = np.linalg.svd(flat.T @ (bent - middle))
        back = (left * [1, 1, np.linalg.det(left @ right)]) @ right
        return back @ rotations, (offsets - middle) @ back.T

    def _folded(self) -> tuple[Floats, Floats]:
        """How the strips move when the first one stays."""
        ends = [
            np.column_stack([x, np.full_like(x, y)]) @ self._axes.T
            for x, y in ((self.lower, -self._depth), (self.upper, self._depth))
        ]
        along = ends[1] - ends[0]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        rotations, offsets = [np.eye(3)], [np.zeros(3)]
        for point, axis, angle in zip(ends[0], along, self.angles, strict=True):
            fold, fixed = _rotation(axis, angle), np.append(point, 0.0)
            offsets.append(offsets[-1] + rotations[-1] @ (fixed - fold @ fixed))
            rotations.append(rotations[-1] @ fold)
        return np.array(rotations), np.array(offsets)


def _rotation(axis: Floats, angle: float) -> Floats:
    """Rotation (3, 3) about a unit vector in the plane z = 0."""
    x, y = axis
    cosine, sine = np.cos(angle), np.sin(angle)
    rest = 1 - cosine
    return np.array(
        [
            [cosine + x * x * rest, x * y * rest, y * sine],
            [x * y * rest, cosine + y * y * rest, -x * sine],
            [-y * sine, x * sine, cosine],
        ]
    )


def sheets(seed: int = 0) -> tuple[Sheet, ...]:
    """Ten sheets, each bent in its own way.

    Parameters
    ----------
    seed : int, default 0
        The same seed gives the same sheets.

    Returns
    -------
    tuple of Sheet
        Ten of 1.6 x 0.9.

    Raises
    ------
    ValueError, TypeError
        If the seed is not a whole number of at least 0.

    Examples
    --------
    >>> from mexpress import simulation
    >>> ten = simulation.sheets()
    >>> len(ten), ten[0]([[0.2, 0.1]]).shape
    (10, (1, 3))
    """
    return _sheets(check.count(seed, "seed", 0))


@lru_cache(maxsize=8)
def _sheets(seed: int) -> tuple[Sheet, ...]:
    bends = np.linspace(*BEND, COUNT)
    return tuple(_sheet(seed, index, float(bend)) for index, bend in enumerate(bends))


def _sheet(seed: int, index: int, bend: float) -> Sheet:
    """The first random sheet of its kind that a camera sees whole from the front."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0, index)))
    while True:
        sheet = _random_sheet(rng, bend)
        frontal = look(sheet.samples[0], np.eye(3), FOCAL[0])
        if facing(*sheet.samples, frontal) > MARGIN:
            return sheet
        bend *= 0.97  # an upper bound on the draws


def _random_sheet(rng: np.random.Generator, bend: float) -> Sheet:
    turn = float(rng.uniform(0, np.pi))
    half = float(np.abs([np.cos(turn), np.sin(turn)]) @ (WIDTH, HEIGHT)) / 2
    lower, upper = (half * _increasing(rng) for _ in range(2))
    flat = Sheet(lower, upper, np.zeros(RULINGS), turn)
    strips = flat.strips(flat.border())
    # Bending where the sheet is, not in the corners of the box.
    time = (np.arange(RULINGS + 1) - strips.min()) / np.ptp(strips)
    normal = _waves(rng, np.clip(time, 0, 1) * 2 * half / WIDTH, WAVES, DECAY)
    return Sheet(lower, upper, np.diff(normal) * bend / np.ptp(normal), turn)


def _increasing(rng: np.random.Generator) -> Floats:
    """Abscissae from -1 to 1 of the rulings, unevenly but smoothly spaced."""
    steps = np.exp(SKEW * _waves(rng, np.linspace(0, 1, RULINGS), 3, 0.0))
    ends = np.cumsum(steps)
    return np.asarray(2 * (ends - steps / 2) / ends[-1] - 1)


def _waves(rng: np.random.Generator, time: Floats, count: int, decay: float) -> Floats:
    """Random smooth function of time: waves of which 1, 2, ... halves fit between 0 and 1."""
    order = np.arange(1, count + 1)
    amplitudes = rng.uniform(0.5, 1.5, count) / order**decay
    phases = rng.uniform(0, 2 * np.pi, count)
    return np.asarray(np.cos(np.pi * order * time[:, None] + phases) @ amplitudes)
