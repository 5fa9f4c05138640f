"""Models of mexpress with settings that are the same in all draws of a row, of which the best is known afterwards."""

import numpy as np

from comparison.methods import error
from mexpress.criteria import Scorer
from mexpress.liftings import ThinPlateSpline
from mexpress.models import CardinalBasis
from mexpress.placement import farthest_order
from mexpress.selection.data import Matches, Samples
from mexpress.selection.sweep import sweep_designs

COUNTS = (30, 900)
"""Numbers of control points, where there are so many data; a fractional warp has a third of the latter at most."""

WEIGHTS = np.logspace(-9, 2, 12)
"""Weights of the bending energy, in units of the number of data times their area."""

SETTINGS = [f"{count} points, weight {weight:.0e}" for count in COUNTS for weight in WEIGHTS]


def model_grid(problem):
    """Return by setting the models of a problem: a few control points or as many as data, and a weight."""
    if problem.is_warp:
        data, most = Matches.of(problem.source, problem.target), 300
        designs = {count: lambda basis: data.design(basis, fractional=True) for count in COUNTS}
    else:
        data, most = Samples.of(problem.source, problem.target), 900
        designs = dict.fromkeys(COUNTS, data.design)
    n = len(problem.source)
    order = problem.source[farthest_order(problem.source, min(n, most))]
    models = []
    for count, design in designs.items():
        basis = CardinalBasis(ThinPlateSpline(order[:count]))
        weights = n * data.domain.area * WEIGHTS
        sweep = sweep_designs([design(basis)], weights, Scorer({}, {}), None, lambda: None)
        models += [sweep.model(0, k) for k in range(len(WEIGHTS))]
    return dict(zip(SETTINGS, models, strict=True))


def fixed_errors(problem):
    """Return the error of every setting."""
    return {
        name: error(problem, lambda given, model=model: model(given.test_source))
        for name, model in model_grid(problem).items()
    }
