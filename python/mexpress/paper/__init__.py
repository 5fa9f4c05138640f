"""The paper's tables and figures, each a function that `mexpress reproduce NAME` runs.

Examples
--------
>>> from mexpress.paper import EXPERIMENTS
>>> EXPERIMENTS["table1"].data
''
"""

from mexpress.paper import figures7to10, table1, table2
from mexpress.paper.experiment import Experiment, Options, Outcome

__all__ = ["EXPERIMENTS", "Experiment", "Options", "Outcome"]

EXPERIMENTS: dict[str, Experiment] = {
    experiment.name: experiment
    for experiment in (
        *(table1.TABLE1, table1.FIGURE2, table1.FIGURE3),
        *(table2.TABLE2, table2.FIGURE4, table2.FIGURE5, table2.FIGURE6),
        *(figures7to10.FIGURE7, figures7to10.FIGURE8, figures7to10.FIGURE9, figures7to10.FIGURE10),
    )
}
"""Every experiment by its name, in the paper's order."""
