"""Surfaces, nested models and clouds, with input that is strange but right, and with input that is wrong."""

import numpy as np
import pytest
from inputs import (
    BAD_COUNTS,
    BAD_COUPLINGS,
    BAD_INDICES,
    BAD_LEVELS,
    BAD_SEEDS,
    BAD_SMOOTHING,
    HALF,
    LOO,
    POINTS,
    SURFACE,
    TARGET,
    WARP,
    A,
    B,
    N,
    nested,
    refused,
    select,
)

import mexpress as mx
from mexpress.liftings import make_lifting

s = mx.schemes
EVERY = ["FIT", "PRESS", "CMPRESS", "KF05", "ER10", "NN10PCT", "DELAUNAY", "AIC", "BIC", "GCV"]
LINE = np.column_stack([np.arange(N), 2.0 * np.arange(N)])


def brief(value):
    return " ".join(repr(value).split())[:40]


# Nested models


@pytest.mark.parametrize(
    "wrong", [*BAD_INDICES, [], [0, 1], [4], [1, 2**62], [2, 1], range(0), range(3, 0, -1), np.nan], ids=brief
)
def test_bad_sizes(wrong):
    refused(lambda: nested(sizes=wrong), "sizes")


@pytest.mark.parametrize(
    "wrong", [None, "loo", 3, LOO, [LOO], {"loo": [[0], [1]]}, {"loo": LOO, 1: LOO}, {"loo": None}], ids=brief
)
def test_what_are_no_schemes_by_name(wrong):
    refused(lambda: mx.cross_validate_nested(A, B, [1], wrong), "schemes", TypeError)


def test_schemes_over_other_data():
    for n in (N - 1, N + 1, N // 2):
        refused(lambda n=n: nested(schemes={"loo": s.leave_one_out(n)}), "schemes", ValueError)
    refused(lambda: nested(coupling=2), "schemes", ValueError)
    assert np.isfinite(nested(schemes=HALF, coupling=2)).all()


@pytest.mark.parametrize("coupling", BAD_COUPLINGS, ids=brief)
def test_bad_couplings_of_nested_models(coupling):
    refused(lambda: nested(coupling=coupling), "coupling")


@pytest.mark.parametrize("penalty", [np.eye(4), np.eye(2), np.ones(3), np.ones((1, 1, 3))], ids=brief)
def test_bad_shapes_of_a_penalty(penalty):
    refused(lambda: nested(penalty=penalty), "penalty", ValueError)


@pytest.mark.parametrize("bad", [0.0, -1.0, -1e-300, 1e-13])
def test_weights_are_positive_and_comparable(bad):
    weights = np.ones(N)
    weights[7] = bad
    refused(lambda: nested(weights=weights), "weights", ValueError)


# Selecting a surface


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        *(
            ("criterion", x)
            for x in (
                "",
                "ER",
                "mine",
                10,
                b"ER10",
                ["ER10"],
                np.array(["ER10", "FIT"]),
                "NN21PTS",
                "KF1",
            )
        ),
        *(("criteria", x) for x in ("FIT", b"FIT", 5, [5], [None], ["ERR"], ..., {"mine": [[1]]}, {1: LOO})),
        *(("criteria", {"mine": s.leave_one_out(n)}) for n in (N // 2, N - 1, N + 1, 2 * N)),
        ("criteria", {"ER10": LOO}),
        *(("max_count", x) for x in (1, 2, *(x for x in BAD_COUNTS if x is not None))),
        *(("min_distance", x) for x in (-1, -1e-300, np.nan, np.inf, "3", True, [1, 2], 3j, {})),
        *(("smoothing", x) for x in BAD_SMOOTHING),
        *(("placement", x) for x in ("", "grid", "Nested", 3, ["nested"], np.array(["lloyd", "x"]))),
        *(("lifting", x) for x in ("", "spline", None, 3, ["tps"], np.array(["tps", "x"]))),
        *(("seed", x) for x in BAD_SEEDS),
        *(("threads", x) for x in (0, -1, 1.5, "2", True)),
        *(("progress", x) for x in (0, 1.0, "no", None, [True])),
    ],
    ids=brief,
)
def test_bad_options_of_select_surface(name, wrong):
    refused(lambda: select(**{name: wrong}), r"(criterion|criteria|scheme|" + name + ")")


@pytest.mark.parametrize("options", [{}, {"placement": "lloyd", "smoothing": 0}, {"lifting": "bspline"}])
def test_a_distance_that_no_placement_keeps_is_refused(options):
    refused(
        lambda: mx.select_surface(POINTS, TARGET, min_distance=3.0, **options), "min_distance", ValueError
    )


def test_a_bad_criterion_beside_schemes_of_ones_own():
    for wrong in (["ER10"], {}, np.array(["a", "b"])):
        refused(lambda w=wrong: select(criterion=w, criteria={"mine": LOO}), "criterion", TypeError)


def test_data_that_coincide_or_lie_on_a_line():
    for points in (LINE, np.ones((N, 2)), np.repeat(POINTS[:2], N // 2, axis=0), 1e90 * LINE, LINE + 1e9):
        refused(lambda p=points: select(p), "points", ValueError)
        refused(lambda p=points: mx.fit_surface(p, TARGET, POINTS[:3]), "points", ValueError)
        refused(lambda p=points: mx.fit_surface(POINTS, TARGET, p[:4]), "control_points", ValueError)
        refused(lambda p=points: mx.Surface(make_lifting("tps", POINTS[:4]), B[:4], p), "domain", ValueError)


@pytest.mark.parametrize("n", [1, 2])
def test_too_few_data(n):
    refused(lambda: select(POINTS[:n], TARGET[:n]), "points", ValueError)
    refused(lambda: mx.fit_surface(POINTS[:n], TARGET[:n], POINTS[:3]), "points", ValueError)


def test_values_are_one_for_each_point():
    for values in (TARGET[:-1], TARGET.T, TARGET[:, :0], np.ones((N, 2, 2)), 3.0):
        refused(lambda v=values: select(values=v), "values", ValueError)
        refused(lambda v=values: mx.fit_surface(POINTS, v, POINTS[:3]), "values", ValueError)
        refused(lambda v=values: mx.Cloud(POINTS, v, None, N), "values", ValueError)


def test_points_are_in_the_plane():
    for wrong in (np.ones((N, 3)), np.ones((N, 1)), np.ones((2, N)), np.ones(N)):
        refused(lambda w=wrong: select(w), "points", ValueError)
        refused(lambda w=wrong: mx.fit_surface(w, TARGET, POINTS[:3]), "points", ValueError)
        refused(lambda w=wrong: mx.Cloud(w, TARGET, None, N), "points", ValueError)


def rough(n=60):
    rng = np.random.default_rng(5)
    points = rng.uniform(0, 100, (n, 2))
    return points, np.sin(points[:, 0] / 15) + 0.1 * rng.normal(size=n)


def curves_of(points, values, **options):
    return mx.select_surface(points, values, "CMPRESS", EVERY, max_count=9, **{"smoothing": 0} | options)


@pytest.mark.parametrize("exponent", [-900, -500, -100, 100, 500, 900])
def test_the_unit_of_values_does_not_matter(exponent):
    points, values = rough()
    plain, scaled = curves_of(points, values), curves_of(points, np.ldexp(values, exponent))
    np.testing.assert_array_equal(scaled.control_points, plain.control_points)
    for name, curve in plain.curves.items():
        found = scaled.curves[name]
        if name in {"AIC", "BIC"}:
            np.testing.assert_allclose(found - 2 * 60 * exponent * np.log(2), curve, rtol=0, atol=1e-6)
        else:
            np.testing.assert_allclose(np.ldexp(found, -exponent), curve, rtol=1e-9)
    assert scaled.selected == plain.selected


@pytest.mark.parametrize(("exponent", "offset"), [(-300, 0), (-20, 1e3), (0, 1e6), (30, -1e12), (300, 0)])
def test_the_unit_and_the_place_of_points_do_not_matter(exponent, offset):
    points, values = rough()
    points = np.round(points, 1)
    plain = curves_of(points, values)
    moved = curves_of(np.ldexp(points, exponent) + offset, values, min_distance=np.ldexp(3.0, exponent))
    same = curves_of(points, values, min_distance=3.0)
    np.testing.assert_allclose(moved.control_points, np.ldexp(same.control_points, exponent) + offset)
    for name, curve in same.curves.items():
        np.testing.assert_allclose(moved.curves[name], curve, rtol=1e-6, err_msg=name)
    assert plain.count == moved.count


@pytest.mark.parametrize("level", [1e302, 1e304, 1.7e308, 1e-310, 5e-324])
def test_values_near_the_limits_are_right_or_refused(level):
    points, values = rough()
    values = np.where(values > 0, level, -level)
    if level > 1e302:
        refused(lambda: curves_of(points, values), "values", ValueError)
        refused(lambda: mx.fit_surface(points, values, points[:5]), "values", ValueError)
        return
    assert np.isfinite(mx.fit_surface(points, values, points[:5]).parameters).all()
    for name, curve in curves_of(points, values).curves.items():
        assert np.isfinite(curve).all() or level < 1e-320, name


@pytest.mark.parametrize("smoothing", [5e-324, 1e-300, 1e-30, 1e30, 1e300, 1.7e308])
def test_any_weight_of_smoothing(smoothing):
    points, values = rough()
    selection = curves_of(points, values, smoothing=smoothing)
    expected = curves_of(points, values)
    if smoothing < 1:
        np.testing.assert_allclose(selection.curves["CMPRESS"], expected.curves["CMPRESS"], rtol=1e-9)
    else:
        flat = np.full(len(selection.counts), expected.curves["CMPRESS"][0])
        np.testing.assert_allclose(selection.curves["CMPRESS"], flat, rtol=1e-6)


# Clouds


@pytest.fixture
def depth_map(tmp_path):
    np.save(tmp_path / "depth.npy", np.arange(1.0, 101).reshape(10, 10))
    return tmp_path / "depth.npy"


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        *(("max_data", x) for x in (1, 2, 3, *(x for x in BAD_COUNTS if x is not None))),
        *(("seed", x) for x in BAD_SEEDS),
        *(("scale", x) for x in (0, -1, -1e-300, np.nan, np.inf, "3", True, [1, 2], 3j, {})),
        *(
            ("intrinsics", x)
            for x in (
                5,
                (1,),
                (1, 2, 3),
                (0, 1, 1, 1),
                (1, np.nan, 0, 0),
                (1, 1, np.inf, 0),
                "abcd",
                {},
                [None] * 4,
            )
        ),
    ],
    ids=brief,
)
def test_bad_options_of_read_cloud(depth_map, name, wrong):
    refused(lambda: mx.read_cloud(depth_map, **{name: wrong}), name)


@pytest.mark.parametrize("form", [int, np.int8, np.uint64, np.array])
def test_whole_numbers_of_any_form(depth_map, form):
    assert len(mx.read_cloud(str(depth_map), max_data=form(9)).points) == 9


@pytest.mark.parametrize("wrong", [None, 3, 2.5, ["depth.npy"], b"depth.npy", np.eye(3)])
def test_what_is_no_path(wrong):
    with pytest.raises(TypeError):
        mx.read_cloud(wrong)


@pytest.mark.parametrize(
    "wrong", [5, (1,), (1, 2, 3), (0, 5), (-1, 5), (np.nan, 5), (np.inf, 5), "ab", ("1", "2"), {}], ids=brief
)
def test_bad_sizes_of_an_image(wrong):
    refused(lambda: mx.Cloud(POINTS, TARGET, wrong, N), "image_size")


def test_a_cloud_has_no_fewer_valid_data_than_it_holds():
    refused(lambda: mx.Cloud(POINTS, TARGET, None, N - 1), "n_valid", ValueError)


@pytest.mark.parametrize("model", [SURFACE, WARP], ids=["surface", "warp"])
@pytest.mark.parametrize("wrong", BAD_LEVELS, ids=repr)
def test_bad_levels_of_an_interval(model, wrong):
    refused(lambda: model.interval(POINTS, wrong), "level")


@pytest.mark.parametrize("model", [SURFACE, WARP], ids=["surface", "warp"])
@pytest.mark.parametrize("wrong", [(POINTS, TARGET), {"points": POINTS}, POINTS, "data", 3], ids=type)
def test_what_is_no_data_of_a_model(model, wrong):
    refused(lambda: type(model)(model.lifting, model.parameters, model.domain, 0.0, wrong), "data", TypeError)


@pytest.mark.parametrize("exponent", [-140, -30, 30, 140])
def test_errors_and_intervals_follow_the_unit_of_values(exponent):
    values, unit = TARGET[:, 0], 2.0**exponent
    plain, scaled = (mx.fit_surface(POINTS, factor * values, POINTS[:5]) for factor in (1, unit))
    np.testing.assert_allclose(scaled.error(POINTS), unit * plain.error(POINTS), rtol=1e-9)
    np.testing.assert_allclose(scaled.interval(POINTS).upper, unit * plain.interval(POINTS).upper, rtol=1e-6)
