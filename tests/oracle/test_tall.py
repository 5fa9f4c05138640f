"""Fits of rows that are read a block at a time: the fit in memory is the oracle, itself tested against refits."""

import copy
import pickle
import subprocess
import sys
import textwrap
import warnings

import numpy as np
import pytest
from refits import expect_same_fit, expect_same_predictions, predicted_exactly

import mexpress as mx
from mexpress.leastsquares import tall

s = mx.schemes
RNG = np.random.default_rng(3)
N, P = 900, 5
POINTS = RNG.uniform(0, 1, (N, 2))
SCHEMES = {
    "each datum": s.leave_one_out(N),
    "folds": s.k_fold(N, 6, seed=0),
    "radius": s.exclusion_radius(POINTS, 0.08),
    "lazy radius": s.Places.of(POINTS).lazily_within(0.08),
    "lazy line": s.Places.of(POINTS[:, :1]).lazily_within(0.004),
    "nearest": s.nearest(POINTS, 12),
    "lazy nearest": s.Places.of(POINTS).lazily_nearest(12),
    "few": s.from_sets([[3, 500, 899], [], [7], [40, 41]], [[500], [], [7], []], n=N),
}


@pytest.fixture(params=[1000, 1 << 22], ids=["many parts", "one part"])
def _parts(request, monkeypatch):
    monkeypatch.setattr(tall, "_PART", request.param)


def make(coupling=1, responses=None, weighted=False):
    """Return a problem."""
    rng, m = np.random.default_rng(5), N * coupling
    A = np.hstack([np.repeat(POINTS, coupling, axis=0), rng.normal(size=(m, P - 2))]) * 10.0 ** np.arange(P)
    b = rng.normal(size=m if responses is None else (m, responses))
    return A, b, rng.uniform(0.2, 3, N) if weighted else None


def blocks_of(A, b, weights, coupling=1, data=130):
    """Yield blocks of rows."""
    for first in range(0, N, data):
        rows, some = slice(first * coupling, (first + data) * coupling), slice(first, first + data)
        yield (A[rows], b[rows]) if weights is None else (A[rows], b[rows], weights[some])


@pytest.mark.usefixtures("_parts")
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize(
    ("coupling", "responses", "weighted"), [(1, None, False), (1, 3, True), (2, 2, True)]
)
def test_predictions_are_those_of_the_fit_in_memory(scheme, coupling, responses, weighted):
    A, b, weights = make(coupling, responses, weighted)
    expected = mx.LeastSquares(A, b, coupling, weights).cross_validate(SCHEMES[scheme])
    for blocks in (blocks_of(A, b, weights, coupling), (A, b, weights)):
        model = mx.LeastSquares.from_blocks(blocks, coupling)
        found = model.cross_validate(SCHEMES[scheme])
        expect_same_predictions(found, expected)


@pytest.mark.usefixtures("_parts")
@pytest.mark.parametrize(("coupling", "responses", "weighted"), [(1, None, False), (3, 2, True)])
def test_the_fit_is_that_in_memory(coupling, responses, weighted):
    A, b, weights = make(coupling, responses, weighted)
    expected = mx.LeastSquares(A, b, coupling, weights)
    model = mx.LeastSquares.from_blocks(blocks_of(A, b, weights, coupling), coupling)
    expect_same_fit(model, expected, P, N)
    assert repr(model).startswith(
        f"TallLeastSquares({N} data, {N * coupling} rows, {P} columns, rank {P}, fit_rms="
    )


def shifted(weighted=False):
    """Return a problem, and its responses moved by multiples of columns that are exact in every digit."""
    A, b, weights = make(responses=3, weighted=weighted)
    A[:, 1], A[:, 2] = 4.0, np.round(64 + 8 * A[:, 2] / np.abs(A[:, 2]).max()) / 64
    b = np.round(1024 * b) / 1024
    return A, b, b + 2.0**30 * np.column_stack([A[:, 1], -A[:, 2], 0 * b[:, 2]]), weights


@pytest.mark.usefixtures("_parts")
@pytest.mark.parametrize("scheme", ["each datum", "folds", "lazy radius", "nearest"])
@pytest.mark.parametrize("weighted", [False, True], ids=["", "weights"])
def test_a_mean_that_a_column_explains_costs_no_digit(scheme, weighted):
    A, plain, b, weights = shifted(weighted)
    expected = mx.LeastSquares(A, plain, 1, weights).cross_validate(SCHEMES[scheme])
    for blocks in (blocks_of(A, b, weights), (A, b, weights)):
        found = mx.LeastSquares.from_blocks(blocks).cross_validate(SCHEMES[scheme])
        np.testing.assert_allclose(found.residuals, expected.residuals, rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.score, expected.score, rtol=1e-12)


@pytest.mark.parametrize("weighted", [False, True], ids=["", "weights"])
def test_a_mean_costs_the_fit_no_digit(weighted):
    A, plain, b, weights = shifted(weighted)
    expected = mx.LeastSquares(A, plain, 1, weights)
    model = mx.LeastSquares.from_blocks(blocks_of(A, b, weights))
    for name in ("residuals", "fit_rms", "press"):
        np.testing.assert_allclose(getattr(model, name), getattr(expected, name), rtol=0, atol=1e-12)
    shift = np.zeros((P, 3))
    shift[1, 0], shift[2, 1] = 2.0**30, -(2.0**30)
    np.testing.assert_allclose(
        model.coefficients - shift, expected.coefficients, rtol=0, atol=2.0**30 * np.finfo(float).eps
    )


@pytest.mark.parametrize(
    "scheme",
    [s.leave_one_out(14), s.k_fold(14, 3, seed=0), s.nearest(np.arange(14.0)[:, None], 3)],
    ids=["each datum", "folds", "neighbours"],
)
def test_predictions_of_large_responses_are_exact_refits(scheme, monkeypatch):
    monkeypatch.setattr(tall, "_PART", 10)
    rng = np.random.default_rng(0)
    A, b = rng.normal(size=(14, 3)), rng.normal(size=14)
    b += 1e8 * A[:, 1]
    found = mx.LeastSquares.from_blocks((A, b)).cross_validate(scheme)
    expected = predicted_exactly(A, b, scheme)[:, 0]
    np.testing.assert_allclose(found.residuals, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("unit", [1e-290, 1e290])
def test_the_largest_and_the_smallest_responses_are_mostly_a_column_too(unit):
    A, _, b, _ = shifted()
    b = b[:, 0] / 2**30
    expected = mx.LeastSquares(A, b).cross_validate(SCHEMES["radius"])
    for columns in (unit, 1 / unit):
        found = mx.LeastSquares.from_blocks((A * columns, b * unit)).cross_validate(SCHEMES["radius"])
        np.testing.assert_allclose(found.residuals / unit, expected.residuals, rtol=0, atol=1e-12)


@pytest.mark.usefixtures("_parts")
def test_columns_that_few_rows_see_are_undefined_without_these():
    """Bumps of which some are seen by a few data near each other: their pairs lose rank, and others nearly do."""
    centres = np.random.default_rng(0).uniform(0, 1, (40, 2))
    A = np.exp(-np.square((POINTS[:, None] - centres) / 0.04).sum(axis=2))
    A[A < 1e-4] = 0
    A = np.hstack([np.ones((N, 1)), A[:, A.any(axis=0)]])
    b = RNG.normal(size=N)
    near = s.exclusion_radius(POINTS, 0.09)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mx.RankLossWarning)
        expected = mx.LeastSquares(A, b).cross_validate(near)
    assert 2 < len(expected.undefined) < N
    model = mx.LeastSquares.from_blocks((A, b))
    with pytest.warns(mx.RankLossWarning, match=f"{len(expected.undefined)} of {N} pairs lose rank"):
        found = model.cross_validate(near)
    np.testing.assert_array_equal(found.undefined, expected.undefined)
    defined = np.isfinite(expected.residuals)
    np.testing.assert_array_equal(np.isfinite(found.residuals), defined)
    scale = np.abs(expected.residuals[defined])
    assert (np.abs(found.residuals - expected.residuals)[defined] <= 1e-8 * (1 + scale)).all()


@pytest.mark.parametrize("seed", range(12))
def test_rank_is_that_of_all_rows(seed):
    """Columns that add up to others but for the rounding of many rows."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2000, 60_000))
    group = rng.integers(2, size=n)
    A = np.column_stack([np.ones(n), group == 0, group == 1]) * rng.uniform(0.1, 10, 3)
    b = rng.normal(size=n)
    model, expected = mx.LeastSquares.from_blocks((A, b)), mx.LeastSquares(A, b)
    assert model.rank == expected.rank == 2
    np.testing.assert_allclose(model.coefficients, expected.coefficients, rtol=1e-9)
    np.testing.assert_allclose(model.residuals, expected.residuals, rtol=0, atol=1e-10)
    np.testing.assert_allclose(model.fit_rms, expected.fit_rms, rtol=1e-12)


@pytest.mark.usefixtures("_parts")
def test_rank_that_is_lost_is_told():
    A, b, _ = make()
    A[:, 4] = A[:, 3] - A[:, 2]
    model, expected = mx.LeastSquares.from_blocks((A, b)), mx.LeastSquares(A, b)
    assert model.rank == expected.rank == P - 1
    moved = mx.LeastSquares.from_blocks((A, b + 100 * A[:, 3]))
    shortest = mx.LeastSquares(A, b + 100 * A[:, 3]).coefficients
    np.testing.assert_allclose(moved.coefficients, shortest, rtol=0, atol=1e-9)
    found, loo = (each.cross_validate(SCHEMES["radius"]).residuals for each in (model, expected))
    np.testing.assert_allclose(found, loo, rtol=1e-9, atol=1e-10)
    assert np.isnan(model.leverage).all()


@pytest.mark.usefixtures("_parts")
@pytest.mark.parametrize("unit", [1e-200, 1e200])
def test_units_do_not_matter(unit):
    A, b, _ = make()
    expected = mx.LeastSquares(A, b).cross_validate(SCHEMES["radius"])
    found = mx.LeastSquares.from_blocks((unit * A, b / unit)).cross_validate(SCHEMES["radius"])
    np.testing.assert_allclose(found.residuals * unit, expected.residuals, rtol=1e-10)
    np.testing.assert_allclose(found.score * unit, expected.score, rtol=1e-12)


@pytest.mark.parametrize("unit", [1e-300, 1e300])
@pytest.mark.parametrize("make_blocks", [lambda *arrays: arrays, blocks_of], ids=["arrays", "blocks"])
def test_units_of_weights_do_not_matter(unit, make_blocks):
    A, b, weights = make(weighted=True)
    expected = mx.LeastSquares.from_blocks((A, b, weights))
    model = mx.LeastSquares.from_blocks(make_blocks(A, b * unit ** (2 / 3), weights * unit))
    np.testing.assert_allclose(model.coefficients / unit ** (2 / 3), expected.coefficients, rtol=1e-10)
    for found, same in ((model.fit_rms, expected.fit_rms), (model.press, expected.press)):
        np.testing.assert_allclose(found / unit ** (2 / 3), same, rtol=1e-10)


def test_memory_of_a_block_may_serve_for_the_next_one():
    A, b, weights = make(weighted=True)
    memory = tuple(np.empty_like(each[:100]) for each in (A, b, weights))

    def blocks():
        for first in range(0, N, 100):
            for each, given in zip(memory, (A, b, weights), strict=True):
                each[:] = given[first : first + 100]
            yield memory

    expected = mx.LeastSquares(A, b, weights=weights)
    model = mx.LeastSquares.from_blocks(blocks())
    np.testing.assert_allclose(model.fit_rms, expected.fit_rms, rtol=1e-12)
    np.testing.assert_allclose(model.press, expected.press, rtol=1e-12)


def test_empty_blocks_are_passed_over():
    A, b, weights = make(2, 3, True)
    nothing = A[:0], b[:0], weights[:0]
    blocks = [nothing, *blocks_of(A, b, weights, 2), nothing]
    expect_same_fit(mx.LeastSquares.from_blocks(blocks, 2), mx.LeastSquares(A, b, 2, weights), P, N)
    with pytest.raises(ValueError, match=r"^Invalid blocks\. .* Given none that has rows"):
        mx.LeastSquares.from_blocks([nothing, nothing], 2)


def test_many_small_blocks_are_reduced_together(monkeypatch):
    A, b, weights = make(weighted=True)
    heights, reduced = [], tall.reduced

    def counted(rows, threads):
        heights.append(len(rows))
        return reduced(rows, threads)

    monkeypatch.setattr(tall, "reduced", counted)
    model = mx.LeastSquares.from_blocks(blocks_of(A, b, weights, data=1))
    assert heights == [N]
    expect_same_fit(model, mx.LeastSquares(A, b, weights=weights), P, N)


def test_results_are_read_only_and_a_model_is_no_file(monkeypatch):
    threads, product = [], tall._core.product

    def counted(*arguments):
        threads.append(arguments[-1])
        return product(*arguments)

    monkeypatch.setattr(tall._core, "product", counted)
    model = mx.LeastSquares.from_blocks(GOOD, threads=1)
    for array in (model.coefficients, model.residuals, model.leverage):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    assert threads == [1]
    for attempt in (pickle.dumps, copy.deepcopy):
        with pytest.raises(TypeError, match=r"^Invalid model\. .* build it again from the blocks"):
            attempt(model)


def test_wide_rows_are_read_about_once(monkeypatch):
    """A part has few of them; its neighbours are whole cells, and pairs come back to it time and again."""
    monkeypatch.setattr(tall, "_PART", 150 * 121)
    rng = np.random.default_rng(7)
    A, b = rng.normal(size=(N, 120)), rng.normal(size=N)
    model, calls = mx.LeastSquares.from_blocks((A, b)), []

    def counted(*given):
        calls.append(len(given[0]))
        return predicted(*given)

    predicted = tall.predicted
    monkeypatch.setattr(tall, "predicted", counted)
    found = model.cross_validate(SCHEMES["radius"])
    expected = mx.LeastSquares(A, b).cross_validate(SCHEMES["radius"])
    np.testing.assert_allclose(found.residuals, expected.residuals, rtol=1e-11)
    assert 4 <= len(calls) <= 7


def test_no_bit_depends_on_threads(monkeypatch):
    monkeypatch.setattr(tall, "_PART", 1500)
    A, b, weights = make(1, 2, True)
    found = []
    for threads in (1, 3):
        model = mx.LeastSquares.from_blocks((A, b, weights), threads=threads)
        found.append((model.coefficients, model.cross_validate(SCHEMES["lazy radius"], threads).residuals))
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


def test_files_of_other_numbers_are_read_where_they_are(tmp_path, monkeypatch):
    monkeypatch.setattr(tall, "_PART", 1500)
    A, b, _ = make()
    np.save(tmp_path / "A.npy", np.asfortranarray(np.round(A)).astype(np.float32))
    np.save(tmp_path / "b.npy", np.round(10 * b).astype(np.int16))
    A, b = (np.load(tmp_path / f"{name}.npy", mmap_mode="r") for name in "Ab")
    expected = mx.LeastSquares(A, b).cross_validate(SCHEMES["radius"])
    found = mx.LeastSquares.from_blocks((A, b)).cross_validate(SCHEMES["radius"])
    np.testing.assert_allclose(found.residuals, expected.residuals, rtol=1e-10)


def test_a_call_goes_on_where_another_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(tall, "_PART", 1000)
    A, b, _ = make()
    model, path, parts = mx.LeastSquares.from_blocks((A, b)), tmp_path / "parts", []
    expected = model.cross_validate(SCHEMES["lazy radius"])
    solve = tall.predicted

    def counted(*arguments):
        parts.append(arguments)
        if len(parts) == 3:
            raise KeyboardInterrupt
        return solve(*arguments)

    monkeypatch.setattr(tall, "predicted", counted)
    with pytest.raises(KeyboardInterrupt):
        model.cross_validate(SCHEMES["lazy radius"], resume=path)
    with path.open("ab") as file:
        file.write(path.read_bytes()[:300])  # a part that was being written
    again = mx.LeastSquares.from_blocks((A, b)).cross_validate(SCHEMES["lazy radius"], resume=path)
    np.testing.assert_array_equal(again.residuals, expected.residuals)
    total = -(-N // 165)  # three cells of 55 data
    assert len(parts) == 3 + total - 2
    model.cross_validate(SCHEMES["lazy radius"], resume=path)
    assert len(parts) == 3 + total - 2, "finished parts were solved again"
    with pytest.raises(ValueError, match=r"^Invalid resume\. .* the same data and the same scheme"):
        model.cross_validate(SCHEMES["each datum"], resume=path)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (s.Places.of(POINTS).lazily_within(5), s.Places.of(POINTS).lazily_nearest(5)),
        (
            s.Places.of(np.round(9 * POINTS)).lazily_within(1),
            s.Places.of(np.round(9 * POINTS[::-1])).lazily_within(1),
        ),
        (s.from_sets([[0, 1], [2]], n=N), s.from_sets([[0], [1, 2]], n=N)),
        (s.from_sets([[0, 1], [2]], [[0], [2]], n=N), s.from_sets([[0, 1], [2]], [[1], [2]], n=N)),
        (SCHEMES["radius"], s.Scheme(N, SCHEMES["radius"].held_out, SCHEMES["radius"].validated)),
    ],
    ids=["how", "points", "ends", "validated", "order"],
)
def test_a_file_of_another_scheme_is_refused(one, other, tmp_path):
    A, b, _ = make()
    model, path = mx.LeastSquares.from_blocks((A, b)), tmp_path / "parts"
    path.touch()  # as good as none
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mx.RankLossWarning)
        model.cross_validate(one, resume=path)
        with pytest.raises(ValueError, match=r"^Invalid resume\. .* the same data and the same scheme"):
            model.cross_validate(other, resume=path)


def test_progress_is_shown(monkeypatch):
    monkeypatch.setattr(tall, "_PART", 1000)
    A, b, _ = make()
    told = []

    class Meter:
        def __init__(self, total, desc):
            told.append([desc, total, 0])

        def update(self, number):
            told[-1][2] += number

        def close(self):
            assert told[-1][1] == told[-1][2]

    mx.LeastSquares.from_blocks((A, b)).cross_validate(SCHEMES["folds"], progress=Meter)
    assert [each[0] for each in told] == ["rows", "held-out parts"]


def test_it_stops_on_a_signal(tmp_path):
    """In the middle of a part, and no file is left behind."""
    script = textwrap.dedent("""
        import numpy as np, mexpress as mx, os, signal, threading, time, sys
        rng = np.random.default_rng(0)
        A, b, points = rng.normal(size=(60_000, 40)), rng.normal(size=60_000), rng.uniform(size=(60_000, 2))
        blocks = ((A[i : i + 6000], b[i : i + 6000]) for i in range(0, 60_000, 6000))
        model = mx.LeastSquares.from_blocks(blocks, directory=sys.argv[1])
        threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
        start = time.monotonic()
        try:
            model.cross_validate(mx.schemes.exclusion_radius(points, 0.2))
        except KeyboardInterrupt:
            print("stopped", time.monotonic() - start < 5)
    """)
    ran = subprocess.run(
        [sys.executable, "-c", script, tmp_path], capture_output=True, text=True, timeout=120, check=True
    )
    assert ran.stdout == "stopped True\n"
    assert not list(tmp_path.iterdir())


GOOD = make()[:2]


def spoiled(array):
    """Return a copy with an entry that is no number."""
    copy = array.copy()
    copy[3, 1] = np.nan
    return copy


@pytest.mark.parametrize(
    ("name", "told", "call"),
    [
        ("blocks", "none", lambda: mx.LeastSquares.from_blocks([])),
        ("blocks", "3", lambda: mx.LeastSquares.from_blocks(3)),
        ("blocks", "'rows'", lambda: mx.LeastSquares.from_blocks("rows")),
        ("blocks", "array", lambda: mx.LeastSquares.from_blocks([GOOD[0]])),
        ("blocks", "shapes", lambda: mx.LeastSquares.from_blocks((GOOD[0], GOOD[1][1:]))),
        ("blocks", "shapes", lambda: mx.LeastSquares.from_blocks([(GOOD[1], GOOD[1])])),
        ("blocks", "nan at row 3", lambda: mx.LeastSquares.from_blocks((spoiled(GOOD[0]), GOOD[1]))),
        ("blocks", "1e\\+304", lambda: mx.LeastSquares.from_blocks((GOOD[0], np.full(N, 1e304)))),
        ("blocks", "columns", lambda: mx.LeastSquares.from_blocks([GOOD, (GOOD[0][:, 1:], GOOD[1])])),
        ("blocks", "text", lambda: mx.LeastSquares.from_blocks(([["text"]], [1.0]))),
        ("coupling", "7", lambda: mx.LeastSquares.from_blocks(GOOD, 7)),
        ("coupling", "0", lambda: mx.LeastSquares.from_blocks(GOOD, 0)),
        ("weights", "shape", lambda: mx.LeastSquares.from_blocks((*GOOD, np.ones(3)))),
        ("weights", "-1", lambda: mx.LeastSquares.from_blocks((*GOOD, np.full(N, -1.0)))),
        ("scheme", "3 data", lambda: mx.LeastSquares.from_blocks(GOOD).cross_validate(s.leave_one_out(3))),
        ("scheme", "None", lambda: mx.LeastSquares.from_blocks(GOOD).cross_validate(None)),
        ("threads", "0", lambda: mx.LeastSquares.from_blocks(GOOD, threads=0)),
        ("directory", "4", lambda: mx.LeastSquares.from_blocks([GOOD], directory=4)),
        ("directory", "nowhere", lambda: mx.LeastSquares.from_blocks([GOOD], directory="nowhere")),
    ],
)
def test_what_is_wrong_is_told(name, told, call):
    with pytest.raises((ValueError, TypeError), match=rf"^Invalid {name}\. .*{told}"):
        call()


def test_scattered_pairs_of_many_data_are_refused(monkeypatch):
    monkeypatch.setattr(tall, "_PART", 1000)
    monkeypatch.setattr(tall, "_MOST", 1500)
    scattered = s.random_sampling(N, 50, 20, seed=0)
    with pytest.raises(ValueError, match=r"^Invalid scheme\. Its pairs must hold out data near each other"):
        mx.LeastSquares.from_blocks(GOOD).cross_validate(scattered)
