"""How sheets bend, and how cameras see them."""

from __future__ import annotations

from dataclasses import dataclass

from mexpress import _validation as check


@dataclass(frozen=True)
class Setting:
    """How long the waves of a set of sheets are, and where their cameras stand.

    Parameters
    ----------
    waves : int, default 8
        Number of half waves of a sheet's normal along its width, for its shortest wave.
    decay : float, default -0.5
        Amplitudes of the normal's waves fall with this power of their number (so they rise).
    tilt : (float, float), default (0.8, 0.3)
        Largest and smallest angle in radians between the optical axis and a sheet's mean normal.
    fill : float, default 1.6
        The nearest camera with the whole sheet in view is this many times farther: the sheet fills the view.

    Raises
    ------
    ValueError, TypeError
        If there are no waves, a number is none, an angle is not from 0 to 1.5, or `fill` is not positive.

    Examples
    --------
    >>> from mexpress.simulation import Setting
    >>> Setting(waves=7, decay=0.0)
    Setting(waves=7, decay=0.0, tilt=(0.8, 0.3), fill=1.6)
    """

    waves: int = 8
    decay: float = -0.5
    tilt: tuple[float, float] = (0.8, 0.3)
    fill: float = 1.6

    def __post_init__(self) -> None:
        rule = "It must be the largest and the smallest angle in radians, from 0 to 1.5."
        tilt = tuple(check.number(angle, "tilt", rule, 0.0) for angle in check.items(self.tilt, "tilt", rule))
        if len(tilt) != 2 or not tilt[1] <= tilt[0] <= 1.5:
            check.refuse("tilt", rule, check.describe(self.tilt))
        object.__setattr__(self, "tilt", tilt)
        object.__setattr__(self, "waves", check.count(self.waves, "waves", 1))
        object.__setattr__(
            self, "decay", check.number(self.decay, "decay", "It must be a number.", -float("inf"))
        )
        object.__setattr__(self, "fill", check.positive(self.fill, "fill"))


DEFAULT = Setting()


def checked_setting(setting: object) -> Setting:
    """Return a setting that a user gave.

    Examples
    --------
    >>> checked_setting(Setting()) == DEFAULT
    True
    """
    if not isinstance(setting, Setting):
        check.refuse("setting", "It must be a Setting.", check.describe(setting), TypeError)
    return setting
