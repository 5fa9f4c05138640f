"""Fits of dask arrays: the fit in memory is the oracle, by threads and on a cluster of which a process is killed."""

import os
import signal
from functools import partial

import numpy as np
import pytest
from clusters import client_of
from refits import expect_same_fit, expect_same_predictions
from test_tall import GOOD, SCHEMES, N, P, make, shifted, spoiled

import mexpress as mx
from mexpress.leastsquares import dask_rows, tall

da = pytest.importorskip("dask.array")
dask = pytest.importorskip("dask")


@pytest.fixture(params=[1000, 1 << 22], ids=["many parts", "one part"])
def _parts(request, monkeypatch):
    monkeypatch.setattr(tall, "_PART", request.param)
    monkeypatch.setattr(dask_rows, "_TOGETHER", 3)


def spread(A, b, lengths=130):
    """Return the problem as dask arrays, in blocks that do not fit each other."""
    return da.from_array(A, chunks=(lengths, 3)), da.from_array(
        b, chunks=b.shape if b.ndim == 1 else (200, 1)
    )


@pytest.mark.usefixtures("_parts")
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize(
    ("coupling", "responses", "weighted"), [(1, None, False), (1, 3, True), (2, 2, True)]
)
def test_predictions_are_those_of_the_fit_in_memory(scheme, coupling, responses, weighted):
    A, b, weights = make(coupling, responses, weighted)
    expected = mx.LeastSquares(A, b, coupling, weights).cross_validate(SCHEMES[scheme])
    arrays = spread(A, b, (131, 1, N * coupling - 532, 400))  # a datum of two rows is in two blocks
    model = mx.LeastSquares.from_blocks((*arrays, weights), coupling)
    found = model.cross_validate(SCHEMES[scheme])
    expect_same_predictions(found, expected)


@pytest.mark.parametrize(("coupling", "responses", "weighted"), [(1, None, False), (3, 2, True)])
def test_the_fit_is_that_in_memory(coupling, responses, weighted):
    A, b, weights = make(coupling, responses, weighted)
    expected = mx.LeastSquares(A, b, coupling, weights)
    given = weights if weights is None else da.from_array(weights, chunks=100)
    model = mx.LeastSquares.from_blocks((spread(A, b)[0], b, given), coupling)
    expect_same_fit(model, expected, P, N)


@pytest.mark.usefixtures("_parts")
def test_a_mean_that_a_column_explains_costs_no_digit():
    A, plain, b, weights = shifted(weighted=True)
    expected = mx.LeastSquares(A, plain, 1, weights)
    model = mx.LeastSquares.from_blocks((*spread(A, b), weights))
    for name in ("residuals", "fit_rms", "press"):
        np.testing.assert_allclose(getattr(model, name), getattr(expected, name), rtol=0, atol=1e-12)
    for scheme in map(SCHEMES.get, ("folds", "lazy radius")):
        found = model.cross_validate(scheme).residuals
        np.testing.assert_allclose(found, expected.cross_validate(scheme).residuals, rtol=0, atol=1e-12)


def test_some_blocks_are_empty():
    """As after a choice of rows."""
    A, b, _ = make()
    few = A[:, 0] > np.sort(A[:, 0])[-40]
    chosen = [each[da.from_array(few, chunks=10)] for each in spread(A, b, 10)]
    for each in chosen:
        each.compute_chunk_sizes()
    assert 0 in chosen[0].chunks[0]
    expected, model = mx.LeastSquares(A[few], b[few]), mx.LeastSquares.from_blocks(tuple(chosen))
    for name in ("coefficients", "residuals", "leverage", "press"):
        np.testing.assert_allclose(getattr(model, name), getattr(expected, name), rtol=1e-10, atol=1e-13)


def test_whole_numbers_and_rows_in_no_order():
    """Neighbours are in all blocks."""
    A, b, _ = make()
    A, b = np.round(A).astype(np.int32), np.round(10 * b).astype(np.float32)
    expected = mx.LeastSquares(A, b).cross_validate(SCHEMES["lazy radius"])
    found = mx.LeastSquares.from_blocks(spread(A, b, 7)).cross_validate(SCHEMES["lazy radius"])
    np.testing.assert_allclose(found.residuals, expected.residuals, rtol=1e-10, atol=1e-12)


@pytest.mark.usefixtures("_parts")
def test_no_bit_depends_on_the_scheduler_or_on_threads():
    A, b, weights = make(1, 2, True)
    found = []
    for scheduler, threads in [("threads", None), ("synchronous", 3)]:
        with dask.config.set(scheduler=scheduler):
            model = mx.LeastSquares.from_blocks((*spread(A, b), weights), threads=threads)
            cv = model.cross_validate(SCHEMES["radius"], threads)
            found.append((model.coefficients, model.leverage, cv.residuals))
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


class Bar:
    """A bar that does something after some held-out parts."""

    def __init__(self, act, after, total, desc):
        self.act, self.left = act, after if desc == "held-out parts" else -1

    def update(self, number):
        """Count a step."""
        self.left -= number
        if self.left == 0:
            self.act()

    def close(self):
        """Do nothing."""


def interrupt():
    raise KeyboardInterrupt


def test_a_call_goes_on_where_another_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(tall, "_PART", 1000)
    monkeypatch.setattr(dask_rows, "_TOGETHER", 3)
    A, b, _ = make()
    model, path, parts = mx.LeastSquares.from_blocks(spread(A, b, 400)), tmp_path / "parts", []
    expected = model.cross_validate(SCHEMES["lazy radius"])
    with pytest.raises(KeyboardInterrupt):
        model.cross_validate(SCHEMES["lazy radius"], resume=path, progress=partial(Bar, interrupt, 4))
    solve = tall.predicted
    monkeypatch.setattr(tall, "predicted", lambda *arguments: parts.append(arguments) or solve(*arguments))
    again = model.cross_validate(SCHEMES["lazy radius"], resume=path)
    np.testing.assert_array_equal(again.residuals, expected.residuals)
    assert 0 < len(parts) == -(-N // (400 // 2)) - 4


@pytest.fixture(scope="module")
def client():
    with client_of(4) as client:
        yield client


def block_of(rows, path=None, at=-1):
    """Return rows of a problem; the process is killed when some rows are read for the third time."""
    first = rows[0, 0]
    if first == at:
        count = len(list(path.iterdir()))
        (path / f"{count}").touch()
        if count == 2:  # the fit reads them once, and each cross-validation twice at least
            os.kill(os.getpid(), signal.SIGKILL)
    return make(2, 2)[0][rows[:, 0]]


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # Dask warns of what is killed
@pytest.mark.parametrize("kept", [False, True], ids=["read again", "persisted"])
def test_the_answer_is_the_same_when_a_process_of_a_cluster_is_killed(client, tmp_path, monkeypatch, kept):
    monkeypatch.setattr(tall, "_PART", 3000)
    monkeypatch.setattr(dask_rows, "_TOGETHER", 3)
    A, b, weights = make(2, 2, True)
    rows = da.arange(2 * N, chunks=301)[:, None]
    told = {} if kept else {"path": tmp_path, "at": 602}
    design = rows.map_blocks(block_of, **told, dtype=float, chunks=(rows.chunks[0], P))
    responses = da.from_array(b, chunks=(400, 2))
    before = client.run(os.getpid)
    if kept:
        design, responses = client.persist([design, responses])
    killed = []

    def kill():
        holder = client.who_has(design)
        address = next(iter(next(iter(holder.values()))))
        killed.append(before[address])
        os.kill(before[address], signal.SIGKILL)

    expected = mx.LeastSquares(A, b, 2, weights)
    model = mx.LeastSquares.from_blocks((design, responses, weights), 2)
    for name in ("coefficients", "leverage") if kept else ():
        np.testing.assert_allclose(getattr(model, name), getattr(expected, name), rtol=1e-10, atol=1e-13)
    for scheme in ("lazy radius", "folds", "each datum"):
        bar = partial(Bar, kill, 2) if kept and not killed else False
        found = model.cross_validate(SCHEMES[scheme], progress=bar)
        np.testing.assert_allclose(
            found.residuals, expected.cross_validate(SCHEMES[scheme]).residuals, rtol=1e-10, atol=1e-11
        )
    assert len(set(before.values()) - set(client.run(os.getpid).values())) == 1, "none was killed"
    assert bool(killed) == kept


@pytest.mark.parametrize(
    ("name", "told", "call"),
    [
        ("blocks", "shapes", lambda A, b: (A, b[1:])),
        ("blocks", "shapes", lambda A, b: (b, b)),
        ("blocks", "complex128", lambda A, b: (A + 1j, b)),
        ("blocks", "compute_chunk_sizes", lambda A, b: (A[A[:, 0] > 0], b)),
        ("blocks", "MaskedArray", lambda A, b: (da.ma.masked_greater(A, 0), b)),
        ("blocks", "nan at row 3", lambda A, b: (da.from_array(spoiled(GOOD[0])), b)),
        ("blocks", "1e\\+304", lambda A, b: (A, da.full(N, 1e304))),
        ("blocks", "text", lambda A, b: (A, ["text"] * N)),
        ("weights", "-1", lambda A, b: (A, b, da.full(N, -1.0))),
    ],
)
def test_what_is_wrong_is_told(name, told, call):
    with pytest.raises((ValueError, TypeError), match=rf"^Invalid {name}\. .*{told}"):
        mx.LeastSquares.from_blocks(call(*spread(*GOOD)))
