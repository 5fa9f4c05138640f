"""Estimators of scikit-learn: closed forms against its own refits, and what it asks of estimators."""

import inspect
import pickle
import warnings

import numpy as np
import pandas as pd
import pytest
import sklearn.linear_model as refits
import verde
from scipy.interpolate import RBFInterpolator
from scipy.sparse import coo_array
from sklearn.base import clone
from sklearn.exceptions import UndefinedMetricWarning
from sklearn.metrics import make_scorer, median_absolute_error
from sklearn.model_selection import (
    GridSearchCV,
    GroupKFold,
    GroupShuffleSplit,
    KFold,
    LeaveOneGroupOut,
    LeaveOneOut,
    LeavePGroupsOut,
    LeavePOut,
    PredefinedSplit,
    RepeatedKFold,
    ShuffleSplit,
    TimeSeriesSplit,
    cross_val_predict,
    cross_val_score,
)
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.estimator_checks import check_estimator

import mexpress as mx
from mexpress.models import CardinalBasis
from mexpress.sklearn import LinearRegression, Ridge, RidgeCV, SurfaceRegressor
from mexpress.sklearn.scores import takes_weights

N, P = 48, 5
RNG = np.random.default_rng(0)
PLACES = RNG.uniform(0, 10, (N, 2))
X = np.column_stack([PLACES, RNG.normal(size=(N, P - 2)) * [1.0, 0.1, 10.0] + [0, 0, 20.0]])
Y = X[:, [0]] + RNG.normal(size=(N, 3)) * [1, 10, 0.1] + [0, 100, 0]
WEIGHTS = RNG.uniform(0.1, 3, N)
SOME_ABSENT = WEIGHTS * (np.arange(N) % 5 > 0)
GROUPS = np.arange(N) % 6

SPLITTERS = {
    "KFold": KFold(5),
    "shuffled": KFold(4, shuffle=True, random_state=0),
    "GroupKFold": GroupKFold(3),
    "LeaveOneGroupOut": LeaveOneGroupOut(),
    "LeaveOneOut": LeaveOneOut(),
    "PredefinedSplit": PredefinedSplit(np.arange(N) // 10),
    "exclusion": mx.schemes.exclusion_radius(PLACES, 1.5),
    "buffered": mx.schemes.buffered(mx.schemes.k_fold(N, 8, seed=0), PLACES, 0.3),
    "BlockKFold": verde.BlockKFold(spacing=3, n_splits=4, shuffle=True, random_state=0),
    # ... and those that do not validate every datum once, for scores only
    "GroupShuffleSplit": GroupShuffleSplit(4, random_state=0),
    "LeavePGroupsOut": LeavePGroupsOut(2),
    "RepeatedKFold": RepeatedKFold(n_splits=4, n_repeats=2, random_state=0),
    "ShuffleSplit": ShuffleSplit(6, test_size=0.3, train_size=0.5, random_state=0),
    "TimeSeriesSplit": TimeSeriesSplit(4, gap=2),
    "BlockShuffleSplit": verde.BlockShuffleSplit(spacing=3, n_splits=4, random_state=0),
}
PARTITIONS = list(SPLITTERS)[:9]
PAIRS = {
    "linear": (LinearRegression(), refits.LinearRegression(tol=1e-13)),
    "linear through the origin": (
        LinearRegression(fit_intercept=False),
        refits.LinearRegression(tol=1e-13, fit_intercept=False),
    ),
    "ridge": (Ridge(3.0), refits.Ridge(3.0, solver="svd")),
    "ridge through the origin": (
        Ridge(0.1, fit_intercept=False),
        refits.Ridge(0.1, solver="svd", fit_intercept=False),
    ),
}


def taken(splitter):
    """What splitters split: those of verde take two coordinates."""
    return PLACES if "Block" in splitter else X


def given(sample_weight):
    return {} if sample_weight is None else {"params": {"sample_weight": sample_weight}}


def close(found, expected, unit=1.0):
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * unit)


@pytest.mark.parametrize("estimator", [LinearRegression(), Ridge(), RidgeCV(), SurfaceRegressor()], ids=repr)
@pytest.mark.filterwarnings(
    "ignore::sklearn.exceptions.SkipTestWarning"
)  # of array libraries that are not installed
@pytest.mark.filterwarnings("ignore::sklearn.exceptions.UndefinedMetricWarning")
def test_scikit_learn_checks_estimators(estimator):
    outcome = {check["check_name"]: check["status"] for check in check_estimator(estimator)}
    assert len(outcome) > 40
    assert {name for name, status in outcome.items() if status != "passed"} <= {"check_array_api_input"}


@pytest.mark.parametrize("weights", [None, WEIGHTS, SOME_ABSENT], ids=["alike", "weighted", "some absent"])
@pytest.mark.parametrize("targets", [slice(0, 1), 1, slice(None)], ids=["column", "one", "several"])
@pytest.mark.parametrize("splitter", SPLITTERS)
@pytest.mark.parametrize("model", PAIRS)
def test_closed_forms_are_refits(model, splitter, targets, weights):
    own, other = PAIRS[model]
    cv, features, y = SPLITTERS[splitter], taken(splitter), Y[:, targets]
    asked = {"cv": cv, "groups": GROUPS if "Group" in splitter else None}
    if splitter in PARTITIONS:
        found = own.cross_val_predict(features, y, sample_weight=weights, **asked)
        expected = cross_val_predict(other, features, y, **asked, **given(weights))
        assert found.shape == y.shape  # scikit-learn's ridge regression flattens a column
        close(found, expected.reshape(y.shape), unit=100)
    scores = own.cross_val_score(
        features, y, scoring="neg_mean_squared_error", sample_weight=weights, **asked
    )
    expected = cross_val_score(
        other, features, y, scoring="neg_mean_squared_error", **asked, **given(weights)
    )
    close(scores, expected)


def test_all_pairs_of_data_are_left_out():
    scores = Ridge(3.0).cross_val_score(X[:14], Y[:14], cv=LeavePOut(2))
    close(scores, cross_val_score(refits.Ridge(3.0, solver="svd"), X[:14], Y[:14], cv=LeavePOut(2)))


@pytest.mark.parametrize(
    "scoring",
    [
        None,
        "r2",
        "neg_mean_squared_error",
        "neg_root_mean_squared_error",
        "neg_mean_absolute_error",
        "neg_median_absolute_error",
        "explained_variance",
        make_scorer(median_absolute_error),
    ],
)
@pytest.mark.parametrize(
    "y", [Y[:, 0], Y, np.repeat([[1.0, 2.0]], N, axis=0)], ids=["one", "several", "constant"]
)
def test_scores_are_those_of_scikit_learn(scoring, y):
    for cv in (None, KFold(7, shuffle=True, random_state=1)):
        scores = Ridge(2.0).cross_val_score(X, y, cv=cv, scoring=scoring)
        close(scores, cross_val_score(refits.Ridge(2.0, solver="svd"), X, y, cv=cv, scoring=scoring))


def test_a_score_of_one_datum_is_not_r2():
    with pytest.warns(UndefinedMetricWarning):
        assert np.isnan(Ridge().cross_val_score(X, Y, cv=LeaveOneOut())).all()


@pytest.mark.parametrize("weights", [None, SOME_ABSENT])
def test_every_response_has_a_weight_of_its_own(weights):
    alphas = [0.1, 10.0, 0.1]
    found = Ridge(alphas).cross_val_predict(X, Y, cv=4, sample_weight=weights)
    other = refits.Ridge(alphas, solver="svd")
    close(found, cross_val_predict(other, X, Y, cv=4, **given(weights)), unit=100)


@pytest.mark.parametrize("weights", [None, SOME_ABSENT])
def test_training_data_that_lose_rank_are_refitted(weights):
    # A column with one entry, dependent columns, and folds with fewer training data than columns.
    dummies = np.eye(4)[np.arange(N) % 4]
    features = np.column_stack([dummies, X[:, 2], np.arange(N) == 7])
    few = [(np.arange(3), np.arange(3, N)), (np.arange(3, N), np.arange(3))]
    groups = list(LeaveOneGroupOut().split(X, Y, np.arange(N) % 4))
    for cv in (KFold(4), few, groups, SPLITTERS["exclusion"]):
        found = LinearRegression().cross_val_predict(features, Y, cv=cv, sample_weight=weights)
        other = refits.LinearRegression(tol=1e-13)
        close(found, cross_val_predict(other, features, Y, cv=cv, **given(weights)), unit=100)


@pytest.mark.parametrize("weights", [None, SOME_ABSENT])
@pytest.mark.parametrize("y", [Y[:, 0], Y[:, :1], Y], ids=["one", "column", "several"])
@pytest.mark.parametrize("features", [X, np.column_stack([X, X[:, 0] + X[:, 2]]), X[:4]], ids=len)
@pytest.mark.parametrize("model", PAIRS)
def test_fits_are_those_of_scikit_learn(model, features, y, weights):
    own, other = (clone(each) for each in PAIRS[model])
    some = slice(len(features))
    given = (features, y[some], None if weights is None else weights[some])
    found, expected = own.fit(*given), other.fit(*given)
    assert found.coef_.shape == (*y.shape[1:], features.shape[1])
    close(found.coef_, expected.coef_.reshape(found.coef_.shape), unit=10)
    close(found.intercept_, expected.intercept_, unit=100)
    predicted = expected.predict(features)
    close(found.predict(features), predicted.reshape(y[some].shape), unit=100)


RARE = np.arange(N) == 3
GROUP = np.arange(N) < 20


@pytest.mark.parametrize("alpha", [1e-10, 1e-6, 1e-3, 1.0])
@pytest.mark.parametrize("size", [1.0, 1e3])
@pytest.mark.parametrize("column", [RARE, ~RARE], ids=["rare", "common"])
@pytest.mark.parametrize(
    "cv", [KFold(5), LeaveOneOut(), list(LeaveOneGroupOut().split(X, Y, GROUPS))], ids=str
)
def test_columns_that_are_nearly_constant_keep_their_digits(cv, column, size, alpha):
    # Without datum 3 they are constant, and a small ridge alone tells them from the ones of the intercept.
    features = np.column_stack([X, size * column])
    expected = cross_val_predict(refits.Ridge(alpha, solver="svd"), features, Y, cv=cv)
    close(Ridge(alpha).cross_val_predict(features, Y, cv=cv), expected, unit=100)
    found = RidgeCV([alpha], cv=cv, scoring="neg_mean_squared_error").fit(features, Y)
    scores = Ridge(alpha).cross_val_score(features, Y, cv=cv, scoring="neg_mean_squared_error")
    assert found.best_score_ == pytest.approx(scores.mean(), rel=1e-9)


@pytest.mark.parametrize("alpha", [1e-6, 1e-3, 1.0])
@pytest.mark.parametrize("size", [1.0, 1e3])
@pytest.mark.parametrize("weights", [None, SOME_ABSENT])
def test_what_is_constant_in_the_smaller_group_keeps_its_digits(weights, size, alpha):
    features, cv = np.column_stack([X, size * GROUP]), list(LeaveOneGroupOut().split(X, Y, GROUP))
    expected = cross_val_predict(refits.Ridge(alpha, solver="svd"), features, Y, cv=cv, **given(weights))
    found = Ridge(alpha).cross_val_predict(features, Y, cv=cv, sample_weight=weights)
    close(found, expected, unit=100)


@pytest.mark.parametrize("estimator", [LinearRegression(), Ridge(2.0)], ids=repr)
def test_data_may_be_far_from_zero(estimator):
    near = np.round(X * 2**20) / 2**20, np.round(Y * 2**20) / 2**20  # so that sums are exact
    far = near[0] + 1e8, near[1] + 1e8
    for cv in (KFold(5), LeaveOneOut()):
        close(estimator.cross_val_predict(*far, cv) - 1e8, estimator.cross_val_predict(*near, cv), unit=1e2)


SCALES = 10.0 ** np.linspace(-14, 14, P)


@pytest.mark.parametrize("scales", [SCALES, SCALES[::-1], 1e200, 1e-200], ids=str)
def test_units_of_features_do_not_matter(scales):
    found, expected = LinearRegression().fit(X * scales, Y), LinearRegression().fit(X, Y)
    close(found.predict(X * scales), expected.predict(X), unit=100)
    close(found.coef_ * scales, expected.coef_, unit=10)
    close(LinearRegression().cross_val_predict(X * scales, Y), LinearRegression().cross_val_predict(X, Y))


@pytest.mark.parametrize("unit", [1.0, 1e200])
@pytest.mark.parametrize("k", [0, 4, 8])
def test_units_of_dependent_features_do_not_matter(k, unit):
    for scales in (10.0 ** np.linspace(-k, k, P), 10.0 ** np.linspace(k, -k, P)):
        own = X * scales
        features = unit * np.column_stack([own, own[:, 0] + own[:, 1], 1e3 * own[:, 3], np.ones(N)])
        found = LinearRegression().fit(features, Y).predict(features)
        np.testing.assert_allclose(found, LinearRegression().fit(X, Y).predict(X), rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("alpha", [1e-12, 1.0, 1e6])
def test_a_ridge_is_as_exact_alone_as_among_others(alpha):
    features = X * SCALES
    found = RidgeCV([alpha, 2 * alpha], cv=5, scoring="neg_mean_squared_error").fit(features, Y)
    alone = [Ridge(a).cross_val_score(features, Y, scoring="neg_mean_squared_error") for a in found.alphas]
    close(found.cv_scores_, np.mean(alone, axis=1))


@pytest.mark.parametrize("weights", [None, SOME_ABSENT])
@pytest.mark.parametrize("fit_intercept", [True, False])
def test_features_may_outnumber_the_data(weights, fit_intercept):
    wide = np.random.default_rng(1).normal(size=(N, 3 * N))
    for cv in (LeaveOneOut(), KFold(3)):
        found = Ridge(5.0, fit_intercept=fit_intercept).cross_val_predict(
            wide, Y, cv=cv, sample_weight=weights
        )
        other = refits.Ridge(5.0, solver="svd", fit_intercept=fit_intercept)
        close(found, cross_val_predict(other, wide, Y, cv=cv, **given(weights)), unit=100)


ALPHAS = np.logspace(-2, 4, 13)


@pytest.mark.parametrize("weights", [None, WEIGHTS, SOME_ABSENT], ids=["alike", "weighted", "some absent"])
@pytest.mark.parametrize("scoring", [None, "neg_mean_absolute_error", "neg_median_absolute_error"])
@pytest.mark.parametrize("y", [Y[:, 0], Y], ids=["one", "several"])
@pytest.mark.parametrize(
    "splitter", ["KFold", "shuffled", "ShuffleSplit", "RepeatedKFold", "TimeSeriesSplit", None]
)
def test_all_weights_of_the_ridge_are_refits(splitter, y, scoring, weights):
    cv = None if splitter is None else SPLITTERS[splitter]
    found = RidgeCV(ALPHAS, cv=cv, scoring=scoring).fit(X, y, weights)
    if (
        splitter is None and weights is SOME_ABSENT
    ):  # what scikit-learn divides by zero, or has as errors of zero
        expected = refits.RidgeCV(ALPHAS, scoring=scoring).fit(
            X[weights > 0], y[weights > 0], weights[weights > 0]
        )
    else:
        expected = refits.RidgeCV(ALPHAS, cv=cv, scoring=scoring).fit(X, y, weights)
    assert found.alpha_ == expected.alpha_
    close(found.best_score_, expected.best_score_)
    assert found.best_score_ == found.cv_scores_.max()
    assert found.cv_scores_.shape == (13,)
    close(found.predict(X), refits.Ridge(found.alpha_, solver="svd").fit(X, y, weights).predict(X), unit=100)


@pytest.mark.parametrize("weights", [None, WEIGHTS])
@pytest.mark.parametrize("scoring", [None, "neg_mean_absolute_error"])
def test_every_response_may_select_for_itself(scoring, weights):
    asked = {"alphas": ALPHAS, "scoring": scoring, "alpha_per_target": True}
    found, expected = RidgeCV(**asked).fit(X, Y, weights), refits.RidgeCV(**asked).fit(X, Y, weights)
    np.testing.assert_array_equal(found.alpha_, expected.alpha_)
    close(found.best_score_, expected.best_score_)
    assert found.cv_scores_.shape == (13, 3)
    folds = RidgeCV(**asked, cv=4).fit(X, Y)
    alone = [RidgeCV(ALPHAS, scoring=scoring, cv=4).fit(X, y).alpha_ for y in Y.T]
    assert folds.alpha_.tolist() == alone


def test_local_exclusion_selects_by_the_squared_error():
    near = mx.schemes.exclusion_radius(PLACES, 2.0)
    found = RidgeCV(ALPHAS, cv=near).fit(X, Y)
    for alpha, score in zip(ALPHAS, found.cv_scores_, strict=True):
        predicted = cross_val_predict(refits.Ridge(alpha, solver="svd"), X, Y, cv=near)
        assert score == pytest.approx(-np.mean((Y - predicted) ** 2), rel=1e-9)


def test_no_ridge_may_compete():
    found = RidgeCV([0.0, 10.0], cv=3).fit(X, Y)
    expected = [-np.inf, -np.inf]
    for i, model in enumerate([refits.LinearRegression(tol=1e-13), refits.Ridge(10.0, solver="svd")]):
        expected[i] = cross_val_score(model, X, Y, cv=3).mean()
    close(found.cv_scores_, expected)


def test_groups_reach_the_splitter():
    found = RidgeCV(ALPHAS, cv=LeaveOneGroupOut()).fit(X, Y, groups=GROUPS)
    expected = RidgeCV(ALPHAS, cv=list(LeaveOneGroupOut().split(X, Y, GROUPS))).fit(X, Y)
    np.testing.assert_array_equal(found.cv_scores_, expected.cv_scores_)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Ridge(-1.0).cross_val_predict(X, Y), "Invalid alpha"),
        (lambda: Ridge([1.0, 2.0]).cross_val_predict(X, Y), "Invalid alpha"),
        (lambda: Ridge("strong").cross_val_predict(X, Y), "Invalid alpha"),
        (lambda: Ridge(np.nan).cross_val_predict(X, Y), "Invalid alpha.*nan"),
        (lambda: Ridge([1.0, np.inf, 1.0]).fit(X, Y), "Invalid alpha.*inf"),
        (lambda: Ridge([[1.0]]).fit(X, Y), "Invalid alpha"),
        (lambda: Ridge(-1.0).fit(X, Y), "Invalid alpha"),
        (lambda: Ridge(fit_intercept="no").fit(X, Y), "Invalid fit_intercept.*'no'"),
        (lambda: LinearRegression(fit_intercept=None).cross_val_predict(X, Y), "Invalid fit_intercept"),
        (lambda: RidgeCV(fit_intercept=1).fit(X, Y), "Invalid fit_intercept"),
        (lambda: RidgeCV([-1.0]).fit(X, Y), "Invalid alphas"),
        (lambda: RidgeCV([]).fit(X, Y), "Invalid alphas"),
        (lambda: RidgeCV([[1.0]]).fit(X, Y), "Invalid alphas"),
        (lambda: RidgeCV([np.nan]).fit(X, Y), "Invalid alphas"),
        (lambda: RidgeCV(cv=LeaveOneOut(), scoring="r2").fit(X, Y), "Invalid scoring"),
        (lambda: Ridge().cross_val_score(X, Y, scoring="best"), "scoring"),
        (lambda: Ridge().cross_val_predict(X, Y, cv=mx.schemes.leave_one_out(N + 1)), "Invalid cv.*48 data"),
        (
            lambda: Ridge().cross_val_predict(X, Y, cv=ShuffleSplit(3)),
            "Invalid cv.*validate every datum once",
        ),
        (lambda: Ridge().cross_val_predict(X, Y, cv="folds"), "Invalid cv.*'folds'"),
        (lambda: Ridge().cross_val_predict(X, Y, cv=b"x"), "Invalid cv.*b'x'"),
        (lambda: RidgeCV(cv=b"x").fit(X, Y), "Invalid cv.*b'x'"),
        (lambda: Ridge().cross_val_predict(X, Y[:-1]), "inconsistent numbers of samples"),
        (lambda: Ridge().cross_val_predict(np.where(X > 9, np.nan, X), Y), "NaN"),
        (lambda: Ridge().cross_val_predict(coo_array(X), Y), "[Ss]parse"),
        (lambda: Ridge().cross_val_predict(X, Y, sample_weight=-WEIGHTS), "Invalid sample_weight"),
        (lambda: Ridge().cross_val_predict(X, Y, sample_weight=WEIGHTS[1:]), "Invalid sample_weight"),
        (lambda: Ridge().cross_val_predict(X, Y, sample_weight=0 * WEIGHTS), "sample_weight.*zero"),
        (
            lambda: Ridge().cross_val_predict(X, Y, sample_weight=10.0 ** np.arange(N)),
            "Invalid sample_weight",
        ),
        (lambda: SurfaceRegressor().fit(X[:, :1], Y), "n_features = 1"),
        (lambda: SurfaceRegressor(lifting="spline").fit(X[:, :2], Y), "Invalid lifting"),
        (lambda: SurfaceRegressor().fit(X[:, [0, 0]], Y), "Invalid points"),
        (lambda: SurfaceRegressor().fit(X, Y).grid(), "Invalid surface.*5 features"),
        (
            lambda: SurfaceRegressor().fit(X[:, :2], Y).predict(X[:, :2], return_std="no"),
            "Invalid return_std",
        ),
    ],
)
@pytest.mark.filterwarnings("ignore::sklearn.exceptions.UndefinedMetricWarning")
def test_what_is_refused(call, message):
    with pytest.raises((ValueError, TypeError), match=message):
        call()


EVEN = np.arange(N) % 2 == 0
ORDER = np.arange(N)


@pytest.mark.parametrize(
    "parts",
    [
        lambda train, test: (train, test),
        lambda train, test: (train.tolist(), test.tolist()),
        lambda train, test: ((ORDER[train] - N).astype(np.int8), ORDER[test] - N),
        lambda train, test: (ORDER[train].astype(np.uint8), ORDER[test].tolist()),
    ],
    ids=["masks", "lists of masks", "from the end", "small integers"],
)
def test_indices_are_those_of_scikit_learn(parts):
    cv = [parts(EVEN, ~EVEN), parts(~EVEN, EVEN)]
    expected = Ridge().cross_val_predict(X, Y, cv=[(ORDER[EVEN], ORDER[~EVEN]), (ORDER[~EVEN], ORDER[EVEN])])
    np.testing.assert_array_equal(Ridge().cross_val_predict(X, Y, cv=cv), expected)
    close(Ridge().cross_val_score(X, Y, cv=cv), cross_val_score(refits.Ridge(solver="svd"), X, Y, cv=cv))


@pytest.mark.parametrize(
    ("cv", "message"),
    [
        ([], r"Invalid cv\. It must validate a datum at least; a generator serves once\. Given \[\]\."),
        (iter([]), r"Invalid cv\. .*generator serves once"),
        ([([0], [])], r"Invalid cv\. It must validate a datum"),
        (mx.schemes.from_sets([[1]], [[]], n=N), r"Invalid cv\. It must validate a datum.*Scheme"),
        ([(ORDER[5:], ORDER[:5]), ([], ORDER)], r"Invalid cv\. .*training data.* Given split 1"),
        (mx.schemes.from_sets([[1], ORDER]), r"Invalid cv\. .*training data.* Given split 1"),
        ([([0, 0, 1], [2])], r"Invalid cv\[0\]\. .*bootstrap.*datum 0, 2 times"),
        ([([0, 1], [2, 2])], r"Invalid cv\[0\]\. Its test data must be a list of distinct"),
        ([([0, 1], [2]), ([0, 1], [1])], r"Invalid cv\[1\]\. Test data must not be trained on"),
        ([([0, 1], [N])], r"Invalid cv\[0\]\. Indices must be from 0 to 47\. Given 48"),
        ([([0, 1], [-N - 1])], r"Invalid cv\[0\]\. Indices must not be negative\. Given -49"),
        ([([0.0, 1.0], [2])], r"Invalid cv\[0\]\. Its training data must be"),
        ([(EVEN[1:], ~EVEN)], r"Invalid cv\[0\]\. Its training data must be"),
        ([([0, 1],)], r"Invalid cv\[0\]\. It must be a pair"),
        ([3], r"Invalid cv\[0\]\. It must be a pair"),
        ([([[1], [2, 3]], [0])], r"Invalid cv\. .*index arrays"),
    ],
)
@pytest.mark.parametrize("fit_intercept", [True, False])
def test_what_holds_out_no_data_is_no_cv(cv, message, fit_intercept):
    ridge = Ridge(fit_intercept=fit_intercept)
    calls = [
        lambda: ridge.cross_val_predict(X, Y, cv=cv),
        lambda: ridge.cross_val_score(X, Y, cv=cv),
        lambda: RidgeCV(fit_intercept=fit_intercept, cv=cv).fit(X, Y),
    ]
    for call in calls:
        with pytest.raises((ValueError, TypeError), match=message):
            call()


def test_training_data_must_not_all_be_absent():
    halves = [(ORDER[EVEN], ORDER[~EVEN]), (ORDER[~EVEN], ORDER[EVEN])]
    for estimator in (Ridge(), LinearRegression(), Ridge(fit_intercept=False)):
        with pytest.raises(ValueError, match=r"Invalid cv\. .*weight above 0\. Given split 1"):
            estimator.cross_val_predict(X, Y, cv=halves, sample_weight=1.0 * EVEN)
    with pytest.raises(ValueError, match=r"Invalid cv\. .*weight above 0\. Given split 1"):
        RidgeCV(cv=halves).fit(X, Y, 1.0 * EVEN)


def weighted_by_a_feature(estimator, features, truth):
    missed = (truth - estimator.predict(features)) ** 2
    return -np.average(missed.reshape(len(truth), -1).mean(axis=1), weights=np.abs(features[:, 4]))


@pytest.mark.parametrize("y", [Y[:, 0], Y], ids=["one", "several"])
def test_a_scorer_of_ones_own_sees_the_features(y):
    for cv in (4, ShuffleSplit(3, random_state=0)):
        asked = {"cv": cv, "scoring": weighted_by_a_feature}
        scores = Ridge(2.0).cross_val_score(X, y, **asked)
        close(scores, cross_val_score(refits.Ridge(2.0, solver="svd"), X, y, **asked))
        found, expected = RidgeCV(ALPHAS, **asked).fit(X, y), refits.RidgeCV(ALPHAS, **asked).fit(X, y)
        close(found.best_score_, expected.best_score_)


@pytest.mark.parametrize("weighs", [False, True])
def test_a_scorer_is_given_weights_if_it_takes_them(weighs):
    def by_weight(estimator, features, truth, sample_weight=None):
        return -np.average(np.abs(truth - estimator.predict(features)), weights=sample_weight)

    def plain(estimator, features, truth):
        return by_weight(estimator, features, truth)

    asked = {"cv": 4, "scoring": by_weight if weighs else plain}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = RidgeCV(ALPHAS, **asked).fit(X, Y[:, 0], WEIGHTS)
        assert [str(each.message)[:30] for each in caught] == ["scoring takes no sample_weight"] * (
            not weighs
        )
        expected = refits.RidgeCV(ALPHAS, **asked).fit(X, Y[:, 0], WEIGHTS)
    assert found.alpha_ == expected.alpha_
    close(found.best_score_, expected.best_score_)


def test_a_scorer_without_a_signature_is_given_no_weights():
    assert not takes_weights(max)


def test_a_scorer_may_select_for_every_response():
    found = RidgeCV(ALPHAS, cv=4, scoring=weighted_by_a_feature, alpha_per_target=True).fit(X, Y)
    alone = [RidgeCV(ALPHAS, cv=4, scoring=weighted_by_a_feature).fit(X, y).cv_scores_ for y in Y.T]
    close(found.cv_scores_, np.transpose(alone))


def test_a_scorer_may_ask_for_the_score():
    scores = Ridge().cross_val_score(X, Y, cv=4, scoring=lambda model, X, y: model.score(X.copy(), y))
    close(scores, Ridge().cross_val_score(X, Y, cv=4))


def test_a_scorer_predicts_the_data_of_its_fold_alone():
    with pytest.raises(
        ValueError, match=r"^Invalid X\. A scorer must predict all 12 data of its fold at once"
    ):
        Ridge().cross_val_score(X, Y, cv=4, scoring=lambda model, X, y: model.predict(X[:2]).sum())


def test_lists_and_frames_are_taken():
    frame = pd.DataFrame(X, columns=list("abcde"))
    expected = Ridge().cross_val_predict(X, Y)
    np.testing.assert_array_equal(Ridge().cross_val_predict(X.tolist(), Y.tolist()), expected)
    np.testing.assert_array_equal(Ridge().cross_val_predict(frame, pd.DataFrame(Y)), expected)
    assert RidgeCV().fit(frame, Y).feature_names_in_.tolist() == list("abcde")
    close(Ridge(2.0).cross_val_predict(X, Y, sample_weight=2.0), expected, unit=100)


# ------------------------------------------------------------------------------------------------- surfaces


def waves(n, seed=0):
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 10, (n, 2))
    return points, np.sin(points[:, 0]) + 0.1 * rng.normal(size=n)


def test_a_surface_is_selected_by_fit():
    points, values = waves(150)
    found, expected = SurfaceRegressor().fit(points, values), mx.select_surface(points, values)
    np.testing.assert_array_equal(found.predict(points), expected.surface(points))
    assert found.selection_.score == expected.score
    mean, std = found.predict(points[:9] + 0.1, return_std=True)
    np.testing.assert_array_equal(std, expected.surface.error(points[:9] + 0.1))
    assert mean.shape == std.shape == (9,)


def test_the_deviation_is_that_of_measurements():
    points, values = waves(600)
    mean, std = SurfaceRegressor().fit(points[:300], values[:300]).predict(points[300:], return_std=True)
    assert 0.8 < np.sqrt(np.mean(((values[300:] - mean) / std) ** 2)) < 1.25


def test_every_value_has_a_deviation_of_its_own():
    points, values = waves(200)
    both = np.column_stack([values, 100 * waves(200, seed=1)[1]])
    asked = {
        "smoothing": 0,
        "placement": "nested",
        "criterion": "FIT",
        "max_count": 30,
    }  # 30, whatever the values
    mean, std = SurfaceRegressor(**asked).fit(points, both).predict(points[:50], return_std=True)
    assert mean.shape == (50, 2)
    for a in range(2):
        alone = SurfaceRegressor(**asked).fit(points, both[:, a])
        np.testing.assert_allclose(std[:, a], alone.predict(points[:50], return_std=True)[1], rtol=1e-9)


# What altitudes may be over positions from 0 to 10, with a rough part or without one.
ROUGH = {
    "apart": lambda x, y, rough: rough,
    "slope": lambda x, y, rough: 0.5 * x + 0.3 * rough,
    "hill": lambda x, y, rough: 3 * np.exp(-((x - 5) ** 2 + (y - 5) ** 2) / 8) + 0.3 * rough,
    "against the surface": lambda x, y, rough: -high(x, y) + 0.2 * rough,
    "ridges": lambda x, y, rough: np.sin(3 * x),  # they go with position, but the surface is smoother
}
SMOOTH = {
    "x": lambda x, y: x,
    "hill": lambda x, y: np.exp(-((x - 5) ** 2 + (y - 5) ** 2) / 30),
    "constant": lambda x, y: np.full(len(x), 0.1),
}


def high(x, y):
    return 2 * np.sin(x) + 1.5 * np.cos(0.7 * y) + 0.3 * x


def climate(altitude, n=200, noise=0.2, seed=0):
    """Return positions and an altitude, values of which the altitude adds 2 times itself, and those without noise."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 10, (n, 2))
    above = altitude(*points.T, rng.normal(size=n))
    truth = high(*points.T) + 2 * above
    return np.column_stack([points, above]), truth + noise * rng.normal(size=n), truth


def off(found, truth):
    return np.sqrt(np.mean((found - truth) ** 2))


@pytest.mark.parametrize(("noise", "most"), [(0.001, 0.03), (0.2, 0.15)])
@pytest.mark.parametrize("altitude", ROUGH.values(), ids=ROUGH)
def test_covariates_are_told_from_the_surface(altitude, noise, most):
    features, values, truth = climate(altitude, 400, noise)
    found = SurfaceRegressor().fit(features[:200], values[:200])
    np.testing.assert_allclose(found.coef_, [2], atol=most)
    known = SurfaceRegressor().fit(features[:200, :2], (values - 2 * features[:, 2])[:200])
    expected = known.predict(features[200:, :2]) + 2 * features[200:, 2]
    assert off(found.predict(features[200:]), truth[200:]) < 1.15 * off(expected, truth[200:])


def left_by_scipy(features, columns, smoothing):
    """What scipy's spline leaves of columns, (n, k): that of all data, with the same weight of the bending energy."""
    points = features[:, :2]
    return columns - RBFInterpolator(points, columns, smoothing=smoothing)(points)


@pytest.mark.parametrize("altitude", ROUGH.values(), ids=ROUGH)
def test_coefficients_are_those_of_the_partial_spline(altitude):
    features, values, _ = climate(altitude)
    features = np.column_stack([features, features[:, 2] + np.random.default_rng(7).normal(size=200)])
    both = np.column_stack([values, 5 * features[:, 3] - values])
    found = SurfaceRegressor().fit(features, both)
    assert len(found.surface_.control_points) == 200
    left = left_by_scipy(features, np.column_stack([features[:, 2:], both]), found.surface_.smoothing)
    expected = np.linalg.lstsq(left[:, :2], left[:, 2:], rcond=None)[0]
    np.testing.assert_allclose(found.coef_, expected.T, rtol=1e-8)


def test_coefficients_are_about_those_of_the_joint_fit():
    """That of a covariate apart from position, with surface and coefficient in one penalised least squares."""
    features, values, _ = climate(ROUGH["apart"])
    found = SurfaceRegressor().fit(features, values)
    surface, above = found.surface_, features[:, 2:]
    functions = CardinalBasis(surface.lifting)
    bending = np.sqrt(surface.smoothing) * functions.bending()
    rows = np.block([[functions.at(features[:, :2]), above], [bending, np.zeros((len(bending), 1))]])
    joint = np.linalg.lstsq(rows, np.append(values, np.zeros(len(bending))), rcond=None)[0]
    noise = 0.2 / np.linalg.norm(above)
    np.testing.assert_allclose(found.coef_, joint[-1], atol=0.5 * noise)
    assert off(found.predict(features), rows[:200] @ joint) < 0.02


@pytest.mark.parametrize("altitude", SMOOTH.values(), ids=SMOOTH)
def test_what_goes_with_position_alone_is_the_surfaces(altitude):
    features, values, _ = climate(lambda x, y, rough: altitude(x, y))
    found = SurfaceRegressor().fit(features, values)
    np.testing.assert_array_equal(found.coef_, [0])
    expected = SurfaceRegressor().fit(features[:, :2], values).predict(features[:, :2])
    np.testing.assert_allclose(found.predict(features), expected, rtol=1e-12)


def test_coefficients_have_the_covariates_units():
    features, values, _ = climate(ROUGH["hill"])
    expected = SurfaceRegressor().fit(features, values).coef_[0]
    for unit, origin in [(1e6, 1e8), (1e-150, 0), (1e150, 0)]:
        other = np.column_stack([features[:, :2], unit * features[:, 2] + origin])
        np.testing.assert_allclose(SurfaceRegressor().fit(other, values).coef_ * unit, expected, rtol=1e-7)
    twice = SurfaceRegressor().fit(features[:, [0, 1, 2, 2]], values).coef_
    np.testing.assert_allclose(twice, [expected / 2] * 2, rtol=1e-9)


@pytest.mark.filterwarnings("ignore::mexpress.suspicion.SuspicionWarning")
def test_wrong_values_do_not_move_coefficients():
    features, values, _ = climate(ROUGH["hill"])
    wrong = np.arange(200) % 25 == 4
    found = SurfaceRegressor(robust=True).fit(features, values + 15 * wrong)
    np.testing.assert_array_equal(found.selection_.left_out, np.flatnonzero(wrong))
    np.testing.assert_allclose(found.coef_, [2], atol=0.15)
    assert abs(SurfaceRegressor().fit(features, values + 15 * wrong).coef_[0] - 2) > 0.2


def test_a_weight_of_two_is_a_datum_twice():
    points, values = waves(120)
    twice = np.arange(120) % 3 == 0
    weighted = SurfaceRegressor().fit(points, values, 1.0 + twice)
    repeated = SurfaceRegressor().fit(np.vstack([points, points[twice]]), np.append(values, values[twice]))
    np.testing.assert_allclose(weighted.predict(points), repeated.predict(points), rtol=1e-9)


def test_a_weight_of_two_is_a_covariate_twice():
    features, values, _ = climate(ROUGH["hill"])
    twice = np.arange(200) % 3 == 0
    weighted = SurfaceRegressor().fit(features, values, 1.0 + twice)
    repeated = SurfaceRegressor().fit(
        np.vstack([features, features[twice]]), np.append(values, values[twice])
    )
    np.testing.assert_allclose(weighted.coef_, repeated.coef_, rtol=1e-9)


def test_a_datum_of_weight_zero_is_absent():
    points, values = waves(120)
    wrong = np.arange(120) % 10 == 0
    found = SurfaceRegressor().fit(points, np.where(wrong, 99.0, values), ~wrong)
    expected = SurfaceRegressor().fit(points[~wrong], values[~wrong])
    np.testing.assert_array_equal(found.predict(points), expected.predict(points))


def test_surfaces_work_where_estimators_do():
    points, values = waves(150)
    frame = pd.DataFrame(points, columns=["x", "y"])
    pipeline = make_pipeline(StandardScaler().set_output(transform="pandas"), SurfaceRegressor()).fit(
        frame, values
    )
    assert pipeline[-1].feature_names_in_.tolist() == ["x", "y"]
    assert pipeline.score(frame, values) > 0.9
    near = mx.schemes.buffered(mx.schemes.k_fold(150, 3, seed=0), points, 0.05)
    search = GridSearchCV(SurfaceRegressor(), {"smoothing": ["auto", 1e9]}, cv=near).fit(points, values)
    assert search.best_params_ == {"smoothing": "auto"}
    again = pickle.loads(pickle.dumps(search.best_estimator_))
    np.testing.assert_array_equal(again.predict(points), search.predict(points))
    assert clone(SurfaceRegressor("ER10", seed=3)).get_params()["seed"] == 3


def test_a_grid_is_a_dataset():
    points, values = waves(150)
    found = SurfaceRegressor().fit(points, values)
    grid = found.grid(region=(2, 8, 3, 7), spacing=1.0, names="height")
    expected = found.surface_.to_xarray((2, 8, 3, 7), spacing=1.0, names="height")
    assert grid.identical(expected)
    assert grid.height.shape == (5, 7)
    assert found.grid(like=expected, outside="extrapolate").sizes == expected.sizes
    parameters = [set(inspect.signature(call).parameters) for call in (found.grid, found.surface_.to_xarray)]
    assert parameters[0] == parameters[1]
