"""Input that is strange but right, input that is wrong, and the functions that get it."""

import re
from fractions import Fraction

import numpy as np
import pytest

import mexpress as mx
from mexpress.liftings import make_lifting
from mexpress.placement import farthest_first

s = mx.schemes
N = 20
RNG = np.random.default_rng(0)
A = RNG.normal(size=(N, 3))
B = RNG.normal(size=N)
POINTS = RNG.uniform(0, 100, (N, 2))
TARGET = 2 * POINTS + RNG.normal(size=(N, 2))
MODEL = mx.LeastSquares(A, B)
LOO = s.leave_one_out(N)
HALF = {"loo": s.leave_one_out(N // 2)}
WEIGHTS = np.array([0.0, 7.0, 90.0])
SURFACE = mx.fit_surface(POINTS, TARGET[:, 0], POINTS[:5])
WARP = mx.fit_warp(POINTS, TARGET, POINTS[:4])


def held(scheme):
    """Return the data that a scheme holds out, set after set."""
    return scheme.held_out.indices


def nested(A=A, b=B, sizes=(1, 3), schemes=None, coupling=1, **options):
    """Cross-validate nested models, by leave-one-out unless told otherwise."""
    given = {"loo": LOO} if schemes is None else schemes
    return mx.cross_validate_nested(A, b, sizes, given, coupling, **options)["loo"]


def batch(A=(A, A), b=(B, B), scheme=LOO, coupling=1, **options):
    """Scores of two problems in one call."""
    return mx.cross_validate_batch(list(A), list(b), scheme, coupling, **options).scores


def select(points=POINTS, values=TARGET, **options):
    """Select a surface of up to six control points."""
    usual = {"criterion": "NN02PTS", "max_count": 6, "smoothing": 0}
    return mx.select_surface(points, values, **(usual | options))


def estimated(source, target):
    """Estimate a warp; a number if the matches do not determine one."""
    warp = mx.Warp.from_estimate(source, target)
    return np.array(0.0) if warp is None else warp.parameters


FORM = re.compile(r"^Invalid [\w\[\]]+\. .+ Given .*\.$", re.DOTALL)


def in_form(error):
    assert type(error) in (ValueError, TypeError)
    assert FORM.match(str(error)), error


def refused(call, name=None, errors=(ValueError, TypeError)):
    """Call, expect an error of the shared form about `name`, and return its text."""
    with pytest.raises(errors) as caught:
        call()
    in_form(caught.value)
    text = str(caught.value)
    if name is not None:
        assert re.match(rf"Invalid {name}(\[\d+\])?\.", text), text
    return text


# Every function with an array argument: its name, and a call that returns plain numbers.
ARRAYS = {
    "LeastSquares A": ("A", A, lambda x: mx.LeastSquares(x, B).residuals),
    "LeastSquares b": ("b", B, lambda x: mx.LeastSquares(A, x).residuals),
    "LeastSquares weights": (
        "weights",
        np.arange(1.0, N + 1),
        lambda x: mx.LeastSquares(A, B, weights=x).residuals,
    ),
    "LeastSquares penalty": ("penalty", np.eye(3), lambda x: mx.LeastSquares(A, B, penalty=x).residuals),
    "exclusion_radius": ("points", POINTS, lambda x: s.exclusion_radius(x, 20).held_out.indices),
    "nearest": ("points", POINTS, lambda x: s.nearest(x, 3).held_out.indices),
    "delaunay": ("points", POINTS, lambda x: s.delaunay(x).held_out.indices),
    "matched points": ("points", POINTS, lambda x: s.matched(x, TARGET).held_out.indices),
    "matched queries": ("queries", TARGET, lambda x: s.matched(POINTS, x).held_out.indices),
    "select_warp source": (
        "source",
        POINTS,
        lambda x: mx.select_warp(x, TARGET, counts=[3, 4], smoothing=0).curves["ER10"],
    ),
    "select_warp target": (
        "target",
        TARGET,
        lambda x: mx.select_warp(POINTS, x, counts=[3, 4], smoothing=0).curves["ER10"],
    ),
    "select_warp smoothing": (
        "smoothing",
        WEIGHTS,
        lambda x: mx.select_warp(POINTS, TARGET, "CMPRESS", counts=[3, 5], smoothing=x).maps["CMPRESS"],
    ),
    "fit_warp smoothing": (
        "smoothing",
        WEIGHTS,
        lambda x: mx.fit_warp(POINTS, TARGET, POINTS[:5], smoothing=x).parameters,
    ),
    "fit_warp source": ("source", POINTS, lambda x: mx.fit_warp(x, TARGET, POINTS[:4]).parameters),
    "fit_warp target": ("target", TARGET, lambda x: mx.fit_warp(POINTS, x, POINTS[:4]).parameters),
    "fit_warp control_points": (
        "control_points",
        POINTS[:5],
        lambda x: mx.fit_warp(POINTS, TARGET, x).parameters,
    ),
    "Warp": ("points", POINTS, WARP),
    "from_estimate source": ("source", POINTS, lambda x: estimated(x, TARGET)),
    "from_estimate target": ("target", TARGET, lambda x: estimated(POINTS, x)),
    "cross_validate_batch A": ("A", A, lambda x: batch(A=[x, x])),
    "cross_validate_batch b": ("b", B, lambda x: batch(b=[B, x])),
    "cross_validate_batch weights": ("weights", np.arange(1.0, N + 1), lambda x: batch(weights=[x, x])),
    "cross_validate_nested A": ("A", A, nested),
    "cross_validate_nested b": ("b", B, lambda x: nested(b=x)),
    "cross_validate_nested weights": ("weights", np.arange(1.0, N + 1), lambda x: nested(weights=x)),
    "cross_validate_nested penalty": ("penalty", np.eye(3), lambda x: nested(penalty=x)),
    "select_surface points": ("points", POINTS, lambda x: select(x).curves["NN02PTS"]),
    "select_surface values": ("values", TARGET, lambda x: select(values=x).curves["NN02PTS"]),
    "select_surface smoothing": (
        "smoothing",
        WEIGHTS,
        lambda x: select(smoothing=x).maps["NN02PTS"],
    ),
    "fit_surface smoothing": (
        "smoothing",
        WEIGHTS,
        lambda x: mx.fit_surface(POINTS, TARGET, POINTS[:5], smoothing=x).parameters,
    ),
    "farthest_first": ("points", POINTS, lambda x: farthest_first(x, 6)),
    "fit_surface points": ("points", POINTS, lambda x: mx.fit_surface(x, TARGET, POINTS[:5]).parameters),
    "fit_surface values": ("values", B, lambda x: mx.fit_surface(POINTS, x, POINTS[:5]).parameters),
    "fit_surface control_points": (
        "control_points",
        POINTS[:5],
        lambda x: mx.fit_surface(POINTS, TARGET, x).parameters,
    ),
    "Lifting control_points": (
        "control_points",
        POINTS[:5],
        lambda x: make_lifting("tps", x).control_points,
    ),
    "Surface parameters": (
        "parameters",
        B[:6],
        lambda x: mx.Surface(make_lifting("tps", POINTS[:6]), x, POINTS).parameters,
    ),
    "Surface domain": (
        "domain",
        POINTS,
        lambda x: mx.Surface(make_lifting("tps", POINTS[:5]), B[:5], x).domain,
    ),
    "Surface": ("points", POINTS, SURFACE),
    "Surface derivatives": ("points", POINTS, SURFACE.derivatives),
    "Surface normals": ("points", POINTS, SURFACE.normals),
    "Surface error": ("points", POINTS, SURFACE.error),
    "Surface covers": ("points", POINTS, SURFACE.covers),
    "Surface interval": ("points", POINTS, lambda x: SURFACE.interval(x, 0.8).upper),
    "Warp error": ("points", POINTS, WARP.error),
    "Warp interval": ("points", POINTS, lambda x: WARP.interval(x, 0.8).upper),
    "Cloud points": ("points", POINTS, lambda x: mx.Cloud(x, TARGET, None, N).points),
    "Cloud values": ("values", TARGET, lambda x: mx.Cloud(POINTS, x, None, N).values),
}
ANY_LENGTH = {  # arrays of which any number of rows will do
    "LeastSquares penalty",
    "cross_validate_nested penalty",
    "exclusion_radius",
    "nearest",
    "delaunay",
    "farthest_first",
    "matched points",
    "matched queries",
    "select_warp smoothing",
    "fit_warp smoothing",
    "select_surface smoothing",
    "fit_surface smoothing",
    "fit_warp control_points",
    "fit_surface control_points",
    "Lifting control_points",
    "Warp",
    "Surface",
    "Surface derivatives",
    "Surface normals",
    "Surface error",
    "Surface covers",
    "Surface interval",
    "Warp error",
    "Warp interval",
    "Surface domain",
}
QUERIES = {  # arrays of positions at which models are asked: there need not be any, and some may not be known
    "Warp",
    "Surface",
    "Surface derivatives",
    "Surface normals",
    "Surface error",
    "Surface covers",
    "Surface interval",
    "Warp error",
    "Warp interval",
}
INDICES = {
    "held_out_residuals": ("rows", MODEL.held_out_residuals),
    "from_sets held_out": ("held_out", lambda x: s.from_sets([x], n=N).held_out.indices),
    "from_sets validated": ("validated", lambda x: s.from_sets([range(N)], [x], n=N).validated.indices),
    "from_splits test": ("splits", lambda x: s.from_splits([([], x)], n=N).validated.indices),
    "from_splits train": ("splits", lambda x: s.from_splits([(x, [])], n=N).held_out.indices),
    "select_warp counts": (
        "counts",
        lambda x: mx.select_warp(POINTS, TARGET, "NN02PTS", counts=x, smoothing=0).counts,
    ),
}

BAD_INDICES = [
    [3, 3],
    [-1, 4],
    [3.0, 4.0],
    [3.5],
    np.arange(N) > 3,
    [True, False],
    "34",
    ["3", "4"],
    [[3, 4]],
    [[3], [4, 5]],
    [3 + 0j],
    [None],
    np.array([3, 4], dtype=object),
    [2**70],
    np.array([2**63], dtype=np.uint64),
    np.ma.array([3, 4], mask=[False, True]),
    None,
    3,
    {3: 4},
]

# Every function with an argument that is a whole number of at least 1: its name, a good one, and a call that returns
# plain numbers. Where None will do, it means the good one.
NUMBERS = {
    "dense_map width": ("width", 2, lambda x: WARP.dense_map(x, 3)),
    "dense_map height": ("height", 3, lambda x: WARP.dense_map(2, x)),
    "inverse_map width": ("width", 2, lambda x: WARP.inverse_map(x, 3)),
    "inverse_map height": ("height", 3, lambda x: WARP.inverse_map(2, x)),
    "displacement_field width": ("width", 2, lambda x: WARP.displacement_field(x, 3)),
    "displacement_field height": ("height", 3, lambda x: WARP.displacement_field(2, x)),
    "leave_one_out n": ("n", 5, lambda x: held(s.leave_one_out(x))),
    "k_fold n": ("n", 9, lambda x: held(s.k_fold(x, 3, seed=0))),
    "k_fold k": ("k", 3, lambda x: held(s.k_fold(9, x, seed=0))),
    "nearest k": ("k", 3, lambda x: held(s.nearest(POINTS, x))),
    "nearest threads": ("threads", 2, lambda x: held(s.nearest(POINTS, 3, threads=x))),
    "exclusion_radius threads": ("threads", 2, lambda x: held(s.exclusion_radius(POINTS, 30, threads=x))),
    "matched threads": ("threads", 2, lambda x: held(s.matched(POINTS, TARGET, threads=x))),
    "from_distance n": ("n", N, lambda x: held(s.from_distance(lambda _: np.arange(float(x)), 3, n=x))),
    "farthest_first max_count": ("max_count", 5, lambda x: farthest_first(POINTS, x)),
    "leave_p_out n": ("n", 9, lambda x: held(s.leave_p_out(x, 2))),
    "leave_p_out p": ("p", 2, lambda x: held(s.leave_p_out(9, x))),
    "leave_p_out max_sets": ("max_sets", 36, lambda x: held(s.leave_p_out(9, 2, x, seed=0))),
    "random_sampling n": ("n", 9, lambda x: held(s.random_sampling(x, 2, 3, seed=0))),
    "random_sampling size": ("size", 2, lambda x: held(s.random_sampling(9, x, 3, seed=0))),
    "random_sampling repeats": ("repeats", 3, lambda x: held(s.random_sampling(9, 2, x, seed=0))),
    "from_sets n": ("n", 9, lambda x: held(s.from_sets([[0, 8]], n=x))),
    "from_splits n": ("n", 9, lambda x: held(s.from_splits([([0], [8])], n=x))),
    "LeastSquares coupling": ("coupling", 2, lambda x: mx.LeastSquares(A, B, coupling=x).fit_rms),
    "LeastSquares threads": ("threads", 2, lambda x: mx.LeastSquares(A, B, threads=x).residuals),
    "cross_validate threads": ("threads", 2, lambda x: MODEL.cross_validate(LOO, threads=x).residuals),
    "hat_blocks threads": ("threads", 2, lambda x: MODEL.hat_blocks(threads=x)),
    "select_warp threads": (
        "threads",
        2,
        lambda x: mx.select_warp(POINTS, TARGET, counts=[3, 4], threads=x, smoothing=0).curves["ER10"],
    ),
    "cross_validate_batch coupling": ("coupling", 2, lambda x: batch(scheme=s.leave_one_out, coupling=x)),
    "cross_validate_batch threads": ("threads", 2, lambda x: batch(threads=x)),
    "cross_validate_nested coupling": ("coupling", 2, lambda x: nested(schemes=HALF, coupling=x)),
    "cross_validate_nested threads": ("threads", 2, lambda x: nested(threads=x)),
    "select_surface max_count": ("max_count", N, lambda x: select(max_count=x).counts),
    "select_surface threads": ("threads", 2, lambda x: select(threads=x).curves["NN02PTS"]),
    "map_problems workers": ("workers", 1, lambda x: mx.map_problems(pow, [(2, 3), (3, 2)], workers=x)),
    "map_problems retries": (
        "retries",
        1,
        lambda x: mx.map_problems(pow, [(2, 3), (3, 2)], workers=1, retries=x),
    ),
    "iterate_problems workers": (
        "workers",
        1,
        lambda x: [result for _, result in mx.iterate_problems(pow, [(2, 3), (3, 2)], workers=x)],
    ),
    "Cloud n_valid": ("n_valid", 25, lambda x: mx.Cloud(POINTS, TARGET, None, x).n_valid),
    "Cloud n_missing": ("n_missing", 3, lambda x: mx.Cloud(POINTS, TARGET, None, N, x).n_missing),
}
OPTIONAL = {
    "from_sets n",
    "from_splits n",
    "leave_p_out max_sets",
    "iterate_problems workers",
    "map_problems workers",
    "select_surface max_count",
    *(name for name, (argument, *_) in NUMBERS.items() if argument == "threads"),
}
FROM_ZERO = {"n_missing", "retries"}

BAD_COUNTS = [
    0,
    -1,
    -(2**70),
    2.0,
    2.5,
    "2",
    b"2",
    True,
    np.True_,
    np.nan,
    np.inf,
    2j,
    [2, 3],
    {},
    None,
    np.float64(2),
]

BAD_COUPLINGS = [
    3,
    N + 1,
    np.zeros(N),
    np.arange(N) - 1,
    np.arange(N) + 1,
    np.arange(N - 1),
    np.arange(N).reshape(-1, 1),
    np.arange(N) * 2**40,
    np.arange(N) > 3,
    ["a"] * N,
    [[0], [1, 2]],
    [],
    np.where(np.arange(N) == 4, 2**63, 0).astype(np.uint64),
    np.ma.array(np.arange(N), mask=np.arange(N) == 3),
    np.arange(N).astype(object),
]

BAD_SMOOTHING = [
    -1,
    np.nan,
    np.inf,
    None,
    True,
    1j,
    "AUTO",
    "auto ",
    "1",
    b"auto",
    [],
    ["auto"],
    ["1", "2"],
    [-1.0, 2.0],
    [1.0, np.nan],
    [1.0, np.inf],
    [[1.0, 2.0]],
    [[1.0], [2.0, 3.0]],
    [None],
    [1j],
    {1.0: 2.0},
    ...,
]

BAD_LEVELS = [0, 1, -0.1, 1.5, 90, np.nan, np.inf, None, True, "0.9", b"0.9", 1j, [0.9, 0.5], {}, ...]

BAD_SEEDS = [-1, 1.5, "seed", [None], ...]


def strided(x):
    wide = np.full((2 * len(x), *x.shape[1:]), np.nan)
    wide[::2] = x
    return wide[::2]


def frozen(x):
    x = x.copy()
    x.flags.writeable = False
    return x


def padded_columns(x):
    return np.column_stack([x, x, x])[:, : x.shape[1]] if x.ndim == 2 else np.column_stack([x, x])[:, 0]


FORMS = {
    "lists": lambda x: x.tolist(),
    "tuples": lambda x: tuple(map(tuple, x)) if x.ndim == 2 else tuple(x),
    "Fortran order": np.asfortranarray,
    "read-only": frozen,
    "strided": strided,
    "part of wider rows": padded_columns,
    "backwards": lambda x: x[::-1].copy()[::-1],
    "big-endian": lambda x: x.astype(">f8"),
    "longdouble": lambda x: x.astype(np.longdouble),
    "masked nowhere": lambda x: np.ma.array(x, mask=False),
    "a subclass": lambda x: x.view(type("Own", (np.ndarray,), {})),
    "misaligned": lambda x: np.frombuffer(b"\0" + x.tobytes(), np.uint8)[1:].view(x.dtype).reshape(x.shape),
}

WRONG_TYPES = {
    "a string": lambda x: "matrix",
    "strings": lambda x: x.astype(str),
    "bytes": lambda x: b"matrix",
    "complex": lambda x: x + 0j,
    "objects": lambda x: x.astype(object),
    "fractions": lambda x: [[Fraction(1, 2)] * 2] * len(x),
    "none": lambda x: None,
    "nones": lambda x: [None] * len(x),
    "a dictionary": lambda x: {"x": 1},
    "ragged": lambda x: [[1.0, 2.0], [3.0]] * (len(x) // 2),
    "masked": lambda x: np.ma.array(x, mask=np.arange(x.size).reshape(x.shape) == 1),
    "dates": lambda x: x.astype("datetime64[s]"),
    "records": lambda x: np.zeros(len(x), dtype=[("x", float), ("y", float)]),
    "a generator": lambda x: (row for row in x),
    "a class": lambda x: np.ndarray,
}

WRONG_SHAPES = {
    "empty": lambda x: [],
    "no rows": lambda x: x[:0],
    "no columns": lambda x: np.zeros((len(x), 0)),
    "a number": lambda x: 3.0,
    "three dimensions": lambda x: np.zeros((*x.shape, 2, 2)),
}

WRONG = {**WRONG_TYPES, **WRONG_SHAPES, "one row short": lambda x: x[:-1]}

# What an argument takes as well, and what it means.
SHORT = {
    "smoothing": (3.0, [3.0]),
    "weights": (None, np.ones(N)),
    "penalty": (None, np.zeros((0, 3))),
}
RIGHT = {
    ("smoothing", "a number"),
    ("weights", "none"),
    ("penalty", "none"),
    ("penalty", "no rows"),
    *((name, "no rows") for name in QUERIES),
}


def wrong_arrays():
    """Yield arguments and what is wrong: for two of them everything, for the others a type and a shape, in turn."""
    for turn, (name, (argument, *_)) in enumerate(ARRAYS.items()):
        types, shapes = (
            [wrong for wrong in group if not {(argument, wrong), (name, wrong)} & RIGHT]
            for group in (WRONG_TYPES, WRONG_SHAPES)
        )
        if name in {
            "LeastSquares A",
            "select_warp smoothing",
        }:  # the checks that all share, and those of weights
            yield from ((name, wrong) for wrong in types + shapes)
        else:
            yield name, types[turn % len(types)]
            yield name, shapes[turn % len(shapes)]
        if name not in ANY_LENGTH:
            yield name, "one row short"
