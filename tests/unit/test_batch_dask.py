"""The same by Dask, on a cluster of processes, of which one is killed."""

import os
import signal
import time

import numpy as np
import pytest
from clusters import client_of
from test_batch_faults import die_always, die_once, done, fail_at_first, root, sleep

import mexpress as mx

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("default")]  # Dask warns of what is killed


@pytest.fixture(scope="module")
def client():
    with client_of(2) as client:
        yield client


def total(design, index, scale=None):
    return os.getpid(), float((design[index] * scale).sum()), design.flags.writeable


def test_small_problems_go_many_at_a_time_and_arrays_once(client):
    design = np.random.default_rng(0).standard_normal((400, 300))
    scale = np.linspace(0, 1, 300)
    start = time.monotonic()
    found = mx.map_problems(total, [(design, i % 400) for i in range(2000)], client=client, scale=scale)
    seconds = time.monotonic() - start
    assert [value for _, value, _ in found] == [float((design[i % 400] * scale).sum()) for i in range(2000)]
    assert len({pid for pid, *_ in found} - {os.getpid()}) == 2
    assert not any(writeable for *_, writeable in found)
    assert seconds < 20  # a gigabyte is sent if the design is sent each time


def test_errors_retries_and_timeouts(client, tmp_path):
    found = mx.map_problems(
        root, [(i,) for i in range(12)], client=client, on_error="return", folder=tmp_path
    )
    assert [i for i, result in enumerate(found) if isinstance(result, mx.Failure)] == [3, 8]
    assert found[8].error.args == ("no root of -8",)
    assert "in root" in found[8].traceback
    assert done(tmp_path) == dict.fromkeys(range(12), 1)
    again = mx.map_problems(
        fail_at_first, [(i,) for i in range(4)], client=client, retries=1, folder=tmp_path, times=1
    )
    assert again == [0, 1, 2, 3]
    found = mx.map_problems(
        sleep, [(i,) for i in range(6)], client=client, on_error="return", timeout=0.3, at=[2], seconds=3
    )
    assert isinstance(found[2].error, TimeoutError)
    assert [found[i] for i in (0, 1, 3, 4, 5)] == [0, 1, 3, 4, 5]


def test_a_lambda_and_what_cannot_be_sent(client):
    assert mx.map_problems(lambda x: x + 1, [(1,), (2,)], client=client) == [2, 3]
    found = mx.map_problems(generator_at, [(i,) for i in range(30)], client=client, on_error="return", at=17)
    assert [i for i, result in enumerate(found) if isinstance(result, mx.Failure)] == [17]


def generator_at(index, at):
    return (i for i in ()) if index == at else index


def test_a_killed_worker_loses_nothing_and_repeats_nothing_that_had_come(client, tmp_path):
    seen = []
    found = mx.map_problems(
        die_once,
        [(i,) for i in range(30)],
        client=client,
        on_result=lambda index, _: seen.append(index),
        folder=tmp_path,
        seconds=0.1,
        at=11,
    )
    assert (tmp_path / "killed").exists()
    assert [index for index, _ in found] == [*range(30)]
    assert sorted(seen) == [*range(30)]
    assert all(times <= 2 for times in done(tmp_path).values())
    assert sum(done(tmp_path).values()) <= 31  # what was done, and not fetched yet


def test_all_workers_are_killed_and_what_they_were_sent_once_is_sent_again(client):
    killed = []

    def kill(index, result):
        if len(killed) < 2 and result[0] not in killed:
            killed.append(result[0])
            os.kill(result[0], signal.SIGKILL)

    design = np.random.default_rng(0).standard_normal((400, 300))
    found = mx.map_problems(
        slow_total, [(design, i) for i in range(40)], client=client, on_result=kill, scale=2.0
    )
    assert len(killed) == 2
    assert [value for _, value, _ in found] == [float((design[i] * 2.0).sum()) for i in range(40)]


def slow_total(design, index, scale):
    time.sleep(0.1)
    return total(design, index, scale)


def test_a_problem_that_always_kills_is_a_failure(client):
    found = mx.map_problems(die_always, [(i,) for i in range(40)], client=client, on_error="return", at=7)
    assert [i for i, result in enumerate(found) if isinstance(result, mx.Failure)] == [7]
    assert "KilledWorker" in repr(found[7].error)
