"""Sheets of paper that are bent, but not stretched.

A developable surface is ruled: through each of its points passes a straight line along which its normal is constant.
A flat sheet that is folded by small angles about many rulings consists of strips that move rigidly, so lengths on the
sheet stay the same up to rounding, for any angles. See `Sheet`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.caching import cached_property
from mexpress.simulation.cameras import FOCAL, facing, look
from mexpress.simulation.settings import DEFAULT, Setting, checked_setting

COUNT = 10
"""Number of sheets in a set, as in the paper."""

WIDTH, HEIGHT = 1.6, 0.9
"""Size of every sheet, with the shape of the camera's image."""

RULINGS = 400
"""Number of rulings: facets are flat to less than a tenth of a pixel."""

BEND = (2.2, 2.4)
"""Smallest and largest initial bending in a set: the range of the angle of a sheet's normal, in radians."""

SKEW = 0.1
"""Amplitude of the waves in the logarithm of the spacing of rulings, on either edge."""

MARGIN = 0.22
"""Smallest cosine between normals and rays in the frontal view of every sheet."""


@dataclass(frozen=True, eq=False, repr=False)
class Sheet:
    """A rectangle that is folded by small angles about rulings: it bends, but does not stretch.

    The rulings join two opposite edges of the sheet's bounding box in a frame that is turned within the sheet. Their
    ends have the same order on both edges, so the rulings do not cross in the sheet.

    Parameters
    ----------
    lower, upper : array_like, (k,)
        Positions of the ends of the rulings along the edges of the box, from the middle of each edge; both increase.
    angles : array_like, (k,)
        Angle of the fold about every ruling, in radians.
    turn : float, default 0
        Angle in radians from the sheet's x axis to the edges that the rulings join.
    width, height : float, default 1.6 and 0.9
        Size of the sheet.

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
        """Range of the sum of the angles, in radians."""
        sums = np.concatenate([[0.0], np.cumsum(self.angles)])
        return float(np.ptp(sums))

    def __call__(self, points: ArrayLike) -> Floats:
        """Positions in space of points on the sheet.

        Parameters
        ----------
        points : array_like, (k, 2)
            Coordinates on the sheet: x to the right and y down from its middle.

        Returns
        -------
        ndarray, (k, 3)
            Positions in a pose of the sheet that is near (x, y, 0).

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
        rotations, offsets = self.motions
        strips = self.strips(where)
        return np.asarray(np.einsum("kij,kj->ki", rotations[strips][:, :, :2], where) + offsets[strips])

    def normals(self, points: ArrayLike) -> Floats:
        """Normals at points on the sheet, near (0, 0, 1).

        Parameters
        ----------
        points : array_like, (k, 2)
            Coordinates on the sheet.

        Returns
        -------
        ndarray, (k, 3)
            Unit vectors.

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
        rotations, _ = self.motions
        return rotations[self.strips(self._on_sheet(points))][:, :, 2]

    def grid(self, columns: int = 60, rows: int = 34) -> Floats:
        """Centres of the cells of a regular grid on the sheet.

        Parameters
        ----------
        columns, rows : int, default 60 and 34
            Numbers of cells.

        Returns
        -------
        ndarray, (columns * rows, 2)
            Coordinates on the sheet, row after row.

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
        """Points along the four sides of the sheet, in order.

        Parameters
        ----------
        count : int, default 40
            Number of points on each side.

        Returns
        -------
        ndarray, (4 * count, 2)
            Coordinates on the sheet. The first point is a corner, and is not repeated at the end.

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
        """Positions and normals all over the sheet and its border, (k, 3) each."""
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
        """Columns: the direction of the edges that the rulings join, and the direction across."""
        cosine, sine = np.cos(self.turn), np.sin(self.turn)
        return np.array([[cosine, -sine], [sine, cosine]])

    @property
    def _depth(self) -> float:
        """Half the distance between the edges that the rulings join."""
        return float(np.abs(self._axes[:, 1]) @ (self.width, self.height)) / 2

    def strips(self, points: Floats) -> Integers:
        """Number of rulings before each point, (k,): the index of its strip."""
        along, across = (points @ self._axes).T
        share = (across / self._depth + 1)[:, None] / 2
        # Rulings do not cross, so their abscissae are in order at every height.
        before = self.lower * (1 - share) + self.upper * share < along[:, None]
        return np.asarray(before.sum(axis=1), dtype=np.int64)

    @cached_property
    def motions(self) -> tuple[Floats, Floats]:
        """Motions of the strips: rotations (k + 1, 3, 3) and offsets (k + 1, 3), whose mean is near the identity."""
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
        """Motions of the strips relative to the first strip."""
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


def sheets(seed: int = 0, setting: Setting = DEFAULT) -> tuple[Sheet, ...]:
    """Ten sheets, each with its own random bending.

    Parameters
    ----------
    seed : int, default 0
        The same seed gives the same sheets.
    setting : Setting, optional
        How they bend.

    Returns
    -------
    tuple of Sheet
        Ten sheets of 1.6 x 0.9.

    Raises
    ------
    ValueError, TypeError
        If the seed is not a whole number of at least 0, or the setting is none.

    Examples
    --------
    >>> from mexpress import simulation
    >>> ten = simulation.sheets()
    >>> len(ten), ten[0]([[0.2, 0.1]]).shape
    (10, (1, 3))
    """
    return _sheets(check.count(seed, "seed", 0), checked_setting(setting))


@lru_cache(maxsize=8)
def _sheets(seed: int, setting: Setting) -> tuple[Sheet, ...]:
    bends = np.linspace(*BEND, COUNT)
    return tuple(_sheet(seed, index, float(bend), setting) for index, bend in enumerate(bends))


def _sheet(seed: int, index: int, bend: float, setting: Setting) -> Sheet:
    """The first random sheet that a camera sees completely from the front."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0, index)))
    while True:
        sheet = _random_sheet(rng, bend, setting)
        frontal = look(sheet.samples[0], np.eye(3), FOCAL[0])
        if facing(*sheet.samples, frontal) > MARGIN:
            return sheet
        bend *= 0.97  # so the number of draws is bounded


def _random_sheet(rng: np.random.Generator, bend: float, setting: Setting) -> Sheet:
    turn = float(rng.uniform(0, np.pi))
    half = float(np.abs([np.cos(turn), np.sin(turn)]) @ (WIDTH, HEIGHT)) / 2
    lower, upper = (half * _increasing(rng) for _ in range(2))
    flat = Sheet(lower, upper, np.zeros(RULINGS), turn)
    strips = flat.strips(flat.border())
    # The bending is within the sheet, not in the corners of the box.
    time = (np.arange(RULINGS + 1) - strips.min()) / np.ptp(strips)
    normal = _waves(rng, np.clip(time, 0, 1) * 2 * half / WIDTH, setting.waves, setting.decay)
    return Sheet(lower, upper, np.diff(normal) * bend / np.ptp(normal), turn)


def _increasing(rng: np.random.Generator) -> Floats:
    """Abscissae of the rulings from -1 to 1, with smoothly varying spacing."""
    steps = np.exp(SKEW * _waves(rng, np.linspace(0, 1, RULINGS), 3, 0.0))
    ends = np.cumsum(steps)
    return np.asarray(2 * (ends - steps / 2) / ends[-1] - 1)


def _waves(rng: np.random.Generator, time: Floats, count: int, decay: float) -> Floats:
    """Random smooth function of time: a sum of waves with 1, 2, ... half waves between 0 and 1."""
    order = np.arange(1, count + 1)
    amplitudes = rng.uniform(0.5, 1.5, count) / order**decay
    phases = rng.uniform(0, 2 * np.pi, count)
    return np.asarray(np.cos(np.pi * order * time[:, None] + phases) @ amplitudes)
