"""One page of a selection: HTML with its style, its script and its pictures inside, which needs nothing from elsewhere.

`page` puts sections together. The other modules draw what is in them, in SVG, from numbers and models: they
know nothing of selections. All text is escaped, and colours follow the reader's light or dark scheme.
"""

from mexpress.report.curves import Curves
from mexpress.report.page import code, page, section
from mexpress.report.surfaces import surface_figures
from mexpress.report.warps import warp_figures

__all__ = ["Curves", "code", "page", "section", "surface_figures", "warp_figures"]
