"""Many problems at once: what is left to do, who does it, and how arrays get there and results back.

`problems` is what users call. An `agenda` has the problems that are not settled. They go to `workers`, processes that
run `serving`, or to `clients`; in either, `calls` makes a call. `sharing`, `parcels`, a `tray` and `pickling` are how
arguments travel, a `spool` is how results do, and a `journal` keeps these.
"""

from mexpress.batch.calls import Failure
from mexpress.batch.problems import iterate_problems, map_problems

__all__ = ["Failure", "iterate_problems", "map_problems"]
