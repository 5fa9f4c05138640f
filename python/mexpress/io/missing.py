"""What stands for a number that is not there: NaN and empty cells always, and the values that somebody says.

Examples
--------
>>> missing = Missing.of([-9999, "drop"])
>>> missing.marks(np.array([1.5, np.nan, -9999]))
array([False,  True,  True])
>>> missing.drop
True
"""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check

DROP, KEEP = "drop", "keep"

_LARGEST = 3.4e38
"""The largest float, and minus the lowest, as they are written in short."""


@dataclass(frozen=True, repr=False)
class Missing:
    """Values that mean no data, and what to do with data that are missing otherwise.

    Parameters
    ----------
    values : tuple of float
        Values that mean that there is no measurement, such as -9999.
    drop : bool
        Whether rows of a table with NaN, infinite or empty cells are left out; else they are an error.
    keep : bool
        Whether they stay instead, as rows of NaN, and so do rows with one of the values.
    """

    values: tuple[float, ...] = ()
    drop: bool = False
    keep: bool = False

    @classmethod
    def of(cls, given: Any) -> Self:
        """Check what a reader is given: None, a number, "drop" or "keep", or a sequence of these.

        Raises
        ------
        ValueError, TypeError
            If it is anything else.

        Examples
        --------
        >>> Missing.of(-9999), Missing.of("drop"), Missing.of(None)
        (Missing(-9999), Missing(drop), Missing())
        """
        if given is None:
            return cls()
        rule = 'It must be a number that means no data, "drop" or "keep", or several of these.'
        parts = [given] if isinstance(given, str) or np.ndim(given) == 0 else list(given)
        words = [part for part in parts if isinstance(part, str)]
        if set(words) not in ({DROP}, {KEEP}, set()):
            check.refuse("missing", rule, check.describe(given))
        numbers = [part for part in parts if not isinstance(part, str)]
        values = tuple(check.number(part, "missing", rule, -np.inf) for part in numbers)
        return cls(values, DROP in words, KEEP in words)

    def __repr__(self) -> str:
        words = [DROP] * self.drop + [KEEP] * self.keep
        return f"Missing({', '.join([*map('{:g}'.format, self.values), *words])})"

    def marks(self, array: NDArray[Any]) -> NDArray[np.bool_]:
        """Return where an array of real numbers has none: it is not finite, or one of the values.

        Examples
        --------
        >>> Missing.of(-3.4e38).marks(np.array([-3.4e38, 1], np.float32))  # the nearest number of the array's type
        array([ True, False])
        """
        return np.asarray(~np.isfinite(array) | self.told(array))

    def told(self, array: NDArray[np.bool_ | np.number[Any]]) -> NDArray[np.bool_]:
        """Return where an array of real numbers has one of the values, in the precision of doubles or floats.

        -3.4e38 is the lowest float, -3.4028235e38, too.

        Examples
        --------
        >>> Missing.of([-3.4e38, 0.1]).told(np.array([np.finfo(np.float32).min, np.float32(0.1), 0.1, 0.2]))
        array([ True,  True,  True, False])
        """
        marked = np.zeros(array.shape, dtype=np.bool_)
        with np.errstate(over="ignore"):
            for value in self.values:
                marked |= (array == value) | (array == np.float32(value))
                if abs(value) >= _LARGEST:
                    marked |= array * np.sign(value) >= _LARGEST
        return marked
