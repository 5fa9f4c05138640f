"""Time cross-validation of scikit-learn's linear models by its own refits, and in closed form by `mexpress.sklearn`.

    python benches/sklearn_refits.py [--rounds 5]

Prints a table: the shortest time of each, their ratio, and the largest difference of predictions or scores.
"""

import argparse
import time
import warnings

import numpy as np
import sklearn.linear_model as refits
import verde
from sklearn.exceptions import UndefinedMetricWarning
from sklearn.model_selection import KFold, LeaveOneOut, ShuffleSplit, cross_val_predict, cross_val_score

import mexpress as mx
from mexpress.sklearn import LinearRegression, Ridge, RidgeCV

SLOW = 3.0
"""Refits that take more seconds than this are timed once."""


def shortest(call, rounds):
    """Shortest time of a call in seconds, and its result."""
    best, result = np.inf, None
    for turn in range(rounds):
        start = time.perf_counter()
        result = call()
        best = min(best, time.perf_counter() - start)
        if turn == 0 and best > SLOW:
            break
    return best, result


def problem(n, p, r):
    """Places, features and responses."""
    rng = np.random.default_rng(0)
    places = rng.uniform(0, 1, (n, 2))
    X = np.column_stack([places, rng.normal(size=(n, p - 2))])
    return places, X, X[:, :r] + rng.normal(size=(n, r))


def rows():
    """What is timed: its name, the closed form, and the refits."""
    alphas = np.logspace(-3, 3, 25)
    for n, p, r in ((500, 10, 1), (2000, 60, 1), (2000, 60, 5)):
        places, X, Y = problem(n, p, r)
        y = Y[:, 0] if r == 1 else Y
        weights = np.random.default_rng(1).uniform(0, 1, n)
        weights[::10] = 0
        near = mx.schemes.exclusion_radius(places, 0.1)
        blocks = list(verde.BlockKFold(spacing=0.1, n_splits=10, shuffle=True, random_state=0).split(places))
        linear, ridge = (
            (LinearRegression(), refits.LinearRegression(tol=1e-13)),
            (Ridge(1.0), refits.Ridge(1.0, solver="svd")),
        )
        for name, (own, other), cv in (
            ("linear, 10 folds", linear, KFold(10)),
            ("linear, 10 folds of blocks (verde)", linear, blocks),
            ("linear, leave-one-out", linear, LeaveOneOut()),
            ("linear, local exclusion", linear, near),
            ("ridge, local exclusion", ridge, near),
        ):
            yield (
                n,
                p,
                r,
                name,
                lambda own=own, cv=cv, X=X, y=y: own.cross_val_predict(X, y, cv=cv),
                lambda other=other, cv=cv, X=X, y=y: cross_val_predict(other, X, y, cv=cv),
            )
        several = ShuffleSplit(1000, random_state=0)
        yield (
            n,
            p,
            r,
            "ridge, weighted, some absent, 1,000 random splits",
            lambda X=X, y=y, w=weights: Ridge(1.0).cross_val_score(X, y, cv=several, sample_weight=w),
            lambda X=X, y=y, w=weights: cross_val_score(
                refits.Ridge(1.0, solver="svd"), X, y, cv=several, params={"sample_weight": w}
            ),
        )
        for name, cv in (
            ("10 folds", KFold(10)),
            ("100 random splits", ShuffleSplit(100, random_state=0)),
            ("leave-one-out, also closed there", None),
        ):
            yield (
                n,
                p,
                r,
                f"25 ridges, {name}",
                lambda cv=cv, X=X, y=y: RidgeCV(alphas, cv=cv).fit(X, y).best_score_,
                lambda cv=cv, X=X, y=y: refits.RidgeCV(alphas, cv=cv).fit(X, y).best_score_,
            )


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    warnings.simplefilter("ignore", UndefinedMetricWarning)
    print(
        "| data | features | responses | what | refits, ms | closed form, ms | times as fast | difference |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for n, p, r, name, closed, refitted in rows():
        fast, found = shortest(closed, rounds)
        slow, expected = shortest(refitted, rounds)
        print(
            f"| {n:,} | {p} | {r} | {name} | {1e3 * slow:,.1f} | {1e3 * fast:,.2f} | {slow / fast:,.1f} | {np.abs(found - expected).max():.0e} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
