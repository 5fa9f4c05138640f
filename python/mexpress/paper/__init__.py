"""The paper's tables and figures, each a function that `mexpress reproduce NAME` runs.

=====================  ==================================================================================
``table1``             table 1, figures 2 and 3: what criteria select on simulated sheets;
                       ``table1_cells``, ``table1_claims`` and ``plot_table1`` sum up, judge and draw it
``table2``             table 2, figures 4 to 6: which warp transfers a contour; ``two_views`` has the scenes,
                       ``contours`` the regions, ``transfer`` one trial, and ``table2_cells``,
                       ``table2_claims`` and ``plot_scenes`` sum up, judge and draw them
``figures7to10``       surfaces of the data in ``surface_data``, drawn by ``plot_panels``
``published``          the paper's own numbers
``experiment``         what all have in common; ``command`` runs them
=====================  ==================================================================================

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
