"""Every public function with input that is strange but right, and with input that is wrong."""

import numpy as np
import pytest
from inputs import (
    ANY_LENGTH,
    ARRAYS,
    BAD_COUNTS,
    BAD_COUPLINGS,
    BAD_INDICES,
    BAD_SEEDS,
    BAD_SMOOTHING,
    FORMS,
    FROM_ZERO,
    INDICES,
    LOO,
    MODEL,
    NUMBERS,
    OPTIONAL,
    POINTS,
    QUERIES,
    SHORT,
    TARGET,
    WRONG,
    A,
    B,
    N,
    frozen,
    in_form,
    refused,
    select,
    wrong_arrays,
)

import mexpress as mx

s = mx.schemes
COVERED = {
    "BatchCrossValidation",  # a result
    "Cloud",
    "CrossValidation",  # a result
    "Failure",  # a result
    "LeastSquares",
    "RankLossWarning",  # no function
    "Selection",  # a result
    "Surface",
    "SurfaceSelection",  # a result
    "TallLeastSquares",  # a result
    "Warp",
    "WarpSelection",  # a result
    "criteria",  # test_criteria.py
    "cross_validate_batch",
    "cross_validate_nested",
    "datasets",  # test_datasets.py
    "fit_surface",
    "fit_warp",
    "io",  # test_io_*.py
    "liftings",  # test_liftings_all.py
    "iterate_problems",  # test_batch.py
    "load",
    "map_problems",  # test_batch.py
    "placement",  # test_placement.py and those beside it
    "read_cloud",  # test_surface_arguments.py and test_io_clouds.py
    "schemes",
    "select_surface",
    "select_warp",
    "show_versions",  # test_versions.py
    "simulation",  # test_simulation.py
    "IndexSets",
    "Scheme",
    "buffered",  # test_schemes.py
    "delaunay",
    "exclusion_radius",
    "from_distance",  # test_schemes.py
    "from_sets",
    "from_splits",
    "k_fold",
    "leave_one_out",
    "leave_p_out",
    "matched",
    "nearest",
    "random_sampling",
}


def test_no_public_name_is_forgotten():
    # A new name must be added here, and what it takes to the tables of inputs.py.
    assert set(mx.__all__) | set(s.__all__) <= COVERED


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", ARRAYS)
def test_the_form_of_an_array_does_not_matter(name, form):
    _, value, call = ARRAYS[name]
    before = value.copy()
    result = call(FORMS[form](value))
    np.testing.assert_array_equal(result, call(value))
    assert type(result) is np.ndarray
    np.testing.assert_array_equal(value, before)


@pytest.mark.parametrize("dtype", [np.float32, np.float16, np.int8, np.int64, np.uint8, bool])
@pytest.mark.parametrize("name", ARRAYS)
def test_other_numbers_mean_what_they_are_as_float64(name, dtype):
    argument, value, call = ARRAYS[name]
    value = np.abs(np.round(value)) + 1 if argument == "weights" else value
    converted = value.astype(dtype)
    try:
        expected = call(converted.astype(np.float64))
    except ValueError:  # true and false, as points, are on a line
        refused(lambda: call(converted))
    else:
        np.testing.assert_array_equal(call(converted), expected)


@pytest.mark.parametrize(("name", "wrong"), list(wrong_arrays()))
def test_what_is_no_array_of_numbers_is_refused(name, wrong):
    argument, value, call = ARRAYS[name]
    # A length is compared with another, which may be taken for the wrong one.
    refused(lambda: call(WRONG[wrong](value)), r"\w+" if wrong == "one row short" else argument)


@pytest.mark.parametrize("name", [name for name, (argument, *_) in ARRAYS.items() if argument in SHORT])
def test_a_short_form_means_an_array(name):
    argument, _, call = ARRAYS[name]
    short, array = SHORT[argument]
    np.testing.assert_array_equal(call(short), call(array))


@pytest.mark.parametrize("name", [name for name in ARRAYS if name in ANY_LENGTH])
def test_any_number_of_rows_will_do(name):
    _, value, call = ARRAYS[name]
    assert np.isfinite(call(value[:-1])).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e101, -1e300])
@pytest.mark.parametrize("name", sorted(QUERIES))
def test_what_is_asked_nowhere_is_unknown_in_its_row_alone(name, bad):
    _, value, call = ARRAYS[name]
    expected, value = call(value), value.copy()
    value[2, 1] = bad
    found = call(value)
    assert found.dtype == expected.dtype
    assert (np.isnan(found[2]) if found.dtype.kind == "f" else ~found[2]).all()
    np.testing.assert_array_equal(np.delete(found, 2, axis=0), call(np.delete(value, 2, axis=0)))
    assert call(value[:0]).shape == (0, *expected.shape[1:])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", [name for name in ARRAYS if name not in QUERIES])
def test_what_is_not_finite_is_refused_and_located(name, bad):
    argument, value, call = ARRAYS[name]
    value = value.copy()
    place = (2,) if value.ndim == 1 else (2, 1)
    value[place] = bad
    text = refused(lambda: call(value), argument, ValueError)
    assert "row 2" in text
    assert "nan" in text if np.isnan(bad) else "inf" in text
    if value.ndim == 2:
        assert "column 1" in text


def test_every_place_that_is_not_finite_is_found():
    for m, p in [(1, 1), (5, 3), (4096, 1), (1400, 3)]:
        for row, column in {(0, 0), (m - 1, p - 1), (m // 2, p // 2)}:
            a = np.ones((m, p))
            a[row, column] = np.nan
            assert f"row {row}, column {column}" in refused(
                lambda a=a, m=m: mx.LeastSquares(a, np.ones(m)), "A"
            )


# -------------------------------------------------------------------------------------------------- indices


@pytest.mark.parametrize("name", INDICES)
@pytest.mark.parametrize(
    "form",
    [
        list,
        tuple,
        lambda x: np.array(x, dtype=np.uint8),
        lambda x: np.array(x, dtype=">i4"),
        lambda x: np.array(x)[::-1],
        lambda x: np.repeat(x, 2)[::2],
        lambda x: frozen(np.array(x)),
    ],
)
def test_indices_of_any_form(name, form):
    _, call = INDICES[name]
    expected, found = call([3, 5, 4]), call(form([3, 5, 4]))
    assert sorted(found.tolist()) == sorted(expected.tolist())


@pytest.mark.parametrize("name", INDICES)
@pytest.mark.parametrize(
    "wrong",
    BAD_INDICES,
    ids=lambda x: " ".join(repr(x).split())[:40],
)
def test_bad_indices(name, wrong):
    argument, call = INDICES[name]
    if name == "select_warp counts" and wrong is None:
        return  # the default
    refused(lambda: call(wrong), argument)


@pytest.mark.parametrize("name", [name for name in INDICES if "counts" not in name])
@pytest.mark.parametrize("index", [N, N + 1, 2**40, 2**62])
def test_indices_that_are_too_large(name, index):
    argument, call = INDICES[name]
    refused(lambda: call([index]), argument, ValueError)


@pytest.mark.parametrize("index", [2**63 - 1, 2**63, 2**64 - 1])
def test_indices_without_a_bound_do_not_wrap(index):
    huge = np.array([index], dtype=np.uint64)
    refused(lambda: MODEL.cross_validate(s.from_sets([huge])))
    refused(lambda: MODEL.cross_validate(s.from_splits([([0], huge)])))


def test_indices_without_a_bound_do_not_take_all_memory():
    refused(lambda: MODEL.cross_validate(s.from_sets([[2**45]])), "scheme")
    refused(lambda: MODEL.cross_validate(s.from_splits([([0], [2**45])])))


@pytest.mark.parametrize("name", [name for name in INDICES if "counts" not in name])
def test_no_indices(name):
    assert INDICES[name][1]([]).shape in {(0,), (N,)}


# -------------------------------------------------------------------------------------------------- numbers


@pytest.mark.parametrize("name", NUMBERS)
def test_whole_numbers_of_any_form(name):
    _, value, call = NUMBERS[name]
    for form in (np.int8, np.uint64, np.int32, np.array):
        np.testing.assert_array_equal(call(form(value)), call(value))


@pytest.mark.parametrize("name", sorted(OPTIONAL))
def test_no_number_is_the_default(name):
    _, value, call = NUMBERS[name]
    np.testing.assert_array_equal(call(None), call(value))


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        (name, wrong)
        for name, (argument, *_) in NUMBERS.items()
        for wrong in BAD_COUNTS
        if not (wrong is None and name in OPTIONAL) and not (wrong == 0 and argument in FROM_ZERO)
    ],
    ids=repr,
)
def test_bad_whole_numbers(name, wrong):
    argument, _, call = NUMBERS[name]
    refused(lambda: call(wrong), argument)


@pytest.mark.parametrize(
    "name", [name for name, (argument, *_) in NUMBERS.items() if argument in {"k", "p", "size"}]
)
def test_more_than_there_are(name):
    argument, _, call = NUMBERS[name]
    for wrong in (10 if "nearest" not in name else N + 1, 2**62, 2**70):
        refused(lambda wrong=wrong: call(wrong), argument, ValueError)


@pytest.mark.parametrize("radius", [-1, -1e-300, np.nan, np.inf, "3", None, True, [1, 2], 3j, {}])
def test_bad_radii(radius):
    refused(lambda: s.exclusion_radius(POINTS, radius), "radius")


@pytest.mark.parametrize("seed", BAD_SEEDS)
def test_bad_seeds(seed):
    for call in (
        lambda: s.k_fold(9, 3, seed),
        lambda: s.leave_p_out(9, 3, 4, seed),
        lambda: s.random_sampling(9, 3, 4, seed),
        lambda: mx.select_warp(POINTS, TARGET, counts=[3], seed=seed, smoothing=0),
        lambda: select(seed=seed),
    ):
        refused(call, "seed", ValueError if seed == -1 else TypeError)


# ------------------------------------------------------------------------------------------------ one model


def test_one_datum():
    model = mx.LeastSquares([[2.0]], [3.0])
    assert model.coefficients.tolist() == [1.5]
    with pytest.warns(mx.RankLossWarning):
        assert np.isnan(model.cross_validate(s.leave_one_out(1)).score)
    model = mx.LeastSquares([[2.0]], [3.0], penalty=[[2.0]])
    assert model.held_out_residuals([0]).tolist() == [3.0]
    assert (
        len(s.nearest([[1.0, 2.0]], 1))
        == len(s.delaunay([[1.0, 2.0]]))
        == len(s.exclusion_radius([[1.0]], 1))
        == 1
    )


@pytest.mark.parametrize("shape", [(N, 1), (N, 4)])
def test_responses_keep_their_shape(shape):
    model = mx.LeastSquares(A, np.ones(shape))
    assert model.residuals.shape == shape
    assert model.coefficients.shape == (3, shape[1])
    assert model.cross_validate(LOO).residuals.shape == shape
    assert model.held_out_residuals([1, 2]).shape == (2, shape[1])


@pytest.mark.parametrize("penalty", [np.eye(4), np.eye(2), np.ones(3), np.ones((1, 1, 3))])
def test_bad_shapes_of_a_penalty(penalty):
    refused(lambda: mx.LeastSquares(A, B, penalty=penalty), "penalty", ValueError)


@pytest.mark.parametrize("bad", [0.0, -1.0, -1e-300])
def test_weights_are_positive(bad):
    weights = np.ones(N)
    weights[7] = bad
    text = refused(lambda: mx.LeastSquares(A, B, weights=weights), "weights", ValueError)
    assert "datum 7" in text


def test_weights_span_no_more_than_the_residuals_can_bear():
    weights = np.ones(N)
    weights[3] = 1e-11
    model = mx.LeastSquares(A, B, weights=weights)
    D = 1 / np.linalg.norm(np.sqrt(weights)[:, None] * A, axis=0)
    x = np.linalg.lstsq(np.sqrt(weights)[:, None] * A * D, np.sqrt(weights) * B, rcond=None)[0]
    np.testing.assert_allclose(model.residuals, B - A * D @ x, rtol=0, atol=1e-9)
    weights[3] = 1e-13
    assert "1e+12 times" in refused(lambda: mx.LeastSquares(A, B, weights=weights), "weights", ValueError)


def test_weights_are_one_for_each_datum():
    for weights in (np.ones(N), np.ones((N // 2, 1)), 1.0, np.ones(N // 2 + 1)):
        refused(lambda w=weights: mx.LeastSquares(A, B, 2, w), "weights", ValueError)


@pytest.mark.parametrize(
    "coupling",
    BAD_COUPLINGS,
    ids=lambda x: repr(x)[:30],
)
def test_bad_couplings(coupling):
    refused(lambda: mx.LeastSquares(A, B, coupling), "coupling")


@pytest.mark.parametrize("scale", [1e-300, 1e-150, 1e150, 1e300])
@pytest.mark.parametrize("what", ["A", "b", "weights", "penalty", "everything"])
def test_magnitudes(what, scale):
    weights = np.linspace(1, 2, N)
    penalty = np.eye(3)
    plain = mx.LeastSquares(A, B, weights=weights, penalty=0 * penalty)
    tune = {name: scale if what in {name, "everything"} else 1.0 for name in ("A", "b", "weights", "penalty")}
    if what == "penalty":
        # A penalty that outweighs the data by so much, or is outweighed, is a constraint, or nothing.
        model = mx.LeastSquares(A, B, penalty=scale * penalty)
        expected = mx.LeastSquares(A, B).residuals if scale < 1 else B
        np.testing.assert_allclose(model.residuals, expected, rtol=1e-9)
        return
    model = mx.LeastSquares(A * tune["A"], B * tune["b"], 1, weights * tune["weights"], 0 * penalty)
    for name in ("press", "fit_rms"):
        assert getattr(model, name) == pytest.approx(getattr(plain, name) * tune["b"], rel=1e-9)
    scheme = s.nearest(POINTS, 5)
    cv, expected = model.cross_validate(scheme), plain.cross_validate(scheme)
    assert cv.score == pytest.approx(expected.score * tune["b"], rel=1e-9)
    np.testing.assert_allclose(cv.residuals, expected.residuals * tune["b"], rtol=1e-8)


@pytest.mark.parametrize(
    "build",
    [
        lambda: mx.LeastSquares(A, np.where(B > 0, 1.7e308, -1.7e308)),
        lambda: mx.LeastSquares(A, B, weights=np.full(N, 1.7e308)),
        lambda: mx.LeastSquares(A, B * 1e200, weights=np.full(N, 1e300)),
        lambda: mx.LeastSquares(A * 1.7e307, B),
        lambda: mx.LeastSquares(A * 5e-324, B),
        lambda: mx.LeastSquares(A * 1e-300, B * 1e300),
    ],
    ids=[
        "b near overflow",
        "weights near overflow",
        "their product",
        "A near overflow",
        "A underflows",
        "x overflows",
    ],
)
def test_numbers_near_the_limits_are_right_or_refused(build):
    try:
        model = build()
    except (ValueError, TypeError) as error:
        in_form(error)
        return
    for value in (
        model.fit_rms,
        model.press,
        model.cross_validate(LOO).score,
        model.cross_validate(s.k_fold(N, 4, 0)).score,
    ):
        assert np.isfinite(value)


def test_points_that_coincide_or_lie_on_a_line():
    line = np.column_stack([np.arange(N), 2.0 * np.arange(N)])
    one_place = np.ones((N, 2))
    for points in (line, one_place):
        assert len(s.nearest(points, 4)) == len(s.exclusion_radius(points, 1)) == len(s.delaunay(points)) == N
        refused(lambda p=points: mx.select_warp(p, TARGET, smoothing=0), "source", ValueError)
        refused(lambda p=points: mx.fit_warp(POINTS, TARGET, p[:4]), "control_points", ValueError)
    refused(lambda: mx.fit_warp(POINTS, TARGET, POINTS[[0, 1, 2, 2]]), "control_points", ValueError)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_too_few_matches(n):
    refused(lambda: mx.select_warp(POINTS[:n], TARGET[:n], smoothing=0), "source", ValueError)


def test_matches_come_in_pairs():
    for call in (
        lambda: mx.select_warp(POINTS, TARGET[:-1], smoothing=0),
        lambda: mx.fit_warp(POINTS[:-1], TARGET, POINTS[:3]),
    ):
        refused(call, "target", ValueError)


def test_points_of_the_wrong_dimension():
    for wrong in (np.ones((N, 4)), np.ones((N, 0)), np.ones(N), np.ones((2, N, 2))):
        refused(lambda w=wrong: s.nearest(w, 2), "points", ValueError)
        refused(lambda w=wrong: s.exclusion_radius(w, 2), "points", ValueError)
    for wrong in (np.ones((N, 3)), np.ones((N, 1)), np.ones((2, N)), np.ones(N)):
        refused(lambda w=wrong: s.delaunay(w), "points", ValueError)
        refused(lambda w=wrong: mx.select_warp(w, TARGET, smoothing=0), "source", ValueError)


# -------------------------------------------------------------------------------------------------- schemes


@pytest.mark.parametrize("wrong", [None, "loo", 3, [[0], [1]], LOO.held_out, {}])
def test_what_is_no_scheme(wrong):
    refused(lambda: MODEL.cross_validate(wrong), "scheme", TypeError)


def test_schemes_over_other_data():
    for n in (N - 1, N + 1):
        text = refused(lambda n=n: MODEL.cross_validate(s.leave_one_out(n)), "scheme", ValueError)
        assert str(n) in text


@pytest.mark.parametrize("wrong", [None, "sets", 3, [[0]], [np.arange(2)]])
def test_what_are_no_sets_of_rows(wrong):
    if wrong is not None:
        refused(lambda: MODEL.hat_blocks(wrong), "sets", TypeError)


@pytest.mark.parametrize("wrong", ["sets", 3, None, 2.5, [3], ["ab"], [[0.5]], [{}], [None]])
def test_what_are_no_lists_of_sets(wrong):
    refused(lambda: s.from_sets(wrong), "held_out")
    if wrong is not None:
        refused(lambda: s.from_sets([[0, 3]], wrong), "validated")


@pytest.mark.parametrize(
    "wrong", ["ab", 3, None, [3], [([0],)], [([0], [1], [2])], ["ab"], [(None, [0])], [([0], 1.5)]]
)
def test_what_are_no_splits(wrong):
    refused(lambda: s.from_splits(wrong), "splits")


@pytest.mark.parametrize("wrong", [5, 2.5, np.array(5)])
def test_what_a_scheme_does_not_split(wrong):
    refused(lambda: LOO.split(wrong), "X", TypeError)


def made_by_hand():
    """Schemes that no builder makes, and what they would have to mean."""
    sets = s.IndexSets
    array = lambda *x: np.array(x, dtype=np.int64)  # noqa: E731
    own = s.compress([array(1, 2, 3)])
    yield "validated without being held out", own, s.compress([array(7)])
    yield "not sorted", sets(array(0, 3), array(3, 1, 2)), sets(array(0, 2), array(2, 3))
    yield "twice the same", sets(array(0, 2), array(1, 1)), sets(array(0, 1), array(1))
    yield "validated twice", own, sets(array(0, 2), array(1, 1))
    yield "offsets past the end", sets(array(0, 5), array(1, 2)), s.compress([array(1)])
    yield "offsets that decrease", sets(array(0, 2, 1, 2), array(1, 2)), s.compress([array(1)] * 3)
    yield "offsets that begin late", sets(array(1, 2), array(1, 2)), s.compress([array(2)])
    yield "no offsets", sets(array(), array(1, 2)), sets(array(), array(1))
    yield "an index too large", s.compress([array(N)]), s.compress([array(N)])
    yield "a negative index", s.compress([array(-1)]), s.compress([array(-1)])
    yield "different lengths", s.compress([array(1), array(2)]), s.compress([array(1)])
    yield "lists", [[1, 2]], [[1]]
    yield "lists inside", sets([0, 1], [1]), sets([0, 1], [1])
    yield (
        "floats inside",
        sets(np.array([0.0, 1.0]), np.array([1.0])),
        sets(np.array([0.0, 1.0]), np.array([1.0])),
    )
    yield "small integers", *[sets(np.array([0, 1], np.int8), np.array([1], np.int8))] * 2
    yield "strided", *[sets(np.array([0, 9, 1, 9])[::2], np.array([1, 9])[::2])] * 2


@pytest.mark.parametrize(
    ("held", "validated"), [pytest.param(h, v, id=name) for name, h, v in made_by_hand()]
)
def test_schemes_made_by_hand_are_right_or_refused(held, validated):
    try:
        cv = MODEL.cross_validate(s.Scheme(N, held, validated))
    except (ValueError, TypeError) as error:
        in_form(error)
        return
    held, validated = set(np.concatenate(list(held)).tolist()), np.concatenate(list(validated)).tolist()
    assert set(validated) <= held
    assert cv.rows.tolist() == validated
    kept = sorted(set(range(N)) - held)
    expected = B[cv.rows] - A[cv.rows] @ np.linalg.lstsq(A[kept], B[kept], rcond=None)[0]
    np.testing.assert_allclose(cv.residuals, expected, rtol=1e-9)


def test_sets_of_rows_made_by_hand():
    for rows in ([N], [-1]):
        refused(lambda rows=rows: MODEL.hat_blocks(s.compress([np.array(rows)])), "sets", ValueError)


# -------------------------------------------------------------------------------------------------- selection


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        *(("criterion", x) for x in ("", "ER", "mine", 10, b"ER10", ["ER10"], np.array(["ER10", "FIT"]))),
        *(("criteria", x) for x in ("FIT", b"FIT", 5, [5], [None], ["ERR"], ..., {"mine": [[1]]}, {1: LOO})),
        ("criteria", {"mine": s.leave_one_out(N + 1)}),
        *(("lifting", x) for x in ("", "spline", None, 3, ["tps"], np.array(["tps", "x"]))),
        *(("counts", x) for x in ([], [2], [3, 3], [0], [-3], [3.0], "345", 3, [[3]], [True], ..., {3: 4})),
        *(
            ("placement", x)
            for x in ("", "grid", "residual", "Nested", 3, ["nested"], np.array(["lloyd", "x"]))
        ),
        *(
            ("image_size", x)
            for x in (5, (1,), (1, 2, 3), (0, 5), (-1, 5), (np.nan, 5), (np.inf, 5), "ab", ("1", "2"), {})
        ),
        *(("seed", x) for x in (-1, 1.5, "a")),
        *(("threads", x) for x in (0, -1, 1.5, "2", True)),
        *((name, x) for name in ("fractional", "progress") for x in (0, 1.0, "no", None, [True])),
        *(("smoothing", x) for x in BAD_SMOOTHING),
    ],
    ids=lambda x: repr(x)[:30],
)
def test_bad_options_of_select_warp(name, wrong):
    options = {"counts": [3, 4], "criterion": "NN02PTS", "smoothing": 0, name: wrong}
    refused(lambda: mx.select_warp(POINTS, TARGET, **options), r"(criterion|criteria|scheme|" + name + ")")


def test_a_bad_criterion_beside_schemes_of_ones_own():
    for wrong in (["ER10"], {}, np.array(["a", "b"])):
        refused(
            lambda w=wrong: mx.select_warp(POINTS, TARGET, w, {"mine": LOO}, counts=[3], smoothing=0),
            "criterion",
            TypeError,
        )


def test_more_control_points_than_matches():
    refused(lambda: mx.select_warp(POINTS, TARGET, counts=[N + 1], smoothing=0))
    refused(lambda: mx.select_warp(POINTS, TARGET, counts=[2**62], smoothing=0))


@pytest.mark.parametrize("lifting", ["bspline", "affine"])
def test_liftings_on_grids_are_not_nested(lifting):
    options = {"lifting": lifting, "criterion": "CMPRESS"}
    for smoothing in (0.0, [1.0, 2.0], "auto"):
        for wrong in ("nested", "residual"):
            given = options | {"smoothing": smoothing, "placement": wrong}
            refused(lambda o=given: select(**o), "placement", ValueError)
        given = options | {"smoothing": smoothing, "placement": "nested"}
        refused(lambda o=given: mx.select_warp(POINTS, TARGET, **o), "placement", ValueError)


def test_no_more_nested_control_points_than_distinct_data():
    source, target = np.repeat(POINTS, 2, axis=0), np.repeat(TARGET, 2, axis=0)
    selection = mx.select_warp(
        source, target, "KF05", counts=[3, 5, N, 2 * N], placement="nested", smoothing=10
    )
    assert selection.counts.tolist() == [3, 5, N]
    surface = mx.select_surface(source, target, "KF05", max_count=2 * N, placement="nested", smoothing=10)
    assert surface.counts.tolist() == list(range(3, N + 1))


@pytest.mark.parametrize("wrong", BAD_SMOOTHING, ids=repr)
def test_bad_smoothing_of_fits(wrong):
    refused(lambda: mx.fit_warp(POINTS, TARGET, POINTS[:5], smoothing=wrong), "smoothing")
    refused(lambda: mx.fit_surface(POINTS, TARGET, POINTS[:5], smoothing=wrong), "smoothing")


@pytest.mark.parametrize("smoothing", [0.0, 1.0, [1.0, 2.0], "auto"])
@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        *(("criterion", x) for x in ("", "ER", "mine", 10, b"ER10", ["ER10"])),
        *(("seed", x) for x in BAD_SEEDS),
        *(("threads", x) for x in (0, -1, 1.5, "2", True)),
    ],
    ids=repr,
)
def test_bad_options_of_fits(name, wrong, smoothing):
    # What scores the weights is checked even if there is one.
    options = {"smoothing": smoothing, name: wrong}
    either = rf"(criterion|criteria|{name})"
    refused(lambda: mx.fit_warp(POINTS, TARGET, POINTS[:5], **options), either)
    refused(lambda: mx.fit_surface(POINTS, TARGET, POINTS[:5], **options), either)


def test_load_refuses_what_is_no_model(tmp_path):
    path = tmp_path / "model.npz"
    for content in (b"", b"text", b"PK\x03\x04"):
        path.write_bytes(content)
        refused(lambda: mx.load(path))
    np.savez(path, a=np.ones(3))
    refused(lambda: mx.load(path))
    with pytest.raises(FileNotFoundError):
        mx.load(tmp_path / "nothing")
