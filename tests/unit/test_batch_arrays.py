"""Arrays on their way to workers: they arrive as they were, those of many problems once; results in a file."""

import os
import pickle
import signal
import subprocess
import sys
import textwrap
import threading
import time

import numpy as np
import pytest
from inputs import refused

import mexpress as mx
from mexpress.batch.agenda import Agenda
from mexpress.batch.parcels import parcel, weight
from mexpress.batch.sharing import Sharing, opened, whole
from mexpress.batch.tray import ROOM, Tray

RNG = np.random.default_rng(0)
LARGE = RNG.standard_normal((40, 60, 6))
TYPED = np.zeros(9000, [("x", "f8"), ("day", "M8[D]")])
WHOLE = {
    "same": [(LARGE, LARGE), (LARGE,)],
    "windows": [(LARGE[i : i + 9],) for i in range(31)],
    "turned": [(part.T[::-1, 1:],) for part in LARGE] * 2,
    "fields": [(TYPED,), (TYPED["day"],), (TYPED[5:9],)],
    "names": [{"a": part, "b": 1} for part in LARGE] * 2,
}
ALIKE = {
    "stack": [(part,) for part in LARGE],
    "stack and more": [(part, i) for i, part in enumerate(LARGE)],
    "by name": [{"a": part, "b": part[0].copy(), "c": str(part[0, 0])} for part in LARGE],
    "types": [(np.arange(3, dtype=">i4") + i, np.array(["a", "bc"]), np.array(i)) for i in range(9)],
    "dates": [(TYPED[i : i + 2].copy(), TYPED["day"][:5].copy()) for i in range(9)],
    "empty": [(np.zeros((0, 3)), np.zeros((3, 0), bool)) for _ in range(9)],
    "ways": [(part,) if i % 2 else {"a": part} for i, part in enumerate(LARGE)],
    "numbers": [(part, part.copy())[: 1 + i % 2] for i, part in enumerate(LARGE)],
    "shapes": [(part[i:],) for i, part in enumerate(LARGE)],
    "orders": [(part if i % 2 else np.asfortranarray(part),) for i, part in enumerate(LARGE)],
    "objects": [(np.array([i, "a", None]),) for i in range(9)],
    "nothing": [()] * 3,
    "masked": [(np.ma.masked_equal(np.arange(3), i),) for i in range(3)],
}


def arrive(calls, folder, options=None):
    """What workers get, the sources, the arrays of many problems, and the bytes that are sent of the rest of each."""
    files = iter(range(100))

    def store(array):
        path = folder / str(next(files))
        array.tofile(path)
        return path

    sharing = Sharing(calls, options or {}, store, mapped=True)
    some, refused = parcel(range(len(calls)), calls, sharing, Tray(folder / "tray"))
    assert refused == []
    sources = opened(sharing.sources)
    some = pickle.loads(pickle.dumps(some))
    found = [
        whole(pickle.loads(light) if isinstance(light, bytes) else light, sources, rows)
        for _, light, rows in some
    ]
    assert [index for index, *_ in some] == [*range(len(calls))]
    return found, sharing.sources, some.stacks, max(map(len, some.others or [b""]))


def as_calls(problems):
    return [(problem, {}) if isinstance(problem, tuple) else ((), problem) for problem in problems]


def assert_same(found, expected):
    assert type(found) is type(expected)
    if isinstance(expected, np.ndarray):
        assert found.dtype == expected.dtype
        assert found.flags.f_contiguous == expected.flags.f_contiguous
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("name", WHOLE | ALIKE)
def test_arguments_arrive_as_they_were(name, tmp_path):
    calls = as_calls((WHOLE | ALIKE)[name])
    for (args, named), (expected, by_name) in zip(arrive(calls, tmp_path)[0], calls, strict=True):
        assert len(args) == len(expected)
        assert named.keys() == by_name.keys()
        for key in by_name:
            assert_same(named[key], by_name[key])
        for one, other in zip(args, expected, strict=True):
            assert_same(one, other)


def test_what_would_be_sent_again_is_sent_once(tmp_path):
    for name, problems in WHOLE.items():
        folder = tmp_path / name
        folder.mkdir()
        _, sources, stacks, most = arrive(as_calls(problems), folder)
        assert len(sources) == 1, name
        assert stacks == {}
        assert most < 400, name
    for options, number in [({"design": LARGE}, 1), ({"design": LARGE[0]}, 0), ({}, 0)]:
        assert len(arrive([((), {}), ((), {})], tmp_path, options)[1]) == number


def test_what_is_alike_is_one_array(tmp_path):
    whole_ones = {
        "stack": [0],
        "stack and more": [0],
        "by name": ["a", "b"],
        "types": [0, 1],
        "dates": [0, 1],
    }
    for name, keys in (whole_ones | {"empty": [0, 1], "numbers": [0]}).items():
        _, sources, stacks, _ = arrive(as_calls(ALIKE[name]), tmp_path)
        assert sources == []
        assert list(stacks) == keys, name
    for name in ("ways", "shapes", "orders", "objects", "nothing", "masked"):
        assert arrive(as_calls(ALIKE[name]), tmp_path)[2] == {}, name


def test_only_what_is_sent_with_a_problem_takes_room():
    shared = [((LARGE, part.copy()), {}) for part in LARGE]
    sharing = Sharing(shared, {}, lambda array: array, mapped=False)
    assert weight(shared[0], sharing) == LARGE[0].nbytes
    agenda = Agenda(range(40), 40, 0, True)
    agenda.learn(1, 1e-6)
    assert agenda.take(1, 1.0, lambda index: 7 + index) == [*range(7)]
    assert agenda.take(1, 1.0, lambda index: 7 + index) == [*range(7, 21)]
    assert agenda.take(1, 1.0) == [*range(21, 40)]
    assert agenda.take(1, 1.0, lambda index: 1) == []


def test_a_problem_that_cannot_be_sent_leaves_the_others_as_they_are():
    calls = [((part, threading.Lock() if i == 3 else i), {}) for i, part in enumerate(LARGE)]
    some, refused = parcel(range(40), calls, Sharing(calls, {}, lambda array: array, mapped=False))
    ((index, error),) = refused
    assert (index, type(error)) == (3, TypeError)
    assert [index for index, *_ in some] == [*range(3), *range(4, 40)]
    for index, _, rows in some:
        np.testing.assert_array_equal(rows[0], LARGE[index])


def test_a_mapped_file_is_passed_as_such(tmp_path):
    np.save(tmp_path / "stack.npy", LARGE)
    mapped = np.load(tmp_path / "stack.npy", mmap_mode="r")
    calls = [((part,), {}) for part in mapped[3:7]] + [((np.asarray(mapped)[::2],), {})]
    found, sources, stacks, most = arrive(calls, tmp_path)
    assert (sources, stacks) == ([tmp_path / "stack.npy"], {})
    assert most < 400
    for (args, _), expected in zip(found, [*LARGE[3:7], LARGE[::2]], strict=True):
        np.testing.assert_array_equal(args[0], expected)
        assert not args[0].flags.writeable
    changed = np.load(tmp_path / "stack.npy", mmap_mode="c")
    changed[0] = 7  # in memory alone
    found, sources, *_ = arrive([((changed[0],), {}), ((changed[1],), {})], tmp_path)
    assert sources == []
    assert (found[0][0][0] == 7).all()


def test_no_room_is_no_failure():
    def full(array):
        raise OSError(28, "No space left on device")

    calls = as_calls(WHOLE["windows"])
    sharing = Sharing(calls, {}, full, mapped=True)
    assert sharing.sources == []
    assert_same(whole(sharing.light(*calls[0]), [], {})[0][0], LARGE[:9])


def write(array, add):
    if add:
        array += add
    return float(array.sum()), array.flags.writeable


def test_workers_get_the_numbers_and_change_no_others():
    for problems, alone in (([(part.copy(),) for part in LARGE], True), ([(LARGE,)] * 20, False)):
        found = mx.map_problems(write, problems, workers=2, add=0)
        assert found == [(float(array.sum()), alone) for (array,) in problems]
        before = LARGE.copy()
        found = mx.map_problems(write, problems, workers=2, add=1, on_error="return")
        if alone:
            assert found == [(float((array + 1).sum()), True) for (array,) in problems]
        else:
            assert all("read-only" in str(failure.error) for failure in found)
        np.testing.assert_array_equal(LARGE, before)


KEPT = []


def keep(array, number):
    """Return an array that was given, and whether those of earlier calls are what they were."""
    KEPT.append((array, number))
    return array, array[1:], number % 50 > 0 or all((earlier == given).all() for earlier, given in KEPT)


def test_what_a_function_keeps_is_its_own():
    problems = [(np.full(8, i), i) for i in range(3000)]
    found = mx.map_problems(keep, problems, workers=2)
    for (array, part, unchanged), (given, _) in zip(found, problems, strict=True):
        np.testing.assert_array_equal(array, given)
        np.testing.assert_array_equal(part, given[1:])
        assert unchanged


def test_arrays_with_and_without_room_on_a_tray_arrive():
    for size in (ROOM // 80, ROOM // 8 + 1):  # ten of which have room, and none
        problems = [(np.full(size, float(i)), i) for i in range(24)]
        assert mx.map_problems(first_and_last, problems, workers=2) == [(i, i) for i in range(24)]


def first_and_last(array, number):
    return array[0], array[-1]


# ---------------------------------------------------------------------------------------------- results in a file


def square(index, folder, array=None):
    if (folder / "fails").exists() and index % 3 == 0:
        raise ValueError(index)
    with (folder / "done").open("a") as file:
        file.write(f"{index}\n")
    return index**2, array


def cube(index, folder, array=None):
    return index * square(index, folder)[0]


def asked(folder):
    """Indices of the calls that were made since the last question."""
    if not (folder / "done").exists():
        return []
    found = sorted(map(int, (folder / "done").read_text().split()))
    (folder / "done").unlink()
    return found


@pytest.mark.parametrize("workers", [1, 2])
def test_a_run_goes_on_from_its_file(workers, tmp_path):
    file, problems = tmp_path / "results", [(i,) for i in range(10)]
    options = {"workers": workers, "resume": file, "folder": tmp_path}
    (tmp_path / "fails").touch()
    first = mx.map_problems(square, problems, on_error="return", **options)
    assert asked(tmp_path) == [1, 2, 4, 5, 7, 8]
    (tmp_path / "fails").unlink()
    seen = []
    found = mx.map_problems(square, problems, on_result=lambda *result: seen.append(result), **options)
    assert found == [(i**2, None) for i in range(10)]
    assert sorted(seen) == list(enumerate(found))
    assert asked(tmp_path) == [0, 3, 6, 9]
    assert [result for result in first if not isinstance(result, mx.Failure)] == [
        found[i] for i in (1, 2, 4, 5, 7, 8)
    ]
    assert mx.map_problems(square, problems, **options) == found
    assert asked(tmp_path) == []


def test_results_of_other_calls_are_not_taken(tmp_path):
    file, arrays = tmp_path / "results", [LARGE[0].copy(), LARGE[0].copy()]

    def run(function=square, **more):
        given = {"problems": [(0, tmp_path, arrays[0]), (1, tmp_path, arrays[1])], **more}
        mx.map_problems(function, workers=1, resume=file, **given)
        return asked(tmp_path)

    assert run() == [0, 1]
    assert run() == []
    arrays[1][3, 4] += 1e-12
    assert run() == [1]
    assert run(problems=[(2, tmp_path, arrays[0]), (1, tmp_path, arrays[1]), (5, tmp_path)]) == [2, 5]
    assert run(function=cube) == [0, 1]


@pytest.mark.parametrize("workers", [1, 2])
def test_a_result_that_cannot_be_kept_is_a_failure(workers, tmp_path):
    options = {"workers": workers, "resume": tmp_path / "results", "at": 1}
    problems = [(i,) for i in range(4)]
    with pytest.raises(TypeError, match=r"The result cannot be pickled: .*lock") as caught:
        mx.map_problems(lock_at, problems, **options)
    assert caught.value.__notes__ == ["This was problem 1 (from 0) of 4."]
    found = mx.map_problems(lock_at, problems, on_error="return", **options)
    assert [found[i] for i in (0, 2, 3)] == [0, 2, 3]
    assert found[1].index == 1
    assert "The result cannot be pickled" in str(found[1].error)
    assert "lock" in found[1].traceback


def lock_at(index, at):
    return threading.Lock() if index == at else index


class Scale:
    """What a method belongs to."""

    def __init__(self, factor):
        self.factor = factor

    def times(self, number):
        """Return a multiple."""
        return self.factor * number


def test_results_of_methods_of_other_objects_are_not_taken(tmp_path):
    for factor in (2, 3, 2):
        found = mx.map_problems(Scale(factor).times, [(1,), (2,)], workers=1, resume=tmp_path / "results")
        assert found == [factor, 2 * factor]


def test_a_record_that_was_being_written_is_done_again_and_the_file_is_whole(tmp_path):
    file = tmp_path / "results"
    mx.map_problems(square, [(i,) for i in range(4)], workers=1, resume=file, folder=tmp_path)
    asked(tmp_path)
    content = file.read_bytes()
    for damaged in (content[:-1], content[:-60], content[:-9] + bytes(9), content[:20], b""):
        file.write_bytes(damaged)
        found = mx.map_problems(square, [(i,) for i in range(4)], workers=1, resume=file, folder=tmp_path)
        assert found == [(i**2, None) for i in range(4)]
        assert 3 in asked(tmp_path)
        assert file.read_bytes() == content


def test_a_file_of_something_else_is_refused_and_left_as_it_is(tmp_path):
    for content in (b"x,y\n1,2\n", b"mexpress 0.0.1: results of map_problems\n", bytes(100)):
        (tmp_path / "data.csv").write_bytes(content)
        text = refused(
            lambda: mx.map_problems(square, [(1,)], resume=tmp_path / "data.csv", folder=tmp_path), "resume"
        )
        assert "data.csv" in text
        assert (tmp_path / "data.csv").read_bytes() == content
    with pytest.raises(FileNotFoundError):
        mx.map_problems(square, [(1,)], resume=tmp_path / "nowhere" / "results", folder=tmp_path)


INTERRUPTED = """
    import sys, time
    sys.path = {path}
    import mexpress as mx
    from pathlib import Path
    import test_batch_arrays as t
    folder = Path({folder!r})
    problems = [(i, folder) for i in range(60)]
    mx.map_problems(t.slow_square, problems, workers=2, resume=folder / "results",
                    on_result=lambda index, _: print(index, flush=True))
"""


def slow_square(index, folder):
    time.sleep(0.05)
    return square(index, folder)


@pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_run_repeats_nothing_that_it_has_told(how, tmp_path):
    code = textwrap.dedent(INTERRUPTED.format(path=sys.path, folder=str(tmp_path)))
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        told = {int(process.stdout.readline()) for _ in range(10)}
        process.send_signal(how)
        told |= set(map(int, process.stdout.read().split()))
    assert len(told) < 60
    asked(tmp_path)
    found = mx.map_problems(
        slow_square, [(i, tmp_path) for i in range(60)], workers=2, resume=tmp_path / "results"
    )
    assert found == [(i**2, None) for i in range(60)]
    assert not told & set(asked(tmp_path))


def test_a_lambda_is_known_by_what_it_does(tmp_path):
    file = tmp_path / "results"
    assert mx.map_problems(lambda x: x + 1, [(1,)], workers=1, resume=file) == [2]
    assert mx.map_problems(lambda x: x + 2, [(1,)], workers=1, resume=file) == [3]
