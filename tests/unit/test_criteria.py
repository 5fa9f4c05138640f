import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mexpress as mx
from mexpress.criteria import Scorer, parse
from mexpress.leastsquares.nested import Nested
from mexpress.placement import covered_region, lattice
from mexpress.selection import largest_count

NAMES = [
    "FIT",
    "PRESS",
    "CMPRESS",
    "KF05",
    "ER10",
    "ER7.5",
    "NN02PTS",
    "NN05PCT",
    "NN2.5PCT",
    "DELAUNAY",
    "MATCHED",
    "LPO02",
]
NAMES += ["RS20PCT", "AIC", "BIC", "GCV"]


def lists(sets):
    return [x.tolist() for x in sets]


def scheme_of(name, points, **options):
    (scheme,) = Scorer.of([name], points, **options).schemes.values()
    return scheme


@pytest.mark.parametrize("name", NAMES)
def test_case_blanks_and_the_papers_suffix_do_not_matter(name):
    expected = parse(name)
    assert expected.name == name
    variants = [name.lower(), name.title(), f" {name} "]
    if expected.family in {"KF", "ER", "NN..PTS", "NN..PCT"}:
        variants += [f"{name}PRESS", f"{name}press".lower()]
    for variant in variants:
        assert parse(variant) == expected


@pytest.mark.parametrize(
    ("name", "family", "amount"),
    [
        ("KF10", "KF", 10),
        ("er7.5Press", "ER", 7.5),
        ("ER01", "ER", 1),
        ("NN02PTS", "NN..PTS", 2),
        ("nn0.5pct", "NN..PCT", 0.5),
    ],
)
def test_what_a_name_says(name, family, amount):
    criterion = parse(name)
    assert (criterion.family, criterion.amount) == (family, amount)


BAD = ["", "ER", "KF", "KF2.5", "ER-5", "ER1e1", "ER10%", "ER.5", "ER5.", "NN05", "NN2.5PTS", "PTS", "XPRESS"]
BAD += ["ER 10", "KF٣", "ER10 PRESS", "ER10,5", "ERnan", "ERinf", "FIT2", "CM", "NN02PTSPCT"]


@pytest.mark.parametrize("name", BAD)
def test_bad_names(name):
    with pytest.raises(ValueError, match=r"^Invalid criterion\. It must be .* Given .*\.$") as caught:
        parse(name)
    near = re.search(r"It must be a criterion's name\. Is it (.*)\?", str(caught.value))
    if near is None:
        assert "It must be one of FIT, PRESS, CMPRESS" in str(caught.value)
    else:
        assert all(parse(known) for known in near[1].split(" or "))


@pytest.mark.parametrize("name", [None, 10, b"ER10", ["ER10"], np.array("FIT")])
def test_names_are_text(name):
    with pytest.raises(TypeError, match=r"^Invalid criterion\. "):
        parse(name)


@pytest.mark.parametrize(
    ("n", "name", "k"),
    [
        # As table 1 of the paper has it, with half rounding up.
        (15, "NN01PCT", 1),
        (15, "NN05PCT", 1),
        (15, "NN10PCT", 2),
        (150, "NN01PCT", 2),
        (150, "NN05PCT", 8),
        (150, "NN10PCT", 15),
        (10, "NN05PCT", 1),
        (10, "NN25PCT", 3),
        (10, "NN100PCT", 10),
        (1000, "NN0.25PCT", 3),
    ],
)
def test_percentages_of_the_data(n, name, k):
    points = np.random.default_rng(0).uniform(size=(n, 2))
    assert lists(scheme_of(name, points).held_out) == lists(mx.schemes.nearest(points, k).held_out)
    assert lists(scheme_of(name, points).held_out) == lists(scheme_of(f"NN{k}PTS", points).held_out)
    if k == 1:
        assert lists(scheme_of(name, points).held_out) == lists(scheme_of("CMPRESS", points).held_out)


def test_matched_asks_for_the_region_that_the_data_cover():
    rng = np.random.default_rng(1)
    crowds = rng.uniform(size=(5, 2))[rng.integers(5, size=200)] + rng.normal(0, 0.02, (200, 2))
    even = lattice(covered_region(crowds), 2000)
    scheme = scheme_of("matched", crowds)
    assert lists(scheme.held_out) == lists(mx.schemes.matched(crowds, even).held_out)
    assert scheme.held_out.sizes.max() > 20


def test_matched_is_listed_for_nested_models_too():
    x, y = np.random.default_rng(2).uniform(size=(2, 60)) ** 3
    points, values = np.column_stack([x, y]), np.sin(5 * x) + y
    design = np.column_stack([x**i * y**j for i in range(3) for j in range(3)])
    scorer = Scorer.of(["MATCHED"], points, nested=True)
    curve = scorer.curves(Nested(design, values), np.arange(1, 10))["MATCHED"]
    for size, score in zip(range(1, 10), curve, strict=True):
        model = mx.LeastSquares(design[:, :size], values)
        assert score.value == pytest.approx(Scorer.of(["MATCHED"], points).scores(model)["MATCHED"].value)


def test_matched_needs_data_that_cover_a_region():
    with pytest.raises(ValueError, match=r"^Invalid criteria\. In MATCHED, .*"):
        Scorer.of(["MATCHED"], np.column_stack([np.arange(9.0), np.arange(9.0)]))


def test_radius_is_a_percentage_of_the_diagonal():
    points = np.random.default_rng(0).uniform(0, [300, 400], (80, 2))
    points[:2] = [[0, 0], [300, 400]]
    assert lists(scheme_of("ER10", points).held_out) == lists(
        mx.schemes.exclusion_radius(points, 50).held_out
    )
    wide = scheme_of("ER7.5", points, diagonal=1000.0)
    assert lists(wide.held_out) == lists(mx.schemes.exclusion_radius(points, 75).held_out)


def test_names_are_schemes():
    points = np.random.default_rng(0).uniform(size=(30, 2))
    s = mx.schemes
    for name, expected in {
        "CMPRESS": s.leave_one_out(30),
        "KF07": s.k_fold(30, 7, seed=5),
        "NN04PTS": s.nearest(points, 4),
        "DELAUNAY": s.delaunay(points),
        "LPO01": s.leave_p_out(30, 1, 1000, seed=5),
        "LPO04": s.leave_p_out(30, 4, 1000, seed=5),
        "RS20PCT": s.random_sampling(30, 6, 100, seed=5),
    }.items():
        found = scheme_of(name, points, seed=5)
        assert lists(found.held_out) == lists(expected.held_out), name
        assert lists(found.validated) == lists(expected.validated), name


UNSUITED = ["KF01", "KF31", "NN00PTS", "NN31PTS", "NN110PCT", "LPO00", "LPO31", "RS110PCT", "KF0"]


@pytest.mark.parametrize("name", UNSUITED)
@pytest.mark.parametrize("digits", ["", "0" * 20, "9" * 400])
def test_numbers_that_do_not_suit_the_data(name, digits):
    points = np.random.default_rng(0).uniform(size=(30, 2))
    if digits.startswith("9"):
        name = name[:2] + digits + name[2:] if not name.startswith("LPO") else name[:3] + digits
    with pytest.raises(ValueError, match=r"^Invalid criteria\. .* Given .*\.$"):
        Scorer.of([name], points)


def test_unsuited_numbers_are_refused_in_one_sentence():
    points = np.random.default_rng(0).uniform(size=(120, 2))
    for name, said in {
        "KF500": "In KF500, k must be a whole number from 2 to 120. Given 500.",
        "RS110PCT": "In RS110PCT, size must be a whole number from 1 to 120. Given 132.",
        "NN130PTS": "In NN130PTS, k must be a whole number from 1 to 120. Given 130.",
    }.items():
        with pytest.raises(ValueError, match=r"^Invalid criteria") as caught:
            Scorer.of([name], points)
        assert str(caught.value) == f"Invalid criteria. {said}"


@pytest.mark.parametrize("name", ["FIT", "cmpress", " er10 ", "KF05PRESS", "gcv"])
def test_schemes_of_ones_own_have_names_of_their_own(name):
    own = {"mine": mx.schemes.leave_one_out(5), name: mx.schemes.leave_one_out(5)}
    with pytest.raises(ValueError, match=r"^Invalid criteria\. .* the name of a criterion\. Given .*\.$"):
        Scorer.of(own, np.eye(5, 2))


def problem(coupling, penalty=None, responses=None):
    rng = np.random.default_rng(0)
    shape = (40,) if responses is None else (40, responses)
    return mx.LeastSquares(rng.normal(size=(40, 4)), rng.normal(size=shape), coupling, penalty=penalty)


def value(model, name):
    points = np.random.default_rng(1).uniform(size=(model.n_data, 2))
    return Scorer.of([name], points).scores(model)[name].value


@pytest.mark.parametrize("penalty", [None, np.eye(4)])
def test_information_criteria_by_hand(penalty):
    # One row to a datum and one response: AIC = n ln(RSS/n) + 2k, BIC = n ln(RSS/n) + k ln n, k = trace(H).
    model = problem(1, penalty)
    rss, k = (model.residuals**2).sum(), model.leverage.sum()
    assert (k < 4) == (penalty is not None)
    assert value(model, "AIC") == pytest.approx(40 * math.log(rss / 40) + 2 * k)
    assert value(model, "BIC") == pytest.approx(40 * math.log(rss / 40) + k * math.log(40))
    # The root of n RSS / (n - k)^2, that it may stand beside the prediction errors.
    assert value(model, "GCV") == pytest.approx(math.sqrt(40 * rss) / (40 - k))


def test_information_criteria_count_measurements():
    one, two = problem(1), problem(2)
    for name in ("AIC", "BIC"):
        assert value(one, name) == pytest.approx(value(two, name))


def test_information_criteria_of_an_exact_fit():
    A = np.random.default_rng(0).normal(size=(9, 3))
    model = mx.LeastSquares(A, np.zeros(9))
    assert value(model, "AIC") == value(model, "BIC") == -math.inf
    assert value(model, "GCV") == 0
    assert math.isnan(value(mx.LeastSquares(A[:3], np.ones(3)), "GCV"))


def test_scores_are_those_of_the_model():
    model = problem(2)
    points = np.random.default_rng(1).uniform(size=(20, 2))
    scores = Scorer.of(["fit", "PRESS", "CMPRESS", "ER20"], points).scores(model)
    radius = 0.2 * np.hypot(*np.ptp(points, axis=0))
    expected = {
        "FIT": model.fit_rms,
        "PRESS": model.press,
        "CMPRESS": model.cross_validate(mx.schemes.leave_one_out(20)).score,
        "ER20": model.cross_validate(mx.schemes.exclusion_radius(points, radius)).score,
    }
    assert {name: score.value for name, score in scores.items()} == pytest.approx(expected, rel=1e-12)
    assert all(score.undefined.size == 0 for score in scores.values())


def test_undefined_data_are_named():
    A = np.column_stack([np.ones(10), np.isin(np.arange(10), [3, 8])])
    points = np.arange(20.0).reshape(10, 2)
    own = {"pairs": mx.schemes.from_sets([[3, 8], [0, 1], [3, 4, 8]], [[8], [0], [3, 4]], n=10)}
    score = Scorer.of(own, points).scores(mx.LeastSquares(A, np.arange(10.0)))["pairs"]
    assert math.isnan(score.value)
    assert score.undefined.tolist() == [3, 4, 8]
    A[8, 1] = 0
    scores = Scorer.of(["PRESS", "CMPRESS", "FIT"], points).scores(mx.LeastSquares(A, np.arange(10.0)))
    assert {name: s.undefined.tolist() for name, s in scores.items()} == {
        "PRESS": [3],
        "CMPRESS": [3],
        "FIT": [],
    }


def test_a_model_that_the_data_do_not_determine_has_no_score():
    model = mx.LeastSquares(np.ones((6, 2)), np.arange(6.0))
    for score in Scorer.of(["FIT", "AIC", "CMPRESS"], np.eye(6, 2)).scores(model).values():
        assert math.isnan(score.value)
        assert score.undefined.tolist() == list(range(6))


def test_largest_count_of_the_paper():
    assert [largest_count(n) for n in (10, 15, 30, 150, 200, 500)] == [6, 7, 15, 75, 100, 100]


@given(n=st.integers(4, 400))
def test_largest_count_is_half_but_for_two(n):
    expected = {10: 6, 15: 7}.get(n, min((n + 1) // 2, 100))
    assert largest_count(n) == expected


def test_the_old_name_of_the_scorer_still_works_and_says_so():
    with pytest.warns(DeprecationWarning, match=r"criteria\.Judge is now criteria\.Scorer"):
        judge = mx.criteria.Judge
    assert judge is Scorer
    with pytest.raises(AttributeError, match="no attribute 'Jury'"):
        mx.criteria.Jury  # noqa: B018


def test_points_of_a_scorer_may_be_lists_and_must_be_finite():
    points = np.random.default_rng(0).uniform(size=(30, 2))
    model = mx.LeastSquares(np.column_stack([np.ones(30), points]), points[:, 0] ** 2)
    expected = Scorer.of(["ER20"], points).scores(model)["ER20"].value
    assert Scorer.of(["ER20"], points.tolist()).scores(model)["ER20"].value == expected
    with pytest.raises(
        ValueError, match=r"^Invalid points\. Its entries must be finite\. Given nan at row 3, column 1"
    ):
        Scorer.of(["ER20"], np.where(np.arange(60).reshape(30, 2) == 7, np.nan, points))
