"""Time cross-validation of scikit-learn's linear models by its own refits, and in closed form by `mexpress.sklearn`.

    python benches/sklearn_refits.py [--rounds 5]

Prints a table: the shortest time of each, their ratio, and the largest difference of predictions or scores.
"""

import argparse
import warnings
from functools import partial

import numpy as np
import sklearn.linear_model as refits
import verde
from sklearn.exceptions import UndefinedMetricWarning
from sklearn.model_selection import KFold, LeaveOneOut, ShuffleSplit, cross_val_predict, cross_val_score
from timing import shortest

import mexpress as mx
from mexpress.sklearn import LinearRegression, Ridge, RidgeCV

HEAD = "| data | features | what | refits, ms | closed form, ms | times as fast | difference |"


def best_score(model, X, y):
    """Score of the weight of the ridge that is selected."""
    return model.fit(X, y).best_score_


def pairs(places, X, y):
    """What is timed: its name, the closed form, and the refits."""
    near = mx.schemes.exclusion_radius(places, 0.1)
    blocks = list(verde.BlockKFold(spacing=0.1, n_splits=10, shuffle=True, random_state=0).split(places))
    linear, ridge = refits.LinearRegression(tol=1e-13), refits.Ridge(1.0, solver="svd")
    for name, cv in (
        ("linear, 10 folds", KFold(10)),
        ("linear, 10 folds of blocks (verde)", blocks),
        ("linear, leave-one-out", LeaveOneOut()),
        ("linear, local exclusion", near),
    ):
        closed = partial(LinearRegression().cross_val_predict, X, y, cv)
        yield name, closed, partial(cross_val_predict, linear, X, y, cv=cv)
    yield (
        "ridge, local exclusion",
        partial(Ridge(1.0).cross_val_predict, X, y, near),
        partial(cross_val_predict, ridge, X, y, cv=near),
    )
    weights = np.random.default_rng(1).uniform(0, 1, len(X)) * (np.arange(len(X)) % 10 > 0)
    several = ShuffleSplit(1000, random_state=0)
    yield (
        "ridge, weighted, some absent, 1,000 random splits",
        partial(Ridge(1.0).cross_val_score, X, y, several, sample_weight=weights),
        partial(cross_val_score, ridge, X, y, cv=several, params={"sample_weight": weights}),
    )
    alphas = np.logspace(-3, 3, 25)
    for name, cv in (
        ("25 ridges, 10 folds", KFold(10)),
        ("25 ridges, 100 random splits", ShuffleSplit(100, random_state=0)),
        ("25 ridges, leave-one-out, closed there too", None),
    ):
        own, other = RidgeCV(alphas, cv=cv), refits.RidgeCV(alphas, cv=cv)
        yield name, partial(best_score, own, X, y), partial(best_score, other, X, y)


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    warnings.simplefilter("ignore", UndefinedMetricWarning)
    print(HEAD, "|---|---|---|---|---|---|---|", sep="\n")
    rng = np.random.default_rng(0)
    for n, p in ((500, 10), (2000, 60)):
        places = rng.uniform(0, 1, (n, 2))
        X = np.column_stack([places, rng.normal(size=(n, p - 2))])
        y = X[:, 0] + rng.normal(size=n)
        for name, closed, refitted in pairs(places, X, y):
            fast, found = shortest(closed, rounds)
            slow, expected = shortest(refitted, rounds)
            ratio = slow / fast
            times = f"{1e3 * slow:,.1f} | {1e3 * fast:,.2f} | {ratio:,.{0 if ratio >= 10 else 1}f}"
            print(f"| {n:,} | {p} | {name} | {times} | {np.abs(found - expected).max():.0e} |", flush=True)


if __name__ == "__main__":
    main()
