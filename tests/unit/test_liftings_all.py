"""What every lifting keeps, whatever its functions are."""

import pickle
import tracemalloc
from functools import cache

import numpy as np
import pytest
from designs import warp_design
from refits import Problem, worst_error
from test_liftings import scattered

import mexpress as mx
from mexpress.liftings import LIFTINGS, BSpline, Lifting, ThinPlateSpline, make_lifting, register

NAMES = ["tps", "bspline", "affine"]
WIDTH, HEIGHT = 640.0, 480.0
BOX = np.array([[0.0, 0.0], [WIDTH, 0.0], [WIDTH, HEIGHT], [0.0, HEIGHT]])
HOMOGRAPHY = np.array([[0.9, 0.2, 30.0], [-0.1, 1.1, -20.0], [1e-3, -5e-4, 1.0]])


def positions(count, seed=0, margin=0.0):
    low, high = np.array([-margin, -margin]), np.array([WIDTH + margin, HEIGHT + margin])
    return np.random.default_rng(seed).uniform(low, high, (count, 2))


@cache
def lifting(name, count=30):
    return make_lifting(name, LIFTINGS[name].place(BOX, count))


def project(homography, points):
    lifted = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return lifted[:, :2] / lifted[:, 2:]


# The functions


@pytest.mark.parametrize("name", NAMES)
def test_functions_sum_to_one_and_reproduce_affine_functions_everywhere(name):
    points = positions(2000, margin=900)
    basis, slopes = lifting(name).basis(points), lifting(name).derivatives(points)
    np.testing.assert_allclose(basis.sum(axis=1), 1, rtol=0, atol=1e-10)
    np.testing.assert_allclose(basis @ lifting(name).control_points, points, rtol=0, atol=1e-8)
    expected = np.broadcast_to(np.eye(2), (2000, 2, 2))
    found = np.einsum("nlb,la->nab", slopes, lifting(name).control_points)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", NAMES)
def test_derivatives_are_the_limits_of_differences_inside_and_outside(name):
    points, step = positions(500, seed=1, margin=300), 1e-3
    for b, shift in enumerate(step * np.eye(2)):
        ahead, behind = (lifting(name).basis(points + sign * shift) for sign in (1, -1))
        difference = (ahead - behind) / (2 * step)
        wrong = np.abs(lifting(name).derivatives(points)[:, :, b] - difference).max(axis=1) > 1e-8
        assert wrong.mean() < 0.005  # an edge of triangles within a step


@pytest.mark.parametrize("name", NAMES)
def test_functions_are_continuous_far_into_the_outside(name):
    x = np.random.default_rng(3).normal(size=(len(lifting(name).control_points), 1))
    for angle in np.linspace(0, np.pi, 7):
        way = np.linspace(-1500, 1500, 50_001)[:, None] * [np.cos(angle), np.sin(angle)]
        jumps = np.abs(np.diff(lifting(name).values(way + BOX.mean(axis=0), x)[:, 0]))
        assert jumps.max() < 0.1  # 0.06 px a step


@pytest.mark.parametrize("name", NAMES)
def test_values_and_slopes_are_the_basis_times_the_parameters_at_every_block(name):
    points = positions(9001, seed=2, margin=50)
    x = np.random.default_rng(0).normal(size=(len(lifting(name).control_points), 3))
    expected = lifting(name).basis(points) @ x
    np.testing.assert_allclose(lifting(name).values(points, x), expected, rtol=0, atol=1e-11)
    expected = np.einsum("nlb,lr->nrb", lifting(name).derivatives(points), x)
    np.testing.assert_allclose(lifting(name).slopes(points, x), expected, rtol=0, atol=1e-12)
    plain = Lifting.values(lifting(name), points, x), Lifting.slopes(lifting(name), points, x)
    np.testing.assert_allclose(lifting(name).values(points, x), plain[0], rtol=0, atol=1e-11)
    np.testing.assert_allclose(lifting(name).slopes(points, x), plain[1], rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_many_points_take_little_memory(name):
    points = positions(200_000)
    x = np.ones((len(lifting(name).control_points), 3))
    lifting(name).values(points[:10], x)
    tracemalloc.start()
    lifting(name).values(points, x)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20e6  # n x l would be 48 MB


@pytest.mark.parametrize("name", NAMES)
def test_no_points_give_no_rows(name):
    x = np.ones((len(lifting(name).control_points), 3))
    assert lifting(name).values(np.empty((0, 2)), x).shape == (0, 3)
    assert lifting(name).slopes(np.empty((0, 2)), x).shape == (0, 3, 2)


@pytest.mark.parametrize("name", NAMES)
def test_bending_is_zero_for_affine_functions_only(name):
    rows, centres = lifting(name).bending(), lifting(name).control_points
    x = np.random.default_rng(3).normal(size=len(centres))
    plane = 0.3 + centres @ [0.5, -2.0]
    usual = np.sum((rows @ (x * np.std(plane))) ** 2)
    assert np.sum((rows @ plane) ** 2) < 1e-12 * usual
    assert np.linalg.matrix_rank(rows) == len(centres) - 3


@pytest.mark.parametrize("name", NAMES)
def test_bending_does_not_depend_on_the_place_and_goes_with_the_unit(name):
    centres = lifting(name).control_points
    x = np.random.default_rng(3).normal(size=len(centres))
    moved = make_lifting(name, 10 * centres + 5e5)
    expected = np.sum((lifting(name).bending() @ x) ** 2)
    np.testing.assert_allclose(100 * np.sum((moved.bending() @ x) ** 2), expected, rtol=1e-6)


def test_one_weight_means_about_one_stiffness_for_every_lifting():
    energies = []
    for name in NAMES:
        flat = make_lifting(name, LIFTINGS[name].place(BOX, 300))
        points = positions(4000)
        values = np.sin(points[:, 0] / 90) * np.cos(points[:, 1] / 70)
        x = np.linalg.lstsq(flat.basis(points), values, rcond=None)[0]
        energies.append(np.sum((flat.bending() @ x) ** 2))
    np.testing.assert_allclose(energies, energies[1], rtol=0.5)  # TPS is over the plane, affine discrete


@pytest.mark.parametrize("name", NAMES)
def test_every_layout_of_the_same_numbers_gives_the_same(name):
    centres = make_lifting(name, LIFTINGS[name].place([[0, 0], [640, 0], [0, 480]], 30)).control_points
    points = positions(10, seed=1).round()
    expected = make_lifting(name, centres).basis(points)
    wide, read_only = np.zeros((10, 4)), points.copy()
    wide[:, ::2] = points
    read_only.flags.writeable = False
    for same in (
        points.tolist(),
        points.astype(np.float32),
        np.asfortranarray(points),
        read_only,
        wide[:, ::2],
    ):
        np.testing.assert_array_equal(make_lifting(name, np.asfortranarray(centres)).basis(same), expected)
    np.testing.assert_array_equal(make_lifting(name, centres.tolist()).basis(points.astype(int)), expected)
    single = make_lifting(name, centres.astype(np.float32)).basis(points)
    np.testing.assert_allclose(single, expected, rtol=0, atol=1e-4)


@pytest.mark.parametrize("name", NAMES)
def test_pickles_are_the_same_read_only_and_without_caches(name):
    made, points = make_lifting(name, lifting(name).control_points), positions(9)
    small = len(pickle.dumps(made))
    made.basis(points), made.bending(), made.span
    assert len(pickle.dumps(made)) == small
    copy = pickle.loads(pickle.dumps(made))
    np.testing.assert_array_equal(copy.basis(points), made.basis(points))
    assert type(copy) is type(made)
    assert not copy.control_points.flags.writeable


@pytest.mark.parametrize("name", NAMES)
def test_points_absurdly_far_away_raise_no_warning(name):
    assert lifting(name).basis([[1e100, -1e100], [-1e100, 3.0]]).shape[0] == 2
    assert lifting(name).derivatives([[1e100, -1e100]]).shape[0] == 1
    tiny = make_lifting(name, 1e-90 * lifting(name).control_points)
    assert tiny.values(np.array([[1e100, 0.0]]), np.ones((len(tiny.control_points), 1))).shape == (1, 1)


HOSTILE = {
    "none": [],
    "one": [[0, 0]],
    "two": [[0, 0], [1, 0]],
    "line": [[k, 2 * k] for k in range(16)],
    "one place": [[1, 1]] * 16,
    "twice": [[0, 0], [1, 0], [0, 1], [1, 1], [1, 0]],
    "four in one place": [[0, 0], [4, 0], [0, 4], *[[1, 1]] * 4],
    "nan": [[0, 0], [1, 0], [0, np.nan]],
    "infinity": [[0, 0], [1, 0], [0, np.inf]],
    "three columns": np.ones((16, 3)),
    "numbers": np.arange(16.0),
    "words": [["a", "b"]] * 16,
    "text": "points",
    "nothing": None,
    "ragged": [[0, 0], [1, 0], [0]],
    "complex": np.ones((16, 2), dtype=complex),
}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("wrong", HOSTILE)
def test_control_points_that_are_none_are_refused(name, wrong):
    for make in (LIFTINGS[name], lambda c: make_lifting(name, c)):
        with pytest.raises((ValueError, TypeError), match=r"Invalid control_points\. .* Given "):
            make(HOSTILE[wrong])


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("points", [[[0, np.nan]], [[np.inf, 0]], [0, 1], [], [["a", "b"]], None, "xy"])
def test_points_that_are_none_are_refused(name, points):
    for method in (lifting(name).basis, lifting(name).derivatives):
        with pytest.raises((ValueError, TypeError), match=r"Invalid points\. .* Given "):
            method(points)


# Placement


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", range(3))
def test_every_count_there_is_can_be_placed_and_covers_the_data(name, seed):
    random = np.random.default_rng(seed)
    points = random.normal(size=(200, 2)) * random.uniform(1, 5, 2) @ random.normal(size=(2, 2))
    counts = LIFTINGS[name].counts(mx.placement.covered_region(points), 60)
    assert counts == sorted(set(counts))
    assert counts[-1] <= 60
    for count in counts:
        made = make_lifting(name, LIFTINGS[name].place(points, count))
        assert len(made.control_points) == count
        if name != "tps":
            x, y = made.span.T
            area = x * np.roll(y, -1) - np.roll(x, -1) * y
            assert area.sum() > 0
            assert (made.span.min(axis=0) <= points.min(axis=0) + 1e-12).all()
            assert (made.span.max(axis=0) >= points.max(axis=0) - 1e-12).all()


@pytest.mark.parametrize("name", NAMES)
def test_there_is_at_least_one_count(name):
    assert len(LIFTINGS[name].counts(BOX, 1)) == 1
    assert LIFTINGS[name].counts(BOX, 0) == LIFTINGS[name].counts(BOX, 1)


@pytest.mark.parametrize("name", ["bspline", "affine"])
@pytest.mark.parametrize("aspect", [1.0, 0.1, 7.3])
def test_cells_are_about_square(name, aspect):
    for count in LIFTINGS[name].counts(BOX * [1, aspect], 120)[10:]:
        centres = LIFTINGS[name].place(BOX * [1, aspect], count)
        steps = [np.diff(np.unique(c.round(6))).mean() for c in centres.T]
        assert 1 / 2.01 <= steps[0] / steps[1] <= 2.01


@pytest.mark.parametrize("name", ["bspline", "affine"])
def test_a_wish_between_two_counts_gets_the_nearer_one(name):
    counts = np.array(LIFTINGS[name].counts(BOX, 200))
    for wish in range(3, 150):
        placed = len(LIFTINGS[name].place(BOX, wish))
        assert abs(placed - wish) == np.abs(counts - wish).min()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("points", "count", "argument"),
    [
        ([[0, 0], [1, 1], [2, 2]], 9, "points"),
        (BOX[:2], 9, "points"),
        ("abc", 9, "points"),
        (BOX, 2, "count"),
        (BOX, 9.5, "count"),
        (BOX, "9", "count"),
    ],
)
def test_places_that_are_none_are_refused(name, points, count, argument):
    with pytest.raises((ValueError, TypeError), match=rf"Invalid {argument}\. .* Given "):
        LIFTINGS[name].place(points, count)


# Warps and surfaces


@pytest.mark.filterwarnings("ignore::mexpress.RankLossWarning")  # of which worst_error knows
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("fractional", [True, False])
@pytest.mark.parametrize("penalised", [True, False])
@pytest.mark.parametrize(
    "rule", [pytest.param("loo", marks=pytest.mark.slow), "kfold", "er10", "nn5", "delaunay"]
)
def test_warps_cross_validate_like_refits(name, fractional, penalised, rule):
    source, random = positions(150), np.random.default_rng(1)
    target = project(HOMOGRAPHY, source) + 5 * np.sin(source[:, ::-1] / 80) + random.normal(size=(150, 2))
    design = warp_design(lifting(name, 16), source, target, fractional)
    scheme = {
        "loo": lambda: mx.schemes.leave_one_out(150),
        "kfold": lambda: mx.schemes.k_fold(150, 7, seed=0),
        "er10": lambda: mx.schemes.exclusion_radius(source, 80.0),
        "nn5": lambda: mx.schemes.nearest(source, 5),
        "delaunay": lambda: mx.schemes.delaunay(source),
    }[rule]()
    rows = 30 * design.bending() if penalised else None
    problem = Problem(design.A, design.b, np.repeat(np.arange(150), design.coupling), penalty=rows)
    cv = problem.model().cross_validate(scheme)
    assert worst_error(problem, scheme, cv) < 1e-9


@pytest.mark.filterwarnings("ignore::mexpress.RankLossWarning")
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("shape", [(), (3,)])
@pytest.mark.parametrize("penalised", [True, False])
def test_surfaces_cross_validate_like_refits(name, shape, penalised):
    points, random = positions(120), np.random.default_rng(1)
    values = np.sin(points @ np.full((2, *shape), 0.01)) + 0.1 * random.normal(size=(120, *shape))
    rows = 10 * lifting(name, 20).bending() if penalised else None
    problem = Problem(lifting(name, 20).basis(points), values, np.arange(120), penalty=rows)
    for scheme in (mx.schemes.leave_one_out(120), mx.schemes.exclusion_radius(points, 70.0)):
        assert worst_error(problem, scheme, problem.model().cross_validate(scheme)) < 1e-9


@pytest.mark.parametrize("name", NAMES)
def test_a_penalised_fit_is_that_of_the_stacked_rows(name):
    points, weight = positions(120), 50.0
    values = np.sin(points[:, 0] / 60) + 0.1 * np.random.default_rng(1).normal(size=120)
    basis, rows = lifting(name).basis(points), np.sqrt(weight) * lifting(name).bending()
    x = mx.LeastSquares(basis, values, penalty=rows).coefficients
    stacked = np.linalg.lstsq(
        np.vstack([basis, rows]), np.concatenate([values, np.zeros(len(rows))]), rcond=None
    )[0]
    np.testing.assert_allclose(x, stacked, rtol=0, atol=1e-8)


@pytest.mark.parametrize("name", NAMES)
def test_endless_smoothing_leaves_the_affine_fit(name):
    points = positions(120)
    values = np.sin(points[:, 0] / 60)
    rows = 1e6 * lifting(name).bending()
    fit = values - mx.LeastSquares(lifting(name).basis(points), values, penalty=rows).residuals
    plane = np.column_stack([np.ones(120), points])
    expected = plane @ np.linalg.lstsq(plane, values, rcond=None)[0]
    np.testing.assert_allclose(fit, expected, rtol=0, atol=1e-5)


def check_homography(warp):
    queries, step = positions(50, seed=3, margin=-20), 1e-4
    np.testing.assert_allclose(warp(queries), project(HOMOGRAPHY, queries), rtol=0, atol=1e-8)
    for b, shift in enumerate(step * np.eye(2)):
        ahead, behind = (project(HOMOGRAPHY, queries + sign * shift) for sign in (1, -1))
        np.testing.assert_allclose(warp.jacobian(queries)[..., b], (ahead - behind) / (2 * step), atol=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_penalised_fractional_warps_reproduce_a_homography(name):
    source = positions(400)
    design = warp_design(lifting(name), source, project(HOMOGRAPHY, source))
    model = mx.LeastSquares(design.A, design.b, design.coupling, penalty=0.1 * design.bending())
    check_homography(design.model(model.coefficients))


@pytest.mark.parametrize("name", ["tps", "affine"])
def test_fractional_warps_reproduce_a_homography(name):
    source, centres = positions(400), lifting(name, 20).control_points
    check_homography(mx.fit_warp(source, project(HOMOGRAPHY, source), centres, lifting=name))


def test_one_homography_is_many_b_splines_and_an_error_that_says_so():
    # Numerators and denominator times any function that is quadratic along x and along y: nine of them.
    source, centres = positions(400), lifting("bspline", 20).control_points
    with pytest.raises(ValueError, match=r"must determine the warp.* 59 unknowns, .* rank 51 in all"):
        mx.fit_warp(source, project(HOMOGRAPHY, source), centres, lifting="bspline")


@pytest.mark.parametrize("name", NAMES)
def test_fractional_warps_reproduce_a_known_rational_map(name):
    random, made = np.random.default_rng(5), lifting(name, 30)
    weights = random.uniform(0.6, 1.6, len(made.control_points))
    targets = made.control_points + random.normal(0, 15, made.control_points.shape)
    source, queries = positions(900), positions(200, seed=3)

    def known(points):
        basis = made.basis(points) * weights
        return basis @ targets / basis.sum(axis=1, keepdims=True)

    warp = mx.fit_warp(source, known(source), made.control_points, lifting=name)
    np.testing.assert_allclose(warp(queries), known(queries), rtol=0, atol=1e-8)
    np.testing.assert_allclose(warp.denominator(queries), made.values(queries, warp.parameters[:, 2:])[:, 0])
    np.testing.assert_allclose(warp.parameters[:, 2] / warp.parameters[0, 2], weights / weights[0], atol=1e-9)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("smoothing", [0.0, 3.2])
def test_models_survive_files_and_pickles_with_their_smoothing(name, smoothing, tmp_path):
    made, points = lifting(name, 16), positions(30)
    x = np.random.default_rng(0).normal(size=(len(made.control_points), 3)) + 5
    for model in (mx.Warp(made, x, BOX, smoothing), mx.Surface(made, x, BOX, smoothing)):
        model.save(tmp_path / "model")
        for copy in (mx.load(tmp_path / "model"), pickle.loads(pickle.dumps(model))):
            assert repr(copy) == repr(model)
            assert copy.smoothing == smoothing
            np.testing.assert_array_equal(copy(points), model(points))
    depth = mx.Surface(made, x[:, 0], BOX)
    depth.save(tmp_path / "depth")
    np.testing.assert_array_equal(mx.load(tmp_path / "depth")(points), depth(points))


def test_models_say_what_they_are():
    x = np.ones((16, 3))
    warp, surface = mx.Warp(lifting("bspline", 16), x, BOX), mx.Surface(lifting("bspline", 16), x, BOX)
    assert repr(warp) == "Warp(fractional bspline, 16 control points)"
    assert repr(surface) == "Surface(3 values, bspline, 16 control points)"
    smooth = (
        mx.Warp(lifting("bspline", 16), x, BOX, 3.2),
        mx.Surface(lifting("bspline", 16), x[:, 0], BOX, 1e-9),
    )
    assert repr(smooth[0]) == "Warp(fractional bspline, 16 control points, smoothing 3.2)"
    assert repr(smooth[1]) == "Surface(depth, bspline, 16 control points, smoothing 1e-09)"


@pytest.mark.parametrize("kind", [mx.Warp, mx.Surface])
def test_a_model_refuses_what_is_no_lifting_and_no_weight(kind):
    made = lifting("affine", 9)
    x = np.ones((len(made.control_points), 2))
    for wrong in ("tps", None, ThinPlateSpline, made.control_points):
        with pytest.raises(TypeError, match=r"Invalid lifting\. It must be a Lifting.* Given "):
            kind(wrong, x, BOX)
    for wrong in (-1.0, np.nan, np.inf, "1", None, [1.0], True):
        with pytest.raises((TypeError, ValueError), match=r"Invalid smoothing\. .* Given "):
            kind(made, x, BOX, wrong)


# Another lifting


class Cone(Lifting):
    """Thin-plate splines by another name; at the top of the module, as pickles need."""

    name = "cone"

    def basis(self, points):  # noqa: D102
        return ThinPlateSpline(self.control_points).basis(points)

    def derivatives(self, points):  # noqa: D102
        return ThinPlateSpline(self.control_points).derivatives(points)

    def bending(self):  # noqa: D102
        return ThinPlateSpline(self.control_points).bending()


@pytest.fixture
def cone():
    register(Cone)
    yield
    LIFTINGS.pop("cone", None)


@pytest.mark.usefixtures("cone")
def test_a_lifting_of_ones_own_is_known_by_its_name_everywhere(tmp_path):
    source = positions(40)
    target = project(HOMOGRAPHY, source) + np.random.default_rng(0).normal(size=(40, 2))
    centres = scattered(6, size=480)
    own = mx.fit_warp(source, target, centres, lifting="cone")
    design = warp_design(ThinPlateSpline(centres), source, target, over_data=True)
    tps = design.model(mx.LeastSquares(design.A, design.b, 2).coefficients)
    np.testing.assert_allclose(own.jacobian(source), tps.jacobian(source), rtol=0, atol=1e-12)
    np.testing.assert_allclose(own.inverse(target), tps.inverse(target), rtol=0, atol=1e-9)
    chosen = mx.select_warp(
        source, target, lifting="cone", counts=[3, 5, 8], criterion="CMPRESS", smoothing=0
    )
    assert repr(chosen.warp).startswith("Warp(fractional cone, ")
    own.save(tmp_path / "own")
    np.testing.assert_array_equal(mx.load(tmp_path / "own")(source), own(source))
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(own))(source), own(source))
    assert register(Cone) is Cone  # twice is once
    LIFTINGS.pop("cone")
    message = r"a warp that cannot be rebuilt: Invalid lifting\. .*\.register` has entered\. Given 'cone'"
    with pytest.raises(ValueError, match=message):
        mx.load(tmp_path / "own")


def test_names_that_are_taken_and_classes_that_are_no_liftings_are_refused():
    for wrong in (3, "tps", int, lifting("tps")):
        with pytest.raises(TypeError, match=r"Invalid lifting\. It must be a subclass of Lifting"):
            register(wrong)
    for name in ("", None, 3):
        with pytest.raises(
            TypeError, match=r"Invalid lifting\. It must be a subclass of Lifting with a name"
        ):
            register(type("Nameless", (Cone,), {"name": name}))
    with pytest.raises(TypeError, match=r"Invalid lifting\. .* with the name None"):
        register(type("Nameless", (Lifting,), {}))
    with pytest.raises(ValueError, match=r"Invalid name\. .* Given 'tps', the name of ThinPlateSpline\."):
        register(type("Usurper", (Cone,), {"name": "tps"}))
    assert LIFTINGS["tps"] is ThinPlateSpline


def test_what_a_lifting_lacks_is_an_error_when_it_is_made():
    with pytest.raises(TypeError, match="abstract"):
        type("Half", (Lifting,), {"name": "half", "basis": Cone.basis})(scattered(4))


class Spread(BSpline):
    """B-splines with their functions in another order and a grid of their own, both by methods that others bypass."""

    name = "spread"

    def basis(self, points):  # noqa: D102
        return super().basis(points)[:, ::-1]

    def values(self, points, parameters):  # noqa: D102
        return super().values(points, parameters[::-1])

    def bending(self):  # noqa: D102
        return super().bending()[:, ::-1]

    @classmethod
    def place(cls, points, count, seed=0, threads=None):  # noqa: D102
        # What users may do to an array of corners.
        low, high = points.min(axis=0), np.vstack([points, points[:1]]).max(axis=0)
        return BSpline.place([low, high, [low[0], high[1]]], count, seed, threads)


@pytest.mark.parametrize("smoothing", [0.0, "auto"])
def test_a_basis_and_a_place_of_ones_own_are_those_that_are_used(smoothing):
    register(Spread)
    try:
        source = positions(80)
        target = source + 5 * np.sin(source / 60)
        own, ours = (
            mx.select_warp(source, target, lifting=name, counts=[16, 20], smoothing=smoothing)
            for name in ("spread", "bspline")
        )
        np.testing.assert_allclose(own.curves["FIT"], ours.curves["FIT"], rtol=1e-6)
        np.testing.assert_allclose(own.warp(source), ours.warp(source), rtol=0, atol=1e-6)
        assert len(own.suspects().scores) == 80
    finally:
        LIFTINGS.pop("spread", None)
